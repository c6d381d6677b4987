"""Base class of the kinds of structures, and the pressures of their interfaces."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import pi, radians, sqrt, tan
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import numpy as np

from multiscale.errors import CaseError
from multiscale.fe.faces import face_of
from multiscale.macro import substructures
from multiscale.macro.data_range import FAR_FACTOR
from multiscale.pipeline.tables.toml_model import Settings
from multiscale.units import readable

if TYPE_CHECKING:
    from skfem import Mesh

    from multiscale.pipeline.stage import Datasets, Job
    from multiscale.pipeline.tables.settings import Case
    from multiscale.schema import Dataset

SPREAD = tan(radians(30.0))  # slope of the cone in which a force spreads from its face
BENDING = 6.0  # pressure at the edge of a rectangle over its moment per area and width


class Face(NamedTuple):
    """Area, m², centroid, m, shape (3,), and mean outward normal, shape (3,), of a boundary."""

    area: float
    centroid: np.ndarray
    normal: np.ndarray

    @classmethod
    def at(cls, mesh: "Mesh", boundary: str) -> "Face":
        """Measure a boundary of a mesh."""
        surface = face_of(mesh, boundary)
        x, normals = surface.position[surface.facets], surface.normals
        areas = np.linalg.norm(normals, axis=1)
        mean = normals.sum(axis=0) / areas.sum()
        return cls(float(areas.sum()), areas @ x.mean(axis=1) / areas.sum(), mean)


def highest_pressure(interface: Face, forces: Iterable[tuple[np.ndarray, Face]]) -> float:
    """Estimate the largest pressure by forces on faces, each in its cone, and their moments, Pa."""
    width, total = sqrt(interface.area), 0.0
    for force, face in forces:
        arm = face.centroid - interface.centroid
        moment = float(np.linalg.norm(np.cross(arm, force)))
        cone = pi * (sqrt(face.area / pi) + SPREAD * float(np.linalg.norm(arm))) ** 2
        pressing = float(np.linalg.norm(force)) + BENDING * moment / width
        # sum of (|F| + 6 |r x F| / w) / min(A, A_cone) with area A and width w of the interface
        total += pressing / min(interface.area, cone)
    return total


OF_CELLS = (
    "pressures in [micro]",
    "press the cells at such pressures by pressures in [micro], or set extrapolate = true in [law]",
)
"""Source of the data of a law of cells, and the remedy for a range that is too narrow."""

Range = tuple[float, float]


class Pressed(NamedTuple):
    """Nominal pressures of an interface, estimated from the loads before the solution."""

    loading: str  # loads and interface, in words, up to the verb
    steps: Sequence[Range]  # least and largest pressure at each load step, Pa
    law: Path | None = None  # law of this interface, in place of the law of the case
    stated: Range | None = None  # pressures of a stated law, Pa


def far_loads(pressed: Pressed, data: Range, source: str, remedy: str) -> Iterator[str]:
    """Report loads that press an interface far outside the data of its law at every step."""
    least, most = data[0] / FAR_FACTOR, data[1] * FAR_FACTOR
    if any(high >= least and low <= most for low, high in pressed.steps):
        return
    ends = min(low for low, _ in pressed.steps), max(high for _, high in pressed.steps)
    yield (
        f"{pressed.loading} by about {_format_range(ends)}, more than a factor of {FAR_FACTOR:g} "
        f"outside the pressures of its law, {_format_range(data)} ({source}), so all "
        f"answers would be unknown; {remedy}"
    )


def far_cells(kind: "StructureKind", case: "Case") -> Iterator[str]:
    """Report loads with pressures far outside the pressures of the cells at every step."""
    if not case.has_cells or case.extrapolate or case.adaptive:
        return
    for pressed in kind.pressed(case):
        data = case.micro.pressures[0], case.micro.pressures[-1]
        if pressed.law is None and pressed.stated is None:
            yield from far_loads(pressed, data, *OF_CELLS)


def _format_range(ends: Range) -> str:
    return " to ".join(dict.fromkeys(readable(f"{end:.2g} Pa") for end in ends))


class StructureKind(Settings):
    """The table ``[structure]`` of a case; a kind also has a method ``build``."""

    stage: ClassVar[str]  # name of the stage that solves it
    asks: ClassVar[tuple[tuple[str, ...], ...]]  # allowed sets of tables
    models: ClassVar[Mapping[str, type[Settings]]] = {}
    """Models of tables with keys that depend on the kind."""
    may_be_cut: ClassVar[bool] = False  # whether ``[substructures]`` may cut it
    may_tire: ClassVar[bool] = False
    """Whether ``[fatigue]`` and ``[growth]`` may follow its elements."""
    quick_note: ClassVar[str] = ""
    """Sentence about settings that ``--quick`` leaves unchanged."""
    of_bodies: ClassVar[bool] = False  # whether it is made of ``[body_1]`` and ``[body_2]``

    @property
    def interface_width(self) -> float | None:
        """Edge of an interface under even pressure, m; None for other structures."""
        return None

    @property
    def file_meshes(self) -> tuple[bool, ...]:
        """Whether a coarser mesh is given, for every mesh that is read from a file."""
        return ()

    def refinement(self) -> float:
        """Return the ratio of element sizes with twice the given size; 1 if they are equal."""
        return 2.0

    def faults_with(self, case: "Case") -> Iterator[str]:
        """Yield sentences on other tables that the structure does not support."""
        yield from ()

    def for_solver(self, case: "Case") -> Any:
        """Return the structure for the stage that solves it."""
        return self

    def pressed(self, case: "Case") -> list[Pressed]:
        """Estimate the nominal pressures of the interfaces; nothing without interfaces."""
        return []

    def point_pressures(self, result: "Dataset") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return pressures of points, (steps, points), Pa, their areas, and their interfaces."""
        area, number = (result[name].to_numpy() for name in ("point_area", "point_joint"))
        return -result["traction"].to_numpy()[..., 0], area, number.astype(int)

    def with_wide_cells(self, case: "Case") -> "Case":
        """Return a case with cells as wide as the interface, if possible."""
        raise CaseError(
            'way = "direct" in [interface] resolves the roughness of a whole interface, which is '
            'possible for [structure] kind = "blocks"; take "adaptive" or "concurrent"'
        )

    def taken_laws(self, case: "Case") -> set[tuple[Path, bool]]:
        """Return files of laws, and whether a case among them is run quick."""
        return {named for named in self.named_laws(case) if named is not None}

    def named_laws(self, case: "Case") -> "Sequence[tuple[Path, bool] | None]":
        """Return the named law of each interface, or of all; None for the law of the cells."""
        source = None if case.makes_law else case.interface
        return [None if source is None or source.law is None else (source.law, source.quick)]

    def taken_volumes(self) -> set[tuple[Path, bool]]:
        """Return files of volumes, and whether a case among them is run quick."""
        return set()

    def cut(self, case: "Case", datasets: "Datasets", job: "Job") -> "substructures.CutProblem":
        """Cut the structure into its substructures, if it may be cut."""
        raise CaseError(f"substructures do not cut a structure of stage {self.stage}")

    def quick_title(self) -> str:
        """Return the remark after the title of a quick case."""
        return "quick"

    def within(self, case: "Case") -> Self:
        """Return the structure of a quick case, limited by the other tables of the case."""
        return self
