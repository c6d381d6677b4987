"""What a case may say of structures of bars and cables: how they are built, loaded and moved."""

from abc import abstractmethod
from functools import partial
from itertools import pairwise
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, PlainSerializer, field_validator, model_validator

from multiscale.errors import CaseError
from multiscale.io import open_mesh, read_table
from multiscale.laws.link import Bar, Cable, LinkLaw, Strut
from multiscale.macro import (
    LinkSystem,
    cable_net,
    cut_links,
    prestress_by_itself,
    system_from_mesh,
    system_from_table,
    tensegrity_grid,
)
from multiscale.macro.substructures import CutProblem, split_grid
from multiscale.pipeline.structure_kind import StructureKind
from multiscale.pipeline.toml_model import (
    Count,
    Length,
    Number,
    Settings,
    TimeSteps,
    quantity,
    with_unit,
)
from multiscale.units import to_si

if TYPE_CHECKING:
    from multiscale.pipeline.structure_settings import StructureCase

__all__ = [
    "CableNet",
    "Dynamics",
    "LinkLawSettings",
    "LinkMesh",
    "LinkTable",
    "Links",
    "Statics",
    "TensegrityGrid",
]

QUICK = 4  # modules or meshes each way

LAWS: dict[str, type[LinkLaw]] = {"bar": Bar, "cable": Cable, "strut": Strut}


def _read_rigidity(value: object, *, unit: str) -> float:
    if value == "inextensible":
        return inf
    try:
        return to_si(value, unit)
    except CaseError as error:
        raise ValueError(f'{error}, or "inextensible"') from error


Force = Annotated[float, quantity("N"), with_unit("N")]
Prestress = Annotated[Force, Field(ge=0.0)]
Rigidity = Annotated[
    float,
    BeforeValidator(partial(_read_rigidity, unit="N")),
    Field(gt=0.0),
    PlainSerializer(lambda value: f"{value!r} N" if isfinite(value) else "inextensible"),
]
Instant = Annotated[float, quantity("s"), Field(ge=0.0), with_unit("s")]
Mass = Annotated[float, quantity("kg"), Field(gt=0.0), with_unit("kg")]


class Links(StructureKind):
    """Bars and cables, at rest or in motion."""

    stage: ClassVar[str] = "links"
    asks: ClassVar[tuple[tuple[str, ...], ...]] = (("statics",), ("dynamics",))

    @abstractmethod
    def build(self) -> LinkSystem:
        """Build the structure.

        Raises
        ------
        CaseError
            If the structure is refused, or a file that it names cannot be read.
        """

    def cut(self, case: "StructureCase") -> CutProblem:
        """Cut the links into boxes."""
        system = self.build()
        return cut_links(system, split_grid(system, case.cut.parts))

    def check(self, case: "StructureCase") -> None:
        """Refuse what a cut structure cannot do."""
        if case.substructures is None:
            return
        if case.dynamics and (case.dynamics.theta, case.dynamics.restitution) != (1.0, 0.0):
            raise ValueError(
                "substructures move by implicit steps: leave out theta and restitution"
            )
        if case.statics:
            case.statics.refuse_large()


class TensegrityGrid(Links):
    """A double-layer grid; see :func:`multiscale.macro.tensegrity_grid`.

    Parameters
    ----------
    n : int
        Modules along x.
    m : int, optional
        Modules along y; n if not given.
    prestress : quantity
        Tension of the upper cables at load factor zero, N.
    size : quantity
        Edge of a module, m.
    height : quantity
        Height of a module, m.
    cable_rigidity : quantity
        EA of the cables, N, or ``"inextensible"``.
    bar_rigidity : quantity
        EA of the bars, N, or ``"inextensible"``.
    nodal_load : quantity
        Downwards on every node at load factor one, N.
    """

    may_be_cut: ClassVar[bool] = True

    kind: Literal["tensegrity_grid"]
    n: Annotated[Count, Field(ge=1)]
    m: Annotated[Count, Field(ge=1)] | None = None
    prestress: Prestress = 2550.0
    size: Length = 1.0
    height: Length = 0.5
    cable_rigidity: Rigidity = 4e6
    bar_rigidity: Rigidity = 8e7
    nodal_load: Force = 40.0

    def build(self) -> LinkSystem:
        """Build the grid."""
        return tensegrity_grid(
            self.n,
            self.m,
            cable=Cable(self.cable_rigidity),
            bar=Bar(self.bar_rigidity),
            prestress=self.prestress,
            size=self.size,
            height=self.height,
            nodal_load=self.nodal_load,
        )

    def quick(self, case: "StructureCase") -> Self:
        """Return a grid of at most 4 x 4 modules.

        The prestress falls with the square of the span, as the tensions do under the load, so that
        as many of a hundred cables go slack.
        """
        n, m = _few(self.n, self.m)
        prestress = self.prestress * (n / self.n) ** 2
        return self.model_copy(update={"n": n, "m": m, "prestress": prestress})


class CableNet(Links):
    """A prestressed saddle; see :func:`multiscale.macro.cable_net`.

    Parameters
    ----------
    n : int
        Meshes along x.
    m : int, optional
        Meshes along y; n if not given.
    mesh : quantity
        Distance of the cables in plan, m.
    rise : quantity
        Height of the saddle, m.
    prestress : quantity
        Horizontal part of every tension at load factor zero, N.
    cable_rigidity : quantity
        EA of the cables, N, or ``"inextensible"``.
    nodal_load : quantity
        Downwards on every inner node at load factor one, N.
    """

    kind: Literal["cable_net"]
    n: Annotated[Count, Field(ge=2)]
    m: Annotated[Count, Field(ge=2)] | None = None
    mesh: Length = 1.0
    rise: Length = 1.0
    prestress: Annotated[Prestress, Field(gt=0.0)] = 10e3
    cable_rigidity: Rigidity = 1e7
    nodal_load: Force = 100.0

    def build(self) -> LinkSystem:
        """Build the net."""
        return cable_net(
            self.n,
            self.m,
            cable=Cable(self.cable_rigidity),
            mesh=self.mesh,
            rise=self.rise,
            prestress=self.prestress,
            nodal_load=self.nodal_load,
        )

    def quick(self, case: "StructureCase") -> Self:
        """Return a net of at most 4 x 4 meshes."""
        n, m = _few(self.n, self.m)
        return self.model_copy(update={"n": n, "m": m})


class LinkLawSettings(Settings):
    """The law of some links.

    Parameters
    ----------
    kind : {"bar", "cable", "strut"}
        Bars pull and push, cables only pull, struts only push.
    rigidity : quantity
        EA, N, or ``"inextensible"``.
    """

    kind: Literal["bar", "cable", "strut"]
    rigidity: Rigidity

    def build(self) -> LinkLaw:
        """Make the law."""
        return LAWS[self.kind](self.rigidity)


Laws = Annotated[dict[str, LinkLawSettings], Field(min_length=1)]


class LinkTable(Links):
    """Two CSV files in SI units; see :func:`multiscale.macro.system_from_table`.

    Parameters
    ----------
    nodes : path
        Table of nodes; relative to the scene file.
    links : path
        Table of links; relative to the scene file.
    laws : tables by name
    self_stress : bool
        Whether the structure gets a state of self-stress that its links can carry, instead of a
        column ``prestress``; see :func:`multiscale.macro.prestress_by_itself`.
    prestress : quantity
        Largest force in a link at load factor zero, N; with ``self_stress``.
    """

    kind: Literal["table"]
    nodes: Path
    links: Path
    laws: Laws
    self_stress: bool = False
    prestress: Annotated[Force, Field(gt=0.0)] | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        _check_self_stress(self.self_stress, self.prestress)
        return self

    def build(self) -> LinkSystem:
        """Build the structure of the tables."""
        columns = {"first": int, "second": int, "group": int, "law": str}
        nodes, links = read_table(self.nodes, {}), read_table(self.links, columns)
        return _stressed(system_from_table(nodes, links, _laws(self.laws)), self.prestress)


class LinkMesh(Links):
    """The lines of a mesh file; see :func:`multiscale.macro.system_from_mesh`.

    Parameters
    ----------
    file : path
        Anything that meshio reads; relative to the scene file.
    unit : quantity
        Length of one unit of the file, m.
    laws : tables by name of a set of lines
    supports : list of names
        Sets of points that are held.
    load : three quantities
        Force on every free node at load factor one, N.
    self_stress, prestress : bool, quantity
        A state of self-stress, as for two tables.
    """

    kind: Literal["mesh"]
    file: Path
    unit: Length
    laws: Laws
    supports: Annotated[tuple[str, ...], Field(min_length=1)]
    load: tuple[Force, Force, Force]
    self_stress: bool = False
    prestress: Annotated[Force, Field(gt=0.0)] | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        _check_self_stress(self.self_stress, self.prestress)
        return self

    def build(self) -> LinkSystem:
        """Build the structure of the mesh."""
        mesh, laws = open_mesh(self.file), _laws(self.laws)
        system = system_from_mesh(
            mesh, laws, supports=self.supports, load=self.load, scale=self.unit
        )
        return _stressed(system, self.prestress)


class Statics(Settings):
    """Equilibrium under rising or falling loads; see :func:`multiscale.macro.solve_static`.

    Parameters
    ----------
    load_factors : list of numbers
        Load of every step over the whole load.
    exact : bool
        Whether elongations and directions follow the moved nodes exactly.
    stability : bool
        Whether to add the smallest eigenvalues of the tangent.
    """

    load_factors: Annotated[tuple[Number, ...], Field(min_length=1)]
    exact: bool = False
    stability: bool = False

    def refuse_large(self) -> None:
        """Refuse what substructures do not solve."""
        if self.exact or self.stability:
            raise ValueError("substructures move little: leave out exact and stability")


class Dynamics(TimeSteps):
    """Motion from a static equilibrium; see :func:`multiscale.macro.simulate`.

    Parameters
    ----------
    step : quantity
        Time step, s; shortened so that a whole number of them fills the duration.
    duration : quantity
        How long the motion is followed, s.
    mass : quantity
        Mass of each node, kg.
    start_load_factor : number
        Load of the equilibrium at the start over the whole load.
    load_history : list of pairs
        Time, s, and load factor; straight lines between, constant before and after.
    theta : number
        1/2 (no numerical damping) to 1 (fully implicit).
    restitution : number
        Share of the speed that inextensible links give back when they run taut.
    """

    mass: Mass
    start_load_factor: Number = 0.0
    load_history: Annotated[tuple[tuple[Instant, Number], ...], Field(min_length=1)]
    theta: Annotated[Number, Field(ge=0.5, le=1.0)] = 1.0
    restitution: Annotated[Number, Field(ge=0.0, le=1.0)] = 0.0

    @field_validator("load_history")
    @classmethod
    def _rise(cls, history: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        times = [time for time, _ in history]
        if any(late <= early for early, late in pairwise(times)):
            raise ValueError("must have times that rise from one pair to the next")
        return history


def _few(n: int, m: int | None) -> tuple[int, int | None]:
    """Modules or meshes each way, at most four."""
    return min(QUICK, n), None if m is None else min(QUICK, m)


def _laws(given: dict[str, LinkLawSettings]) -> dict[str, LinkLaw]:
    """Make the laws by name."""
    return {name: law.build() for name, law in given.items()}


def _check_self_stress(asked: bool, prestress: float | None) -> None:
    """Refuse a self-stress of unknown size, and a size of none."""
    if asked != (prestress is not None):
        raise ValueError("give both self_stress = true and prestress, or neither")


def _stressed(system: LinkSystem, prestress: float | None) -> LinkSystem:
    """Add the state of self-stress that is asked for."""
    return system if prestress is None else prestress_by_itself(system, prestress)
