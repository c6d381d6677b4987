"""Refusals and needs of a case before its stages are run."""

from collections.abc import Iterable
from dataclasses import replace
from math import inf, isnan
from pathlib import Path

from multiscale.errors import CaseError
from multiscale.executors import cores, usable_memory
from multiscale.needs import Cost, Needs, join_needs, readable_time
from multiscale.pipeline.case import taken_cases, taken_law
from multiscale.pipeline.run_folder import read_up_to_date
from multiscale.pipeline.stages import stages_of
from multiscale.pipeline.tables.joint_settings import LawSource
from multiscale.pipeline.tables.settings import Case
from multiscale.pipeline.tables.structure_kind import OF_CELLS, Pressed, Range, far_loads
from multiscale.upscaling import law_from_dataset
from multiscale.upscaling.tables import read_law


def prepare(case: Case) -> None:
    """Refuse a case for its files, and for loads that are far outside the data of its laws."""
    for stage in stages_of(case.tables):
        stage.prepare(case)
    if case.adaptive:
        _refuse_without_cells(case)
    if case.structure is not None and not (case.extrapolate or case.adaptive):
        for pressed in case.structure.pressed(case):
            for fault in far_loads(pressed, *_data_of(case, pressed)):
                raise CaseError(f"{case.title}: {fault}")


EVERY = (0.0, inf)  # pressures of a law of grains, which hold at a speed only, Pa


def _refuse_without_cells(case: Case) -> None:
    """Refuse to press cells further for laws without cells."""
    assert case.structure is not None  # no other table has interfaces
    for named in case.structure.named_laws(case):
        if named is None and not case.has_cells:
            where = "an interface has neither cells nor a law with cells"
        elif named is not None and (
            named[0].suffix != ".toml" or not taken_law(*named)[1].has_cells
        ):
            where = f"{named[0].name} is a law without cells"
        else:
            continue
        raise CaseError(
            f'{case.title}: way = "{case.way}" in [interface] presses the cells of a law again, '
            f"and {where}; name a case with cells by law, or leave way out"
        )


def _data_of(case: Case, pressed: Pressed) -> tuple[Range, str, str]:
    """Pressures of the law of an interface, Pa, their source, and the remedy."""
    if pressed.stated is not None:
        return pressed.stated, "stated by the case", "state a law for such pressures"
    if case.third_body is not None:
        return EVERY, "", ""
    if pressed.law is None and case.has_cells:
        return (case.micro.pressures[0], case.micro.pressures[-1]), *OF_CELLS
    remedy = "take a law of such pressures, or set extrapolate = true in [interface]"
    file = pressed.law or (case.interface or LawSource()).source
    if file.suffix == ".toml":
        _, other = taken_law(file, quick=False)
        if other.third_body is not None:
            return EVERY, file.name, remedy
        return (other.micro.pressures[0], other.micro.pressures[-1]), file.name, remedy
    law = read_law(file)
    known = EVERY if "sliding_speed" in law.attrs else law_from_dataset(law).pressure_range
    return known, file.name, remedy


LONGEST = 86400.0  # s, of a run that needs no consent


def requirements(case: Case, *, processes: int = 1) -> Needs:
    """Return the needs of the stages of a case, and the methods that they leave out.

    Parameters
    ----------
    processes : int, that share the substructures of a structure

    Examples
    --------
    >>> from multiscale.pipeline import load_case
    >>> needs = requirements(load_case("ground_steel"))
    >>> needs.unknowns_per_contact, needs.omitted["tilt"]
    (1, "Poisson's ratio below 0.4, or no elements")
    """
    parts = {
        f"{stage.name} of {place.name.rpartition('-')[0]}": stage.needs(other)
        for place, other in taken_cases(case).items()
        for stage in stages_of(other.tables)
    }
    parts |= {stage.name: stage.needs(case) for stage in stages_of(case.tables)}
    costs = [Cost(name, needs.memory, needs.seconds) for name, needs in parts.items()]
    needs = replace(join_needs(parts.values()), costs=tuple(costs))
    if processes == 1:
        return needs
    return replace(needs, libraries=tuple(sorted({*needs.libraries, "mpi4py"})))


def refuse_excess(cases: Iterable[Case], folders: Iterable[Path], *, jobs: int = 0) -> None:
    """Refuse cases that do not fit into the memory of this machine, or take more than a day.

    Parameters
    ----------
    folders : iterable of Path
        Run folder of each case; up-to-date datasets in it cost nothing.
    jobs : int, worker processes; 0 for one per core

    Raises
    ------
    CaseError
        If a stage exceeds a limit; the message names the stage and the number.
    """
    limit, workers, seconds = usable_memory(), jobs or cores(), 0.0
    for case, folder in zip(cases, folders, strict=True):
        taken = [(other, folder / place) for place, other in taken_cases(case).items()]
        todo = [
            (stage, other)
            for other, place in (*taken, (case, folder))
            for stage in stages_of(other.tables)
            if read_up_to_date(stage, other, place) is None
        ]
        for stage, other in todo:
            cost = stage.needs(other)
            if cost.memory > limit:
                raise CaseError(
                    f"{case.title}: {stage.name} takes {1e-9 * cost.memory:.6g} GB of memory, and "
                    f"this machine has {1e-9 * limit:.3g} GB; use a coarser grid, or give "
                    f"--force"
                )
            seconds += 0.0 if isnan(cost.seconds) else cost.seconds
            if seconds > LONGEST * workers:
                raise CaseError(
                    f"{case.title}: the stages up to {stage.name} take about "
                    f"{readable_time(seconds / workers)} with --jobs {workers}, more than a day; "
                    f"reduce the case, or give --force"
                )
