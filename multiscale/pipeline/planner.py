"""From a target for the error to cells, grid and realisations: cells, forecast, more cells."""

import logging
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from multiscale.errors import CaseError, ConvergenceError
from multiscale.io import make_folder, open_dataset, write_dataset
from multiscale.micro.layer import graded_planes
from multiscale.pipeline.case_cells import joint_scales, longest_wave, make_surfaces
from multiscale.pipeline.forecast import (
    COARSE,
    CONTROLS,
    GRIDS,
    REALISATIONS,
    SIZES,
    CostModel,
    Estimate,
    Setting,
    cheapest,
)
from multiscale.pipeline.stage import Job, ShowProgress, unseen
from multiscale.pipeline.stages.cells import run_micro
from multiscale.pipeline.stages.ensembles import press_control
from multiscale.pipeline.stages.joint import solve_joint
from multiscale.pipeline.tables.rough_bodies import InstrumentSurface, SyntheticSurface
from multiscale.pipeline.tables.settings import Case
from multiscale.schema import CONTROL_RESPONSE, MICRO_RESPONSE, Dataset
from multiscale.surfaces import Surface, rms_height
from multiscale.upscaling import (
    at_rms_height,
    error_budget,
    fit_law,
    normal_observations,
    with_budget,
    without_bias,
)
from multiscale.upscaling.budget import ALWAYS, ERROR_TERMS, Term
from multiscale.upscaling.cell_size import size_term
from multiscale.upscaling.law_budget import grid_term

__all__ = ["Plan", "pilot_cases", "plan", "resize", "surface_at_large"]

logger = logging.getLogger(__name__)

FEWEST_WAVES = 2.0  # across the smallest cells: those with fewer tell no power of the size
FIRST_CELLS, FIRST_CONTROL = (6, 4), 48
"""Cells of the first two sizes, and flat ones beside dearer ones."""

PAIRS = {-1: 6, 0: 6, 1: 4, 2: 4}
"""Cells of the smallest size that are solved on other grids, too."""

MOST_ROUNDS = 8

FEWEST_POINTS = 8
"""Of a cell, each way."""

MANY_WAVES = 32  # across a surface at large
MOST_POINTS = 2048  # across it

SIZE_SEED = 1_000_003
"""Between the first realisations of different sizes."""


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
    spent, forecast : float, time of all cells, s, and what was expected after the first ones
    lines : tuple of str, what was decided and found, a sentence for each round
    """

    case: Case
    micro_response: Dataset
    interface_law: Dataset
    macro_result: Dataset | None
    folder: Path
    total: float
    spent: float
    forecast: float
    lines: tuple[str, ...]

    @property
    def datasets(self) -> tuple[Dataset, Dataset, Dataset | None]:
        """Response, law and answer; law and answer say what was decided and spent."""
        told = {
            "plan": "\n".join(self.lines),
            "time_spent": self.spent,
            "time_forecast": self.forecast,
        }
        result = None if self.macro_result is None else self.macro_result.assign_attrs(told)
        return self.micro_response, self.interface_law.assign_attrs(told), result


def plan(
    case: Case, out: Path, *, executor: Executor | None = None, progress: ShowProgress = unseen
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
    Flat cells are on a coarse grid, and dearer ones on the grid of the case. What they lack is
    told by differences of small scatter between cells on the same surfaces, and taken out: few
    cells of the smallest size lead to finer grids, and few dear cells of the first two sizes to
    many flat ones of any size; see :class:`~multiscale.upscaling.sampling.Control`. Cells of
    several sizes tell the bias by the size. Gaps are those at the height of the surface at large.

    From the errors that are left, and from the times of cells, follows the setting of least time
    whose total is expected to be below the target; see :class:`~.forecast.Estimate`. Its cells are
    solved and its budget is estimated anew, which is the next forecast's base, until the estimate
    is below the target. Sizes and grids change by a factor of two at a time, as each tells how the
    errors fall to the next one.
    """
    _check(case)
    campaign = _Campaign(case, out / "plan", executor, progress, surface_at_large(case))
    known, forecast = campaign.explore(), np.nan
    target, lines = case.accuracy.target, list[str]()
    for _ in range(MOST_ROUNDS):
        if known.estimate.total <= target:
            return campaign.finish(known, tuple(lines), forecast)
        setting = campaign.choose(known)
        time = known.time_of(setting)
        spent, expected = campaign.spent(), known.estimate.at(setting).total
        logger.info("%s: about %.3g s and %.3g %%", setting, time, 100.0 * expected)
        forecast = forecast if lines else spent + time
        try:
            known = campaign.advance(known, setting)
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
    if known.estimate.total <= target:
        return campaign.finish(known, tuple(lines), forecast)
    raise ConvergenceError(
        f"the estimated error is {100.0 * known.estimate.total:.3g} % after {MOST_ROUNDS} rounds, "
        f"above the target of {100.0 * target:.3g} %; run again to go on, or ask for "
        f"a larger target"
    )


def resize(case: Case, setting: Setting, *, grid: int = COARSE) -> Case:
    """Return a case with the cells and the realisations of a setting, on a grid.

    Surfaces of different sizes are independent. Layers of larger cells are thicker by the same
    factor from one to the next.
    """
    larger, finer = 2.0**setting.size, 2.0 ** (setting.size + grid)
    most, layers = float(max(case.cell.points)), case.cell.layers
    thickness = np.diff(graded_planes(most, layers, 1.0))  # over the spacing, from base to top
    ratio = max(float(thickness[0] / thickness[-1]), 1.0 + 1e-6)
    growth = ratio ** (2.0**-grid / (layers - 1))
    graded = np.log1p((growth - 1.0) * finer * most) / np.log(growth)
    cell = case.cell.model_copy(
        update={
            "size": tuple(larger * edge for edge in case.cell.size),
            "points": tuple(2 * max(2, round(0.5 * finer * n)) for n in case.cell.points),
            "layers": max(4, round(graded)),
        }
    )
    seed = case.micro.seed + int(SIZE_SEED * (setting.size % len(SIZES)))
    micro = case.micro.model_copy(update={"realisations": setting.realisations, "seed": seed})
    return case.model_copy(update={"cell": cell, "micro": micro})


def surface_at_large(case: Case) -> Surface | None:
    """Return the composite surface of a case on a patch of many waves; none of a measured map."""
    surfaces = [body.surface for body in case.bodies if body.surface is not None]
    synthetic = [one for one in surfaces if isinstance(one, SyntheticSurface)]
    if len(synthetic) < len(surfaces):
        return None
    wave = max(one.longest_wave for one in synthetic)
    wanted = MANY_WAVES * wave / max(case.cell.size)
    room = MOST_POINTS / max(case.cell.points)
    larger = 2 ** max(0, int(np.ceil(np.log2(min(wanted, room)))))
    cell = case.cell.model_copy(
        update={
            "size": tuple(larger * edge for edge in case.cell.size),
            "points": tuple(larger * n for n in case.cell.points),
        }
    )
    micro = case.micro.model_copy(update={"realisations": 1})
    (large,) = make_surfaces(case.model_copy(update={"cell": cell, "micro": micro}))
    return large


def pilot_cases(case: Case) -> list[Case]:
    """Return the cases that a planner begins with."""
    smallest = _smallest(case)
    settings = [Setting(smallest + k, 0, n) for k, n in enumerate(FIRST_CELLS)]
    first = [resize(case, one, grid=_grid(case)) for one in settings]
    if case.beside_flat:
        first += [resize(case, one).control(FIRST_CONTROL) for one in settings]
    return [*first, resize(case, settings[0], grid=COARSE - _grid(case))]


def _grid(case: Case) -> int:
    """Return the grid of the answer: errors of dear cells on coarse ones differ between sizes."""
    return COARSE if case.cell.geometry == "flat" else 0


def _smallest(case: Case) -> int:
    """Return the first size: half of the cell of the case, or the cell if it has few waves."""
    waves = 0.5 * max(case.cell.size) / longest_wave(case)
    return SIZES[0] if case.measured or waves >= FEWEST_WAVES else 0


def _check(case: Case) -> None:
    """Refuse cases whose surface would differ between grids, or whose grids are too coarse."""
    for number, body in enumerate(case.bodies, start=1):
        if isinstance(body.surface, InstrumentSurface) and body.surface.short_cutoff is None:
            raise CaseError(
                f"[accuracy] compares grids, on which the surface has to be the same: give "
                f"short_cutoff in [body_{number}.surface]"
            )
    fewest = min(resize(case, Setting(-1, 0, 1)).cell.points)
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
class _Ensemble:
    """Cells of one size, and flat ones, of which the first are beside them."""

    setting: Setting
    response: Dataset
    control: Dataset | None = None
    time: float = np.nan  # of a flat cell of this size, s

    @property
    def cheap(self) -> float:
        """Share of the flat cells in the variance of the mean gap, median over the steps."""
        parts = normal_observations(self.response, self.control).parts
        each = [np.nanvar(one.masked, axis=0) / freedom for one, freedom in parts]
        return float(np.median(each[-1] / sum(each))) if len(parts) == 2 else 0.0


@dataclass(frozen=True, eq=False)
class _Known:
    """What a planner knows after a round: first cells of the smallest size are on all grids."""

    estimate: Estimate
    ensembles: Mapping[float, _Ensemble]
    grids: Mapping[int, Dataset]
    costs: CostModel
    grid: int  # of the answer
    flat_costs: CostModel | None = None
    sizes: range = SIZES  # that can be had

    def time_of(self, setting: Setting) -> float:
        """Time of what a setting has and is not there, s."""
        there = self.ensembles.get(setting.size)
        have = Setting(setting.size, 0, 0) if there is None else there.setting
        cells, flat = setting.realisations - have.realisations, setting.control - have.control
        if not setting.control or self.flat_costs is None:
            time = max(0, cells) * self.costs.of_cell(setting.size, self.grid)
        else:
            time = max(0, flat) * self.flat_costs.of_cell(setting.size, COARSE)
            pairs = self.ensembles[min(setting.size, min(self.ensembles) + 1)].setting
            more = max(0, setting.realisations - pairs.realisations)
            time += more * self.costs.of_cell(pairs.size, self.grid)
        finer = [grid for grid in PAIRS if max(self.grids, default=2) < grid <= setting.grid]
        return time + sum(
            PAIRS[one] * self.costs.of_cell(min(self.ensembles), one) for one in finer
        )


@dataclass(frozen=True, eq=False)
class _Campaign:
    """The ensembles of a case that a planner works with."""

    case: Case
    out: Path
    executor: Executor | None
    progress: ShowProgress
    large: Surface | None  # the surface at large

    def folder(self, size: float, grid: int) -> Path:
        """Return where the cells of a size are."""
        return self.out / f"size{size:+g}-grid{grid:+g}"

    def solve(self, setting: Setting, grid: int) -> Dataset:
        """Response of the cells of a setting, at the height of the surface at large.

        Cells that are there are kept.
        """
        cells = f"cells of size {setting.size:+g}, grid {grid:+g}"
        response = run_micro(
            resize(self.case, setting, grid=grid),
            self.folder(setting.size, grid) / "micro_response.nc",
            executor=self.executor,
            progress=lambda finished, total, _: self.progress(finished, total, cells),
            fields=False,
        )
        return self.at_large(response)

    def press(self, setting: Setting) -> Dataset:
        """Response of the flat cells of a setting, which are on the coarse grid."""
        folder = self.folder(setting.size, COARSE)
        job = Job(make_folder(folder), self.executor, self.progress)
        control = press_control(resize(self.case, setting), setting.control, job)
        write_dataset(control, folder / f"{CONTROL_RESPONSE.name}.nc", CONTROL_RESPONSE)
        return self.at_large(control)

    def own(self, setting: Setting) -> Setting:
        """Return the setting of the dear cells: with flat ones beside, they do not grow."""
        return replace(setting, size=min(setting.size, _smallest(self.case) + 1.0))

    def ensemble(self, setting: Setting) -> _Ensemble:
        """Solve the cells of a setting, with the flat ones that it has."""
        import xarray as xr

        if not setting.control:
            return _Ensemble(setting, self.solve(setting, _grid(self.case)))
        own = self.own(setting)
        response, control = self.solve(own, _grid(self.case)), self.press(setting)
        time = _time(control)
        if own.size < setting.size:
            n = setting.realisations
            pairs = self.press(replace(own, control=max(n, FIRST_CONTROL)))
            numbers = n + np.arange(control.sizes["realisation"])
            both = pairs.isel(realisation=slice(n)), control.assign_coords(realisation=numbers)
            control = xr.concat(both, "realisation", combine_attrs="override")
            control = control.assign_attrs(pairs_apart=1)
        return _Ensemble(setting, response, control, time)

    def at_large(self, response: Dataset) -> Dataset:
        """Return a response at the height of the surface at large."""
        return response if self.large is None else at_rms_height(response, rms_height(self.large))

    def explore(self) -> _Known:
        """Start from small cells of two sizes, some of the smaller ones on two grids."""
        dear, grid = self.case.beside_flat, _grid(self.case)
        control, first = FIRST_CONTROL if dear else 0, float(_smallest(self.case))
        found = {
            first + k: self.ensemble(Setting(first + k, 0, n, control))
            for k, n in enumerate(FIRST_CELLS)
        }
        small, last = found.values()
        other = COARSE - grid
        grids = dict(sorted({grid: small.response, other: self.on_grid(other)}.items()))
        times: dict[tuple[float, float], float] = {
            (size, grid): _time(one.response) for size, one in found.items()
        }
        times[first, other] = _time(grids[other])
        costs = CostModel.fit(times, layered=self.case.cell.geometry != "flat")
        flat: dict[tuple[float, float], float] = {
            (size, COARSE): one.time for size, one in found.items()
        }
        flat_costs = CostModel.fit(flat, layered=False) if dear else None
        known = _Known(NOTHING, found, grids, costs, grid, flat_costs)
        return self.estimated(known, last)

    def on_grid(self, grid: int) -> Dataset:
        """Response of first cells of the smallest size on another grid."""
        return self.solve(Setting(_smallest(self.case), 0, PAIRS[grid]), grid)

    def choose(self, known: _Known) -> Setting:
        """Choose the cheapest setting; one step at a time, as each tells how the errors fall."""
        target, now = self.case.accuracy.target, known.estimate.setting
        setting = cheapest(known.estimate, self.settings(known), known.time_of, target)
        size, grid = min(setting.size, now.size + 1), min(setting.grid, now.grid + 1)
        return replace(setting, size=size, grid=grid)

    def settings(self, known: _Known) -> list[Setting]:
        """Return the settings that can be had."""
        now = known.estimate.setting
        sizes = [float(one) for one in known.sizes if one >= now.size]
        grids = [one for one in GRIDS if one >= now.grid]
        numbers = [one for one in REALISATIONS if one >= now.realisations]
        controls = CONTROLS if known.estimate.cheap > 0.0 else (0,)
        found = [Setting(*one) for one in product(sizes, grids, numbers, controls)]
        return [one for one in found if one.control > one.realisations or not one.control]

    def advance(self, known: _Known, setting: Setting) -> _Known:
        """Solve the cells of a setting, and estimate the error that they leave."""
        found = self.ensemble(setting)
        grids, costs, flat = dict(known.grids), known.costs, known.flat_costs
        grids |= {one: self.on_grid(one) for one in PAIRS if max(grids) < one <= setting.grid}
        if flat is None or found.control is None:
            costs = costs.seen(setting.size, known.grid, _time(found.response))
        else:
            flat = flat.seen(setting.size, COARSE, found.time)
        ensembles = {**known.ensembles, setting.size: found}
        known = replace(known, ensembles=ensembles, grids=grids, costs=costs, flat_costs=flat)
        return self.estimated(known, found)

    def terms(self, known: _Known, found: _Ensemble) -> tuple[Term, Term]:
        """Return what cells lack by their size and by their grid, with the biases."""
        response, setting = found.response, found.setting
        beside = {2.0 ** (size - setting.size): one for size, one in known.ensembles.items()}
        others = {ratio: one.response for ratio, one in beside.items() if ratio != 1.0}
        controls = {ratio: one.control for ratio, one in beside.items()}
        grids = {2.0 ** (known.grid - grid): one for grid, one in known.grids.items()}
        return (
            size_term(response, others, controls=controls),
            grid_term(response, grids, apart=True),
        )

    def law(self, known: _Known, found: _Ensemble) -> tuple[Case, Dataset]:
        """Fit the law of cells less their biases, with its budget.

        It has no bootstrap samples: their bands would hold the scatter of few cells, and not the
        errors by size and grid, which the budget has.
        """
        chosen = resize(self.case, found.setting)
        pressure = normal_observations(found.response).pressure
        size, grid = (one.smooth(pressure) for one in self.terms(known, found))
        terms = {"cell size": size, "micro discretisation": grid}
        response = without_bias(found.response, *terms.values())
        law = fit_law(response, control=found.control, n_terms=chosen.law.terms, n_samples=0)
        budget = error_budget(
            response,
            law,
            scales=joint_scales(chosen),
            apart=True,
            control=found.control,
            known={name: term.taken_out("cells of the planner") for name, term in terms.items()},
        )
        return chosen, with_budget(law, budget)

    def estimated(self, known: _Known, found: _Ensemble) -> _Known:
        """Say how wrong the answer of cells is."""
        chosen, carrier = self.law(known, found)
        quantity = self.case.accuracy.quantity
        if quantity == "joint_stiffness":
            carrier = solve_joint(chosen, carrier)
        one = carrier.sel(quantity=quantity)
        half, bias = one["error_half_width"].to_numpy(), one["error_bias"].to_numpy()
        setting = replace(found.setting, grid=max(known.grids))
        estimate = Estimate(setting, half, bias, found.cheap)
        if not np.isfinite(estimate.total):
            missing = [
                term
                for term, known_steps in zip(ERROR_TERMS, np.isfinite(half), strict=True)
                if not known_steps.all() and (known_steps.any() or term in ALWAYS)
            ]
            raise CaseError(
                f"{self.case.title}: the error of {quantity} cannot be estimated: "
                f"{', '.join(missing)} is not known at all pressures; change the keys that the "
                f"cautions name, or leave out [accuracy]"
            )
        return replace(known, estimate=estimate)

    def finish(self, known: _Known, lines: tuple[str, ...], forecast: float) -> Plan:
        """Fit the law that is the answer, and solve the joint with it, if there is one."""
        accuracy, total = self.case.accuracy, known.estimate.total
        found, spent = known.ensembles[known.estimate.setting.size], self.spent()
        chosen, law = self.law(known, found)
        result = None if chosen.interface_width is None else solve_joint(chosen, law)
        expected = f", {forecast:.3g} s forecast at the start" if lines else ""
        last = (
            f"the estimated error of {accuracy.quantity} is {100.0 * total:.3g} %, below the "
            f"target of {100.0 * accuracy.target:.3g} %; {spent:.3g} s of solver time were spent"
            f"{expected}"
        )
        own = self.own(found.setting) if found.control is not None else found.setting
        folder, solved = self.folder(own.size, known.grid), resize(self.case, own, grid=known.grid)
        lines = (*lines, last)
        return Plan(solved, found.response, law, result, folder, total, spent, forecast, lines)

    def spent(self) -> float:
        """Time of all cells that are there, s."""
        schemas = MICRO_RESPONSE, CONTROL_RESPONSE
        return sum(
            float(open_dataset(file, schema)["wall_time"].sum())
            for schema in schemas
            for file in self.out.glob(f"*/{schema.name}.nc")
        )


def _time(response: Dataset) -> float:
    """Median time of a cell, s: the first one may have compiled kernels."""
    return float(np.median(response["wall_time"].sum("step")))


NOTHING = Estimate(Setting(np.nan, 0, 1), np.empty(0), np.empty(0))
