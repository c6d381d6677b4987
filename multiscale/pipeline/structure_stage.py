"""How stages that solve a structure are made."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.errors import CaseError, ConvergenceError
from multiscale.macro import substructures
from multiscale.macro.substructures.substructure_needs import cut_needs
from multiscale.needs import Choice, Needs
from multiscale.pipeline.settings import Case
from multiscale.pipeline.showing import Rows, Table, list_cycles, list_facts
from multiscale.pipeline.stage import (
    Datasets,
    Job,
    Section,
    Stage,
    list_cautions,
)
from multiscale.schema import INTERFACE_LAW, MACRO_RESULT, Dataset, Schema, with_cautions

if TYPE_CHECKING:
    from multiscale.macro.substructures import ProcessGroup

__all__ = [
    "choose_solver",
    "counting",
    "require_converged",
    "require_known",
    "solver_needs",
    "structure_stage",
    "with_law_cautions",
    "with_too_far",
]

SOLVES = 3  # times of a whole path that all solves for the intervals take together, about


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
    """Choose the solver of bodies, unless the case names it.

    ``[substructures]`` and many processes ask for LATIN.
    """
    method, shared = case.statics.method, team is not None and team.size > 1
    if method == "newton":
        if shared:
            raise CaseError(
                'method = "newton" in [statics] solves the whole on one process; take "latin", or '
                "one process"
            )
        return substructures.choose_method(size, substructures.AssembledNewton())
    asks = method == "latin" or case.substructures is not None or shared
    return substructures.choose_method(size, case.cut.method(team) if asks else None)


def counting(method: "substructures.Method", job: Job, steps: int) -> "substructures.Method":
    """Return the method that shows which of so many load steps are finished."""
    done = count(1)
    job.progress(0, steps, "load steps")  # the first step tells the time of all
    return replace(method, after_step=lambda: job.progress(next(done), steps, "load steps"))


def solver_needs(
    chosen: "substructures.MethodChoice", size: "substructures.JointSize", slabs: int
) -> Needs:
    """Return what the chosen solver of bodies needs, and why it was chosen."""
    taken = chosen.taken
    needs = cut_needs(
        size.unknowns,
        joint_points=size.joint_points,
        substructures=taken.substructures,
        coarse=taken.method.coarse,
        slabs=slabs,
    )
    told = Choice("method", chosen.explain())
    seconds = (1 + SOLVES) * taken.seconds
    return replace(needs, memory=taken.memory, seconds=seconds, choices=(told, *needs.choices))


def with_law_cautions(
    result: Dataset, case: Case, found: Datasets, laws: Mapping[str, Dataset]
) -> Dataset:
    """Add the cautions of laws, by their names, once each.

    Cautions of the law of the case's own cells already stand beside those of the structure.
    """
    told = list_cautions(found[INTERFACE_LAW.name]) if case.has_cells else []
    for name, law in laws.items():
        further = [one for one in list_cautions(law) if one not in told]
        told += further
        result = with_cautions(result, *(f"{name}: {one}" for one in further))
    return result


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
    """Make the stage that solves some kinds of structures, with further fields of its record."""

    def run(case: Case, found: Datasets, job: Job) -> Dataset:
        result = solve(case.structure, case, found, job)
        return result.assign_attrs(title=case.title, case=case.to_toml())

    def all_needs(case: Case) -> Needs:
        own, installed = needs(case.structure, case), tuple(filter(find_spec, solver))
        return replace(own, libraries=tuple(sorted({*own.libraries, "meshio", *installed})))

    def sections(found: Datasets, out: Path) -> Iterator[Section]:
        result = found[schema.name]
        rows = table.rows(result) if isinstance(table, Table) else table(result)
        told = [*list_facts(result), *list_cycles(result)]
        yield Section("Structure", _failures(result), *rows, told=told)
        yield from more(result)

    def sentences(result: Dataset) -> Iterator[str]:
        steps, solved = result.sizes["step"], int((result["converged"] == 1).sum())
        said = list(answer(result))
        yield from said
        if solved < steps or not said:
            yield f"{solved} of {steps} steps have an answer; see the table."

    asked: dict[str, Any] = {
        "schema": schema,
        "tables": ("structure", name),
        "reads": {"title", *reads},
        "run": run,
        "write_fields": write_fields,
        "needs": all_needs,
        "prepare": lambda case: prepare(case.structure, case),
        "check": require_converged,
        "sections": sections,
        "answer": sentences,
        "failure": lambda result: "; ".join(_failures(result)),
    }
    return Stage(**(asked | record))


def with_too_far(result: Dataset, *cautions: str) -> Dataset:
    """Add a caution against nodes that move farther than the structure measures, or those given."""
    size = float(np.ptp(result["position"].values, axis=0).max())
    moved = float(np.abs(np.nan_to_num(result["displacement"].values)).max(initial=0.0))
    if moved <= size:
        return with_cautions(result, *cautions)
    return with_cautions(
        result,
        f"nodes move by up to {moved:.3g} m, more than the structure measures ({size:.3g} m), "
        f"where no law of its parts holds: check loads, moduli and their units",
    )


def _failures(result: Dataset) -> list[str]:
    return str(result.attrs.get("failure", "")).splitlines()
