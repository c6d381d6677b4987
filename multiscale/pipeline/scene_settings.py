"""What a scene may say: every key with its unit, range and default."""

from functools import partial
from itertools import pairwise
from math import inf, isfinite
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, PlainSerializer, field_validator, model_validator

from multiscale.errors import CaseError
from multiscale.pipeline.body_settings import (
    BODIES,
    JointLawSettings,
    LapJoint,
    Loading,
    Plate,
    StackedBlocks,
    Substructures,
)
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

__all__ = [
    "CableNet",
    "Dynamics",
    "LinkLawSettings",
    "LinkMesh",
    "LinkTable",
    "Scene",
    "Statics",
    "TensegrityGrid",
]

QUICK = 4  # modules or meshes each way


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


class TensegrityGrid(Settings):
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

    kind: Literal["tensegrity_grid"]
    n: Annotated[Count, Field(ge=1)]
    m: Annotated[Count, Field(ge=1)] | None = None
    prestress: Prestress = 2550.0
    size: Length = 1.0
    height: Length = 0.5
    cable_rigidity: Rigidity = 4e6
    bar_rigidity: Rigidity = 8e7
    nodal_load: Force = 40.0


class CableNet(Settings):
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


Laws = Annotated[dict[str, LinkLawSettings], Field(min_length=1)]


class LinkTable(Settings):
    """Two CSV files in SI units; see :func:`multiscale.macro.system_from_table`.

    Parameters
    ----------
    nodes : path
        Table of nodes; relative to the scene file.
    links : path
        Table of links; relative to the scene file.
    laws : tables by name
    """

    kind: Literal["table"]
    nodes: Path
    links: Path
    laws: Laws


class LinkMesh(Settings):
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
    """

    kind: Literal["mesh"]
    file: Path
    unit: Length
    laws: Laws
    supports: Annotated[tuple[str, ...], Field(min_length=1)]
    load: tuple[Force, Force, Force]


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


class Scene(Settings):
    """One question to a structure of bars and cables, or of elastic bodies.

    Parameters
    ----------
    title : str
        Stands in tables and datasets.
    structure : table
        Its ``kind`` is ``"tensegrity_grid"``, ``"cable_net"``, ``"table"`` or ``"mesh"``;
        ``"plate"``, ``"stacked_blocks"`` or ``"lap_joint"``.
    statics, dynamics : table
        Exactly one of them, and for a plate statics.
    joint, loading : table
        In their place, and both, for blocks and lap joint.
    substructures : table
        Cuts a tensegrity grid, at rest or in motion, or any bodies.
    """

    title: str
    structure: Annotated[
        TensegrityGrid | CableNet | LinkTable | LinkMesh | Plate | StackedBlocks | LapJoint,
        Field(discriminator="kind"),
    ]
    statics: Statics | None = None
    dynamics: Dynamics | None = None
    joint: JointLawSettings | None = None
    loading: Loading | None = None
    substructures: Substructures | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        given = self.structure
        rough = isinstance(given, StackedBlocks | LapJoint)
        if (self.joint is not None, self.loading is not None) != (rough, rough):
            raise ValueError(
                f"a structure of kind {given.kind!r} "
                + ("needs [joint] and [loading]" if rough else "takes no [joint] or [loading]")
            )
        if rough and (self.statics or self.dynamics):
            raise ValueError(f"{given.kind!r} takes [loading] and no [statics] or [dynamics]")
        if not rough and (self.statics is None) == (self.dynamics is None):
            raise ValueError("give either [statics] or [dynamics]")
        _check_damage(given, self.joint)
        _check_cut(given, self.statics, self.dynamics, self.substructures)
        return self

    def quick(self) -> Self:
        """Return the same scene with at most 4 x 4 modules or meshes, or few elements and steps.

        The prestress of a grid falls with the square of its span, as the tensions do under the
        load, so that as many of a hundred cables go slack.
        """
        structure: Any = self.structure
        if isinstance(structure, BODIES):
            smaller: dict[str, Any] = {
                "title": f"{self.title} (quick)",
                "structure": structure.quick(),
                "loading": self.loading and self.loading.quick(),
                "substructures": self.substructures and _few_parts(self.substructures),
            }
            return self.model_copy(update=smaller)
        if not isinstance(structure, TensegrityGrid | CableNet):
            return self
        m = None if structure.m is None else min(QUICK, structure.m)
        changes: dict[str, Any] = {"n": min(QUICK, structure.n), "m": m}
        if isinstance(structure, TensegrityGrid):
            changes["prestress"] = structure.prestress * (changes["n"] / structure.n) ** 2
        small = {
            "title": f"{self.title} (quick)",
            "structure": structure.model_copy(update=changes),
            "substructures": self.substructures and _few_parts(self.substructures),
        }
        return self.model_copy(update=small)


def _few_parts(cut: Substructures) -> Substructures:
    """Two parts each way, at most."""
    return cut.model_copy(update={"parts": tuple(min(2, number) for number in cut.parts)})


def _check_damage(given: Settings, joint: JointLawSettings | None) -> None:
    """Refuse damages that are not one for each joint."""
    if not isinstance(given, StackedBlocks | LapJoint) or joint is None or not joint.damage:
        return
    if len(joint.damage) != given.joints:
        raise ValueError(
            f"[joint] damage should have one entry for each joint ({given.joints}), got "
            f"{len(joint.damage)}"
        )


def _check_cut(
    given: Any, statics: Statics | None, dynamics: Dynamics | None, cut: Substructures | None
) -> None:
    """Refuse what substructures do not solve."""
    if isinstance(given, Plate) and statics is None:
        raise ValueError("a structure of kind 'plate' takes [statics]")
    if cut is not None and not isinstance(given, (TensegrityGrid, *BODIES)):
        raise ValueError(
            f"[substructures] cut tensegrity grids, plates, blocks and lap joints, not a structure "
            f"of kind {given.kind!r}"
        )
    if dynamics and cut and (dynamics.theta, dynamics.restitution) != (1.0, 0.0):
        raise ValueError("substructures move by implicit steps: leave out theta and restitution")
    special = statics is not None and (statics.exact or statics.stability)
    if special and (cut is not None or isinstance(given, BODIES)):
        raise ValueError("substructures move little: leave out exact and stability")
