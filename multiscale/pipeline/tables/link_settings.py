"""Tables of bars and cables: their structures, loads and motion."""

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from functools import partial
from itertools import pairwise
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, PlainSerializer, field_validator

from multiscale import macro
from multiscale.errors import CaseError
from multiscale.io.csv_tables import finite, read_table
from multiscale.io.meshes import open_mesh
from multiscale.laws.link import Bar, Beam, Cable, LinkLaw, Strut
from multiscale.macro import substructures
from multiscale.pipeline.tables import toml_model as toml
from multiscale.pipeline.tables.structure_kind import StructureKind
from multiscale.units import to_si

if TYPE_CHECKING:
    from multiscale.pipeline.stage import Datasets, Job
    from multiscale.pipeline.tables.settings import Case

QUICK = 4  # modules or meshes each way

ELEMENTS = 4
"""Smallest number of elements along an axis of a plate of modules with reliable intervals."""

COARSE, FINE, FEWER = 2, 8, 0.5
"""Fewest modules of a specimen, and most of a grid, along an axis of an element, and the largest
ratio of the modules of a specimen to the modules of a grid along an axis."""

LAWS: dict[str, type[LinkLaw]] = {"bar": Bar, "cable": Cable, "strut": Strut}


def _read_rigidity(value: object, *, unit: str) -> float:
    if value == "inextensible":
        return inf
    try:
        return to_si(value, unit)
    except CaseError as error:
        raise ValueError(f'{error}, or "inextensible"') from error


Force = Annotated[float, toml.quantity("N"), toml.with_unit("N")]
Prestress = Annotated[Force, Field(ge=0.0)]
Bending = Annotated[float, toml.quantity("N m^2"), Field(gt=0.0), toml.with_unit("N m^2")]
Size = Annotated[Force, Field(gt=0.0)]
Modules = Annotated[toml.Count, Field(ge=1, le=2048)]  # 2048 x 2048 take some 50 GB
Several = Annotated[toml.Count, Field(ge=2, le=4096)]
Rigidity = Annotated[
    float,
    BeforeValidator(partial(_read_rigidity, unit="N")),
    Field(gt=0.0),
    PlainSerializer(lambda value: f"{value!r} N" if isfinite(value) else "inextensible"),
]
OF_SPAN = toml.Quick(lambda grid, tension: tension * (min(QUICK, grid.n) / grid.n) ** 2)
"""Prestress of quick grids: proportional to the square of the span, as the tensions under the load,
so that the share of slack cables stays."""
Instant = Annotated[float, toml.quantity("s"), Field(ge=0.0), toml.with_unit("s")]
Mass = Annotated[float, toml.quantity("kg"), Field(gt=0.0), toml.with_unit("kg")]


class Statics(toml.Settings):
    """Loads on bars, cables and plates; see :func:`multiscale.macro.solve_static`."""

    load_factors: tuple[toml.Number, ...] = Field(min_length=1)
    """Load of every step over the whole load."""
    exact: bool = False
    """Whether elongations and directions follow the moved nodes exactly."""
    stability: bool = False
    """Whether to add smallest eigenvalues of the tangent."""
    past_limit: bool = False
    """Whether to follow the equilibrium of bars and cables from rest to a single load factor, also
    with falling loads, as after snap-through, with the critical load factor; with `exact`. See
    `multiscale.macro.solve_past_limit`."""

    mass: Mass | None = None
    """Mass of each node, kg, for the first frequencies of small vibration at every load factor;
    beams also have rotary inertia. See `multiscale.macro.links.natural_frequencies`."""

    def _faults(self) -> Iterator[str]:
        if self.exact and self.mass is not None:
            yield "frequencies need small displacements: leave out exact or mass"
        if not self.past_limit:
            return
        if not self.exact or self.stability:
            yield (
                "past_limit needs exact positions and has the smallest eigenvalue: set exact to "
                "true, and leave out stability"
            )
        if len(self.load_factors) != 1 or self.load_factors[0] == 0.0:
            yield (
                f"past_limit needs a single load factor that is not zero, got "
                f"{list(self.load_factors)}"
            )


class LinkStructure(StructureKind):
    """Bars and cables, at rest or in motion."""

    stage: ClassVar[str] = "links"
    asks: ClassVar[tuple[tuple[str, ...], ...]] = (("statics",), ("dynamics",))
    models: ClassVar[Mapping[str, type[toml.Settings]]] = {"statics": Statics}
    prestressed: ClassVar[bool] = False
    """Whether the prestress of links of a cut structure resists their rotation."""

    @abstractmethod
    def build(self) -> "macro.LinkSystem":
        """Build the structure."""

    def cut(self, case: "Case", datasets: "Datasets", job: "Job") -> "substructures.CutProblem":
        """Cut the links into boxes."""
        system = self.build()
        owner = substructures.split_grid(system, case.cut.parts)
        return macro.cut_links(system, owner, prestressed=self.prestressed)

    def modules(self, parts: tuple[int, int]) -> tuple["macro.links.EquivalentPlate", ...]:
        """Return the plate of the modules of substructures, and its specimen, if any."""
        return ()

    def faults_with(self, case: "Case") -> Iterator[str]:
        """Report options that are wrong for a cut structure."""
        if case.substructures is None:
            return
        if case.dynamics and (case.dynamics.theta, case.dynamics.restitution) != (1.0, 0.0):
            yield "substructures move by implicit steps: leave out theta and restitution"
        if case.statics and (case.statics.exact or case.statics.stability):
            yield "substructures have small displacements: leave out exact and stability"
        if case.statics and case.statics.mass is not None:
            yield "substructures have no frequencies at rest: leave out mass"


class TensegrityGrid(LinkStructure):
    """A double-layer grid; see :func:`multiscale.macro.tensegrity_grid`."""

    may_be_cut: ClassVar[bool] = True

    kind: Literal["tensegrity_grid"]
    n: Annotated[Modules, toml.at_most(QUICK)] = Field(description="Modules along x.")
    m: Annotated[Modules | None, toml.at_most(QUICK)] = None
    """Modules along y; n if not given."""
    prestress: Annotated[Prestress, OF_SPAN] = 2550.0
    """Tension of the upper cables at load factor 0, N."""
    size: toml.Length = Field(1.0, description="Edge of a module, m.")
    height: toml.Length = Field(0.5, description="Height of a module, m.")
    cable_rigidity: Rigidity = Field(4e6, description='EA of the cables, N, or `"inextensible"`.')
    bar_rigidity: Rigidity = Field(8e7, description='EA of the bars, N, or `"inextensible"`.')
    nodal_load: Force = Field(40.0, description="Weight on every node at load factor 1, N.")

    def build(self) -> "macro.LinkSystem":
        """Build the grid."""
        same = self.model_dump(include={"n", "m", "prestress", "size", "height", "nodal_load"})
        return macro.tensegrity_grid(
            cable=Cable(self.cable_rigidity), bar=Bar(self.bar_rigidity), **same
        )

    def plate(self, elements: tuple[int, int]) -> "macro.links.EquivalentPlate":
        """Build the plate of the modules of the grid."""
        module = self.model_copy(update={"n": 1, "m": 1}).build()
        cell = macro.links.plate_cell(module, (self.size, self.size))
        return macro.links.EquivalentPlate(self.build(), cell, elements)

    def modules(self, parts: tuple[int, int]) -> tuple["macro.links.EquivalentPlate", ...]:
        """Return the plate of all modules, and of the smallest sufficient specimen, if any."""
        n, m = self.n, self.m or self.n
        most = max(n / parts[0], m / parts[1])
        if inf in (self.cable_rigidity, self.bar_rigidity) or min(parts) < ELEMENTS or most > FINE:
            return ()
        for across in range(COARSE * parts[0], int(FEWER * n) + 1, parts[0]):
            # whole modules in every element, in the shape of the grid
            along, rest = divmod(across * m, n)
            if not rest and along % parts[1] == 0 and along >= COARSE * parts[1]:
                fewer = {"n": across, "m": along, "prestress": self.prestress * (across / n) ** 2}
                return self.plate(parts), self.model_copy(update=fewer).plate(parts)
        return ()


class EquivalentPlate(StructureKind):
    """The plate equivalent to a grid; see :class:`multiscale.macro.links.EquivalentPlate`."""

    stage: ClassVar[str] = "equivalent_plate"
    asks: ClassVar[tuple[tuple[str, ...], ...]] = (("statics",),)
    models: ClassVar[Mapping[str, type[toml.Settings]]] = {"statics": Statics}

    kind: Literal["equivalent_plate"]
    links: TensegrityGrid
    """The grid, with its modules as cells of the plate, its supports and its loads."""
    elements: Annotated[tuple[Modules, Modules] | None, toml.Quick(lambda *_: None)] = None
    """Elements of the plate along x and y; one element for each module if not given."""
    resolve: bool = True
    """Whether the links are solved too, for the error of the plate."""

    @property
    def divisions(self) -> tuple[int, int]:
        """Elements of the plate along x and y, or its modules."""
        return self.elements or (self.links.n, self.links.m or self.links.n)

    def build(self) -> "macro.links.EquivalentPlate":
        """Build the plate, its cell and its links."""
        return self.links.plate(self.divisions)

    def faults_with(self, case: "Case") -> Iterator[str]:
        """Report links of fixed length and large displacements."""
        if inf in (self.links.cable_rigidity, self.links.bar_rigidity):
            yield "an equivalent plate has extensible links: give a finite rigidity"
        if case.statics.exact or case.statics.stability:
            yield "an equivalent plate has small displacements: leave out exact and stability"


class CableNet(LinkStructure):
    """A prestressed saddle; see :func:`multiscale.macro.cable_net`."""

    may_be_cut: ClassVar[bool] = True
    prestressed: ClassVar[bool] = True

    kind: Literal["cable_net"]
    n: Annotated[Several, toml.at_most(QUICK)] = Field(description="Meshes along x.")
    m: Annotated[Several | None, toml.at_most(QUICK)] = None
    """Meshes along y; n if not given."""
    mesh: toml.Length = Field(1.0, description="Distance of the cables in plan, m.")
    rise: toml.Length = Field(1.0, description="Height of the saddle, m.")
    prestress: Size = 10e3
    """Horizontal part of every tension at load factor 0, N."""
    cable_rigidity: Rigidity = Field(1e7, description='EA of the cables, N, or `"inextensible"`.')
    nodal_load: Force = 100.0
    """Weight on every inner node at load factor 1, N."""

    def build(self) -> "macro.LinkSystem":
        """Build the net."""
        same = self.model_dump(include={"n", "m", "mesh", "rise", "prestress", "nodal_load"})
        return macro.cable_net(cable=Cable(self.cable_rigidity), **same)


class LinkLawSettings(toml.Settings):
    """The law of some links."""

    kind: Literal["bar", "cable", "strut", "beam"]
    """Kind of link: bars carry tension and compression, cables only tension, struts only
    compression; beams also bend and twist, and their nodes rotate."""
    rigidity: Rigidity = Field(description='EA, N, or `"inextensible"`.')
    torsion: Bending | None = None
    """GJ of a beam, N m²."""
    bending_y: Bending | None = None
    """EI of a beam about its second local axis, N m²."""
    bending_z: Bending | None = None
    """EI of a beam about its third local axis, N m²."""
    up: tuple[toml.Number, toml.Number, toml.Number] | None = None
    """Vector in the plane of the axis of a beam and its third local axis; z if not given."""

    def _faults(self) -> Iterator[str]:
        section = {name: getattr(self, name) for name in ("torsion", "bending_y", "bending_z")}
        if self.kind == "beam":
            if missing := [name for name, value in section.items() if value is None]:
                yield f"a beam needs its section: give {', '.join(missing)} in N m^2, or take a bar"
        elif self.up is not None or any(value is not None for value in section.values()):
            yield f"a {self.kind} does not bend: leave out the section, or take a beam"

    def build(self) -> LinkLaw:
        """Return the law."""
        if self.torsion is None or self.bending_y is None or self.bending_z is None:
            return LAWS[self.kind](self.rigidity)
        up = self.up or (0.0, 0.0, 1.0)
        return Beam(self.rigidity, self.torsion, self.bending_y, self.bending_z, up=up)


Laws = Annotated[dict[str, LinkLawSettings], Field(min_length=1)]


class GivenLinks(LinkStructure):
    """Links from a file, with their laws and possibly a self-stress."""

    may_be_cut: ClassVar[bool] = True

    laws: Laws
    self_stress: bool = False
    """Whether to compute a state of self-stress that the links can carry, in place of a column
    `prestress`; see `multiscale.macro.prestress_by_itself`."""
    prestress: Size | None = None
    """Largest force in a link at load factor zero, N; with `self_stress`."""

    def _faults(self) -> Iterator[str]:
        if self.self_stress != (self.prestress is not None):
            yield "give both self_stress = true and prestress, or neither"

    def faults_with(self, case: "Case") -> Iterator[str]:
        """Report beams in substructures and in motion."""
        yield from super().faults_with(case)
        if not any(law.kind == "beam" for law in self.laws.values()):
            return
        if case.substructures is not None:
            yield (
                "substructures are cut through bars and cables: leave out [substructures], or take "
                "bars for the beams"
            )
        if case.dynamics:
            yield (
                "[dynamics] has masses but no rotary inertias, which the nodes of beams need: "
                "solve beams by [statics], or take bars"
            )

    @abstractmethod
    def read(self, laws: dict[str, LinkLaw]) -> "macro.LinkSystem":
        """Read the structure with its laws."""

    def build(self) -> "macro.LinkSystem":
        """Build the structure of the files."""
        system = self.read({name: law.build() for name, law in self.laws.items()})
        if self.prestress is None:
            return system
        return macro.prestress_by_itself(system, self.prestress)


class LinkTable(GivenLinks):
    """Two tables in SI units (CSV with any separator); see `multiscale.macro.system_from_table`."""

    kind: Literal["table"]
    nodes: Path = Field(description="Table of nodes.")
    links: Path = Field(description="Table of links.")

    def read(self, laws: dict[str, LinkLaw]) -> "macro.LinkSystem":
        """Read the tables."""
        kinds: dict[str, Any] = {"first": int, "second": int, "group": int, "law": str}
        links = read_table(self.links, lambda name: kinds.get(name, finite))
        return macro.system_from_table(read_table(self.nodes), links, laws)


class LinkMesh(GivenLinks):
    """The lines of a mesh file; see :func:`multiscale.macro.system_from_mesh`."""

    kind: Literal["mesh"]
    file: Path
    """Mesh file of gmsh, Salome, Abaqus, CalculiX, or another format that meshio reads."""
    unit: toml.Length = Field(description="Length of the unit of the file, m.")
    supports: tuple[str, ...] = Field(min_length=1, description="Sets of points that are fixed.")
    load: tuple[Force, Force, Force]
    """Force on every free node at load factor 1, N."""

    def read(self, laws: dict[str, LinkLaw]) -> "macro.LinkSystem":
        """Read the mesh."""
        return macro.system_from_mesh(
            open_mesh(self.file), laws, supports=self.supports, load=self.load, scale=self.unit
        )


class Dynamics(toml.TimeSteps):
    """Motion from a static equilibrium; see :func:`multiscale.macro.simulate`."""

    mass: Mass = Field(description="Mass of each node, kg.")
    start_load_factor: toml.Number = Field(0.0, description="Load factor of the first equilibrium.")
    load_history: tuple[tuple[Instant, toml.Number], ...] = Field(min_length=1)
    """Time, s, and load factor; linear between, constant outside."""
    theta: toml.Number = Field(1.0, ge=0.5, le=1.0)
    """Time scheme: 1/2 (no numerical damping) to 1 (fully implicit)."""
    restitution: toml.Share = Field(
        0.0, description="Restitution of the speed by inextensible links."
    )

    @field_validator("load_history")
    @classmethod
    def _rise(cls, history: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        times = [time for time, _ in history]
        if any(late <= early for early, late in pairwise(times)):
            raise ValueError("must have times that rise from one pair to the next")
        return history
