"""Bodies of a case with the laws of their interfaces, and their sources of error."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np

from multiscale import upscaling
from multiscale.laws import InterfaceLaw, NormalLaw
from multiscale.pipeline.stage import Datasets, Job
from multiscale.pipeline.tables.settings import Case
from multiscale.pipeline.tables.solved_bodies import SolvedBodies, StructureParts, stated_error
from multiscale.schema import Dataset
from multiscale.upscaling.budget import has_budget, known_terms
from multiscale.upscaling.propagation import STRETCH
from multiscale.upscaling.shear_budget import shear_errors

UNKNOWN_LAW = (
    "intervals do not contain the error of the law of interface {number}, which is unknown: take "
    "the law of a run"
)
NO_BUDGET = (
    f"{UNKNOWN_LAW}, or state law_error of a table, or half-widths of values, as in "
    'friction = "0.2 +- 10 %"'
)


@dataclass(frozen=True, eq=False)
class Change:
    """Changes of a structure that is solved again."""

    joints: tuple[int, ...] = ()  # joints with a changed law
    normal: NormalLaw | None = None  # normal law of these joints
    factors: Mapping[str, float] = field(default_factory=dict)  # factors of friction parameters
    coarse_bed: bool = False  # whether the beds of these joints have half of their slabs
    structure: SolvedBodies | None = None  # structure on another mesh, or with another parameter


@dataclass(frozen=True, eq=False)
class BodiesWithLaws:
    """Bodies of a case, and the law of every interface."""

    bodies: SolvedBodies
    case: Case
    laws: Sequence[Dataset | None]

    @classmethod
    def of(
        cls, structure: SolvedBodies, case: Case, datasets: Datasets, job: Job
    ) -> "BodiesWithLaws":
        """Read volumes and laws."""
        bodies = structure.with_volumes(case, datasets, job.read_rve)
        return cls(bodies, case, bodies.read_laws(case, datasets, job.read_law))

    def build(self, laws: Sequence[InterfaceLaw]) -> StructureParts:
        """Build the bodies with some laws of their interfaces."""
        return self.bodies.build(self.case, laws)

    def changed(self, change: Change) -> "BodiesWithLaws":
        """Return the bodies of a change."""
        return replace(self, bodies=change.structure or self.bodies)

    def sliders(
        self,
        change: Change = Change(),  # frozen
        slabs: int | None = None,
    ) -> list[InterfaceLaw]:
        """Return the laws of all interfaces, as :meth:`SolvedBodies.sliders`, with a change."""
        normal = {} if change.normal is None else dict.fromkeys(change.joints, change.normal)
        made = self.bodies.sliders(self.case, self.laws, normal, slabs)
        return change_friction(made, change)


@dataclass(frozen=True, eq=False)
class JointsOfLaw:
    """Joints that share a law with a budget."""

    law: Dataset  # carries its budget
    joints: tuple[int, ...]
    measured: Collection[str]  # parameters of their sliders that come from the law

    @property
    def name(self) -> str:
        """Name of the joints."""
        return f"interface {', '.join(map(str, self.joints))}"

    def sources(
        self,
        pressure: np.ndarray | None,
        without: Mapping[str, np.ndarray] = {},
        drawn: Sequence[np.ndarray] | None = None,
        beyond: tuple[bool, bool] = (False, False),
    ) -> list[upscaling.Source]:
        """Return the errors of normal law and friction at a pressure of the joints, Pa, if any."""

        def change(normal: NormalLaw) -> Change:
            return Change(self.joints, normal)

        listed = upscaling.law_sources(
            self.law, pressure, of=self.name, change=change, drawn=drawn, beyond=beyond
        )
        friction = {} if pressure is None else shear_errors(self.law, pressure)
        known = known_terms(self.law)
        for parameter, widths in friction.items():
            if parameter not in self.measured:
                continue
            half_width = {
                term: np.where(without.get(term, False), 0.0, half)
                for term, half in widths.items()
                if term in known
            }
            larger = Change(self.joints, factors={parameter: 1.0 + STRETCH})
            name = parameter.replace("_", " ")
            listed.append(
                upscaling.Uncertainty(
                    name=name, of=self.name, half_width=half_width, changes=[larger]
                )
            )
        return listed


@dataclass(frozen=True, eq=False)
class ErrorSources:
    """Error sources of bodies with interfaces."""

    laws: list[JointsOfLaw]  # laws with independent errors
    stated: list[upscaling.Uncertainty]  # of stated values and representative volumes
    unknown: list[str]  # laws without an error, a sentence each
    beds: tuple[int, ...]  # joints that have beds of sliders
    meshes: Mapping[float, SolvedBodies]  # coarser structures, by the ratio of the spacings

    @classmethod
    def of(cls, jointed: BodiesWithLaws) -> "ErrorSources":
        """Collect the error sources of bodies and laws."""
        bodies, case, laws = jointed.bodies, jointed.case, jointed.laws
        shared_laws, unknown = [], []
        for number, law in enumerate(laws):
            interface = bodies.interfaces[number]
            if not has_budget(law):
                # a stated law has the half-widths of its parameters
                if law is not None or not any(interface.uncertain(1.0)):
                    unknown.append(NO_BUDGET.format(number=number))
            elif not any(law is other for other in laws[:number]):  # the first interface of its law
                source = interface.over(case.interface)
                joints = tuple(k for k, other in enumerate(laws) if other is law)
                measured = {"friction", "stiffness_ratio"} - source.given.keys()
                shared_laws.append(JointsOfLaw(law, joints, measured))
        stated = [
            replace(error, of=error.name, name="", changes=[Change(structure=changed)])
            for error, changed in bodies.uncertainties()
        ]
        for key, half, _ in case.interface.uncertain(1.0) if case.interface else ():
            shares = [getattr(interface, key) is None for interface in bodies.interfaces]
            joints = tuple(np.flatnonzero(shares).tolist())
            larger = Change(joints, factors={key: 1.0 + STRETCH})
            error = stated_error(key, half)
            stated.append(replace(error, of=error.name, name="", changes=[larger]))
        beds = tuple(
            k for k, interface in enumerate(bodies.interfaces) if interface.asperities is None
        )
        return cls(shared_laws, stated, unknown, beds, bodies.coarser())

    def __bool__(self) -> bool:
        """Whether any error is known."""
        return bool(self.laws or self.stated or self.meshes)


def change_friction(laws: Sequence[InterfaceLaw], change: Change) -> list[InterfaceLaw]:
    """Return the laws of all joints, with the changed parameters and slabs of a change."""

    def changed(law: InterfaceLaw) -> InterfaceLaw:
        bed = cast(Any, law)  # laws are dataclasses
        values = {name: factor * getattr(bed, name) for name, factor in change.factors.items()}
        values |= {"slabs": bed.slabs // 2} if change.coarse_bed else {}
        return cast(InterfaceLaw, replace(bed, **values))

    return [changed(law) if joint in change.joints else law for joint, law in enumerate(laws)]
