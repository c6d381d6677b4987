"""Tables of elastic bodies with user meshes, interfaces, bolts and named loads."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, field_validator

from multiscale import macro
from multiscale.errors import CaseError, suggest
from multiscale.laws import InterfaceLaw
from multiscale.macro import substructures
from multiscale.pipeline.tables import assembly_parts, meshed_bodies
from multiscale.pipeline.tables.joint_settings import (
    SLABS,
    JointLaw,
    OpenLaw,
    Slabs,
    SolverChoice,
)
from multiscale.pipeline.tables.solved_bodies import SolvedBodies, StructureParts, body_faults
from multiscale.pipeline.tables.structure_kind import Face, Pressed, highest_pressure
from multiscale.pipeline.tables.toml_model import Number, Positive, Settings, at_most
from multiscale.schema import Dataset

if TYPE_CHECKING:
    from skfem import Mesh

    from multiscale.pipeline.stage import Datasets
    from multiscale.pipeline.tables.settings import Case

PRELOAD = "preload"  # name of the tightening of the bolts among the loads
KINDS = {4: "tetrahedra", 8: "hexahedra"}  # kinds of elements by the number of their corners


class LoadSteps(SolverChoice):
    """Steps over the named loads; see :class:`multiscale.macro.substructures.LoadPath`."""

    steps: tuple[dict[str, Number], ...] = Field(min_length=1)
    """Factors of loads at the end of every step, by the names of the loads; `preload` tightens all
    bolts. A load without a new factor keeps its factor, 0 at first."""
    substeps: Positive = Field(1, description="Number of equal parts of every step.")


class LoadCycles(Settings):
    """Cycles of a named load about its factor at the end of the steps."""

    load: str = Field(description="Name of the load.")
    amplitude: Annotated[Number, Field(gt=0.0)] = 1.0
    """Amplitude of its factor."""
    cycles: Annotated[Positive, at_most(1)]
    """Closed cycles after the first loading."""
    steps: Annotated[Positive, at_most(2)] = 10
    """Load steps from the middle to the amplitude."""
    slabs: Slabs = SLABS
    """Slabs of the beds of sliders."""


class Bodies(SolvedBodies):
    """Elastic bodies with user meshes, interfaces, bolts and named loads."""

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
    quick_note: ClassVar[str] = (
        "--quick uses larger elements in geometries, and elements of first order on meshes that "
        "are read from files, which it cannot make coarser"
    )
    no_coarser: ClassVar[str] = (
        "the error of the meshes is unknown, and in no interval: give every body a coarser "
        "mesh, of elements twice as large"
    )

    kind: Literal["bodies"]
    bolts: tuple[assembly_parts.BodyBolt, ...] = ()
    loads: tuple[assembly_parts.NamedLoad, ...] = ()

    @field_validator("bodies", "loads")
    @classmethod
    def _name_once(cls, parts: tuple[Any, ...]) -> tuple[Any, ...]:
        names = [part.name for part in parts]
        if twice := [name for name in names if names.count(name) > 1]:
            raise ValueError(f"names must differ, and {twice[0]!r} is given {len(twice)} times")
        return parts

    def _faults(self) -> Iterator[str]:
        if not (self.bolts or self.loads):
            yield "nothing loads the bodies: give [[structure.loads]] or bolts"
        if any(load.name == PRELOAD for load in self.loads):
            yield f"a load is named {PRELOAD!r}, which is the tightening of the bolts; rename it"
        for user, face in self._faces():
            self._find(user, face)
        pairs = [set(interface.sides) for interface in self.interfaces]
        if double := [pair for pair, other in combinations(pairs, 2) if pair == other]:
            yield f"{' and '.join(sorted(double[0]))} meet in two interfaces; delete one of them"

    def _faces(self) -> list[tuple[str, str]]:
        named = [
            (f"interface {i}", face)
            for i, interface in enumerate(self.interfaces)
            for face in interface.faces
        ]
        named += [(f"bolt {i}", face) for i, bolt in enumerate(self.bolts) for face in bolt.sides]
        return [*named, *((f"the load {load.name}", load.face) for load in self.loads)]

    @property
    def load_names(self) -> tuple[str, ...]:
        """Names of all loads, the tightening of the bolts first."""
        return (PRELOAD,) * bool(self.bolts) + tuple(load.name for load in self.loads)

    def faults_with(self, case: "Case") -> Iterator[str]:
        """Report a path over loads that do not exist, and joints without friction."""
        names = self.load_names
        given = [name for step in case.statics.steps for name in step]
        given += [case.cycles.load] if case.cycles else []
        if unknown := [name for name in given if name not in names]:
            yield (
                f"the path names the load {unknown[0]!r}, which does not exist; there are "
                f"{', '.join(names)}"
            )
        if self.bolts and not case.statics.steps[0].get(PRELOAD, 0.0) > 0.0:
            yield (
                f"the first of steps in [statics] must tighten the bolts, such as "
                f"{{ {PRELOAD} = 1 }}, got {case.statics.steps[0]}"
            )
        if case.cycles and case.cycles.load == PRELOAD:
            yield f"[cycles] load is {PRELOAD!r}; bolts are tightened only by steps"
        yield from body_faults(self.bodies, case)
        several = len(self.bodies) > 1 or self.interfaces or self.bolts
        if case.growth is not None and (case.cycles or case.vibration or several):
            yield (
                "[growth] cracks one body under [statics], without interfaces and bolts; leave out "
                "[growth], or the others"
            )
        for number, interface in enumerate(self.interfaces):
            if interface.surface_damage and not any(
                self.bodies[self._find("interface", face)[0]].porous for face in interface.faces
            ):
                yield (
                    f"surface_damage of interface {number} belongs to representative volumes, and "
                    f"neither body has a volume; leave it out, or give damage"
                )
        if case.has_cells:
            for number, interface in enumerate(self.interfaces):
                law = interface.over(case.interface)
                if interface.law is None:
                    yield from law.missing(case.known_shear, case.strict, f"interface {number}")

    def named_laws(self, case: "Case") -> "Sequence[tuple[Path, bool] | None]":
        """Return the named law of every interface; None for a stated law, and for cells."""
        sources = [
            None if interface.is_stated else interface.over(case.interface)
            for interface in self.interfaces
        ]
        return [
            None if source is None or source.law is None else (source.law, source.quick)
            for source in sources
        ]

    def taken_volumes(self) -> set[tuple[Path, bool]]:
        """Return the files of volumes of bodies, and whether a case among them is run quick."""
        return {(body.rve, body.quick) for body in self.bodies if body.rve is not None}

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

    def path(self, case: "Case", forces: Sequence[float]) -> "substructures.LoadPath":
        """Return the path over the loads, from their resultants at the factor 1, N."""
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

    def read_laws(
        self, case: "Case", datasets: "Datasets", open_law: OpenLaw
    ) -> list[Dataset | None]:
        """Read the law of every interface, shared where it is the same; None for a stated law."""
        read: dict[Any, Dataset | None] = {}
        laws = []
        for number, interface in enumerate(self.interfaces):
            source = interface.over(case.interface)
            key = (
                interface.asperities
                or interface.exponential
                or interface.linear
                or (
                    *(source.law, source.quick, source.law_error, source.speed),
                    *(source.friction, source.stiffness_ratio),
                )
            )
            if key not in read:
                ratio = self.poissons_ratio(interface)
                read[key] = None
                if not interface.is_stated:
                    law = (
                        source.read(open_law)
                        if source.law
                        else case.interface_law(datasets, open_law)
                    )
                    middle = float(np.sqrt(law.attrs["pressure_min"] * law.attrs["pressure_max"]))
                    where = f"interface {number}"
                    read[key] = source.complete(law, ratio, middle, case.strict, where)
            laws.append(read[key])
        return laws

    def build(self, case: "Case", laws: Sequence[InterfaceLaw]) -> StructureParts:
        """Build bodies, interfaces and bolts, and the path over the loads."""
        meshes = [body.load() for body in self.bodies]
        bodies, forces = self._build_bodies(meshes)
        interfaces = [self._join(meshes, number, law) for number, law in enumerate(laws)]
        bolts, sections, described = self._tighten(meshes, bodies)
        facts = (
            f"Interface {number}: {interface.name}."
            for number, interface in enumerate(self.interfaces)
        )
        times = tuple(map(float, range(len(self.loads))))
        assembly = macro.Assembly(
            tuple(bodies), tuple(interfaces), times, bolts=tuple(bolts), sections=tuple(sections)
        )
        return StructureParts(assembly, self.path(case, forces), (*facts, *described))

    def _build_bodies(self, meshes: Sequence["Mesh"]) -> tuple[list["macro.Body"], list[float]]:
        """Build the bodies with their loads, and return the resultants of all loads, N."""
        kinds = {
            body.name: KINDS[mesh.t.shape[0]]
            for body, mesh in zip(self.bodies, meshes, strict=True)
        }
        if len(set(kinds.values())) > 1:
            description = " and ".join(f"{name} {kind}" for name, kind in kinds.items())
            raise CaseError(
                f"the bodies have elements of two kinds, {description}; use the same kind for all"
            )
        pulls: list[dict[str, dict[int, np.ndarray]]] = [{} for _ in meshes]
        forces = [sum(bolt.preload for bolt in self.bolts)] * bool(self.bolts)
        for number, load in enumerate(self.loads):
            body, boundary = self.place(meshes, f"the load {load.name}", load.face)
            traction, area = load.traction_on(meshes[body], boundary)
            pulls[body].setdefault(boundary, {})[number] = traction
            forces.append(float(np.linalg.norm(traction)) * area)
        for supported in self.bodies:
            for boundary in supported.supports:
                self.place(meshes, f"supports of {supported.name}", f"{supported.name}.{boundary}")
        built = zip(self.bodies, meshes, pulls, strict=True)
        return [body.build(mesh, pull) for body, mesh, pull in built], forces

    def _join(self, meshes: Sequence["Mesh"], number: int, law: InterfaceLaw) -> "macro.Interface":
        """Build an interface of two bodies, or of a body and the ground."""
        joint, user = self.interfaces[number], f"interface {number}"
        grounded = joint.sides[0] == assembly_parts.GROUNDED
        lower = macro.bodies.GROUND if grounded else self.place(meshes, user, joint.sides[0])
        upper = self.place(meshes, user, joint.sides[1])
        gap = None if joint.gap is None else joint.gap.build()
        return macro.Interface((lower[0], upper[0]), (lower[1], upper[1]), law, gap=gap)

    def _tighten(
        self, meshes: Sequence["Mesh"], bodies: "Sequence[macro.Body]"
    ) -> tuple[list["macro.Bolt"], list["macro.BoltSection"], list[str]]:
        """Build springs and meshed sections of bolts, and describe the springs."""
        bolts, sections, described = [], [], []
        for number, bolt in enumerate(self.bolts):
            head, nut = (self.place(meshes, f"bolt {number}", face) for face in bolt.sides)
            sides = (head[0], nut[0]), (head[1], nut[1])
            if bolt.meshed:
                sections.append(macro.BoltSection(*sides, bolt.preload))
                continue
            made, description = bolt.build(*sides, bodies)
            bolts.append(made)
            described.append(f"Bolt {number}, {description}: {1e-6 * made.stiffness:.4g} N/µm.")
        return bolts, sections, described

    def place(self, meshes: "Sequence[Mesh]", user: str, face: str) -> tuple[int, str]:
        """Return the number of a body and the name of its face, which its mesh must have."""
        body, boundary = self._find(user, face)
        names = sorted(meshes[body].boundaries)
        if boundary not in names:
            hint = suggest(boundary, names, f"its faces are {', '.join(names)}")
            raise CaseError(
                f"{user} names {face!r}, and the mesh of {self.bodies[body].name} has no face "
                f"{boundary!r}; {hint}"
            )
        return body, boundary

    def pressed(self, case: "Case") -> list[Pressed]:
        """Estimate pressures of the interfaces from the resultants of bolts and loads."""
        if not self.interfaces:
            return []
        meshes = [body.load() for body in self.bodies]
        places = [self.place(meshes, f"the load {load.name}", load.face) for load in self.loads]
        # resultants at the factor 1, bolts first, and the faces on which they act
        acting: list[list[tuple[np.ndarray, Face]]] = [[]] * bool(self.bolts)
        for bolt in self.bolts:
            placed = [self.place(meshes, "a bolt", side) for side in bolt.sides]
            ends = [Face.at(meshes[body], boundary) for body, boundary in placed]
            acting[0] = [*acting[0], *((-0.5 * bolt.preload * end.normal, end) for end in ends)]
        for load, place in zip(self.loads, places, strict=True):
            traction, area = load.traction_on(meshes[place[0]], place[1])
            acting.append([(area * traction, Face.at(meshes[place[0]], place[1]))])
        factors = self.path(case, ()).factors()
        faces_of = [
            [(body, Face.at(meshes[body], boundary)) for body, boundary in placed]
            for interface in self.interfaces
            for placed in [[self.place(meshes, interface.name, side) for side in interface.faces]]
        ]
        # certain pressure by bolts, if no supports carry their force
        shared = np.zeros(len(factors))
        laws = [
            (interface.law, interface.exponential, interface.is_stated, interface.gap)
            for interface in self.interfaces
        ]
        alike = all(law == laws[0] for law in laws)  # otherwise the pressed interface is unknown
        if self.bolts and alike and sum(bool(body.supports) for body in self.bodies) < 2:
            area = sum(faces[-1][1].area for faces in faces_of)
            shared = factors[:, 0] * sum(bolt.preload for bolt in self.bolts) / area
        pressed = []
        for number, interface in enumerate(self.interfaces):
            if interface.asperities or interface.linear or interface.gap:
                continue  # heights or a gap press it, too; a constant stiffness has no limits
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
            loading = f"the loads press interface {number}, {interface.name},"
            steps = (np.stack([least, most], axis=1) / (1.0 - interface.damage)).tolist()
            stated = interface.exponential.pressures if interface.exponential else None
            pressed.append(Pressed(loading, steps, interface.law, stated))
        return pressed

    def _hangs_on(self, body: int, number: int) -> bool:
        """Whether an interface is the only support of a body."""
        name = f"{self.bodies[body].name}."
        touching = [
            k
            for k, interface in enumerate(self.interfaces)
            if any(side.startswith(name) for side in interface.sides)
        ]
        return touching == [number] and not self.bodies[body].supports and not self.bolts

    @property
    def file_meshes(self) -> tuple[bool, ...]:
        """Whether a coarser mesh is given, for every mesh that is read from a file."""
        return tuple(body.coarser is not None for body in self.bodies if body.element is None)

    def refinement(self) -> float:
        """Return the ratio of the sizes of elements at twice the asked sizes; 1 if alike."""
        sized = [body for body in self.bodies if body.element is not None]
        ratio = _size_ratio(sized, [body.coarsened() or body for body in sized]) if sized else 1.0
        return ratio if ratio >= meshed_bodies.COARSER else 1.0

    def coarser(self) -> dict[float, Self]:
        """Return the same bodies on coarser meshes, if any, by the ratio of the element sizes."""
        coarse = [body.coarsened() for body in self.bodies]
        bodies = tuple(body for body in coarse if body is not None)
        if len(bodies) < len(coarse):
            return {}
        ratio = _size_ratio(self.bodies, bodies)
        if ratio < meshed_bodies.COARSER:
            return {}
        return {ratio: self.model_copy(update={"bodies": bodies})}

    def quick_title(self) -> str:
        """Report whether elements have a lower order than in the whole case."""
        lower = any(body.element is None and body.order_on(body.load()) > 1 for body in self.bodies)
        return "quick, elements of first order" if lower else "quick"


def _size_ratio(
    fine: Sequence[meshed_bodies.MeshedBody], coarse: Sequence[meshed_bodies.MeshedBody]
) -> float:
    """Return the ratio of the sizes of the elements of coarse and fine bodies."""
    many, few = (
        sum(meshed_bodies.n_tetrahedra(body.load()) for body in bodies) for bodies in (fine, coarse)
    )
    return float((many / few) ** (1.0 / 3.0))
