"""Bodies of a case with the laws of their interfaces, ready to be loaded, and loaded again."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from multiscale.macro import substructures
from multiscale.pipeline.assembly_parts import doubt_density
from multiscale.pipeline.assembly_settings import Bodies, StructureParts
from multiscale.pipeline.body_budget import Change, changed_sliders
from multiscale.pipeline.made_bodies import RoughBodies
from multiscale.pipeline.porous_body import PorousBody
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Datasets, Job, list_cautions
from multiscale.pipeline.structure_stage import choose_solver, with_law_cautions, with_too_far
from multiscale.schema import Dataset, with_cautions

__all__ = ["ReadyBodies", "SolveAgain", "with_cautions_of"]

Follow = Callable[..., Dataset]
"""From a cut problem, the areas of its loads, a method and ``near``, what is near, to a result;
workers must be able to import it."""


@dataclass(frozen=True, eq=False)
class ReadyBodies:
    """Bodies of a case, built and condensed for the method that solves them."""

    bodies: Bodies
    case: Case
    laws: Sequence[Dataset | None]  # of every interface
    parts: StructureParts
    chosen: "substructures.MethodChoice"
    structure: "substructures.CondensedProblem"

    @classmethod
    def of(
        cls, structure: Bodies | RoughBodies, case: Case, found: Datasets, job: Job
    ) -> "ReadyBodies":
        """Build the structure of a case."""
        bodies = structure.with_volumes(case, found, job.read_rve)
        laws = bodies.read_laws(case, found, job.read_law)
        parts = bodies.build(case, bodies.sliders(case, laws))
        chosen = choose_solver(case, structure.joint_size(case), job.team)
        substructures.require_held(parts.assembly)
        condensed = substructures.condense_assembly(parts.assembly, chosen.taken.method)
        return cls(bodies, case, laws, parts, chosen, condensed)

    @property
    def method(self) -> "substructures.Method":
        """The method that solves them."""
        return self.chosen.taken.method

    def again(self, follow: Follow, near: object) -> "SolveAgain":
        """Return what follows the path again, near the path without a change."""
        problem, areas = self.structure.small, self.parts.assembly.areas
        return SolveAgain(
            self.bodies, self.case, self.laws, problem, areas, self.method, follow, near
        )

    def finish(self, result: Dataset, facts: Sequence[str]) -> Dataset:
        """Add what is said of bodies, loads and solver, and the fields of the elements."""
        solver = f"Solved by {self.method.name}: {self.chosen.why}."
        result = result.assign_attrs(facts="\n".join([*facts, solver]))
        damages = [body.worst_damage for body in self.bodies.bodies]
        return with_too_far(
            substructures.add_body_fields(result, self.parts.assembly.bodies, damage=damages)
        )


@dataclass(frozen=True, eq=False)
class SolveAgain:
    """What solves bodies again with a change, in workers too."""

    bodies: Bodies
    case: Case
    laws: Sequence[Dataset | None]
    problem: "substructures.CutProblem"
    areas: Sequence[float]
    method: "substructures.Method"
    follow: Follow
    near: Any

    def __call__(self, change: Change) -> Dataset:
        """Follow the path again."""
        source = change.structure or self.bodies
        laws = changed_sliders(source, self.case, self.laws, change)
        if change.structure is None:
            problem = self.problem.with_laws(laws)
            return self.follow(problem, self.areas, self.method, near=self.near)
        other = source.build(self.case, laws).assembly
        return self.follow(
            substructures.condense_assembly(other, self.method).small, other.areas, self.method
        )


def with_cautions_of(
    result: Dataset, bodies: Bodies, case: Case, found: Datasets, laws: Sequence[Dataset | None]
) -> Dataset:
    """Add what laws, once each, and representative volumes say.

    The `[rve]` of the case has said its own beside.
    """
    told = {f"the law of interface {k}": law for k, law in enumerate(laws) if law is not None}
    if len(told) == len(laws) > 0 and all(law is laws[0] for law in laws):
        told = {"its law": next(iter(told.values()))}
    result = with_law_cautions(result, case, found, told)
    result = with_cautions(result, *bodies.assumed(case))
    for body in bodies.bodies:
        result = with_cautions(result, *doubt_density(body.name, body.density))
        if isinstance(body, PorousBody):
            said = list_cautions(body.volume_data) if body.rve is not None else []
            known = [f"volume of {body.name}: {caution}" for caution in said]
            result = with_cautions(result, *known, *body.cautions(body.load()))
    return result
