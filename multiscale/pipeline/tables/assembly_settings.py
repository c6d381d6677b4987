"""Tables of elastic bodies with meshes of the user, interfaces, bolts and named loads."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from multiscale import macro
from multiscale.errors import CaseError, suggest
from multiscale.laws import Exponential, InterfaceLaw, ModifiedLaw, Sliders
from multiscale.laws.bulk.moduli import mindlin_ratio
from multiscale.macro import substructures
from multiscale.pipeline.tables.assembly_parts import (
    COARSER,
    GROUNDED,
    BodyBolt,
    BodyInterface,
    MeshedBody,
    NamedLoad,
    n_tetrahedra,
)
from multiscale.pipeline.tables.joint_settings import SLABS, JointLaw, OpenLaw, SolverChoice
from multiscale.pipeline.tables.porous_body import PorousBody
from multiscale.pipeline.tables.structure_kind import Face, Pressed, StructureKind, highest_pressure
from multiscale.pipeline.tables.toml_model import Number, Positive, Settings
from multiscale.schema import RVE, Dataset
from multiscale.upscaling import law_from_dataset, sliders_from_dataset
from multiscale.upscaling.budget import FEW_CELLS, STATED
from multiscale.upscaling.propagation import STRETCH, Uncertainty

if TYPE_CHECKING:
    from skfem import Mesh

    from multiscale.laws import NormalLaw
    from multiscale.pipeline.stage import Datasets
    from multiscale.pipeline.tables.settings import Case

__all__ = ["Bodies", "LoadCycles", "LoadSteps", "StructureParts", "check_bodies"]

PRELOAD = "preload"
"""Name of the tightening of the bolts among the loads."""

KINDS = {4: "tetrahedra", 8: "hexahedra"}
"""Kinds of elements by the number of their corners."""

QUICK_ELEMENT = 1.5
"""Element size of quick geometries over the size stated."""

STATED_HOW = "half-widths stated with +-"
"""How errors of stated values are known."""


class LoadSteps(SolverChoice):
    """Steps over the named loads; see :class:`multiscale.macro.substructures.LoadPath`."""

    steps: tuple[dict[str, Number], ...] = Field(min_length=1)
    """Factors of loads at the end of every step, by their names; `preload` is the tightening of all
    bolts. A load that a step does not name keeps its factor, 0 at first."""
    substeps: Positive = Field(1, description="Equal parts into which every step is cut.")


class LoadCycles(Settings):
    """One named load to and fro, about its factor at the end of the steps."""

    load: str = Field(description="Name of the load.")
    amplitude: Annotated[Number, Field(gt=0.0)] = 1.0
    """By how much its factor rises, then falls."""
    cycles: Positive = Field(description="Closed cycles after the first loading.")
    steps: Positive = Field(10, description="Load steps from the middle to the amplitude.")

    def quick(self) -> Self:
        """Return one cycle of few steps."""
        return self.model_copy(update={"cycles": 1, "steps": min(2, self.steps)})


@dataclass(frozen=True, eq=False)
class StructureParts:
    """The structure of a case, built."""

    assembly: "macro.Assembly"
    path: "substructures.LoadPath"
    facts: tuple[str, ...] = ()  # what is reported beside the answer
    loading: "substructures.JointLoading | None" = None  # has the path as its main part


class Bodies(StructureKind):
    """Elastic bodies with meshes of the user, interfaces, bolts and named loads."""

    stage: ClassVar[str] = "loaded_bodies"
    asks: ClassVar[tuple[tuple[str, ...], ...]] = (
        ("statics",),
        ("interface", "statics"),
        ("statics", "cycles"),
        ("interface", "statics", "cycles"),
        ("statics", "vibration"),
        ("interface", "statics", "vibration"),
    )
    models: ClassVar[Mapping[str, type[Settings]]] = {
        "interface": JointLaw,
        "statics": LoadSteps,
        "cycles": LoadCycles,
    }
    may_be_cut: ClassVar[bool] = True
    may_tire: ClassVar[bool] = True

    kind: Literal["bodies"]
    bodies: tuple[MeshedBody, ...] = Field(min_length=1)
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
        """Refuse a path over loads that do not exist, and joints without a friction."""
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
        check_bodies(self.bodies, case)
        if case.growth is not None and (case.cycles or case.vibration or not self.is_one):
            raise ValueError(
                "[growth] cracks one body under [statics], without interfaces and bolts; leave out "
                "[growth], or the others"
            )
        for number, one in enumerate(self.interfaces):
            faces = one.sides[one.sides[0] == GROUNDED :]
            if one.surface_damage and not any(
                self.bodies[self._find("interface", face)[0]].porous for face in faces
            ):
                raise ValueError(
                    f"surface_damage of interface {number} is of representative volumes, and "
                    f"neither body has one; leave it out, or give damage"
                )
        if case.has_cells:
            told = ("friction", "stiffness_ratio") if case.micro.shear is not None else ()
            for number, one in enumerate(self.interfaces):
                own = one.over(case.interface)
                if one.law is None and (
                    missing := own.tell_missing(told, case.strict, f"interface {number}")
                ):
                    raise ValueError(missing)

    def taken_laws(self, case: "Case") -> set[tuple[Path, bool]]:
        """Return laws that interfaces name, and whether one that is a case is quick."""
        sources = [one.over(case.interface) for one in self.interfaces if not one.is_stated]
        return {(one.law, one.quick) for one in sources if one.law is not None}

    def taken_volumes(self) -> set[tuple[Path, bool]]:
        """Return volumes that bodies name, and whether one that is a case is quick."""
        return {(one.rve, one.quick) for one in self.bodies if one.rve is not None}

    def joint_size(self, case: "Case") -> "substructures.JointSize":
        """Count unknowns, points of interfaces and load steps."""
        meshes = [body.load() for body in self.bodies]
        nodes = sum(body.count_nodes(mesh) for body, mesh in zip(self.bodies, meshes, strict=True))
        points = 0
        for number, joint in enumerate(self.interfaces):
            body, face = self.place(meshes, f"interface {number}", joint.sides[1])
            points += self.bodies[body].count_face_nodes(meshes[body], face)
        return substructures.JointSize(
            3 * nodes, points, len(meshes), len(self.path(case, ()).factors())
        )

    @property
    def is_one(self) -> bool:
        """Whether there is one body, without interfaces and bolts."""
        return len(self.bodies) == 1 and not self.interfaces and not self.bolts

    def path(self, case: "Case", forces: Sequence[float]) -> "substructures.LoadPath":
        """Return the path over the loads, whose resultants at the factor one are given, N."""
        now, steps = dict.fromkeys(self.load_names, 0.0), []
        for step in case.statics.steps:
            now |= step
            steps.append(tuple(now.values()))
        path = substructures.LoadPath(
            self.load_names, tuple(forces), tuple(steps), case.statics.substeps
        )
        if (to := case.cycles) is None:
            return path
        return replace(
            path, cycled=to.load, amplitude=to.amplitude, cycles=to.cycles, cycle_steps=to.steps
        )

    def with_volumes(self, case: "Case", found: "Datasets", open_rve: OpenLaw) -> Self:
        """Return the same bodies with their representative volumes, and damaged interfaces."""
        bodies = tuple(
            PorousBody.of(one, open_rve(one.rve, one.quick) if one.rve else found[RVE.name])
            if one.porous
            else one
            for one in self.bodies
        )
        known = self.model_copy(update={"bodies": bodies})
        carried = [
            one.model_copy(update={"damage": 1.0 - (1.0 - one.damage) * known.carried(number)[0]})
            for number, one in enumerate(self.interfaces)
        ]
        return known.model_copy(update={"interfaces": tuple(carried)})

    def carried(self, number: int) -> tuple[float, float]:
        """Share of an interface that sections of its bodies leave, and half-width over it."""
        interface, share, error = self.interfaces[number], 1.0, 0.0
        for face in interface.sides[interface.sides[0] == GROUNDED :] * interface.surface_damage:
            at, boundary = self._find(f"interface {number}", face)
            body = self.bodies[at]
            if isinstance(body, PorousBody):
                mesh = body.load()
                damage = body.surface_damage(mesh, boundary)
                share *= 1.0 - damage.mean
                error = float(np.hypot(error, damage.half_width / (1.0 - damage.mean)))
        return share, error

    def uncertainties(self) -> "list[tuple[Uncertainty, Self]]":
        """List what is unknown of values stated and volumes, and the structure with each stretched.

        Every parameter is larger by :data:`STRETCH` in a structure of its own. Bodies of one volume
        err alike; the one that holds the fewest volumes tells by how much.
        """
        listed = []
        for key, half, stretched in self.uncertain(1.0 + STRETCH):
            name = f"{key} ± {100.0 * half:.3g} %"
            error = Uncertainty(name=name, half_width={STATED: half}, how={STATED: STATED_HOW})
            listed.append((error, stretched))
        porous = [one for one in self.bodies if isinstance(one, PorousBody)]
        for volume in dict.fromkeys(one.rve for one in porous):
            alike = {one.name: one for one in porous if one.rve == volume}
            errors = [one.error(one.load()) for one in alike.values()]
            worst = max(errors, key=lambda error: error.half_width[FEW_CELLS])
            name = f"volume of {' and '.join(alike)}"
            bodies = tuple(
                one.model_copy(update={"factor": 1.0 + STRETCH}) if one.name in alike else one
                for one in self.bodies
            )
            changed = self.model_copy(update={"bodies": bodies})
            listed.append((replace(worst, name=name), changed))
        for at, one in enumerate(self.interfaces):
            if one.surface_damage:
                less = 1.0 - (1.0 - one.damage) * (1.0 - STRETCH)
                changed_one = one.model_copy(update={"damage": less})
                interfaces = (*self.interfaces[:at], changed_one, *self.interfaces[at + 1 :])
                told = "scatter of sections of the volume, over the area of the interface"
                error = Uncertainty(
                    name=f"sections at interface {at}",
                    half_width={FEW_CELLS: self.carried(at)[1]},
                    how={FEW_CELLS: told},
                )
                listed.append((error, self.model_copy(update={"interfaces": interfaces})))
        return listed

    def read_laws(self, case: "Case", found: "Datasets", open_law: OpenLaw) -> list[Dataset | None]:
        """Read the law of every interface, with its tangential branch; None of a stated one.

        Interfaces of one law and one friction share a dataset.
        """
        read: dict[Any, Dataset | None] = {}
        laws = []
        for number, one in enumerate(self.interfaces):
            source = one.over(case.interface)
            key = (
                one.asperities
                or one.exponential
                or one.linear
                or (
                    *(source.law, source.quick, source.law_error),
                    *(source.friction, source.stiffness_ratio),
                )
            )
            if key not in read:
                ratio = self.poissons_ratio(one)
                read[key] = None
                if not one.is_stated:
                    law = (
                        case.interface_law(found, open_law)
                        if source.law is None
                        else source.read(open_law)
                    )
                    middle = float(np.sqrt(law.attrs["pressure_min"] * law.attrs["pressure_max"]))
                    where = f"interface {number}"
                    read[key] = source.complete(law, ratio, middle, case.strict, where)
            laws.append(read[key])
        return laws

    def poissons_ratio(self, interface: BodyInterface) -> float:
        """Mean of the bodies that an interface joins."""
        faces = interface.sides[interface.sides[0] == GROUNDED :]
        bodies = [self.bodies[self._find("interface", face)[0]] for face in faces]
        return float(np.mean([body.poissons_ratio or 0.0 for body in bodies]))

    def sliders(
        self,
        case: "Case",
        laws: Sequence[Dataset | None],
        normal: "Mapping[int, NormalLaw] | None" = None,
        slabs: int | None = None,
    ) -> list[InterfaceLaw]:
        """Make the laws of all interfaces, less their damage, of those of :meth:`read_laws`."""
        beds = self.beds(case) | ({} if slabs is None else {"slabs": slabs})
        made: list[InterfaceLaw] = []
        changed = normal or {}
        for number, (one, law) in enumerate(zip(self.interfaces, laws, strict=True)):
            if law is None:
                made.append(self._stated(case, number, beds["slabs"]))
                continue
            sound = changed.get(number) or law_from_dataset(law)
            damage = one.damage or float(law.get("interface_damage", 0.0))
            worn = ModifiedLaw(sound, damage) if damage else sound
            bed = sliders_from_dataset(law, normal=worn, **beds)
            made.append(replace(bed, **one.over(case.interface).given))
        return made

    def beds(self, case: "Case") -> dict[str, Any]:
        """Options of :class:`Sliders` of every interface: the bed is fine over the data."""
        return {"slabs": SLABS}

    def _stated(self, case: "Case", number: int, slabs: int) -> InterfaceLaw:
        """Law of an interface that is stated, with a friction that is given."""
        one = self.interfaces[number]
        source = one.over(case.interface)
        if missing := source.tell_missing((), case.strict, f"interface {number}"):
            raise CaseError(missing)
        assert source.friction is not None  # else told as missing
        if one.asperities is not None:
            return one.asperities.build(source.friction, source.stiffness_ratio, one.damage)
        theory = mindlin_ratio(self.poissons_ratio(one))
        stated = one.exponential or one.linear
        assert stated is not None
        normal = stated.build()
        return Sliders(
            ModifiedLaw(normal, one.damage) if one.damage else normal,
            source.friction,
            source.stiffness_ratio or theory,
            pressures=stated.pressures,
            slabs=slabs,
        )

    def assumed(self, case: "Case") -> list[str]:
        """Report what stated laws leave to theory, one sentence each."""
        return [
            f"interface {number}: the stiffness ratio of "
            f"{mindlin_ratio(self.poissons_ratio(one)):.3g} is assumed; give stiffness_ratio, or "
            f"take the law of cells that are sheared"
            for number, one in enumerate(self.interfaces)
            if (one.exponential or one.linear) and one.over(case.interface).stiffness_ratio is None
        ]

    def build(self, case: "Case", laws: Sequence[InterfaceLaw]) -> StructureParts:
        """Build bodies, interfaces and bolts, and the path over the loads."""
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
                macro.bodies.GROUND
                if first == GROUNDED
                else self.place(meshes, f"interface {number}", first)
            )
            upper = self.place(meshes, f"interface {number}", second)
            sides = (lower[0], upper[0]), (lower[1], upper[1])
            gap = None if joint.gap is None else joint.gap.build()
            interfaces.append(macro.Interface(*sides, law, gap=gap))
        facts = [f"Interface {number}: {one.name}." for number, one in enumerate(self.interfaces)]
        bolts, sections = [], []
        for number, bolt in enumerate(self.bolts):
            head, nut = (self.place(meshes, f"bolt {number}", face) for face in bolt.sides)
            if bolt.meshed:
                cut = (head[0], nut[0]), (head[1], nut[1])
                sections.append(macro.BoltSection(*cut, bolt.preload))
                continue
            made, said = bolt.build((head[0], nut[0]), (head[1], nut[1]), bodies)
            bolts.append(made)
            facts.append(f"Bolt {number}, {said}: {1e-6 * made.stiffness:.4g} N/µm.")
        times = tuple(map(float, range(len(self.loads))))
        return StructureParts(
            macro.Assembly(
                tuple(bodies),
                tuple(interfaces),
                times,
                bolts=tuple(bolts),
                sections=tuple(sections),
            ),
            self.path(case, forces),
            tuple(facts),
        )

    def place(self, meshes: "Sequence[Mesh]", what: str, face: str) -> tuple[int, str]:
        """Find the number of a body and the name of its face, which its mesh must have."""
        body, boundary = self._find(what, face)
        known = sorted(meshes[body].boundaries)
        if boundary not in known:
            hint = suggest(boundary, known, f"its faces are {', '.join(known)}")
            raise CaseError(
                f"{what} names {face!r}, and the mesh of {self.bodies[body].name} has no face "
                f"{boundary!r}; {hint}"
            )
        return body, boundary

    def try_to_build(self, case: "Case", require: "Callable[[macro.Assembly], object]") -> None:
        """Refuse meshes, faces and bolts that do not fit, and free bodies, whatever the laws."""
        for one in self.bodies:
            one.check_coarser()
        frictions = [one.over(case.interface).friction for one in self.interfaces]
        any_law = Exponential(1e9, 1e-6)
        laws = [
            Sliders(any_law, 1.0 if mu is None else mu, 1.0, pressures=(1e6, 1e8))
            for mu in frictions
        ]
        require(self.build(case, laws).assembly)

    def pressed(self, case: "Case") -> list[Pressed]:
        """Estimate pressures of the interfaces from the resultants of bolts and loads."""
        if not self.interfaces:
            return []
        meshes = [body.load() for body in self.bodies]
        places = [self.place(meshes, f"the load {one.name}", one.face) for one in self.loads]
        # resultants at the factor one, bolts first, where they act, and on which bodies
        acting: list[list[tuple[np.ndarray, Face]]] = [[]] * bool(self.bolts)
        for bolt in self.bolts:
            ends = [Face.at(meshes, self.place(meshes, "a bolt", side)) for side in bolt.sides]
            acting[0] = [*acting[0], *((-0.5 * bolt.preload * end.normal, end) for end in ends)]
        for load, place in zip(self.loads, places, strict=True):
            traction, area = load.traction_on(meshes[place[0]], place[1])
            acting.append([(area * traction, Face.at(meshes, place))])
        factors = self.path(case, ()).factors()
        faces_of = [
            [
                (place[0], Face.at(meshes, place))
                for side in one.sides
                if side != GROUNDED
                for place in [self.place(meshes, one.name, side)]
            ]
            for one in self.interfaces
        ]
        shared = np.zeros(len(factors))  # what bolts press for sure, unless supports hold it apart
        laws = [(one.law, one.exponential, one.is_stated, one.gap) for one in self.interfaces]
        alike = all(law == laws[0] for law in laws)  # else the interface that they press is unknown
        if self.bolts and alike and sum(bool(body.supports) for body in self.bodies) < 2:
            area = sum(faces[-1][1].area for faces in faces_of)
            shared = factors[:, 0] * sum(bolt.preload for bolt in self.bolts) / area
        found = []
        for number, one in enumerate(self.interfaces):
            if one.asperities is not None or one.linear is not None or one.gap is not None:
                continue  # heights or a gap press it, too, and a constant stiffness has no limits
            faces = faces_of[number]
            smallest = min((face for _, face in faces), key=lambda face: face.area)
            most = np.abs(factors) @ [highest_pressure(smallest, forces) for forces in acting]
            least = shared
            for body, face in faces:
                if self._hangs_on(body, number):  # and so balances its loads
                    on_it = [
                        sum(force @ face.normal for force, _ in forces) if place[0] == body else 0.0
                        for forces, place in zip(acting, places, strict=True)
                    ]
                    least = np.maximum(least, factors @ on_it / face.area)
            damaged = 1.0 - one.damage
            found.append(
                Pressed(
                    f"the loads press interface {number}, {one.name},",
                    [
                        (low / damaged, high / damaged)
                        for low, high in zip(least, most, strict=True)
                    ],
                    one.law,
                    one.exponential.pressures if one.exponential else None,
                )
            )
        return found

    def _hangs_on(self, body: int, number: int) -> bool:
        """Whether an interface is all that holds a body."""
        name = f"{self.bodies[body].name}."
        touching = [one for one in self.interfaces if any(s.startswith(name) for s in one.sides)]
        alone = touching == [self.interfaces[number]] and not self.bodies[body].supports
        return alone and not self.bolts

    def coarser(self) -> dict[float, Self]:
        """Return the same bodies on coarser meshes, by the ratio of the element sizes.

        Nothing if a body has none, or they are hardly coarser: gmsh makes no elements larger than
        about a tenth of a geometry.
        """
        coarse = [one.coarsened() for one in self.bodies]
        bodies = tuple(one for one in coarse if one is not None)
        if len(bodies) < len(coarse):
            return {}
        fine, few = (
            sum(n_tetrahedra(one.load()) for one in each) for each in (self.bodies, bodies)
        )
        ratio = (fine / few) ** (1.0 / 3.0)
        return {ratio: self.model_copy(update={"bodies": bodies})} if ratio >= COARSER else {}

    def quick_title(self) -> str:
        """Report whether elements have a lower order than the whole case takes."""
        lower = any(one.element is None and one.order_on(one.load()) > 1 for one in self.bodies)
        return "quick, elements of first order" if lower else "quick"

    def quick(self, case: "Case") -> Self:
        """Return the same bodies of coarser geometries, and quick runs of the cases they name.

        Meshes that are read cannot be made coarser: their elements are of first order.
        """
        interfaces = tuple(
            one.model_copy(update={"quick": one.law is not None}) for one in self.interfaces
        )
        bodies = tuple(
            one.model_copy(
                update={
                    "quick": one.rve is not None,
                    "element": one.element and QUICK_ELEMENT * one.element,
                    "order": one.order if one.element else 1,
                }
            )
            for one in self.bodies
        )
        return self.model_copy(update={"bodies": bodies, "interfaces": interfaces})


def check_bodies(bodies: Sequence[MeshedBody], case: "Case") -> None:
    """Refuse bodies that lack what the other tables of their case ask for.

    That is stiffness, mass to vibrate, a cycle and a body that fatigue may follow; and a volume
    that no body takes.
    """
    takers = [one.name for one in bodies if one.porous and one.rve is None]
    if takers and case.rve is None:
        raise ValueError(
            f"{takers[0]} has neither moduli nor rve, and the case has no [rve]; give one of them"
        )
    if case.rve is not None and not takers and case.growth is None:
        raise ValueError(
            "every body has moduli or an rve of its own, and none takes the [rve] of this case"
        )
    without = [body.name for body in bodies if body.density is None]
    if case.vibration is not None and without:
        raise ValueError(
            f"[vibration] needs the mass of all bodies, and {without[0]} has no density; give it, "
            f'such as "7850 kg/m^3"'
        )
    if case.fatigue is not None:
        _check_fatigue(bodies, case)
    if (method := case.statics.method) is None:
        return
    for table in ("vibration", "growth"):
        if getattr(case, table) is not None:
            raise ValueError(
                f'method = "{method}" in [statics] is not for [{table}], which has a solver of its '
                f"own; leave out method"
            )
    if method == "newton" and case.substructures is not None:
        raise ValueError(
            'method = "newton" in [statics] solves the whole, and [substructures] cut it for '
            "LATIN; leave out one of them"
        )


def _check_fatigue(bodies: Sequence[MeshedBody], case: "Case") -> None:
    """Refuse a history without a cycle, and a body that does not exist."""
    if case.cycles is None:
        raise ValueError(
            "[fatigue] repeats the last cycle of the loads, and the history has no cycle; give "
            "[cycles]"
        )
    names = [one.name for one in bodies]
    if case.fatigue.body is None and len(names) > 1:
        raise ValueError(
            f"[fatigue] follows one body, and there are {', '.join(names)}; name one by body"
        )
    if case.fatigue.body not in (None, *names):
        raise ValueError(
            f"[fatigue] body is {case.fatigue.body!r}, and there are {', '.join(names)}"
        )
    followed = bodies[names.index(case.fatigue.body or names[0])]
    if followed.porous:
        raise ValueError(
            f"[fatigue] follows {followed.name}, whose inclusions have no moduli; give it "
            f"youngs_modulus and poissons_ratio in place of a representative volume"
        )
