"""From a target for the error to cells, grid and realisations: pilot runs, forecast, more runs."""

import logging
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError, ConvergenceError
from multiscale.io import open_response
from multiscale.pipeline.forecast import GRIDS, SIZES, CostModel, Estimate, Setting, cheapest
from multiscale.pipeline.joint import joint_scales, solve_joint
from multiscale.pipeline.micro import run_micro
from multiscale.pipeline.settings import Case, InstrumentSurface
from multiscale.upscaling import error_budget, fit_law, with_budget, without_size_bias

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Plan", "plan", "resize"]

logger = logging.getLogger(__name__)

STUDY = {(-1, -1): 12, (0, -1): 6}
"""Cells of the pilot runs by (size, grid): scatter, and bias by the size, on a coarse grid."""

PAIRS = 5
"""Cells of the smaller pilot runs that are solved on the grid of the case, too."""

MOST_ROUNDS = 8

LEAST_EXPONENT, MOST_EXPONENT = 1.0, 1.5
"""Of the unknowns in the time of a cell: small cells are dominated by what does not grow."""

FEWEST_POINTS = 8
"""Of a cell, each way."""

PILOT_SEED = 1_000_003
"""Between the first realisations of pilot runs of different sizes, and of the answer."""


@dataclass(frozen=True, eq=False)
class Plan:
    """What a planner has chosen, computed and spent.

    Attributes
    ----------
    case : Case
        With the cells, grid and realisations chosen.
    micro_response, interface_law, macro_result : Dataset
        As those of a run, with their error budgets.
    folder : Path
        Of the cells.
    total : float
        Estimated error, relative.
    spent, forecast : float
        Time of all cells, s, and what was expected after the pilot runs.
    lines : tuple of str
        What was decided and found, a sentence for each round.
    """

    case: Case
    micro_response: "xr.Dataset"
    interface_law: "xr.Dataset"
    macro_result: "xr.Dataset"
    folder: Path
    total: float
    spent: float
    forecast: float
    lines: tuple[str, ...]


def plan(
    case: Case,
    out: Path,
    *,
    executor: Executor | None = None,
    progress: Callable[[int], None] = lambda finished: None,
) -> Plan:
    r"""Compute until the estimated error of a case is below its target, in the least time.

    Parameters
    ----------
    case : Case
        With ``accuracy``; its cells, grid and realisations are where the planner starts from.
    out : Path
        Cells go to the folder ``plan`` in it; those found there are not computed again.
    executor : Executor, optional
        See :func:`multiscale.micro.run_ensemble`.
    progress : callable
        Gets the number of finished realisations of an ensemble.

    Returns
    -------
    Plan

    Raises
    ------
    CaseError
        If the target is out of reach, or the case cannot be solved on other grids.
    ConvergenceError
        If the estimate stays above the target for :data:`MOST_ROUNDS` rounds.

    Notes
    -----
    Pilot runs of small cells on coarse grids tell the scatter, the bias by the size of the cell,
    which is taken out of the law, the error of the grid and the time of a cell. From them follows
    the setting of least time whose total is expected to be below the target; see
    :class:`~.forecast.Estimate`. Its cells are solved and its budget is estimated anew, which is
    the next forecast's base, until the estimate is below the target.
    """
    assert case.accuracy is not None
    _check(case)
    campaign = _Campaign(case, out / "plan", executor, progress)
    target, lines = case.accuracy.target, []
    pilots = campaign.pilots(1)
    estimate = campaign.estimate(Setting(0, -1, STUDY[0, -1]), pilots.study[0], pilots)
    solved = {(0, -1): pilots.study[0], (-1, 0): pilots.pairs[0]}
    sizes, forecast = SIZES, np.nan
    for number in range(MOST_ROUNDS):
        costs = _costs(case, solved)
        setting, time = cheapest(estimate, costs, campaign.done(), STUDY, target, (sizes, GRIDS))
        spent = campaign.spent()
        forecast = spent + time if number == 0 else forecast
        try:
            if setting.study > estimate.setting.study:
                pilots = campaign.pilots(setting.study)
            response = campaign.solve(setting)
        except CaseError as error:  # a measured map holds no more or no larger windows
            if setting.size <= 0:
                raise
            logger.info("size %d: %s", setting.size, error)
            sizes = range(sizes.start, setting.size)
            continue
        solved[setting.size, setting.grid] = response
        found = campaign.estimate(setting, response, pilots)
        lines.append(
            f"round {number + 1}: {setting}; forecast {time:.3g} s and "
            f"{100.0 * estimate.at(setting).total:.3g} %, spent {campaign.spent() - spent:.3g} s, "
            f"estimated error {100.0 * found.total:.3g} %"
        )
        logger.info(lines[-1])
        estimate = found
        if found.total <= target:
            spent = campaign.spent()
            lines.append(
                f"the estimated error of {case.accuracy.quantity} is {100.0 * found.total:.3g} %, "
                f"below the target of {100.0 * target:.3g} %; {spent:.3g} s of solver time were "
                f"spent, {forecast:.3g} s forecast after the pilot runs"
            )
            chosen, law = campaign.law(setting, response, pilots, case.law.samples)
            result = solve_joint(chosen, law, bootstrap=False)
            folder = campaign.folder(setting)
            return Plan(
                chosen, response, law, result, folder, found.total, spent, forecast, tuple(lines)
            )
    raise ConvergenceError(
        f"the estimated error is {100.0 * estimate.total:.3g} % after {MOST_ROUNDS} rounds, above "
        f"the target of {100.0 * target:.3g} %; run again to go on, or ask for a larger target"
    )


def resize(case: Case, setting: Setting, *, pilot: bool = False) -> Case:
    """Return a case with the cells, the grid and the realisations of a setting.

    Parameters
    ----------
    case : Case
    setting : Setting
    pilot : bool
        Whether the surfaces are those of pilot runs, independent of those of the answer.
    """
    larger, finer = 2.0**setting.size, 2.0 ** (setting.size + setting.grid)
    cell = case.cell.model_copy(
        update={
            "size": tuple(larger * edge for edge in case.cell.size),
            "points": tuple(2 * max(2, round(0.5 * finer * n)) for n in case.cell.points),
            "layers": max(4, round(2.0**setting.grid * case.cell.layers)),
        }
    )
    seed = case.micro.seed + (PILOT_SEED * (1 + setting.size - SIZES.start) if pilot else 0)
    micro = case.micro.model_copy(update={"realisations": setting.realisations, "seed": seed})
    return case.model_copy(update={"cell": cell, "micro": micro})


def _check(case: Case) -> None:
    """Refuse cases whose surface would differ between grids, or whose grids are too coarse."""
    for number, body in enumerate(case.bodies, start=1):
        if isinstance(body.surface, InstrumentSurface) and body.surface.short_cutoff is None:
            raise CaseError(
                f"[accuracy] compares grids, on which the surface has to be the same: give "
                f"short_cutoff in [body_{number}.surface]"
            )
    fewest = min(resize(case, Setting(-1, -1, 1)).cell.points)
    if fewest < FEWEST_POINTS:
        raise CaseError(
            f"[accuracy] begins with a quarter of the points, which would be {fewest}; "
            f"give points = {4 * FEWEST_POINTS} or more in [cell]"
        )
    cutoffs = [body.surface.short_cutoff for body in case.bodies if body.surface is not None]
    shortest = min(cutoff for cutoff in cutoffs if cutoff is not None)
    spacing = max(edge / n for edge, n in zip(case.cell.size, case.cell.points, strict=True))
    if 4.0 * spacing >= shortest:
        raise CaseError(
            f"[accuracy] compares with a grid of twice the spacing, {2.0 * spacing:.3g} m, which "
            f"cannot carry waves of {shortest:.3g} m; give more than "
            f"{4.0 * max(case.cell.size) / shortest:.0f} points in [cell]"
        )


@dataclass(frozen=True, eq=False)
class _Pilots:
    """Responses of pilot runs: cells of several sizes by size, and the same cells by grid."""

    study: dict[int, "xr.Dataset"]
    pairs: dict[int, "xr.Dataset"]


@dataclass(frozen=True, eq=False)
class _Campaign:
    """The ensembles of a case that a planner works with."""

    case: Case
    out: Path
    executor: Executor | None
    progress: Callable[[int], None]

    def folder(self, setting: Setting, *, pilot: bool = False) -> Path:
        """Return where the cells of a setting are."""
        name = f"size{setting.size:+d}-grid{setting.grid:+d}"
        return self.out / (f"pilot-{name}" if pilot else name)

    def solve(self, setting: Setting, *, pilot: bool = False) -> "xr.Dataset":
        """Response of the cells of a setting; those that are there are kept."""
        return run_micro(
            resize(self.case, setting, pilot=pilot),
            self.folder(setting, pilot=pilot) / "micro_response.nc",
            executor=self.executor,
            progress=self.progress,
            fields=False,
        )

    def pilots(self, multiple: int) -> "_Pilots":
        """Solve the pilot runs: cells of two sizes, and some of them on two grids."""
        study = {
            size: self.solve(Setting(size, grid, multiple * n), pilot=True)
            for (size, grid), n in STUDY.items()
        }
        fine = self.solve(Setting(-1, 0, multiple * PAIRS), pilot=True)
        coarse = study[-1].isel(realisation=slice(multiple * PAIRS))
        return _Pilots(study, {0: fine, -1: coarse})

    def law(
        self, setting: Setting, response: "xr.Dataset", pilots: "_Pilots", samples: int
    ) -> tuple[Case, "xr.Dataset"]:
        """Fit the law of a response, with its budget."""
        chosen = resize(self.case, setting)
        sizes = {2.0 ** (size - setting.size): one for size, one in pilots.study.items()}
        response = without_size_bias(response, sizes)
        law = fit_law(response, n_terms=chosen.law.terms, n_samples=samples)
        budget = error_budget(
            response,
            law,
            resolutions={2.0 ** (setting.grid - grid): one for grid, one in pilots.pairs.items()},
            sizes=sizes,
            scales=joint_scales(chosen),
            apart=True,
        )
        return chosen, with_budget(law, budget)

    def estimate(self, setting: Setting, response: "xr.Dataset", pilots: "_Pilots") -> Estimate:
        """Say how wrong the answer of a response is."""
        assert self.case.accuracy is not None
        (chosen, law), quantity = (
            self.law(setting, response, pilots, 0),
            self.case.accuracy.quantity,
        )
        carrier = law
        if quantity == "joint_stiffness":
            carrier = solve_joint(chosen, law, bootstrap=False)
        one = carrier.sel(quantity=quantity)
        return Estimate(setting, one["error_half_width"].to_numpy(), one["error_bias"].to_numpy())

    def done(self) -> dict[tuple[int, int], int]:
        """Count the cells of each setting that are there, pilot runs apart."""
        keys = [(size, grid) for size in SIZES for grid in GRIDS]
        return {
            key: len(list((self.folder(Setting(*key, 1)) / "micro").glob("realisation-*.nc")))
            for key in keys
        }

    def spent(self) -> float:
        """Time of all cells that are there, s."""
        files = self.out.glob("*/micro_response.nc")
        return sum(float(open_response(file)["wall_time"].sum()) for file in files)


def _costs(case: Case, solved: dict[tuple[int, int], "xr.Dataset"]) -> CostModel:
    """Fit the time of a cell to the two kinds with most unknowns among those solved.

    The median over the realisations counts, since the first one may have compiled kernels.
    """
    unit = CostModel(1.0, 1.0, case.cell.geometry != "flat")
    rows: dict[float, float] = {}
    for (size, grid), response in solved.items():
        time = float(np.median(response["wall_time"].sum("step")))
        unknowns = unit.of_cell(size, grid)
        rows[unknowns] = min(time, rows.get(unknowns, np.inf))
    *others, (large, time) = sorted(rows.items())
    exponent = LEAST_EXPONENT
    if others:
        small, short = others[-1]
        exponent = float(np.log(time / short) / np.log(large / small))
    exponent = min(max(exponent, LEAST_EXPONENT), MOST_EXPONENT)
    return CostModel(time / large**exponent, exponent, unit.layered)
