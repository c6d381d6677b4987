"""What a case may say of elastic bodies: blocks, plate, stacked blocks, lap joint."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from multiscale import macro
from multiscale.fe.boxes import box_mesh
from multiscale.laws.bulk import Elastic
from multiscale.macro import substructures
from multiscale.macro.data_range import FAR_FACTOR
from multiscale.pipeline.joint_settings import LawSource, RisingPreloads
from multiscale.pipeline.link_settings import Statics
from multiscale.pipeline.rve_settings import Direction
from multiscale.pipeline.structure_kind import Pressed, StructureKind, refuse_far_cells
from multiscale.pipeline.toml_model import Density, Length, Positive, Pressure, Ratio, Settings

if TYPE_CHECKING:
    from multiscale.pipeline.settings import Case
    from multiscale.pipeline.stage import Datasets, Job

__all__ = ["COARSER", "Blocks", "Material", "Plate", "doubt_density", "fewer"]

COARSER = 1.2
"""Ratio of the sizes of elements below which two meshes tell no error."""

SOLID_DENSITIES = (10.0, 23e3)
"""Densities of solids, from foams to osmium, kg/m3."""

QUICK_ELEMENTS = 4
"""Elements along an edge, at most."""

Edges = tuple[Length, Length, Length]
Elements = tuple[Positive, Positive, Positive]


class Blocks(StructureKind):
    """Two blocks pressed together, evenly, of the materials of both bodies."""

    stage: ClassVar[str] = "joint"
    asks: ClassVar[tuple[tuple[str, ...], ...]] = (("statics",), ("interface", "statics"))
    models: ClassVar[Mapping[str, type[Settings]]] = {
        "interface": LawSource,
        "statics": RisingPreloads,
    }
    of_bodies: ClassVar[bool] = True

    kind: Literal["blocks"]
    height: Length = Field(description="Height of each block, m.")
    width: Length = Field(description="Edge of their square section, m.")

    @property
    def interface_width(self) -> float:
        """Edge of the interface, m."""
        return self.width

    def check(self, case: "Case") -> None:
        """Refuse a joint that the cells will tell nothing of."""
        refuse_far_cells(self, case)
        if case.accuracy is None or case.accuracy.quantity != "joint_stiffness":
            return
        p = case.micro.pressures
        low, high = p[0] / FAR_FACTOR, p[-1] * FAR_FACTOR
        far = [preload for preload in case.statics.preloads if not low <= preload <= high]
        if far:
            raise ValueError(
                f"preloads in [statics] of {', '.join(f'{1e-6 * one:g}' for one in far)} MPa lie "
                f"more than a factor of {FAR_FACTOR:g} outside the pressures in [micro], "
                f"{1e-6 * p[0]:g} to {1e-6 * p[-1]:g} MPa: "
                f"the joint would be unknown there; press the cells at such pressures"
            )

    def pressed(self, case: "Case") -> list[Pressed]:
        """Return the preloads, which press the interface evenly."""
        return [Pressed("preloads in [statics] press the joint", case.statics.even)]


def doubt_density(what: str, density: float | None) -> list[str]:
    """Return a caution if no solid has a density, kg/m3."""
    low, high = SOLID_DENSITIES
    if density is None or low <= density <= high:
        return []
    return [
        f"{what} has a density of {density:.4g} kg/m^3, and solids have {low:g} to {high:g} "
        f"kg/m^3; check its unit, as in 7.85 g/cm^3 or 7850 kg/m^3"
    ]


class Material(Settings):
    """What an elastic body is made of: moduli or a representative volume."""

    youngs_modulus: Pressure | None = None
    """Young's modulus, Pa; the stiffness of a representative volume if not given."""
    poissons_ratio: Ratio | None = None
    """Poisson's ratio; together with the modulus."""
    density: Density | None = Field(None, description="Density, kg/m3; [vibration] needs it.")
    rve: Path | None = None
    """Representative volume: a dataset `rve`, the folder of a run, or a case, which is run in a
    folder of its own; the `[rve]` of this case if not given, nor the moduli."""
    rve_axes: tuple[Direction, Direction] | None = None
    """Directions of the x and the y axis of the volume in the body; its own axes if not given."""

    @model_validator(mode="after")
    def _check_material(self) -> Self:
        if (self.youngs_modulus is None) != (self.poissons_ratio is None):
            raise ValueError("youngs_modulus and poissons_ratio belong together; give both or none")
        if not self.porous and self.rve is not None:
            raise ValueError("takes either its moduli or rve, whose volume has moduli of its own")
        if self.rve_axes is not None:
            first, second = np.array(self.rve_axes, dtype=float)
            norms = np.linalg.norm(first) * np.linalg.norm(second)
            if not (norms > 0.0 and abs(first @ second) < 1e-3 * norms):
                told = " and ".join(f"{list(one)}" for one in self.rve_axes)
                raise ValueError(f"rve_axes are two directions at right angles, got {told}")
        return self

    @property
    def moduli(self) -> tuple[float, float]:
        """Young's modulus, Pa, and Poisson's ratio of a body that is not porous."""
        assert self.youngs_modulus is not None
        assert self.poissons_ratio is not None
        return self.youngs_modulus, self.poissons_ratio

    @property
    def porous(self) -> bool:
        """Whether a representative volume gives its stiffness."""
        return self.youngs_modulus is None

    @property
    def axes(self) -> np.ndarray:
        """Axes of the representative volume in the body, as columns, shape (3, 3)."""
        if self.rve_axes is None:
            return np.eye(3)
        first, second = np.array(self.rve_axes, dtype=float)
        first = first / np.linalg.norm(first)
        second = second - (second @ first) * first
        second = second / np.linalg.norm(second)
        return np.stack([first, second, np.cross(first, second)], axis=1)


class Plate(StructureKind):
    """An elastic plate, clamped on its left and right edges, under an even pressure on its top."""

    stage: ClassVar[str] = "plate"
    asks: ClassVar[tuple[tuple[str, ...], ...]] = (("statics",),)
    models: ClassVar[Mapping[str, type[Settings]]] = {"statics": Statics}
    may_be_cut: ClassVar[bool] = True

    kind: Literal["plate"]
    size: Edges = Field(description="Lengths along x, y and z, m.")
    elements: Elements = Field(description="Hexahedra along x, y and z.")
    youngs_modulus: Pressure = Field(description="Young's modulus, Pa.")
    poissons_ratio: Ratio = Field(description="Poisson's ratio.")
    pressure: Pressure = Field(description="Pressure on the top at load factor one, Pa.")

    def build(self) -> "macro.Assembly":
        """Clamp the plate and load it."""
        clamped = (0.0, 0.0, 0.0)
        plate = macro.Body(
            box_mesh(self.size, self.elements),
            Elastic(self.youngs_modulus, self.poissons_ratio),
            supports={"left": clamped, "right": clamped},
            tractions={"top": (0.0, 0.0, -self.pressure)},
        )
        return macro.Assembly((plate,))

    def cut(self, case: "Case", found: "Datasets", job: "Job") -> "substructures.CutProblem":
        """Cut the plate into boxes."""
        return substructures.cut_assembly(self.build(), case.cut.parts)

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        x, y, z = self.elements
        return (x + 1) * (y + 1) * (z + 1)

    def check(self, case: "Case") -> None:
        """Refuse large displacements."""
        case.statics.refuse_large()

    def quick(self, case: "Case") -> Self:
        """Return the same plate with four elements along an edge."""
        return self.model_copy(update={"elements": fewer(self.elements)})


def fewer(elements: Elements) -> Elements:
    """Return at most four elements along each edge."""
    x, y, z = (min(QUICK_ELEMENTS, number) for number in elements)
    return x, y, z
