"""The main job: from the surfaces of a case to the stiffness of its joint."""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.convergence import Status
from multiscale.errors import ConvergenceError
from multiscale.io import make_folder, save_law, write_dataset
from multiscale.pipeline.case_budget import case_budget
from multiscale.pipeline.case_joint import solve_joint
from multiscale.pipeline.case_response import run_micro, write_fields
from multiscale.pipeline.case_slide import slide_bodies
from multiscale.pipeline.planner import plan
from multiscale.pipeline.run_folder import claim_folder
from multiscale.pipeline.settings import Case
from multiscale.schema import MACRO_RESULT, MICRO_RESPONSE
from multiscale.upscaling import (
    fit_branches,
    loading_branch,
    with_budget,
)

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Results", "run"]


@dataclass(frozen=True)
class Results:
    """What a run has computed; the datasets follow the schemas of the same names."""

    micro_response: "xr.Dataset"
    interface_law: "xr.Dataset"
    macro_result: "xr.Dataset"


def run(
    case: Case,
    out: str | Path,
    *,
    executor: Executor | None = None,
    progress: Callable[[int], None] = lambda finished: None,
) -> Results:
    """Run the whole chain: cells, response, law, joint; and slide the bodies if the case says so.

    Parameters
    ----------
    case : Case
    out : path
        Run folder; made if needed. Finished cells of the same case found there are kept.
    executor : Executor, optional
        See :func:`multiscale.micro.run_ensemble`.
    progress : callable
        Gets the number of finished realisations.

    Returns
    -------
    Results

    Raises
    ------
    MultiscaleError
        If an input is refused, a file cannot be written, or no realisation converged.
    """
    out = make_folder(Path(out))
    claim_folder(out, case)
    if case.slide is not None:
        slide_bodies(case, case.slide, out / "sliding_response.nc", executor=executor)
    if case.accuracy is not None:
        return _run_to_target(case, out, executor, progress)
    response = run_micro(case, out / "micro_response.nc", executor=executor, progress=progress)

    loading = loading_branch(response) if case.micro.unloading else response
    law = fit_branches(response, n_terms=case.law.terms, n_samples=case.law.samples)
    law = with_budget(law, case_budget(case, loading, law))
    save_law(law, out / "interface_law.nc")

    result = solve_joint(case, law)
    return _finish(Results(response, law, result), out)


def _run_to_target(
    case: Case, out: Path, executor: Executor | None, progress: Callable[[int], None]
) -> Results:
    """Let the planner choose and solve the cells, and write what it has found as a run."""
    found = plan(case, out, executor=executor, progress=progress)
    write_fields(found.case, found.folder, out)
    write_dataset(found.micro_response, out / "micro_response.nc", MICRO_RESPONSE)
    save_law(found.interface_law, out / "interface_law.nc")
    result = found.macro_result.assign_attrs(
        plan="\n".join(found.lines), time_spent=found.spent, time_forecast=found.forecast
    )
    return _finish(Results(found.micro_response, found.interface_law, result), out)


def _finish(results: Results, out: Path) -> Results:
    """Write the result of the joint, and refuse one that is nowhere known."""
    result = results.macro_result
    write_dataset(result, out / "macro_result.nc", MACRO_RESULT)
    if not result["converged"].values.any():
        raise ConvergenceError(
            f"the joint did not converge at any of {result.sizes['step']} preloads: "
            f"{Status.MAX_ITERATIONS.value}"
        )
    if not np.isfinite(result["joint_stiffness"].values).any():
        raise ConvergenceError(f"the joint is unknown at every preload: {result.attrs['cautions']}")
    return results
