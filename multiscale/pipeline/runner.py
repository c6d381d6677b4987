"""Run of a case: its stages from the surfaces to the answer."""

import logging
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from shutil import copyfile
from time import perf_counter
from typing import TYPE_CHECKING

from multiscale.errors import MultiscaleError
from multiscale.io import make_folder, open_dataset, write_dataset
from multiscale.micro.cell import WORTH
from multiscale.pipeline.adaptive import reach_loads
from multiscale.pipeline.case import taken_law, taken_volume
from multiscale.pipeline.case_needs import prepare
from multiscale.pipeline.costs import SECONDS
from multiscale.pipeline.run_folder import claim_folder, read_up_to_date, require_claimed
from multiscale.pipeline.stage import Datasets, Job, ShowProgress, Stage, unseen
from multiscale.pipeline.stages import ACCURACY_STAGE, COMPUTED, stages_of
from multiscale.pipeline.stages.accuracy import planned_case
from multiscale.pipeline.tables.settings import Case
from multiscale.schema import (
    INTERFACE_LAW,
    MACRO_RESULT,
    MICRO_RESPONSE,
    RVE,
    Dataset,
    with_cautions,
)
from multiscale.upscaling.tables import read_law

if TYPE_CHECKING:
    from multiscale.macro.substructures import ProcessGroup

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Results(Mapping[str, Dataset]):
    """Datasets of the stages of a run, by the names of their schemas.

    Attributes
    ----------
    datasets : dict of str to Dataset, in the order in which the stages were run
    """

    datasets: dict[str, Dataset]

    def __getitem__(self, name: str) -> Dataset:
        return self.datasets[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.datasets)

    def __len__(self) -> int:
        return len(self.datasets)

    def _repr_html_(self) -> str:
        shown = ((name, dataset._repr_html_()) for name, dataset in self.datasets.items())
        return "".join(
            f"<details><summary>{name}</summary>{html}</details>" for name, html in shown
        )

    @property
    def micro_response(self) -> Dataset:
        """Response of the cells."""
        return self.datasets[MICRO_RESPONSE.name]

    @property
    def interface_law(self) -> Dataset:
        """Law fitted to the response."""
        return self.datasets[INTERFACE_LAW.name]

    @property
    def macro_result(self) -> Dataset:
        """Answer of the joint, of the tread block or of the structure."""
        return self.datasets[MACRO_RESULT.name]


def run(
    case: Case,
    out: str | Path,
    *,
    executor: Executor | None = None,
    progress: ShowProgress = unseen,
    force: bool = False,
    sparing: bool = False,
) -> Results:
    """Run the stages of a case that are out of date, in their order.

    Parameters
    ----------
    out : path
        Run folder; made if needed. Finished cells of the same case in it are not computed again,
        nor are stages with unchanged tables that depend only on such stages.
    executor : Executor, optional, see :func:`multiscale.executors.run_jobs`
    progress : ShowProgress
        Called as ``progress(finished, total, parts)`` after every realisation, time step or solve.
    force : bool, default False
        Whether all stages and cells are computed again, even if they are up to date.
    sparing : bool, default False
        Whether to write only slow results, with which a stopped run can continue: no case, no
        fields, and no cells and datasets that took less time than :data:`WORTH`.

    Raises
    ------
    MultiscaleError
        If an input is refused, a file cannot be written, or nothing converged.
    """
    job = replace(job_in(Path(out), executor, progress), sparing=sparing)
    return Results(_run(case, job, force=force))


def _run(case: Case, job: Job, *, force: bool = False) -> dict[str, Dataset]:
    """Run the stages of a case that are out of date; of a target, first the plan."""
    if not job.sparing or job.out.exists():
        claim_folder(make_folder(job.out), case, force=force)
    prepare(case)
    stages = stages_of(case.tables)
    datasets: dict[str, Dataset] = {}
    planned: Datasets = {}
    if case.accuracy is not None:
        plan = _up_to_date_or_run(ACCURACY_STAGE, case, {}, job)
        if not all((job.out / stage.file).exists() for stage in stages):
            planned = _take_planned(case, plan, job)
        datasets[ACCURACY_STAGE.name] = plan
    for stage in stages:
        if stage.name in planned:
            identity = stage.identity(case)
            write_dataset(
                planned[stage.name], job.out / stage.file, stage.schema, identity=identity
            )
            datasets[stage.name] = planned[stage.name]
        else:
            datasets[stage.name] = _up_to_date_or_run(stage, case, datasets, job)
    if job.out.exists():
        require_claimed(job.out, case)
    return {stage.name: datasets[stage.name] for stage in stages}


def _take_planned(case: Case, plan: Dataset, job: Job) -> Datasets:
    """Return the datasets of the last setting of a plan, and copy its fields."""
    place, chosen = planned_case(case, plan, COMPUTED, job)
    datasets = job.solve(place, chosen, True)
    for file in (job.out / place / "fields").glob("*"):
        copyfile(file, make_folder(job.out / "fields") / file.name)
    return datasets


def _up_to_date_or_run(stage: Stage, case: Case, datasets: Datasets, job: Job) -> Dataset:
    """Read the dataset of a stage, if it is there, or compute it."""
    dataset = read_up_to_date(stage, case, job.out)
    if dataset is None:  # or of another run in the same folder
        return _compute(stage, case, datasets, job, job.out / stage.file)
    logger.info("%s: up to date", stage.name)
    stage.check(dataset)
    return dataset


def _solve_coarse(case: Case, job: Job) -> dict[str, Dataset]:
    """Run a case without intervals; only its ensembles are stored."""
    datasets: dict[str, Dataset] = {}
    job = replace(job, out=make_folder(job.out), intervals=False, sparing=False)
    for stage in stages_of(case.tables):
        result = read_up_to_date(stage, case, job.out)
        if result is None:
            begin = perf_counter()
            result = _solve(stage, case, datasets, job)
            stage.check(result)
            result = result.assign_attrs({SECONDS: perf_counter() - begin})
        datasets[stage.name] = result
    return datasets


def run_macro(
    case: Case,
    file: str | Path,
    *,
    law: str | Path | None = None,
    team: "ProcessGroup | None" = None,
) -> Dataset:
    """Solve the structure of a case; write its result and ``fields`` for ParaView next to it.

    Cells of the case are not solved. With ``homogenise`` in ``[substructures]`` the condensed
    stiffness of the substructures is written as well.

    Parameters
    ----------
    file : path, dataset to write; its folder is made if needed
    law : path, optional, interface law of the joints, in place of the law of the case
    team : ProcessGroup, optional
        Processes that share the substructures. All call this function; the first process writes.

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``, or ``GRANULATE`` for grains. The attribute ``failure`` lists
        failed steps with the reasons; ``cautions`` report answers outside the data of a law, nodes
        that moved farther than the size of the structure, and grain contacts above tolerance.

    Raises
    ------
    CaseError
        If the structure or its law is refused.
    ConvergenceError
        If no step converged, or there is no equilibrium from which a motion starts.
    """
    file, case = Path(file), case.from_structure(None if law is None else Path(law))
    prepare(case)
    job = job_in(file.parent, team=team)
    first, *rest = stages_of(case.tables)
    datasets = {first.name: _compute(first, case, {}, job, file)}
    for stage in rest if _writes(job) else ():
        _compute(stage, case, datasets, job, file.with_name(f"{file.stem}-{stage.name}.nc"))
    return datasets[first.name]


def job_in(
    out: Path,
    executor: Executor | None = None,
    progress: ShowProgress = unseen,
    team: "ProcessGroup | None" = None,
) -> Job:
    """Return the job of a folder; other cases named in a case are run in its subfolders."""

    def run_alone(place: Path, case: Case) -> Path:
        """Run a case, unless it is up to date, in the first process of a team."""
        failed = list[MultiscaleError]()
        if team is None or team.rank == 0:
            try:
                run(case, out / place, executor=executor, progress=progress)
            except MultiscaleError as error:
                failed.append(error)
        failed = failed if team is None else team.collect(failed)  # a barrier of all processes
        if failed:
            raise failed[0]
        return out / place

    def law_of(file: Path, quick: bool) -> Dataset:
        if file.suffix == ".toml":
            file = run_alone(*taken_law(file, quick)) / f"{INTERFACE_LAW.name}.nc"
        return read_law(file)

    def cells_of(file: Path, quick: bool) -> tuple[Case, Datasets]:
        place, other = taken_law(file, quick)
        folder = run_alone(place, other)
        stages = stages_of(other.tables)
        return other, {s.name: open_dataset(folder / s.file, s.schema) for s in stages}

    def volume_of(file: Path, quick: bool) -> Dataset:
        if file.suffix == ".toml":
            file = run_alone(*taken_volume(file, quick)) / f"{RVE.name}.nc"
        return open_dataset(file, RVE)

    def solve(place: Path, case: Case, whole: bool) -> Datasets:
        inner = replace(job, out=out / place)
        return _run(case, inner) if whole else _solve_coarse(case, inner)

    job = Job(
        out,
        executor,
        progress,
        team,
        read_law=law_of,
        read_rve=volume_of,
        open_cells=cells_of,
        solve=solve,
    )
    return job


def _compute(stage: Stage, case: Case, datasets: Datasets, job: Job, file: Path) -> Dataset:
    """Run a stage and write its files, the dataset last."""
    logger.info("%s: begun", stage.name)
    begin = perf_counter()
    result = _solve(stage, case, datasets, job)
    result = result.assign_attrs({SECONDS: perf_counter() - begin})
    if _writes(job) and not (job.sparing and perf_counter() - begin < WORTH):
        make_folder(file.parent)
        if stage.write_fields is not None and not job.sparing:
            stage.write_fields(result, make_folder(file.parent / "fields"), name=file.stem)
        write_dataset(result, file, stage.schema, identity=stage.identity(case))
    logger.info("%s: finished after %.3g s", stage.name, perf_counter() - begin)
    stage.check(result)
    return result


def _solve(stage: Stage, case: Case, datasets: Datasets, job: Job) -> Dataset:
    """Compute a stage; laws of a structure are first extended to its loads, if requested."""
    if case.adaptive and "structure" in stage.tables:
        datasets, job = reach_loads(case, datasets, job)
    return with_cautions(stage.run(case, datasets, job), *job.notes)


def _writes(job: Job) -> bool:
    return job.team is None or job.team.rank == 0
