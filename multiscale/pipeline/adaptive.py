"""The adaptive and the concurrent way: cells are pressed at the pressures of a structure."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from multiscale.errors import CaseError
from multiscale.io import make_folder, write_dataset
from multiscale.macro.data_range import (
    LOAD_SHARES,
    ROUNDS,
    data_ends,
    further_pressures,
    pressures_between,
    pressures_of_points,
)
from multiscale.pipeline.stage import Datasets, Job, unseen
from multiscale.pipeline.stages import stages_of
from multiscale.pipeline.stages.cells import CELLS
from multiscale.pipeline.stages.ensembles import COARSER_CELLS, CONTROL_CELLS, press_control
from multiscale.pipeline.stages.fitted_law import FITTED_LAW
from multiscale.pipeline.tables.settings import Case
from multiscale.schema import Dataset
from multiscale.units import readable
from multiscale.upscaling import law_from_dataset
from multiscale.upscaling.budget import OF_ONE_PART, has_budget
from multiscale.upscaling.response_observations import join_pressures

NEAR = 0.03
"""Relative difference of pressures of the concurrent way that share a cell."""

FOLDER = "adaptive"
"""Folder of further cells and of the laws with them in a run folder."""

Named = tuple[Path, bool] | None
"""File of a law, and whether its case is run quick; None for the law of the cells of a case."""


@dataclass(frozen=True, eq=False)
class PressedCells:
    """Cells of a case, and their law."""

    case: Case
    datasets: Datasets  # of the stages of the cells and of their law
    added: tuple[float, ...] = ()  # further pressures, Pa
    solved: int = 0  # steps of cells at them

    @property
    def law(self) -> Dataset:
        """Law fitted to all pressures."""
        return self.datasets[FITTED_LAW.name]

    def further(
        self, way: str, shares: np.ndarray, points: tuple[np.ndarray, np.ndarray]
    ) -> tuple[float, ...]:
        """Return the further pressures that the load of interfaces, or their points, need, Pa."""
        ends, known = data_ends(law_from_dataset(self.law)), self.case.micro.pressures
        if way == "concurrent":
            asked, near = pressures_of_points(ends, *points), NEAR
        else:
            data = self.law["fit_pressure"].to_numpy()
            asked = further_pressures(ends, shares)
            given = len(known) - len(self.added)
            asked += pressures_between(data, _unsure(self.law), *points, given)
            near = 1e-5
        return tuple(p for p in asked if not np.isclose(p, known, rtol=near).any())

    def press(self, pressures: tuple[float, ...], job: Job) -> "PressedCells":
        """Press the cells at further pressures too, and fit the law to all of them."""
        case, joined = self.case, dict(self.datasets)
        whole = case.pressed_at({*case.micro.pressures, *pressures})
        remembers = case.yield_stress is not None or case.micro.unload is not False
        solved = whole if remembers else case.pressed_at(pressures)
        inner = replace(job, out=job.out / FOLDER / whole.checksum()[:8], sparing=True)
        more = {
            stage.name: stage.run(solved, {}, inner)
            for stage in (CELLS, COARSER_CELLS)
            if stage.name in joined
        }
        if (control := joined.get(CONTROL_CELLS.name)) is not None:
            more[CONTROL_CELLS.name] = press_control(solved, control.sizes["realisation"], inner)
        solved_steps = sum(int(new["converged"].sum()) for new in more.values())
        joined |= {
            name: new if remembers else join_pressures(joined[name], new)
            for name, new in more.items()
        }
        law = FITTED_LAW.run(whole, joined, inner)
        write_dataset(law, make_folder(inner.out) / FITTED_LAW.file, FITTED_LAW.schema)
        datasets = joined | {FITTED_LAW.name: law}
        return PressedCells(whole, datasets, (*self.added, *pressures), self.solved + solved_steps)

    def report(self) -> str:
        """Report the cells that were solved."""
        count = self.case.micro.realisations
        listed = _list_pressures(self.added)
        return (
            f"the structure needs further pressures, and {count} cells were pressed under "
            f"{listed} too ({self.solved} steps of cells and control cells, which all points share)"
        )


def reach_loads(case: Case, datasets: Datasets, job: Job) -> tuple[Datasets, Job]:
    """Return datasets and job with laws that have data for the structure at rest."""
    if job.team is not None and job.team.size > 1:
        raise CaseError(
            f'{case.title}: way = "{case.way}" in [interface] presses cells between solves of the '
            f"structure, in one process, got {job.team.size}"
        )
    assert case.interface is not None  # it has the way
    # answers far outside the data determine the further pressures
    interface = case.interface.model_copy(update={"extrapolate": True})
    others = dict.fromkeys(("vibration", "fatigue", "growth"))
    still = case.model_copy(update={**others, "interface": interface})
    (stage,) = (s for s in stages_of(still.tables) if s.tables == ("structure", s.tables[-1]))
    assert case.structure is not None  # no other table has interfaces
    named = list(case.structure.named_laws(case))
    cells = {name: _open_cells(case, name, datasets, job) for name in dict.fromkeys(named)}
    quiet = replace(job, intervals=False, progress=unseen)
    for _ in range(ROUNDS):
        result = stage.run(still, *_with_laws(cells, datasets, quiet))
        shares = np.array([result[name].to_numpy() for name in LOAD_SHARES])
        of_all = named * (shares.shape[2] if len(named) == 1 else 1)
        pressure, area, number = case.structure.point_pressures(result)
        further = {}
        for name, pressed in cells.items():
            its = np.array([other == name for other in of_all])
            points = pressure[:, its[number]], area[its[number]]
            further[name] = pressed.further(case.way, shares[..., its], points)
        if not any(further.values()):
            break
        for name, pressures in further.items():
            if pressures:
                cells[name] = cells[name].press(pressures, job)
    notes = [pressed.report() for pressed in cells.values() if pressed.added]
    if any(further.values()):
        listed = _list_pressures(p for pressures in further.values() for p in pressures)
        notes.append(
            f"all {ROUNDS} solves of the structure need further pressures, the last "
            f"{listed}: the answer may change with cells at further pressures; give more "
            f"pressures in [micro]"
        )
    return _with_laws(cells, datasets, replace(job, notes=tuple(notes)))


def _unsure(law: Dataset) -> np.ndarray:
    """Return the steps at which the form of a law has the largest error of its stiffness."""
    if not has_budget(law):
        return np.zeros(law["fit_pressure"].size, dtype=bool)
    half = law["error_half_width"].sel(quantity="stiffness")
    others = half.drop_sel(error_term=[*OF_ONE_PART, "fit"], errors="ignore")
    return np.asarray(~(half.sel(error_term="fit") <= np.sqrt((others**2).sum("error_term"))))


def _list_pressures(pressures: Iterable[float]) -> str:
    return ", ".join(dict.fromkeys(readable(f"{p:.4g} Pa") for p in sorted(pressures)))


def _open_cells(case: Case, named: Named, datasets: Datasets, job: Job) -> PressedCells:
    """Return the cells of the law of this case, or of the law of another case."""
    if named is None:
        return PressedCells(case, datasets)
    return PressedCells(*job.open_cells(*named))


def _with_laws(
    cells: Mapping[Named, PressedCells], datasets: Datasets, job: Job
) -> tuple[Datasets, Job]:
    """Return datasets and a job that give the laws of pressed cells."""
    laws = {name: pressed.law for name, pressed in cells.items()}

    def read_law(file: Path, quick: bool) -> Dataset:
        return laws[file, quick] if (file, quick) in laws else job.read_law(file, quick)

    law_of_case = {FITTED_LAW.name: laws[None]} if None in laws else {}
    return {**datasets, **law_of_case}, replace(job, read_law=read_law)
