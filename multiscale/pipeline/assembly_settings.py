"""What a case may say of elastic bodies of the user: meshes, interfaces, bolts and named loads."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, field_validator, model_validator

from multiscale.errors import CaseError
from multiscale.fe.facets import facet_normals, surface_of
from multiscale.laws import Damaged, Exponential, Sliders
from multiscale.macro import Assembly, Body, Bolt, Interface, load_mesh, shank_stiffness
from multiscale.macro.bodies.assembly import GROUND
from multiscale.macro.substructures import CutProblem, LoadPath, require_held
from multiscale.pipeline.body_settings import elasticity
from multiscale.pipeline.joint_settings import SLABS, Damage, JointLaw, alike_bodies
from multiscale.pipeline.structure_kind import StructureKind
from multiscale.pipeline.toml_model import (
    Factor,
    Length,
    Number,
    Positive,
    Pressure,
    Ratio,
    Settings,
    must_rise,
    quantity,
    with_unit,
)
from multiscale.units import to_si
from multiscale.upscaling import law_from_dataset, sliders_from_dataset

if TYPE_CHECKING:
    import xarray as xr
    from skfem import Mesh

    from multiscale.laws import NormalLaw
    from multiscale.pipeline.settings import Case
    from multiscale.pipeline.stage import Datasets

__all__ = ["Bodies", "LoadCycles", "LoadSteps", "StructureParts"]

PRELOAD = "preload"
"""Name of the tightening of the bolts among the loads."""

GROUNDED = "ground"
"""First side of an interface with the rigid ground."""

LARGE, SMALL = 10.0, 1e-3
"""Lengths of a body, m, beyond which the unit of its mesh must be given."""

PLANE = 1e-6
"""Spread of the unit normals of a plane face."""

KINDS = {4: "tetrahedra", 8: "hexahedra"}
"""Kinds of elements by the number of their corners."""

CLAMPED = "xyz"


def _read_axes(value: object) -> object:
    """Read ``"clamped"``, or the axes along which nothing moves."""
    if value == "clamped":
        return CLAMPED
    if not (isinstance(value, str) and value and set(value) <= set(CLAMPED)):
        raise ValueError(
            f'should be "clamped", or the axes along which nothing moves, such as "z" or "xy", '
            f"got {value!r}"
        )
    return value


def _read_component(value: object, *, unit: str) -> float:
    """Read a quantity, or the number zero."""
    if isinstance(value, int | float) and not isinstance(value, bool) and value == 0:
        return 0.0
    try:
        return to_si(value, unit)
    except CaseError as error:
        raise ValueError(str(error)) from error


def _read_unit(value: object) -> object:
    """Read ``"mm"`` as ``"1 mm"``."""
    return f"1 {value}" if isinstance(value, str) and value.isalpha() else value


OpenLaw = Callable[[Path, bool], "xr.Dataset"]
"""From a dataset, or a case and whether it is quick, to an interface law."""

Axes = Annotated[str, BeforeValidator(_read_axes)]
Stress = Annotated[float, BeforeValidator(partial(_read_component, unit="Pa")), with_unit("Pa")]
Newton = Annotated[float, BeforeValidator(partial(_read_component, unit="N")), with_unit("N")]
Size = Annotated[float, quantity("N"), Field(gt=0.0), with_unit("N")]
Stiffness = Annotated[float, quantity("N/m"), Field(gt=0.0), with_unit("N/m")]
Unit = Annotated[Length, BeforeValidator(_read_unit)]
Name = Annotated[str, Field(pattern=r"^[^.\s]+$")]


class ElasticBody(Settings):
    """An elastic body with a mesh of its own."""

    name: Name = Field(description="Name of the body, without dots.")
    mesh: Path = Field(
        description="Mesh of straight tetrahedra or hexahedra with named faces, of gmsh or of "
        "another program whose files meshio reads."
    )
    coarser: Path | None = Field(
        None,
        description="Mesh of the same body with about twice the element size, which tells the "
        "error of the mesh; it is not known if not given.",
    )
    volume: str = Field(
        "", description="Named volume of the mesh that is the body; the whole mesh if not given."
    )
    unit: Unit | None = Field(
        None, description='Length of one unit of the mesh, such as `"mm"`; m if not given.'
    )
    youngs_modulus: Pressure = Field(description="Young's modulus, Pa.")
    poissons_ratio: Ratio = Field(description="Poisson's ratio.")
    damage: Damage = Field(0.0, description="Damage of the body: it is 1 - D as stiff.")
    stiffness: Path | None = Field(
        None, description="Dataset `rve_stiffness` whose tensor replaces the moduli."
    )
    supports: dict[str, Axes] = Field(
        {},
        description='Faces that are held: `"clamped"`, or the axes along which they do not move, '
        'such as `"z"` or `"xy"`.',
    )

    def load(self) -> "Mesh":
        """Read the mesh.

        Raises
        ------
        CaseError
            If it is refused, has no named faces, or a unit that is not given leaves it very large
            or very small.
        """
        mesh = load_mesh(self.mesh, scale=self.unit or 1.0, volume=self.volume)
        if mesh.dim() != 3:
            raise CaseError(
                f"{self.mesh}: the mesh of {self.name} is plane, and a body takes tetrahedra or "
                f"hexahedra; mesh it in three dimensions"
            )
        if not mesh.boundaries:
            raise CaseError(
                f"{self.mesh}: the mesh of {self.name} names no faces, which supports, interfaces "
                f"and loads need; name them, in gmsh as physical surfaces"
            )
        extent = np.ptp(mesh.p, axis=1)
        if self.unit is None and not SMALL < extent.max() < LARGE:
            box = " x ".join(f"{one:.4g}" for one in extent)
            raise CaseError(
                f"{self.mesh}: {self.name} would measure {box} m, as the mesh has no unit; give "
                f'unit = "mm" if its coordinates are millimetres, or unit = "m" if it is so large'
            )
        return mesh

    def build(self, mesh: "Mesh", tractions: Mapping[str, Mapping[int, np.ndarray]]) -> Body:
        """Make the body of its mesh, of faces with tractions, Pa, by the numbers of load cases."""
        supports = {
            boundary: tuple(0.0 if axis in axes else None for axis in CLAMPED)
            for boundary, axes in self.supports.items()
        }
        pulled = {
            boundary: tuple(partial(_at_time, parts, axis) for axis in range(3))
            for boundary, parts in tractions.items()
        }
        law = elasticity(self.youngs_modulus, self.poissons_ratio, self.stiffness, self.damage)
        return Body(mesh, law, supports, pulled, name=self.name)


class StatedLaw(Settings):
    """A normal law without cells: the pressure p_c exp(-g/u_0) at the gap g."""

    pressure_scale: Pressure = Field(description="Pressure p_c at zero gap, Pa.")
    decay_length: Length = Field(description="Decay length u_0 of the pressure, m.")
    pressures: tuple[Pressure, Pressure] = Field(
        description="Pressures between which the law is meant to hold, Pa, rising."
    )

    _rise = field_validator("pressures")(must_rise)

    def build(self) -> Exponential:
        """Make the law."""
        return Exponential(self.pressure_scale, self.decay_length, pressure_range=self.pressures)


class BodyInterface(Settings):
    """An interface between two named faces, whose meshes need not match."""

    sides: tuple[str, str] = Field(
        description='Both faces, as `"BODY.FACE"`; the first may be `"ground"`.'
    )
    law: Path | None = Field(
        None,
        description="Law of this interface: a dataset, the folder of a run, or a case, which is "
        "run in a folder of its own; if not given, the law of the cells or of `[interface]`.",
    )
    exponential: StatedLaw | None = Field(
        None, description="Stated normal law, in place of `law`; takes a friction of its own."
    )
    quick: bool = Field(False, description="Whether a case that `law` names is run `--quick`.")
    friction: Factor | None = Field(
        None, description="Coefficient of friction, if not the value of `[interface]` or the law."
    )
    stiffness_ratio: Annotated[Number, Field(gt=0.0)] | None = Field(
        None,
        description="Tangential over normal stiffness, if not the value of `[interface]` or the "
        "law.",
    )
    damage: Damage = Field(0.0, description="Damage of the interface: it carries 1 - D of the law.")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.exponential is not None and self.law is not None:
            raise ValueError("an interface takes either law or exponential")
        return self

    @property
    def name(self) -> str:
        """Both faces in words."""
        return " on ".join(reversed(self.sides))

    def over(self, shared: JointLaw) -> JointLaw:
        """Return the keys of ``[interface]`` with those of this interface in their place."""
        own = self.model_dump(include={"law", "friction", "stiffness_ratio"}, exclude_none=True)
        return shared.model_copy(update=own)


class BodyBolt(Settings):
    """A bolt between two faces that look away from each other along x, y or z.

    Its washers are rigid and tilt, and it carries no shear.
    """

    sides: tuple[str, str] = Field(
        description='Faces under head and nut, as `"BODY.FACE"`, of the size of the washers.'
    )
    preload: Size = Field(description="Force of the bolt at the factor one of `preload`, N.")
    diameter: Length | None = Field(None, description="Diameter of the shank, m.")
    length: Length | None = Field(
        None, description="Length of the shank, m; the distance of its washers if not given."
    )
    youngs_modulus: Pressure = Field(210e9, description="Young's modulus of the shank, Pa.")
    stiffness: Stiffness | None = Field(
        None, description="Axial stiffness of the shank, N/m, in place of its diameter."
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.diameter is None) == (self.stiffness is None):
            raise ValueError("a bolt takes either the diameter of its shank or its stiffness")
        return self

    def build(
        self, sides: tuple[int, int], boundaries: tuple[str, str], bodies: Sequence[Body]
    ) -> tuple[Bolt, str]:
        """Make the bolt between faces of bodies, and say between which and of which shank."""
        bolt = Bolt(sides, boundaries, self.stiffness or 1.0, self.preload)
        said = " to ".join(self.sides)
        one, two = bolt.washers(bodies)
        if self.diameter is None:
            return bolt, said
        assert one.point is not None
        assert two.point is not None
        length = self.length or abs(two.point[one.axis] - one.point[one.axis])
        between = "" if self.length else " between its washers"
        said += (
            f", shank of {1e3 * length:.4g} mm{between} and {1e-9 * self.youngs_modulus:.4g} GPa"
        )
        k = shank_stiffness(self.diameter, length, self.youngs_modulus)
        return replace(bolt, stiffness=k), said


class NamedLoad(Settings):
    """A load on a face, by a name that the path uses: a traction, a force or a pressure."""

    name: Name = Field(description="Name of the load.")
    face: str = Field(description='Face that is loaded, as `"BODY.FACE"`.')
    traction: tuple[Stress, Stress, Stress] | None = Field(
        None, description="Force per area along x, y and z at the factor one, Pa."
    )
    force: tuple[Newton, Newton, Newton] | None = Field(
        None, description="Resultant along x, y and z, evenly spread, at the factor one, N."
    )
    pressure: Stress | None = Field(
        None, description="Pressure on a plane face at the factor one, Pa."
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        given = [one for one in (self.traction, self.force, self.pressure) if one is not None]
        if len(given) != 1:
            raise ValueError("a load is either a traction, a force or a pressure")
        if not np.any(given[0]):
            raise ValueError("the load is zero")
        return self

    def traction_on(self, mesh: "Mesh", boundary: str) -> tuple[np.ndarray, float]:
        """Return the traction at the factor one, Pa, and the area of the face, m².

        Raises
        ------
        CaseError
            If there is a pressure on a face that is not plane.
        """
        face = surface_of(mesh, boundary)
        normals = facet_normals(mesh.p.T[face.nodes][face.facets])
        area = float(np.linalg.norm(normals, axis=1).sum())
        if self.force is not None:
            return np.array(self.force) / area, area
        if self.traction is not None:
            return np.array(self.traction), area
        mean = normals.sum(axis=0) / area
        if np.linalg.norm(mean) < 1.0 - PLANE:
            raise CaseError(
                f"the load {self.name} is a pressure on {self.face}, which is not plane; give its "
                f"traction or force"
            )
        return -float(self.pressure or 0.0) * mean, area


class LoadSteps(Settings):
    """Steps over the named loads; see :class:`multiscale.macro.substructures.LoadPath`."""

    steps: tuple[dict[str, Number], ...] = Field(
        min_length=1,
        description="Factors of loads at the end of every step, by their names; `preload` is the "
        "tightening of all bolts. A load that a step does not name keeps its factor, 0 at first.",
    )
    substeps: Positive = Field(1, description="Equal parts into which every step is cut.")


class LoadCycles(Settings):
    """One named load to and fro, about its factor at the end of the steps."""

    load: str = Field(description="Name of the load.")
    amplitude: Annotated[Number, Field(gt=0.0)] = Field(
        1.0, description="By how much its factor rises, then falls."
    )
    cycles: Positive = Field(description="Closed cycles after the first loading.")
    steps: Positive = Field(10, description="Load steps from the middle to the amplitude.")

    def quick(self) -> Self:
        """Return one cycle of few steps."""
        return self.model_copy(update={"cycles": 1, "steps": min(2, self.steps)})


@dataclass(frozen=True, eq=False)
class StructureParts:
    """The structure of a case, built.

    Attributes
    ----------
    assembly : Assembly
    path : LoadPath
    facts : tuple of str, what is said of it beside the answer
    """

    assembly: Assembly
    path: LoadPath
    facts: tuple[str, ...]


class Bodies(StructureKind):
    """Elastic bodies with meshes of the user, interfaces, bolts and named loads."""

    stage: ClassVar[str] = "loaded_bodies"
    asks: ClassVar[tuple[tuple[str, ...], ...]] = (
        ("statics",),
        ("interface", "statics"),
        ("statics", "cycles"),
        ("interface", "statics", "cycles"),
    )
    models: ClassVar[Mapping[str, type[Settings]]] = {
        "interface": JointLaw,
        "statics": LoadSteps,
        "cycles": LoadCycles,
    }
    may_be_cut: ClassVar[bool] = True

    kind: Literal["bodies"]
    bodies: tuple[ElasticBody, ...] = Field(min_length=1)
    interfaces: tuple[BodyInterface, ...] = ()
    bolts: tuple[BodyBolt, ...] = ()
    loads: tuple[NamedLoad, ...] = ()

    @field_validator("bodies", "loads")
    @classmethod
    def _name_once(cls, parts: tuple[Any, ...]) -> tuple[Any, ...]:
        names = [one.name for one in parts]
        if twice := [name for name in names if names.count(name) > 1]:
            raise ValueError(f"give the name {twice[0]!r} to one only, got {len(twice)} of them")
        return parts

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        if not (self.bolts or self.loads):
            raise ValueError("nothing loads the bodies: give [[structure.loads]] or bolts")
        if any(load.name == PRELOAD for load in self.loads):
            raise ValueError(
                f"a load is named {PRELOAD!r}, which is the tightening of the bolts; rename it"
            )
        for what, face in self._faces():
            self._find(what, face)
        pairs = [set(one.sides) for one in self.interfaces]
        if double := [one for one, other in combinations(pairs, 2) if one == other]:
            raise ValueError(f"{' and '.join(sorted(double[0]))} meet in two interfaces; give one")
        return self

    def _faces(self) -> list[tuple[str, str]]:
        """Every face that is named outside a body, and by what."""
        named = [
            (f"interface {i}", face)
            for i, one in enumerate(self.interfaces)
            for face in one.sides[one.sides[0] == GROUNDED :]
        ]
        named += [(f"bolt {i}", face) for i, one in enumerate(self.bolts) for face in one.sides]
        return [*named, *((f"the load {one.name}", one.face) for one in self.loads)]

    def _find(self, what: str, face: str) -> tuple[int, str]:
        """Find the number of the body of a face, and the name of the face in it."""
        body, dot, boundary = face.partition(".")
        names = [one.name for one in self.bodies]
        if not (dot and boundary):
            raise ValueError(f'{what} names {face!r}, which is no face; write "BODY.FACE"')
        if body not in names:
            raise ValueError(
                f"{what} names {face!r}, and there is no body {body!r}; there are "
                f"{', '.join(names)}"
            )
        return names.index(body), boundary

    @property
    def load_names(self) -> tuple[str, ...]:
        """Names of all loads, the tightening of the bolts first."""
        return (PRELOAD,) * bool(self.bolts) + tuple(load.name for load in self.loads)

    def check(self, case: "Case") -> None:
        """Refuse a path over loads that do not exist, and friction that nothing tells."""
        known = self.load_names
        given = [name for step in case.statics.steps for name in step]
        given += [case.cycles.load] if case.cycles else []
        if unknown := [name for name in given if name not in known]:
            raise ValueError(
                f"the path names the load {unknown[0]!r}, which does not exist; there are "
                f"{', '.join(known)}"
            )
        if self.bolts and not case.statics.steps[0].get(PRELOAD, 0.0) > 0.0:
            raise ValueError(
                f"the first of steps in [statics] must tighten the bolts, such as "
                f"{{ {PRELOAD} = 1 }}, got {case.statics.steps[0]}"
            )
        if case.cycles and case.cycles.load == PRELOAD:
            raise ValueError(f"[cycles] load is {PRELOAD!r}; bolts are tightened by steps alone")
        if case.has_cells:
            told = ("friction", "stiffness_ratio") if case.micro.shear is not None else ()
            for number, one in enumerate(self.interfaces):
                own = one.over(case.interface or JointLaw())
                if one.law is None and (
                    missing := own.tell_missing(told, case.strict, f"interface {number}")
                ):
                    raise ValueError(missing)

    def path(self, case: "Case", forces: Sequence[float]) -> LoadPath:
        """Return the path over the loads, whose resultants at the factor one are given, N."""
        now, steps = dict.fromkeys(self.load_names, 0.0), []
        for step in case.statics.steps:
            now |= step
            steps.append(tuple(now.values()))
        path = LoadPath(self.load_names, tuple(forces), tuple(steps), case.statics.substeps)
        if case.cycles is None:
            return path
        return LoadPath(
            path.names,
            path.forces,
            path.steps,
            path.substeps,
            case.cycles.load,
            case.cycles.amplitude,
            case.cycles.cycles,
            case.cycles.steps,
        )

    def read_laws(
        self, case: "Case", found: "Datasets", open_law: "OpenLaw"
    ) -> "list[xr.Dataset | None]":
        """Read the law of every interface, with its tangential branch; None of a stated one.

        Interfaces of one law and one friction share a dataset.

        Raises
        ------
        MultiscaleError
            If a law is missing or refused, or nothing tells its friction.
        """
        read: dict[Any, xr.Dataset | None] = {}
        laws = []
        for number, one in enumerate(self.interfaces):
            source = one.over(case.interface or JointLaw())
            key = one.exponential or (source.law, source.friction, source.stiffness_ratio)
            if key not in read:
                ratio = self._poissons_ratio(one)
                read[key] = None
                if one.exponential is None:
                    law = (
                        case.interface_law(found)
                        if source.law is None
                        else open_law(source.law, one.quick)
                    )
                    read[key] = source.complete(law, ratio, case.strict, f"interface {number}")
            laws.append(read[key])
        return laws

    def _poissons_ratio(self, interface: BodyInterface) -> float:
        """Mean of the bodies that an interface joins."""
        faces = interface.sides[interface.sides[0] == GROUNDED :]
        bodies = [self.bodies[self._find("interface", face)[0]] for face in faces]
        return float(np.mean([body.poissons_ratio for body in bodies]))

    def sliders(
        self,
        case: "Case",
        laws: "Sequence[xr.Dataset | None]",
        normal: "Mapping[int, NormalLaw] | None" = None,
    ) -> list[Sliders]:
        """Make the laws of all interfaces, less their damage, of those of :meth:`read_laws`.

        Parameters
        ----------
        case : Case
        laws : sequence of Dataset or None
        normal : mapping of int to NormalLaw, optional
            In place of the normal laws of some interfaces, by their numbers.
        """
        made, changed = [], normal or {}
        for number, (one, law) in enumerate(zip(self.interfaces, laws, strict=True)):
            if law is None:
                made.append(self._stated(case, number))
                continue
            sound = changed.get(number) or law_from_dataset(law)
            worn = Damaged(sound, one.damage) if one.damage else sound
            made.append(sliders_from_dataset(law, normal=worn, slabs=SLABS))
        return made

    def _stated(self, case: "Case", number: int) -> Sliders:
        """Law of an interface that is stated, with a friction that is given."""
        one = self.interfaces[number]
        source = one.over(case.interface or JointLaw())
        if missing := source.tell_missing((), case.strict, f"interface {number}"):
            raise CaseError(missing)
        theory = alike_bodies(self._poissons_ratio(one))
        stated = one.exponential
        assert stated is not None
        assert source.friction is not None  # else told as missing
        normal = stated.build()
        return Sliders(
            Damaged(normal, one.damage) if one.damage else normal,
            source.friction,
            source.stiffness_ratio or theory,
            pressures=stated.pressures,
            slabs=SLABS,
        )

    def assumed(self, case: "Case") -> list[str]:
        """Say what stated laws leave to theory, one sentence each."""
        shared = case.interface or JointLaw()
        return [
            f"interface {number}: the stiffness ratio of "
            f"{alike_bodies(self._poissons_ratio(one)):.3g} is assumed; give stiffness_ratio, or "
            f"take the law of cells that are sheared"
            for number, one in enumerate(self.interfaces)
            if one.exponential is not None and one.over(shared).stiffness_ratio is None
        ]

    def build(self, case: "Case", laws: Sequence[Sliders]) -> StructureParts:
        """Build bodies, interfaces and bolts, and the path over the loads.

        Raises
        ------
        MultiscaleError
            If a mesh is refused, a face does not exist, or a bolt goes through nothing.
        """
        meshes = [body.load() for body in self.bodies]
        kinds = {
            one.name: KINDS[mesh.t.shape[0]] for one, mesh in zip(self.bodies, meshes, strict=True)
        }
        if len(set(kinds.values())) > 1:
            said = " and ".join(f"{name} {kind}" for name, kind in kinds.items())
            raise CaseError(f"the bodies have elements of two kinds, {said}; mesh all by one kind")
        pulls: list[dict[str, dict[int, np.ndarray]]] = [{} for _ in meshes]
        forces = [sum(bolt.preload for bolt in self.bolts)] * bool(self.bolts)
        for number, load in enumerate(self.loads):
            body, boundary = self.place(meshes, f"the load {load.name}", load.face)
            traction, area = load.traction_on(meshes[body], boundary)
            pulls[body].setdefault(boundary, {})[number] = traction
            forces.append(float(np.linalg.norm(traction)) * area)
        for one in self.bodies:
            for boundary in one.supports:
                self.place(meshes, f"supports of {one.name}", f"{one.name}.{boundary}")
        bodies = [
            one.build(mesh, pull)
            for one, mesh, pull in zip(self.bodies, meshes, pulls, strict=True)
        ]
        interfaces = []
        for number, (joint, law) in enumerate(zip(self.interfaces, laws, strict=True)):
            first, second = joint.sides
            lower = (
                GROUND if first == GROUNDED else self.place(meshes, f"interface {number}", first)
            )
            upper = self.place(meshes, f"interface {number}", second)
            interfaces.append(Interface((lower[0], upper[0]), (lower[1], upper[1]), law))
        facts = [f"Interface {number}: {one.name}." for number, one in enumerate(self.interfaces)]
        bolts = []
        for number, bolt in enumerate(self.bolts):
            head, nut = (self.place(meshes, f"bolt {number}", face) for face in bolt.sides)
            made, said = bolt.build((head[0], nut[0]), (head[1], nut[1]), bodies)
            bolts.append(made)
            facts.append(f"Bolt {number}, {said}: {1e-6 * made.stiffness:.4g} N/µm.")
        times = tuple(map(float, range(len(self.loads))))
        return StructureParts(
            Assembly(tuple(bodies), tuple(interfaces), times, bolts=tuple(bolts)),
            self.path(case, forces),
            tuple(facts),
        )

    def place(self, meshes: "Sequence[Mesh]", what: str, face: str) -> tuple[int, str]:
        """Find the number of a body and the name of its face, which its mesh must have."""
        body, boundary = self._find(what, face)
        known = sorted(meshes[body].boundaries)
        if boundary not in known:
            close = get_close_matches(boundary, known, n=1)
            hint = f"did you mean {close[0]!r}?" if close else f"its faces are {', '.join(known)}"
            raise CaseError(
                f"{what} names {face!r}, and the mesh of {self.bodies[body].name} has no face "
                f"{boundary!r}; {hint}"
            )
        return body, boundary

    def try_to_build(self, case: "Case") -> None:
        """Refuse meshes, faces and bolts that do not fit, and free bodies, whatever the laws."""
        shared = case.interface or JointLaw()
        frictions = [one.over(shared).friction for one in self.interfaces]
        any_law = Exponential(1e9, 1e-6)
        laws = [
            Sliders(any_law, 1.0 if mu is None else mu, 1.0, pressures=(1e6, 1e8))
            for mu in frictions
        ]
        require_held(self.build(case, laws).assembly)

    def coarser(self) -> dict[float, Self]:
        """Return the same bodies on their coarser meshes, by the ratio of the element sizes.

        Nothing if a body has none.
        """
        coarse = [one.coarser for one in self.bodies]
        if not all(coarse):
            return {}
        bodies = tuple(
            one.model_copy(update={"mesh": mesh, "coarser": None})
            for one, mesh in zip(self.bodies, coarse, strict=True)
        )
        fine, few = (sum(one.load().t.shape[1] for one in each) for each in (self.bodies, bodies))
        return {(fine / few) ** (1.0 / 3.0): self.model_copy(update={"bodies": bodies})}

    def cut(self, case: "Case", found: "Datasets") -> CutProblem:
        """Cut every body into boxes."""
        raise CaseError("homogenise in [substructures] takes no bodies of the user")

    def quick(self, case: "Case") -> Self:
        """Return the same bodies; laws of other cases are those of quick runs."""
        interfaces = tuple(
            one.model_copy(update={"quick": one.law is not None}) for one in self.interfaces
        )
        return self.model_copy(update={"interfaces": interfaces})


def _at_time(
    tractions: Mapping[int, np.ndarray], axis: int, position: np.ndarray, time: float
) -> np.ndarray:
    """One component of the traction of the load case whose number is the time."""
    traction = tractions.get(int(time))
    return np.full(position.shape[1], 0.0 if traction is None else traction[axis])
