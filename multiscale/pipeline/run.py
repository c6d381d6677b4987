"""The main job: the stages of a case, from its surfaces to the answer."""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from multiscale.io import make_folder, save_law, write_dataset
from multiscale.pipeline.case_response import write_fields
from multiscale.pipeline.planner import plan
from multiscale.pipeline.run_folder import claim_folder
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Job
from multiscale.pipeline.stages import stages_of
from multiscale.pipeline.tyre_settings import TyreCase
from multiscale.schema import INTERFACE_LAW, MACRO_RESULT, MICRO_RESPONSE

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Results", "run"]


@dataclass(frozen=True, eq=False)
class Results(Mapping[str, "xr.Dataset"]):
    """What a run has computed: the dataset of every stage by its name, which is its schema's.

    Attributes
    ----------
    found : dict of str to Dataset
        In the order in which the stages were run.
    """

    found: "dict[str, xr.Dataset]"

    def __getitem__(self, name: str) -> "xr.Dataset":
        return self.found[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.found)

    def __len__(self) -> int:
        return len(self.found)

    @property
    def micro_response(self) -> "xr.Dataset":
        """Response of the cells."""
        return self.found[MICRO_RESPONSE.name]

    @property
    def interface_law(self) -> "xr.Dataset":
        """Law fitted to the response."""
        return self.found[INTERFACE_LAW.name]

    @property
    def macro_result(self) -> "xr.Dataset":
        """Answer of the joint or of the tread block."""
        return self.found[MACRO_RESULT.name]


def run(
    case: Case | TyreCase,
    out: str | Path,
    *,
    executor: Executor | None = None,
    progress: Callable[[int], None] = lambda finished: None,
) -> Results:
    """Run the stages that a case asks for, one after another.

    Parameters
    ----------
    case : Case or TyreCase
    out : path
        Run folder; made if needed. Finished cells of the same case found there are kept.
    executor : Executor, optional
        See :func:`multiscale.executors.run_jobs`.
    progress : callable
        Gets the number of finished realisations.

    Returns
    -------
    Results

    Raises
    ------
    MultiscaleError
        If an input is refused, a file cannot be written, or nothing converged.
    """
    job = Job(make_folder(Path(out)), executor, progress)
    claim_folder(job.out, case)
    found = {} if case.accuracy is None else _plan(case, job)
    for stage in stages_of(case.tables):
        if stage.name not in found:
            found[stage.name] = stage.run(case, found, job)
        stage.check(found[stage.name])
    return Results({stage.name: found[stage.name] for stage in stages_of(case.tables)})


def _plan(case: Case, job: Job) -> "dict[str, xr.Dataset]":
    """Let the planner choose and solve the cells, and write what it has found as a run."""
    out = job.out
    planned = plan(case, out, executor=job.executor, progress=job.progress)
    write_fields(planned.case, planned.folder, out)
    write_dataset(planned.micro_response, out / "micro_response.nc", MICRO_RESPONSE)
    save_law(planned.interface_law, out / "interface_law.nc")
    result = planned.macro_result.assign_attrs(
        plan="\n".join(planned.lines), time_spent=planned.spent, time_forecast=planned.forecast
    )
    write_dataset(result, out / "macro_result.nc", MACRO_RESULT)
    return {
        MICRO_RESPONSE.name: planned.micro_response,
        INTERFACE_LAW.name: planned.interface_law,
        MACRO_RESULT.name: result,
    }
