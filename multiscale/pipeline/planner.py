"""From a target for the error to cells, grid and realisations: pilot runs, forecast, more runs."""

import logging
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError, ConvergenceError
from multiscale.io import open_dataset, open_response, write_dataset
from multiscale.pipeline.case_budget import joint_scales
from multiscale.pipeline.forecast import GRIDS, SIZES, CostModel, Estimate, Setting, cheapest
from multiscale.pipeline.pilots import Pilots, stored_pilots, surface_at_large
from multiscale.pipeline.rough_bodies import InstrumentSurface
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Job, ShowProgress, unseen
from multiscale.pipeline.stages.cells import run_micro
from multiscale.pipeline.stages.control_cells import press_control
from multiscale.pipeline.stages.joint import solve_joint
from multiscale.schema import CONTROL_RESPONSE, MICRO_RESPONSE
from multiscale.surfaces import Surface, rms_height
from multiscale.upscaling import (
    at_rms_height,
    error_budget,
    fit_law,
    with_budget,
    without_size_bias,
)
from multiscale.upscaling.budget import ALWAYS, ERROR_TERMS, how_attribute
from multiscale.upscaling.control_variates import FEWEST_PAIRS

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Plan", "pilot_cases", "plan", "resize"]

logger = logging.getLogger(__name__)

STUDY: dict[tuple[float, float], int] = {(-1, -1): 8, (0, -1): 4}
"""Cells of the pilot runs by (size, grid): scatter, and bias by the size, on a coarse grid."""

PAIRS = 4
"""Cells of the smaller pilot runs that are solved on the grid of the case, too."""

MOST_ROUNDS = 8

FEWEST_POINTS = 8
"""Of a cell, each way."""

PILOT_SEED = 1_000_003
"""Between the first realisations of pilot runs of different sizes, and of the answer."""


@dataclass(frozen=True, eq=False)
class Plan:
    """What a planner has chosen, computed and spent.

    Attributes
    ----------
    case : Case, with the cells, grid and realisations chosen
    micro_response, interface_law : Dataset, as the datasets of a run, with their error budgets
    macro_result : Dataset or None
        Answer of the blocks, with its error budget, if the case has blocks.
    folder : Path, of the cells
    total : float, estimated error, relative
    spent, forecast : float, time of all cells, s, and what was expected after the pilot runs
    lines : tuple of str, what was decided and found, a sentence for each round
    """

    case: Case
    micro_response: "xr.Dataset"
    interface_law: "xr.Dataset"
    macro_result: "xr.Dataset | None"
    folder: Path
    total: float
    spent: float
    forecast: float
    lines: tuple[str, ...]

    @property
    def datasets(self) -> "tuple[xr.Dataset, xr.Dataset, xr.Dataset | None]":
        """Response, law and answer; law and answer say what was decided and spent."""
        told = {
            "plan": "\n".join(self.lines),
            "time_spent": self.spent,
            "time_forecast": self.forecast,
        }
        result = None if self.macro_result is None else self.macro_result.assign_attrs(told)
        return self.micro_response, self.interface_law.assign_attrs(told), result


def plan(
    case: Case,
    out: Path,
    *,
    executor: Executor | None = None,
    progress: ShowProgress = unseen,
) -> Plan:
    r"""Compute until the estimated error of a case is below its target, in the least time.

    Parameters
    ----------
    case : Case
        With ``accuracy``; its cells, grid and realisations are where the planner starts from.
    out : Path, cells go to the folder ``plan`` in it; those found there are not computed again
    executor, progress
        As of :func:`~multiscale.pipeline.run`, for every ensemble.

    Raises
    ------
    CaseError
        If the target is out of reach, or the case cannot be solved on other grids.
    ConvergenceError
        If the estimate stays above the target for :data:`MOST_ROUNDS` rounds.

    Notes
    -----
    Stored cells of a spectrum alike, or pilot runs of small cells on coarse grids, tell the
    scatter, the bias by the size of the cell, which is taken out of the law, the error of the grid
    and the time of a cell. Gaps are those at the height of the surface at large. From them follows
    the setting of least time whose total is expected to be below the target; see
    :class:`~.forecast.Estimate`. Its cells are solved and its budget is estimated anew, which is
    the next forecast's base, until the estimate is below the target.
    """
    assert case.accuracy is not None
    _check(case)
    campaign = _Campaign(case, out / "plan", executor, progress, surface_at_large(case))
    known, forecast = campaign.begin(), np.nan
    lines: list[str] = []
    for _ in range(MOST_ROUNDS):
        setting, time, known = campaign.choose(known)
        spent, expected = campaign.spent(), known.estimate.at(setting).total
        logger.info("%s: about %.3g s and %.3g %%", setting, time, 100.0 * expected)
        forecast = forecast if lines else spent + time
        try:
            known, response = campaign.advance(known, setting)
        except CaseError as error:  # a measured map holds no more or no larger windows
            if setting.size <= 0:
                raise
            logger.info("size %d: %s", setting.size, error)
            known = replace(known, sizes=range(known.sizes.start, int(setting.size)))
            continue
        lines.append(
            f"round {len(lines) + 1}: {setting}; forecast {time:.3g} s and "
            f"{100.0 * expected:.3g} %, spent {campaign.spent() - spent:.3g} s, "
            f"estimated error {100.0 * known.estimate.total:.3g} %"
        )
        logger.info(lines[-1])
        if known.estimate.total <= case.accuracy.target:
            return campaign.finish(known, response, tuple(lines), forecast)
    raise ConvergenceError(
        f"the estimated error is {100.0 * known.estimate.total:.3g} % after {MOST_ROUNDS} rounds, "
        f"above the target of {100.0 * case.accuracy.target:.3g} %; run again to go on, or ask for "
        f"a larger target"
    )


def resize(case: Case, setting: Setting, *, pilot: bool = False) -> Case:
    """Return a case with the cells, the grid and the realisations of a setting.

    The surfaces of pilot runs are independent of those of the answer.
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


def pilot_cases(case: Case) -> list[Case]:
    """Return the cases of the first pilot runs, which stored cells may save."""
    runs = (*STUDY.items(), ((-1.0, 0.0), PAIRS))
    return [resize(case, Setting(*kind, count), pilot=True) for kind, count in runs]


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
    spacing = case.cell.spacing
    if 4.0 * spacing >= shortest:
        raise CaseError(
            f"[accuracy] compares with a grid of twice the spacing, {2.0 * spacing:.3g} m, which "
            f"cannot carry waves of {shortest:.3g} m; give more than "
            f"{4.0 * max(case.cell.size) / shortest:.0f} points in [cell]"
        )


@dataclass(frozen=True, eq=False)
class _Known:
    """What a planner knows after a round."""

    estimate: Estimate
    pilots: Pilots
    costs: CostModel
    sizes: range = SIZES  # that can be had


@dataclass(frozen=True, eq=False)
class _Campaign:
    """The ensembles of a case that a planner works with."""

    case: Case
    out: Path
    executor: Executor | None
    progress: ShowProgress
    large: Surface | None  # the surface at large

    def folder(self, setting: Setting, *, pilot: bool = False) -> Path:
        """Return where the cells of a setting are."""
        name = f"size{setting.size:+g}-grid{setting.grid:+g}"
        return self.out / (f"pilot-{name}" if pilot else name)

    def solve(self, setting: Setting, *, pilot: bool = False) -> "xr.Dataset":
        """Response of the cells of a setting, at the height of the surface at large.

        Cells that are there are kept.
        """
        cells = (
            f"{'pilot ' if pilot else ''}cells of size {setting.size:+g}, grid {setting.grid:+g}"
        )
        response = run_micro(
            resize(self.case, setting, pilot=pilot),
            self.folder(setting, pilot=pilot) / "micro_response.nc",
            executor=self.executor,
            progress=lambda finished, total, _: self.progress(finished, total, cells),
            fields=False,
        )
        return self.at_large(response)

    def at_large(self, response: "xr.Dataset") -> "xr.Dataset":
        """Return a response at the height of the surface at large."""
        return response if self.large is None else at_rms_height(response, rms_height(self.large))

    def control(self, setting: Setting, *, pilot: bool = False) -> "xr.Dataset | None":
        """Flat cells beside those of a setting; none if these are few, or are stored ones."""
        file = self.folder(setting, pilot=pilot) / "micro_response.nc"
        few = setting.realisations < FEWEST_PAIRS
        if few or not self.case.micro.control or not file.exists():
            return None
        cells = resize(self.case, setting, pilot=pilot)
        found = press_control(cells, open_response(file), Job(file.parent, self.executor))
        write_dataset(found, file.with_name(f"{CONTROL_RESPONSE.name}.nc"), CONTROL_RESPONSE)
        return self.at_large(found)

    def begin(self) -> _Known:
        """Start from stored cells, or from pilot runs where none stand for the case."""
        pilots = stored_pilots(self.case, self.large)
        if pilots is None:
            return self.begin_with_pilots()
        edge, spacing = sorted(pilots.sizes)[1], max(pilots.grids)
        size = float(np.log2(edge / max(self.case.cell.size)))
        grid = float(np.log2(self.case.cell.spacing / spacing))
        response = pilots.sizes[edge]
        setting = Setting(size, grid, response.sizes["realisation"])
        kinds: dict[tuple[float, float], float] = {}
        for one_edge, one in pilots.sizes.items():
            kinds[size + float(np.log2(one_edge / edge)), grid] = _time(one)
        costs = CostModel.fit(kinds, layered=False)
        return _Known(self.estimate(setting, response, pilots), pilots, costs)

    def begin_with_pilots(self) -> _Known:
        """Start from pilot runs."""
        pilots = self.pilots(1)
        small, large = sorted(pilots.sizes)
        times: dict[tuple[float, float], float] = {
            (-1, -1): _time(pilots.sizes[small]),
            (0, -1): _time(pilots.sizes[large]),
            (-1, 0): _time(pilots.grids[min(pilots.grids)]),
        }
        costs = CostModel.fit(times, layered=self.case.cell.geometry != "flat")
        setting = Setting(0, -1, STUDY[0, -1])
        estimate = self.estimate(setting, pilots.sizes[large], pilots, pilot=True)
        return _Known(estimate, pilots, costs)

    def pilots(self, multiple: int) -> Pilots:
        """Solve the pilot runs: cells of two sizes, and some of them on two grids."""
        edge, spacing = max(self.case.cell.size), self.case.cell.spacing
        study = {
            2.0**size * edge: self.solve(Setting(size, grid, multiple * n), pilot=True)
            for (size, grid), n in STUDY.items()
        }
        fine = self.solve(Setting(-1, 0, multiple * PAIRS), pilot=True)
        coarse = study[0.5 * edge].isel(realisation=slice(multiple * PAIRS))
        return Pilots(study, {spacing: fine, 2.0 * spacing: coarse})

    def choose(self, known: _Known) -> tuple[Setting, float, _Known]:
        """Choose the cheapest setting, and pilot runs where stored cells do not reach so far."""
        assert self.case.accuracy is not None
        study = {} if known.pilots.stored else STUDY
        limits, target = (known.sizes, GRIDS), self.case.accuracy.target
        fewest = FEWEST_PAIRS if self.case.micro.control else 1
        costs, done = known.costs, self.done()
        try:
            return (*cheapest(known.estimate, costs, done, study, target, limits, fewest), known)
        except CaseError:
            if not known.pilots.stored:
                raise
            return self.choose(replace(self.begin_with_pilots(), sizes=known.sizes))

    def advance(self, known: _Known, setting: Setting) -> tuple[_Known, "xr.Dataset"]:
        """Solve the cells of a setting, and estimate the error that they leave."""
        more = setting.study > known.estimate.setting.study
        pilots = self.pilots(setting.study) if more else known.pilots
        response = self.solve(setting)
        estimate = self.estimate(setting, response, pilots)
        more_time = self.time_of_control(setting) / setting.realisations
        costs = known.costs.seen(setting, _time(response) + more_time)
        return replace(known, estimate=estimate, pilots=pilots, costs=costs), response

    def time_of_control(self, setting: Setting) -> float:
        """Time of the flat cells beside those of a setting, s."""
        file = self.folder(setting) / f"{CONTROL_RESPONSE.name}.nc"
        return (
            float(open_dataset(file, CONTROL_RESPONSE)["wall_time"].sum()) if file.exists() else 0.0
        )

    def law(
        self, setting: Setting, response: "xr.Dataset", pilots: Pilots, *, pilot: bool = False
    ) -> tuple[Case, "xr.Dataset"]:
        """Fit the law of a response, with its budget; with flat cells as control of dearer ones.

        It has no bootstrap samples: their bands would hold the scatter of few cells, and neither
        that of the pilot runs nor the errors by size and grid, which the budget has.
        """
        chosen = resize(self.case, setting)
        sizes, grids = pilots.beside(chosen)
        response = without_size_bias(response, sizes)
        control = self.control(setting, pilot=pilot)
        law = fit_law(response, control=control, n_terms=chosen.law.terms, n_samples=0)
        scales = joint_scales(chosen)
        budget = error_budget(
            response,
            law,
            resolutions=grids,
            sizes=sizes,
            scales=scales,
            apart=True,
            control=control,
        )
        told = [how_attribute(one) for one in ("sampling", "cell size", "micro discretisation")]
        sources = {one: f"{budget.attrs[one]} ({pilots.source})" for one in told}
        return chosen, with_budget(law, budget.assign_attrs(sources))

    def estimate(
        self, setting: Setting, response: "xr.Dataset", pilots: Pilots, *, pilot: bool = False
    ) -> Estimate:
        """Say how wrong the answer of a response is."""
        assert self.case.accuracy is not None
        chosen, carrier = self.law(setting, response, pilots, pilot=pilot)
        quantity = self.case.accuracy.quantity
        if quantity == "joint_stiffness":
            carrier = solve_joint(chosen, carrier)
        one = carrier.sel(quantity=quantity)
        half = one["error_half_width"].to_numpy()
        estimate = Estimate(setting, half, one["error_bias"].to_numpy())
        if not np.isfinite(estimate.total):
            missing = [
                term
                for term, known in zip(ERROR_TERMS, np.isfinite(half), strict=True)
                if not known.all() and (known.any() or term in ALWAYS)
            ]
            raise CaseError(
                f"{self.case.title}: the error of {quantity} cannot be estimated: "
                f"{', '.join(missing)} is not known at all pressures; change the keys that the "
                f"cautions name, or leave out [accuracy]"
            )
        return estimate

    def finish(
        self, known: _Known, response: "xr.Dataset", lines: tuple[str, ...], forecast: float
    ) -> Plan:
        """Fit the law that is the answer, and solve the joint with it, if there is one."""
        assert self.case.accuracy is not None
        accuracy, setting, total = self.case.accuracy, known.estimate.setting, known.estimate.total
        spent = self.spent()
        chosen, law = self.law(setting, response, known.pilots)
        result = None if chosen.interface_width is None else solve_joint(chosen, law)
        last = (
            f"the estimated error of {accuracy.quantity} is {100.0 * total:.3g} %, below the "
            f"target of {100.0 * accuracy.target:.3g} %; {spent:.3g} s of solver time were spent, "
            f"{forecast:.3g} s forecast at the start"
        )
        folder = self.folder(setting)
        return Plan(chosen, response, law, result, folder, total, spent, forecast, (*lines, last))

    def done(self) -> dict[tuple[float, float], int]:
        """Count the cells of each setting that are there, pilot runs apart."""
        keys = [(size, grid) for size in SIZES for grid in GRIDS]
        return {
            key: len(list((self.folder(Setting(*key, 1)) / "micro").glob("realisation-*.nc")))
            for key in keys
        }

    def spent(self) -> float:
        """Time of all cells that are there, s."""
        schemas = MICRO_RESPONSE, CONTROL_RESPONSE
        return sum(
            float(open_dataset(file, schema)["wall_time"].sum())
            for schema in schemas
            for file in self.out.glob(f"*/{schema.name}.nc")
        )


def _time(response: "xr.Dataset") -> float:
    """Median time of a cell, s: the first one may have compiled kernels."""
    return float(np.median(response["wall_time"].sum("step")))
