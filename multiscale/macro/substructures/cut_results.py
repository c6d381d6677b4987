"""What the solvers for cut structures take and return alike."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.macro.substructures.problem import CutProblem
from multiscale.schema import COMPONENTS, MACRO_RESULT, Dataset

__all__ = ["assemble_result", "end_path", "link_fields", "load_factors"]

NOT_TRIED = {"iterations": 0, "krylov_iterations": 0, "wall_time": 0.0}
"""What a step after a failure has taken."""

FIELDS = ("displacement", "tension", "slack", "jump", "traction")
"""What a step that failed does not have."""

ENDED = "the steps end before step"
"""Begins the sentence that says why."""


def load_factors(
    problem: CutProblem, load_factor: float | np.ndarray, after: Dataset | None = None
) -> np.ndarray:
    """One row of factors for each step, shape (steps, cases), maybe after an earlier path."""
    if after is not None:
        _check_after(problem, after)
    factors = np.asarray(load_factor, dtype=float)
    cases = problem.n_cases
    if factors.ndim < 2 and cases == 1:
        factors = factors.reshape(-1, 1)
    if factors.ndim != 2 or factors.shape[1] != cases or not np.isfinite(factors).all():
        raise CaseError(
            f"load_factor must have one finite column for each of {cases} load cases, got shape "
            f"{np.shape(load_factor)}"
        )
    return factors


def link_fields(
    problem: CutProblem, tension: np.ndarray, slack: np.ndarray
) -> dict[str, np.ndarray]:
    """Tension, N, and slack, m, in the order of the whole structure, given part after part."""
    if not problem.n_links:
        return {}
    order = np.concatenate([part.links.number for part in problem.substructures if part.links])
    place = np.argsort(order)
    return {"tension": tension[place], "slack": slack[place]}


def _check_after(problem: CutProblem, after: Dataset) -> None:
    """Refuse an earlier path that ended with a failure, or has other nodes or points."""
    if not after["converged"].values.all():
        raise CaseError(
            f"the earlier path has failed, so that nothing follows it ({after.attrs['failure']}); "
            f"go on from the steps before, after.isel(step=slice(...))"
        )
    points = problem.weight.size
    found = after.sizes["node"], after.sizes.get("point", 0)
    if found != (len(problem.position), points):
        raise CaseError(
            f"the earlier path has {found[0]} nodes and {found[1]} points of joints, where the "
            f"structure has {len(problem.position)} and {points}; cut it as before"
        )


def end_path(result: Dataset, step: int, steps: int, reason: str = "") -> Dataset:
    """Let a path of so many steps end with a failure at one of them.

    The reason is the one that the path has told if none is given.
    """
    number = np.arange(steps)
    result = result.isel(step=np.minimum(number, step)).assign_coords(step=number)
    sound, tried = result["step"] < step, result["step"] <= step
    known = set(result.data_vars)
    ended = {name: result[name].where(sound) for name in known & set(FIELDS)}
    ended |= {name: result[name].where(tried, 0) for name in known & set(NOT_TRIED)}
    result = result.assign(ended | {"converged": result["converged"].where(sound, 0)})
    return result.assign_attrs(failure=f"{ENDED} {step}: {reason}") if reason else result


def assemble_result(
    problem: CutProblem,
    factors: np.ndarray,
    columns: Sequence[dict[str, Any]],
    after: Dataset | None = None,
    **attributes: str | float | int,
) -> Dataset:
    """Make a dataset after ``MACRO_RESULT`` of one column for each step; failed ones are NaN.

    A path ends with its first failure: later steps have no column. The steps of an earlier path
    come first.
    """
    columns = [*columns, *[columns[-1] | NOT_TRIED] * (len(factors) - len(columns))]
    values: dict[str, Any] = {
        name: np.array([column[name] for column in columns])
        for name in columns[0]
        if name != "failure"
    }
    for name in FIELDS:
        if name in values:
            values[name][values["converged"] == 0] = np.nan
    if factors.shape[1] == 1:
        values["load_factor"] = factors[:, 0]
    if after is not None:
        if lacking := sorted(set(values) - set(after.variables)):
            raise CaseError(
                f"the earlier path has no {lacking[0]!r}: another method has made it; go on by the "
                f"same method"
            )
        values = {name: np.concatenate([after[name], value]) for name, value in values.items()}
    values["position"] = problem.position
    if "jump" in values:
        values |= {
            "point_position": np.concatenate([face.position for face in problem.joints]),
            "point_area": problem.weight,
            "point_joint": problem.point_joint,
        }
    result = MACRO_RESULT.build(
        values,
        unknowns=problem.n,
        substructures=len(problem.substructures),
        interfaces=len(problem.interfaces),
        **attributes,
    )
    if "jump" in values:
        result = result.assign_coords(direction=list(COMPONENTS))
    failed = np.flatnonzero(values["converged"] == 0)
    if failed.size:
        result = result.assign_attrs(failure=f"{ENDED} {failed[0]}: {columns[-1]['failure']}")
    return result.assign_coords(component=["x", "y", "z"])
