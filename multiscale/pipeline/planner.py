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
from multiscale.upscaling import at_rms_height, error_budget, fit_law, with_budget, without_bias
from multiscale.upscaling.budget import ALWAYS, ERROR_TERMS, Term
from multiscale.upscaling.cell_size import size_term
from multiscale.upscaling.law_budget import grid_term
from multiscale.upscaling.response_observations import normal_observations

logger = logging.getLogger(__name__)

FEWEST_WAVELENGTHS = (
    2.0  # across the smallest cells: with fewer the error has no power law in the size
)
FIRST_CELLS, FIRST_CONTROL = (6, 4), 48
"""Numbers of cells of the first two sizes, and of flat control cells of dearer cells."""

PAIRS = {-1: 6, 0: 6, 1: 4, 2: 4}
"""Cells of the smallest size that are solved on other grids, too."""

MOST_ROUNDS = 8

FEWEST_POINTS = 8
"""Points of a cell along an edge."""

MANY_WAVELENGTHS = 32  # across a surface at large
MOST_POINTS = 2048  # across it

SIZE_SEED = 1_000_003
"""Distance of the seeds of different sizes."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Choice, datasets and solver time of a planner.

    Attributes
    ----------
    case : Case, with the cells, grid and realisations chosen
    micro_response, interface_law : Dataset, as the datasets of a run, with their error budgets
    macro_result : Dataset or None
        Answer of the blocks, with its error budget, if the case has blocks.
    folder : Path, of the cells
    total : float, estimated error, relative
    spent, forecast : float, time of all cells, s, and the time expected after the first cells
    lines : tuple of str, choice and error of each round, a sentence each
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
        """Response, law and answer; law and answer have plan and time as attributes."""
        record = {
            "plan": "\n".join(self.lines),
            "time_spent": self.spent,
            "time_forecast": self.forecast,
        }
        result = None if self.macro_result is None else self.macro_result.assign_attrs(record)
        return self.micro_response, self.interface_law.assign_attrs(record), result


def plan(
    case: Case, out: Path, *, executor: Executor | None = None, progress: ShowProgress = unseen
) -> Plan:
    r"""Compute until the estimated error of a case is below its target, in the least time.

    Parameters
    ----------
    case : Case
        With ``accuracy``; its cells, grid and realisations are where the planner starts from.
    out : Path, cells go to the folder ``plan`` in it; stored cells are not computed again
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
    Flat cells are on a coarse grid, and dearer cells on the grid of the case. Their biases are
    estimated by differences between cells on the same surfaces, which scatter little, and
    subtracted: few cells of the smallest size are solved on finer grids, and few dear cells of the
    first two sizes are paired with many flat cells of any size; see
    :class:`~multiscale.upscaling.sampling.Control`. Cells of several sizes give the bias by the
    size. Gaps are scaled to the rms height of the surface at large.

    The remaining errors and the times of the cells forecast error and time of every setting; see
    :class:`~.forecast.Estimate`. The cells of the cheapest setting with a total below the target
    are solved, and the budget is estimated again, until the estimate is below the target. Size and
    grid change by a factor of two per round, as each level shows how the errors fall to the next.
    """
    _check(case)
    campaign = _Campaign(case, out / "plan", executor, progress, surface_at_large(case))
    state, forecast = campaign.explore(), np.nan
    target, lines = case.accuracy.target, list[str]()
    for _ in range(MOST_ROUNDS):
        if state.estimate.total <= target:
            return campaign.finish(state, tuple(lines), forecast)
        setting = campaign.choose(state)
        time = state.time_of(setting)
        spent, expected = campaign.spent(), state.estimate.at(setting).total
        logger.info("%s: about %.3g s and %.3g %%", setting, time, 100.0 * expected)
        forecast = forecast if lines else spent + time
        try:
            state = campaign.advance(state, setting)
        except CaseError as error:  # a measured map holds no more or no larger windows
            if setting.size <= 0:
                raise
            logger.info("size %d: %s", setting.size, error)
            state = replace(state, sizes=range(state.sizes.start, int(setting.size)))
            continue
        lines.append(
            f"round {len(lines) + 1}: {setting}; forecast {time:.3g} s and "
            f"{100.0 * expected:.3g} %, spent {campaign.spent() - spent:.3g} s, "
            f"estimated error {100.0 * state.estimate.total:.3g} %"
        )
        logger.info(lines[-1])
    if state.estimate.total <= target:
        return campaign.finish(state, tuple(lines), forecast)
    raise ConvergenceError(
        f"the estimated error is {100.0 * state.estimate.total:.3g} % after {MOST_ROUNDS} rounds, "
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
    """Return the composite surface of a case on a patch of many wavelengths; None for a map."""
    surfaces = [body.surface for body in case.bodies if body.surface is not None]
    synthetic = [surface for surface in surfaces if isinstance(surface, SyntheticSurface)]
    if len(synthetic) < len(surfaces):
        return None
    wavelength = max(surface.longest_wave for surface in synthetic)
    wanted = MANY_WAVELENGTHS * wavelength / max(case.cell.size)
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
    first = [resize(case, setting, grid=_grid(case)) for setting in settings]
    if case.beside_flat:
        first += [resize(case, setting).control(FIRST_CONTROL) for setting in settings]
    return [*first, resize(case, settings[0], grid=COARSE - _grid(case))]


def _grid(case: Case) -> int:
    """Return the grid of the answer: errors of dear cells on coarse ones differ between sizes."""
    return COARSE if case.cell.geometry == "flat" else 0


def _smallest(case: Case) -> int:
    """Return the first size: half of the cell of the case, or the cell with few wavelengths."""
    n_wavelengths = 0.5 * max(case.cell.size) / longest_wave(case)
    return SIZES[0] if case.from_maps or n_wavelengths >= FEWEST_WAVELENGTHS else 0


def _check(case: Case) -> None:
    """Refuse cases with surfaces that differ between grids, or with too coarse grids."""
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
            f"cannot resolve wavelengths of {shortest:.3g} m; give more than "
            f"{4.0 * max(case.cell.size) / shortest:.0f} points in [cell]"
        )


@dataclass(frozen=True, eq=False)
class _Ensemble:
    """Cells of one size, and flat control cells, the first of which have the same surfaces."""

    setting: Setting
    response: Dataset
    control: Dataset | None = None
    time: float = np.nan  # of a flat cell of this size, s

    @property
    def cheap(self) -> float:
        """Share of the flat cells in the variance of the mean gap, median over the steps."""
        parts = normal_observations(self.response, self.control).ensembles
        each = [np.nanvar(sample, axis=0) / freedom for sample, freedom in parts]
        return float(np.median(each[-1] / sum(each))) if len(parts) == 2 else 0.0


@dataclass(frozen=True, eq=False)
class _State:
    """State of a planner after a round; the first cells of the smallest size are on all grids."""

    estimate: Estimate
    ensembles: Mapping[float, _Ensemble]
    grids: Mapping[int, Dataset]
    costs: CostModel
    grid: int  # of the answer
    flat_costs: CostModel | None = None
    sizes: range = SIZES  # that can be had

    def time_of(self, setting: Setting) -> float:
        """Time of the cells of a setting that are not solved yet, s."""
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
            PAIRS[grid] * self.costs.of_cell(min(self.ensembles), grid) for grid in finer
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

        Solved cells are not solved again.
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

    def dear_cells(self, setting: Setting) -> Setting:
        """Return the setting of the dear cells: with flat control cells they do not grow."""
        return replace(setting, size=min(setting.size, _smallest(self.case) + 1.0))

    def ensemble(self, setting: Setting) -> _Ensemble:
        """Solve the cells of a setting, with its flat control cells."""
        import xarray as xr

        if not setting.control:
            return _Ensemble(setting, self.solve(setting, _grid(self.case)))
        dear = self.dear_cells(setting)
        response, control = self.solve(dear, _grid(self.case)), self.press(setting)
        time = _time(control)
        if dear.size < setting.size:
            n = setting.realisations
            pairs = self.press(replace(dear, control=max(n, FIRST_CONTROL)))
            numbers = n + np.arange(control.sizes["realisation"])
            both = pairs.isel(realisation=slice(n)), control.assign_coords(realisation=numbers)
            control = xr.concat(both, "realisation", combine_attrs="override")
            control = control.assign_attrs(pairs_apart=1)
        return _Ensemble(setting, response, control, time)

    def at_large(self, response: Dataset) -> Dataset:
        """Return a response at the height of the surface at large."""
        return response if self.large is None else at_rms_height(response, rms_height(self.large))

    def explore(self) -> _State:
        """Start from small cells of two sizes, some of the smaller ones on two grids."""
        dear, grid = self.case.beside_flat, _grid(self.case)
        control, first = FIRST_CONTROL if dear else 0, float(_smallest(self.case))
        ensembles = {
            first + k: self.ensemble(Setting(first + k, 0, n, control))
            for k, n in enumerate(FIRST_CELLS)
        }
        small, last = ensembles.values()
        other = COARSE - grid
        grids = dict(sorted({grid: small.response, other: self.on_grid(other)}.items()))
        times: dict[tuple[float, float], float] = {
            (size, grid): _time(ensemble.response) for size, ensemble in ensembles.items()
        }
        times[first, other] = _time(grids[other])
        costs = CostModel.fit(times, layered=self.case.cell.geometry != "flat")
        flat: dict[tuple[float, float], float] = {
            (size, COARSE): ensemble.time for size, ensemble in ensembles.items()
        }
        flat_costs = CostModel.fit(flat, layered=False) if dear else None
        state = _State(NOTHING, ensembles, grids, costs, grid, flat_costs)
        return self.estimated(state, last)

    def on_grid(self, grid: int) -> Dataset:
        """Response of first cells of the smallest size on another grid."""
        return self.solve(Setting(_smallest(self.case), 0, PAIRS[grid]), grid)

    def choose(self, state: _State) -> Setting:
        """Choose the cheapest setting, with at most a step of size and grid per round."""
        target, now = self.case.accuracy.target, state.estimate.setting
        setting = cheapest(state.estimate, self.settings(state), state.time_of, target)
        size, grid = min(setting.size, now.size + 1), min(setting.grid, now.grid + 1)
        return replace(setting, size=size, grid=grid)

    def settings(self, state: _State) -> list[Setting]:
        """Return the settings that can be solved."""
        now = state.estimate.setting
        sizes = [float(size) for size in state.sizes if size >= now.size]
        grids = [grid for grid in GRIDS if grid >= now.grid]
        numbers = [number for number in REALISATIONS if number >= now.realisations]
        controls = CONTROLS if state.estimate.cheap > 0.0 else (0,)
        candidates = [Setting(*choice) for choice in product(sizes, grids, numbers, controls)]
        return [
            setting
            for setting in candidates
            if setting.control > setting.realisations or not setting.control
        ]

    def advance(self, state: _State, setting: Setting) -> _State:
        """Solve the cells of a setting, and estimate their error."""
        ensemble = self.ensemble(setting)
        grids, costs, flat = dict(state.grids), state.costs, state.flat_costs
        grids |= {
            finer: self.on_grid(finer) for finer in PAIRS if max(grids) < finer <= setting.grid
        }
        if flat is None or ensemble.control is None:
            costs = costs.seen(setting.size, state.grid, _time(ensemble.response))
        else:
            flat = flat.seen(setting.size, COARSE, ensemble.time)
        ensembles = {**state.ensembles, setting.size: ensemble}
        state = replace(state, ensembles=ensembles, grids=grids, costs=costs, flat_costs=flat)
        return self.estimated(state, ensemble)

    def terms(self, state: _State, ensemble: _Ensemble) -> tuple[Term, Term]:
        """Return the error terms of cells by their size and by their grid, with the biases."""
        response, setting = ensemble.response, ensemble.setting
        by_ratio = {
            2.0 ** (size - setting.size): ensemble for size, ensemble in state.ensembles.items()
        }
        others = {ratio: ensemble.response for ratio, ensemble in by_ratio.items() if ratio != 1.0}
        controls = {ratio: ensemble.control for ratio, ensemble in by_ratio.items()}
        grids = {2.0 ** (state.grid - grid): response for grid, response in state.grids.items()}
        return (
            size_term(response, others, controls=controls),
            grid_term(response, grids, apart=True),
        )

    def law(self, state: _State, ensemble: _Ensemble) -> tuple[Case, Dataset]:
        """Fit the law of cells less their biases, with its budget.

        It has no bootstrap samples: their bands would hold the scatter of few cells, and not the
        errors by size and grid, which the budget has.
        """
        chosen = resize(self.case, ensemble.setting)
        pressure = normal_observations(ensemble.response).pressure
        size, grid = (term.smooth(pressure) for term in self.terms(state, ensemble))
        terms = {"cell size": size, "micro discretisation": grid}
        response = without_bias(ensemble.response, *terms.values())
        law = fit_law(response, control=ensemble.control, n_terms=chosen.law.terms, n_samples=0)
        budget = error_budget(
            response,
            law,
            scales=joint_scales(chosen),
            apart=True,
            control=ensemble.control,
            known={name: term.taken_out("cells of the planner") for name, term in terms.items()},
        )
        return chosen, with_budget(law, budget)

    def estimated(self, state: _State, ensemble: _Ensemble) -> _State:
        """Return the state with the estimated error of the answer of cells."""
        chosen, carrier = self.law(state, ensemble)
        quantity = self.case.accuracy.quantity
        if quantity == "joint_stiffness":
            carrier = solve_joint(chosen, carrier)
        errors = carrier.sel(quantity=quantity)
        half, bias = errors["error_half_width"].to_numpy(), errors["error_bias"].to_numpy()
        setting = replace(ensemble.setting, grid=max(state.grids))
        estimate = Estimate(setting, half, bias, ensemble.cheap)
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
        return replace(state, estimate=estimate)

    def finish(self, state: _State, lines: tuple[str, ...], forecast: float) -> Plan:
        """Fit the final law, and solve the joint with it, if the case has a joint."""
        accuracy, total = self.case.accuracy, state.estimate.total
        ensemble, spent = state.ensembles[state.estimate.setting.size], self.spent()
        chosen, law = self.law(state, ensemble)
        result = None if chosen.interface_width is None else solve_joint(chosen, law)
        expected = f", {forecast:.3g} s forecast at the start" if lines else ""
        last = (
            f"the estimated error of {accuracy.quantity} is {100.0 * total:.3g} %, below the "
            f"target of {100.0 * accuracy.target:.3g} %; {spent:.3g} s of solver time were spent"
            f"{expected}"
        )
        dear = (
            self.dear_cells(ensemble.setting) if ensemble.control is not None else ensemble.setting
        )
        folder = self.folder(dear.size, state.grid)
        solved = resize(self.case, dear, grid=state.grid)
        lines = (*lines, last)
        return Plan(solved, ensemble.response, law, result, folder, total, spent, forecast, lines)

    def spent(self) -> float:
        """Time of all solved cells, s."""
        schemas = MICRO_RESPONSE, CONTROL_RESPONSE
        return sum(
            float(open_dataset(file, schema)["wall_time"].sum())
            for schema in schemas
            for file in self.out.glob(f"*/{schema.name}.nc")
        )


def _time(response: Dataset) -> float:
    """Median time of a cell, s: the first cell may have compiled kernels."""
    return float(np.median(response["wall_time"].sum("step")))


NOTHING = Estimate(Setting(np.nan, 0, 1), np.empty(0), np.empty(0))
