"""Stages that solve a structure, and bodies that are built and condensed for their solver."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale import macro
from multiscale.errors import CaseError, ConvergenceError
from multiscale.macro import substructures
from multiscale.macro.data_range import ROUNDS
from multiscale.needs import Choice, Needs
from multiscale.pipeline.body_budget import FirstOrder, JointAnswers
from multiscale.pipeline.body_sources import BodiesWithLaws, Change
from multiscale.pipeline.showing import Rows, Table, list_cycles, list_facts
from multiscale.pipeline.stage import (
    Datasets,
    Job,
    Section,
    Stage,
    list_cautions,
)
from multiscale.pipeline.tables.meshed_bodies import doubt_density
from multiscale.pipeline.tables.porous_body import PorousBody
from multiscale.pipeline.tables.settings import Case
from multiscale.pipeline.tables.solved_bodies import SolvedBodies, StructureParts
from multiscale.schema import INTERFACE_LAW, MACRO_RESULT, Dataset, Schema, with_cautions

if TYPE_CHECKING:
    from multiscale.macro.substructures import ProcessGroup

SOLVES = 3  # time of all solves for the intervals over the time of the whole path, about


def require_converged(result: Dataset) -> None:
    """Refuse a result without any step that converged."""
    if not result["converged"].values.any():
        raise ConvergenceError(
            f"{result.attrs['title']}: no step converged; {result.attrs['failure']}"
        )


def require_known(result: Dataset, answer: str) -> None:
    """Refuse a result without any step that converged, or with an answer that is never known."""
    require_converged(result)
    if np.isnan(result[answer].values).all():
        raise ConvergenceError(
            f"{result.attrs['title']}: the answer is unknown at every step; "
            f"{'; '.join(list_cautions(result))}"
        )


def choose_solver(
    case: Case, size: "substructures.JointSize", team: "ProcessGroup | None" = None
) -> "substructures.MethodChoice":
    """Choose the solver of bodies, unless the case has a method or substructures."""
    method, shared = case.statics.method, team is not None and team.size > 1
    if method in ("newton", "multigrid"):
        if shared:
            raise CaseError(
                f'method = "{method}" in [statics] runs on a single process; take "latin", '
                f"or one process"
            )
        whole = substructures.MultigridNewton if method == "multigrid" else macro.AssembledNewton
        return substructures.choose_method(size, whole())
    asks = method == "latin" or case.substructures is not None or shared
    return substructures.choose_method(size, case.cut.method(team) if asks else None)


def solver_needs(structure: SolvedBodies, case: Case) -> Needs:
    """Return the needs of the chosen solver of bodies, and the reason of the choice."""
    size = structure.joint_size(case)
    chosen = choose_solver(case, size)
    taken = chosen.taken
    needs = substructures.cut_needs(
        size.unknowns,
        joint_points=size.joint_points,
        substructures=taken.substructures,
        coarse=taken.method.coarse,
        slabs=structure.slabs(case) if size.joint_points else 0,
    )
    choices = [Choice("method", chosen.explain())]
    if case.way == "adaptive":
        asks = (
            f"up to {ROUNDS} more solves at rest, between which cells are pressed at up to two "
            f"pressures beyond each end of the data, and between them at as many as the case gives"
        )
        choices.append(Choice("way", asks))
    seconds = (1 + SOLVES) * taken.seconds
    return replace(needs, memory=taken.memory, seconds=seconds, choices=(*choices, *needs.choices))


def structure_of(case: Case) -> Any:
    """Return the structure of a case for its stage."""
    assert case.structure is not None  # it requests the stage
    return case.structure.for_solver(case)


def structure_stage(
    name: str,
    solve: Callable[[Any, Case, Datasets, Job], Dataset],
    needs: Callable[[Any, Case], Needs],
    table: Table | Callable[[Dataset], Rows],
    write_fields: Callable[..., object],
    *,
    reads: set[str],
    schema: Schema = MACRO_RESULT,
    solver: tuple[str, ...] = ("pypardiso",),
    prepare: Callable[[Any, Case], object] = lambda structure, case: None,
    more: Callable[[Dataset], Iterable[Section]] = lambda result: (),
    answer: Callable[[Dataset], Iterable[str]] = lambda result: (),
    **record: Any,
) -> Stage:
    """Build the stage that solves some kinds of structures, with further fields of its record."""

    def run(case: Case, datasets: Datasets, job: Job) -> Dataset:
        result = solve(structure_of(case), case, datasets, job)
        return result.assign_attrs(title=case.title, case=case.to_toml())

    def all_needs(case: Case) -> Needs:
        required, installed = needs(structure_of(case), case), tuple(filter(find_spec, solver))
        return replace(
            required, libraries=tuple(sorted({*required.libraries, "meshio", *installed}))
        )

    def sections(datasets: Datasets, out: Path) -> Iterator[Section]:
        result = datasets[schema.name]
        rows = table.rows(result) if isinstance(table, Table) else table(result)
        remarks = [*list_facts(result), *list_cycles(result)]
        yield Section("Structure", _failures(result), *rows, remarks=remarks)
        yield from more(result)

    def sentences(result: Dataset) -> Iterator[str]:
        steps, solved = result.sizes["step"], int((result["converged"] == 1).sum())
        lines = list(answer(result))
        yield from lines
        if solved < steps or not lines:
            yield f"{solved} of {steps} steps converged; see the table."

    asked: dict[str, Any] = {
        "schema": schema,
        "tables": ("structure", name),
        "reads": {"title", *reads},
        "run": run,
        "write_fields": write_fields,
        "needs": all_needs,
        "prepare": lambda case: prepare(structure_of(case), case),
        "check": require_converged,
        "sections": sections,
        "answer": sentences,
        "failure": lambda result: "; ".join(_failures(result)),
    }
    return Stage(**(asked | record))


def with_too_far(result: Dataset, *cautions: str) -> Dataset:
    """Add the cautions, and a caution if nodes move farther than the size of the structure."""
    size = float(np.ptp(result["position"].values, axis=0).max())
    moved = float(np.abs(np.nan_to_num(result["displacement"].values)).max(initial=0.0))
    if moved <= size:
        return with_cautions(result, *cautions)
    return with_cautions(
        result,
        f"nodes move by up to {moved:.3g} m, more than the structure measures ({size:.3g} m), "
        f"outside the validity of its laws: check loads, moduli and their units",
    )


def _failures(result: Dataset) -> list[str]:
    return str(result.attrs.get("failure", "")).splitlines()


@dataclass(frozen=True, eq=False)
class ReadyBodies:
    """Bodies of a case, built and condensed for their solver."""

    jointed: BodiesWithLaws
    parts: StructureParts
    chosen: "substructures.MethodChoice"
    structure: "substructures.CondensedProblem"

    @classmethod
    def of(cls, structure: SolvedBodies, case: Case, datasets: Datasets, job: Job) -> "ReadyBodies":
        """Build the structure of a case."""
        jointed = BodiesWithLaws.of(structure, case, datasets, job)
        parts = jointed.build(jointed.sliders())
        chosen = choose_solver(case, structure.joint_size(case), job.team)
        substructures.require_held(parts.assembly)
        condensed = substructures.condense_assembly(parts.assembly, chosen.taken.method)
        return cls(jointed, parts, chosen, condensed)

    @property
    def method(self) -> "substructures.Method":
        """The solver."""
        return self.chosen.taken.method

    def solve(self, datasets: Datasets, job: Job) -> "tuple[substructures.FollowedLoads, Dataset]":
        """Follow the path of the loads; the result has cautions of laws and volumes."""
        path, done = self.parts.path, count(1)
        job.progress(0, path.count, "load steps")  # the first step forecasts the time of all
        method = replace(
            self.method, after_step=lambda: job.progress(next(done), path.count, "load steps")
        )
        followed = substructures.follow_loads(self.structure.small, path, method=method)
        measured = substructures.measure_loads(followed, extrapolate=self.jointed.case.extrapolate)
        result = self.structure.restore(measured)
        return followed, with_cautions_of(result, self.jointed, datasets)

    def near(
        self, followed: "substructures.FollowedLoads", path: "substructures.LoadPath"
    ) -> "substructures.FollowedLoads":
        """Follow a shorter path without a change, near which those with changes start."""
        if not (path.cycles or path.amplitudes):
            return replace(followed, loads=path)
        return substructures.follow_loads(self.structure.small, path, method=self.method)

    def first_order(
        self, near: "substructures.FollowedLoads", changes: Sequence[Change]
    ) -> Mapping[str, np.ndarray]:
        """Return relative changes of the stiffnesses of joints at rest, (changes, preloads)."""
        problem = self.structure.small
        made = [self.jointed.sliders(change, slabs=1) for change in changes]  # without slip
        return substructures.changed_stiffness(near, [problem.with_laws(laws).law for laws in made])

    def finish(self, result: Dataset, facts: Sequence[str]) -> Dataset:
        """Add facts on bodies, loads and solver, and the fields of the elements."""
        solver = f"Solved by {self.method.name}: {self.chosen.why}."
        result = result.assign_attrs(facts="\n".join([*facts, solver]))
        damages = [body.worst_damage for body in self.jointed.bodies.bodies]
        return with_too_far(
            macro.bodies.add_body_fields(result, self.parts.assembly.bodies, damage=damages)
        )


@dataclass(frozen=True, kw_only=True)
class PathAnswers:
    """Answers of bodies on a kind of path: how they are completed, shown and compared."""

    question: str
    complete: Callable[[Dataset, ReadyBodies], Dataset]  # adds answers in addition to the path
    facts: Callable[[Dataset, ReadyBodies], Iterable[str]]
    with_errors: "Callable[[Dataset, substructures.LoadPath, FirstOrder], JointAnswers]"
    """Return the answers that have an error budget."""
    tabulate: Callable[[Dataset], Rows]
    sentences: Callable[[Dataset], Iterable[str]]
    sections: Callable[[Dataset], Iterable[Section]]
    compared: Callable[[Dataset], Dataset]


@dataclass(frozen=True, eq=False)
class SolveAgain:
    """Solve of bodies with a change, that workers can import."""

    jointed: BodiesWithLaws
    problem: "substructures.CutProblem"
    method: "substructures.Method"
    near: "substructures.FollowedLoads"  # the path without a change

    def __call__(self, change: Change) -> Dataset:
        """Follow the path again."""
        jointed = self.jointed.changed(change)
        laws = jointed.sliders(change)
        if change.structure is None:
            problem, near = self.problem.with_laws(laws), self.near
        else:
            other = jointed.build(laws).assembly
            problem, near = substructures.condense_assembly(other, self.method).small, None
        return substructures.follow_cut_loads(
            problem, self.near.loads, method=self.method, extrapolate=True, near=near
        )


def with_cautions_of(result: Dataset, jointed: BodiesWithLaws, datasets: Datasets) -> Dataset:
    """Add the cautions of laws, once each, and of representative volumes from other cases."""
    bodies, case, laws = jointed.bodies, jointed.case, jointed.laws
    named = {f"the law of interface {k}": law for k, law in enumerate(laws) if law is not None}
    if len(named) == len(laws) > 0 and all(law is laws[0] for law in laws):
        named = {"its law": next(iter(named.values()))}
    # the stage of the law reports the cautions of the cells of the case
    reported = list_cautions(datasets[INTERFACE_LAW.name]) if case.makes_law else []
    for name, law in named.items():
        further = [caution for caution in list_cautions(law) if caution not in reported]
        reported += further
        result = with_cautions(result, *(f"{name}: {caution}" for caution in further))
    result = with_cautions(result, *bodies.assumed(case))
    for body in bodies.bodies:
        result = with_cautions(result, *doubt_density(body.name, body.density))
        if isinstance(body, PorousBody):
            cautions = list_cautions(body.volume_data) if body.rve is not None else []
            of_volume = [f"volume of {body.name}: {caution}" for caution in cautions]
            result = with_cautions(result, *of_volume, *body.cautions(body.load()))
    return result
