"""Elastic bodies with interfaces for the stages that solve them."""

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from pydantic import Field

from multiscale import macro
from multiscale.errors import CaseError
from multiscale.laws import Exponential, InterfaceLaw, ModifiedLaw, Sliders
from multiscale.laws.bulk.bulk_law import mindlin_ratio
from multiscale.macro import substructures
from multiscale.pipeline.tables import assembly_parts, meshed_bodies
from multiscale.pipeline.tables.joint_settings import SLABS, OpenLaw
from multiscale.pipeline.tables.porous_body import PorousBody
from multiscale.pipeline.tables.structure_kind import StructureKind
from multiscale.schema import RVE, Dataset
from multiscale.upscaling import law_from_dataset, sliders_from_dataset
from multiscale.upscaling.budget import FEW_CELLS, STATED
from multiscale.upscaling.propagation import STRETCH, Uncertainty

if TYPE_CHECKING:
    from multiscale.laws import NormalLaw
    from multiscale.pipeline.stage import Datasets, Job
    from multiscale.pipeline.tables.settings import Case


def stated_error(key: str, half_width: float) -> Uncertainty:
    """Return the source of error of a value that a case states with its relative half-width."""
    name, how = f"{key} ± {100.0 * half_width:.3g} %", "half-widths stated with +-"
    return Uncertainty(name=name, half_width={STATED: half_width}, how={STATED: how})


@dataclass(frozen=True, eq=False)
class StructureParts:
    """The structure of a case, built."""

    assembly: "macro.Assembly"
    path: "substructures.LoadPath"
    facts: tuple[str, ...] = ()  # sentences that are reported with the answer


class SolvedBodies(StructureKind):
    """Elastic bodies, their interfaces, and the path of their loads."""

    stage: ClassVar[str] = "loaded_bodies"
    may_be_cut: ClassVar[bool] = True
    may_tire: ClassVar[bool] = True
    no_coarser: ClassVar[str]  # caution if no coarser structure can be solved

    kind: str
    bodies: tuple[meshed_bodies.MeshedBody, ...] = Field(min_length=1)
    interfaces: tuple[assembly_parts.BodyInterface, ...] = ()

    @property
    def mesher(self) -> tuple[str, ...]:
        """Library that meshes bodies, if any."""
        return ("gmsh",) * any(body.element is not None for body in self.bodies)

    @abstractmethod
    def path(self, case: "Case", forces: Sequence[float]) -> "substructures.LoadPath":
        """Return the path over the loads, from their resultants at the factor 1, N."""

    @abstractmethod
    def joint_size(self, case: "Case") -> "substructures.JointSize":
        """Count unknowns, points of interfaces and load steps."""

    @abstractmethod
    def read_laws(
        self, case: "Case", datasets: "Datasets", open_law: OpenLaw
    ) -> list[Dataset | None]:
        """Read the law of every interface, shared where it is the same; None for a stated law."""

    @abstractmethod
    def build(self, case: "Case", laws: Sequence[InterfaceLaw]) -> StructureParts:
        """Build bodies, interfaces and bolts, and the path over the loads."""

    @abstractmethod
    def coarser(self) -> dict[float, Self]:
        """Return the same structure on larger elements, if any, by the ratio of their sizes."""

    def _find(self, user: str, face: str) -> tuple[int, str]:
        """Return the number of the body of a face, and the name of the face in it."""
        body, dot, boundary = face.partition(".")
        names = [body.name for body in self.bodies]
        if not (dot and boundary):
            raise ValueError(f'{user} names {face!r}, which is not a face; write "BODY.FACE"')
        if body not in names:
            raise ValueError(
                f"{user} names {face!r}, and there is no body {body!r}; there are "
                f"{', '.join(names)}"
            )
        return names.index(body), boundary

    def with_volumes(self, case: "Case", datasets: "Datasets", open_rve: OpenLaw) -> Self:
        """Return the same bodies with their representative volumes, and damaged interfaces."""
        bodies = tuple(
            PorousBody.of(body, open_rve(body.rve, body.quick) if body.rve else datasets[RVE.name])
            if body.porous
            else body
            for body in self.bodies
        )
        structure = self.model_copy(update={"bodies": bodies})
        carried = [
            interface.model_copy(
                update={"damage": 1.0 - (1.0 - interface.damage) * structure.carried(number)[0]}
            )
            for number, interface in enumerate(self.interfaces)
        ]
        return structure.model_copy(update={"interfaces": tuple(carried)})

    def carried(self, number: int) -> tuple[float, float]:
        """Share of an interface left by sections of its bodies, and its relative half-width."""
        interface, share, error = self.interfaces[number], 1.0, 0.0
        for face in interface.faces * interface.surface_damage:
            at, boundary = self._find(f"interface {number}", face)
            body = self.bodies[at]
            if isinstance(body, PorousBody):
                mesh = body.load()
                damage = body.surface_damage(mesh, boundary)
                share *= 1.0 - damage.mean
                error = float(np.hypot(error, damage.half_width / (1.0 - damage.mean)))
        return share, error

    def uncertainties(self) -> "list[tuple[Uncertainty, Self]]":
        """List the errors of stated values and volumes, each with its changed structure."""
        listed = []
        for key, half, stretched in self.uncertain(1.0 + STRETCH):
            listed.append((stated_error(key, half), stretched))
        porous = [body for body in self.bodies if isinstance(body, PorousBody)]
        for volume in dict.fromkeys(body.rve for body in porous):
            alike = {body.name: body for body in porous if body.rve == volume}
            errors = [body.error(body.load()) for body in alike.values()]
            worst = max(errors, key=lambda error: error.half_width[FEW_CELLS])
            name = f"volume of {' and '.join(alike)}"
            bodies = tuple(
                body.model_copy(update={"factor": 1.0 + STRETCH}) if body.name in alike else body
                for body in self.bodies
            )
            changed = self.model_copy(update={"bodies": bodies})
            listed.append((replace(worst, name=name), changed))
        for at, interface in enumerate(self.interfaces):
            if interface.surface_damage:
                less = 1.0 - (1.0 - interface.damage) * (1.0 - STRETCH)
                damaged = interface.model_copy(update={"damage": less})
                interfaces = (*self.interfaces[:at], damaged, *self.interfaces[at + 1 :])
                how = "scatter of sections of the volume, over the area of the interface"
                error = Uncertainty(
                    name=f"sections at interface {at}",
                    half_width={FEW_CELLS: self.carried(at)[1]},
                    how={FEW_CELLS: how},
                )
                listed.append((error, self.model_copy(update={"interfaces": interfaces})))
        return listed

    def poissons_ratio(self, interface: assembly_parts.BodyInterface) -> float:
        """Mean of the bodies that an interface joins."""
        bodies = [self.bodies[self._find("interface", face)[0]] for face in interface.faces]
        return float(np.mean([body.poissons_ratio or 0.0 for body in bodies]))

    def sliders(
        self,
        case: "Case",
        laws: Sequence[Dataset | None],
        normal: "Mapping[int, NormalLaw] | None" = None,
        slabs: int | None = None,
    ) -> list[InterfaceLaw]:
        """Return the laws of all interfaces from :meth:`read_laws`, reduced by their damage."""
        beds = self.beds(case) | ({} if slabs is None else {"slabs": slabs})
        made: list[InterfaceLaw] = []
        changed = normal or {}
        for number, (interface, law) in enumerate(zip(self.interfaces, laws, strict=True)):
            if law is None:
                made.append(self._stated(case, number, beds["slabs"]))
                continue
            sound = changed.get(number) or law_from_dataset(law)
            worn = ModifiedLaw(sound, interface.damage) if interface.damage else sound
            bed = sliders_from_dataset(law, normal=worn, **beds)
            made.append(replace(bed, **interface.over(case.interface).given))
        return made

    def slabs(self, case: "Case") -> int:
        """Slabs of the beds of sliders."""
        return case.cycles.slabs if case.cycles else SLABS

    def beds(self, case: "Case") -> dict[str, Any]:
        """Options of :class:`Sliders` of every interface: the bed resolves the data."""
        return {"slabs": self.slabs(case)}

    def _stated(self, case: "Case", number: int, slabs: int) -> InterfaceLaw:
        interface = self.interfaces[number]
        source = interface.over(case.interface)
        for fault in source.missing((), case.strict, f"interface {number}"):
            raise CaseError(fault)
        assert source.friction is not None  # else refused above
        if interface.asperities is not None:
            return interface.asperities.build(
                source.friction, source.stiffness_ratio, interface.damage
            )
        theory = mindlin_ratio(self.poissons_ratio(interface))
        stated = interface.exponential or interface.linear
        assert stated is not None
        normal = stated.build()
        return Sliders(
            ModifiedLaw(normal, interface.damage) if interface.damage else normal,
            source.friction,
            source.stiffness_ratio or theory,
            pressures=stated.pressures,
            slabs=slabs,
        )

    def assumed(self, case: "Case") -> list[str]:
        """Report the assumed stiffness ratios of stated laws, a sentence each."""
        return [
            f"interface {number}: the stiffness ratio of "
            f"{mindlin_ratio(self.poissons_ratio(interface)):.3g} is assumed; give "
            f"stiffness_ratio, or take the law of sheared cells"
            for number, interface in enumerate(self.interfaces)
            if (interface.exponential or interface.linear)
            and interface.over(case.interface).stiffness_ratio is None
        ]

    def cut(self, case: "Case", datasets: "Datasets", job: "Job") -> "substructures.CutProblem":
        """Cut every body into boxes."""
        bodies = self.with_volumes(case, datasets, job.read_rve)
        laws = bodies.sliders(case, bodies.read_laws(case, datasets, job.read_law))
        return substructures.cut_assembly(bodies.build(case, laws).assembly, case.cut.parts)

    def try_to_build(self, case: "Case", require: "Callable[[macro.Assembly], object]") -> None:
        """Refuse wrong meshes, faces and bolts, and free bodies, for any law."""
        for body in self.bodies:
            body.check_coarser()
        frictions = [interface.over(case.interface).friction for interface in self.interfaces]
        any_law = Exponential(1e9, 1e-6)
        laws = [
            Sliders(any_law, 1.0 if mu is None else mu, 1.0, pressures=(1e6, 1e8))
            for mu in frictions
        ]
        require(self.build(case, laws).assembly)


def body_faults(bodies: Sequence[meshed_bodies.MeshedBody], case: "Case") -> Iterator[str]:
    """Report bodies without the data for the other tables of their case."""
    takers = [body.name for body in bodies if body.porous and body.rve is None]
    if takers and case.rve is None:
        yield f"{takers[0]} has neither moduli nor rve, and the case has no [rve]; give one of them"
    if case.rve is not None and not takers and case.growth is None:
        yield "every body has moduli or rve, so no body uses the [rve] of this case"
    without = [body.name for body in bodies if body.density is None]
    if case.vibration is not None and without:
        yield (
            f"[vibration] needs the mass of all bodies, and {without[0]} has no density; give it, "
            f'such as "7850 kg/m^3"'
        )
    if case.fatigue is not None:
        yield from _fatigue_faults(bodies, case)
    if (method := case.statics.method) is None:
        return
    for table in ("vibration", "growth"):
        if getattr(case, table) is not None:
            yield (
                f'method = "{method}" in [statics] is not for [{table}], which has a different '
                f"solver; leave out method"
            )
    if method != "latin" and case.substructures is not None:
        yield (
            f'method = "{method}" in [statics] solves the whole structure, and [substructures] cut '
            f"it for LATIN; leave out one of them"
        )


def _fatigue_faults(bodies: Sequence[meshed_bodies.MeshedBody], case: "Case") -> Iterator[str]:
    if case.cycles is None:
        yield (
            "[fatigue] repeats the last cycle of the loads, and the history has no cycle; give "
            "[cycles]"
        )
    names = [body.name for body in bodies]
    if case.fatigue.body is None and len(names) > 1:
        yield f"[fatigue] needs a single body, and there are {', '.join(names)}; name it by body"
    if case.fatigue.body not in (None, *names):
        yield f"[fatigue] body is {case.fatigue.body!r}, and there are {', '.join(names)}"
    followed = bodies[names.index(case.fatigue.body or names[0])]
    if followed.porous:
        yield (
            f"[fatigue] needs the moduli of the inclusions of {followed.name}; give it "
            f"youngs_modulus and poissons_ratio in place of a representative volume"
        )
