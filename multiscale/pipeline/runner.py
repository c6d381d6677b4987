"""Run of a case: its stages from the surfaces to the answer."""

import logging
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from multiscale.errors import MultiscaleError
from multiscale.io import make_folder, open_dataset, write_dataset
from multiscale.micro.cell import WORTH
from multiscale.pipeline.case import taken_law, taken_volume
from multiscale.pipeline.case_needs import prepare
from multiscale.pipeline.planner import plan
from multiscale.pipeline.run_folder import claim_folder
from multiscale.pipeline.stage import Datasets, Job, ShowProgress, Stage, unseen
from multiscale.pipeline.stages import stages_of
from multiscale.pipeline.stages.cells import CELLS, write_fields
from multiscale.pipeline.stages.fitted_law import FITTED_LAW
from multiscale.pipeline.stages.joint import JOINT
from multiscale.pipeline.tables.settings import Case
from multiscale.schema import INTERFACE_LAW, MACRO_RESULT, MICRO_RESPONSE, RVE, Dataset
from multiscale.upscaling import read_law

if TYPE_CHECKING:
    from multiscale.macro.substructures import ProcessGroup

logger = logging.getLogger(__name__)

PLANNED = (CELLS, FITTED_LAW, JOINT)
"""Stages that a planner runs by itself, as far as a case asks for them."""


@dataclass(frozen=True, eq=False)
class Results(Mapping[str, Dataset]):
    """Datasets of the stages of a run, by the names of their schemas.

    Attributes
    ----------
    found : dict of str to Dataset, in the order in which the stages were run
    """

    found: dict[str, Dataset]

    def __getitem__(self, name: str) -> Dataset:
        return self.found[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.found)

    def __len__(self) -> int:
        return len(self.found)

    def _repr_html_(self) -> str:
        shown = ((name, dataset._repr_html_()) for name, dataset in self.found.items())
        return "".join(
            f"<details><summary>{name}</summary>{html}</details>" for name, html in shown
        )

    @property
    def micro_response(self) -> Dataset:
        """Response of the cells."""
        return self.found[MICRO_RESPONSE.name]

    @property
    def interface_law(self) -> Dataset:
        """Law fitted to the response."""
        return self.found[INTERFACE_LAW.name]

    @property
    def macro_result(self) -> Dataset:
        """Answer of the joint, of the tread block or of the structure."""
        return self.found[MACRO_RESULT.name]


def run(
    case: Case,
    out: str | Path,
    *,
    executor: Executor | None = None,
    progress: ShowProgress = unseen,
    force: bool = False,
    sparing: bool = False,
) -> Results:
    """Run the stages that a case asks for, one after another, as far as they are out of date.

    Parameters
    ----------
    case : Case
    out : path
        Run folder; made if needed. Finished cells of the same case in it are not computed again,
        nor are stages with unchanged tables that depend only on such stages.
    executor : Executor, optional, see :func:`multiscale.executors.run_jobs`
    progress : ShowProgress
        Called as ``progress(finished, total, parts)`` after every realisation, time step or solve.
    force : bool, default False
        Whether all stages and cells are computed again, even if they are up to date.
    sparing : bool, default False
        Whether only slow results are written, from which a run that was killed goes on: no case,
        no fields, and no cells and datasets that cost less than :data:`WORTH`.

    Raises
    ------
    MultiscaleError
        If an input is refused, a file cannot be written, or nothing converged.
    """
    folder = Path(out)
    job = replace(_job(folder, executor, progress), sparing=sparing)
    if not sparing or folder.exists():
        claim_folder(make_folder(folder), case, force=force)
    prepare(case)
    planned_files = [job.out / stage.file for stage in PLANNED if stage.asked_for(case.tables)]
    if case.accuracy is not None and not all(file.exists() for file in planned_files):
        planned = plan(case, job.out, executor=executor, progress=progress)
        write_fields(planned.case, planned.folder, job.out)
        for stage, dataset in zip(PLANNED, planned.datasets, strict=True):
            if dataset is not None:
                identity = stage.identity(case)
                write_dataset(dataset, job.out / stage.file, stage.schema, identity=identity)
    datasets: dict[str, Dataset] = {}
    for stage in stages_of(case.tables):
        file = job.out / stage.file
        if file.exists():
            logger.info("%s: up to date, kept", stage.name)
            datasets[stage.name] = open_dataset(file, stage.schema)
            stage.check(datasets[stage.name])
        else:
            datasets[stage.name] = _compute(stage, case, datasets, job, file)
    return Results(datasets)


def run_macro(
    case: Case,
    file: str | Path,
    *,
    law: str | Path | None = None,
    team: "ProcessGroup | None" = None,
) -> Dataset:
    """Solve the structure of a case; write its result and, next to it, ``fields`` for ParaView.

    Cells of the case are not solved. With ``homogenise`` in ``[substructures]`` the condensed
    stiffness of the substructures is written as well.

    Parameters
    ----------
    case : Case
    file : path, dataset to write; its folder is made if needed
    law : path, optional, interface law of the joints, instead of the law that the case names
    team : ProcessGroup, optional
        Processes that share the substructures. All call this function; the first one writes.

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
        If no step converged, or the equilibrium from which a motion starts cannot be found.
    """
    file, case = Path(file), case.from_structure(None if law is None else Path(law))
    prepare(case)
    job = _job(file.parent, team=team)
    first, *rest = stages_of(case.tables)
    datasets = {first.name: _compute(first, case, {}, job, file)}
    for stage in rest if _writes(job) else ():
        _compute(stage, case, datasets, job, file.with_name(f"{file.stem}-{stage.name}.nc"))
    return datasets[first.name]


def _job(
    out: Path,
    executor: Executor | None = None,
    progress: ShowProgress = unseen,
    team: "ProcessGroup | None" = None,
) -> Job:
    """Return the job of a folder; other cases that a case names are run in its subfolders."""

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

    def volume_of(file: Path, quick: bool) -> Dataset:
        if file.suffix == ".toml":
            file = run_alone(*taken_volume(file, quick)) / f"{RVE.name}.nc"
        return open_dataset(file, RVE)

    return Job(out, executor, progress, team, read_law=law_of, read_rve=volume_of)


def _compute(stage: Stage, case: Case, datasets: Datasets, job: Job, file: Path) -> Dataset:
    """Run a stage and write its files, the dataset last."""
    logger.info("%s: begun", stage.name)
    begin = perf_counter()
    result = stage.run(case, datasets, job)
    if _writes(job) and not (job.sparing and perf_counter() - begin < WORTH):
        make_folder(file.parent)
        if stage.write_fields is not None and not job.sparing:
            stage.write_fields(result, make_folder(file.parent / "fields"), name=file.stem)
        write_dataset(result, file, stage.schema, identity=stage.identity(case))
    logger.info("%s: finished after %.3g s", stage.name, perf_counter() - begin)
    stage.check(result)
    return result


def _writes(job: Job) -> bool:
    return job.team is None or job.team.rank == 0
