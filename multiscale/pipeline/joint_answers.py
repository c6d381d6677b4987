"""Answers of joints that have an error budget: their steps and places in a result."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from multiscale.macro import substructures
from multiscale.schema import MACRO_RESULT, Dataset
from multiscale.upscaling import interval_errors, limits, over_steps, with_budget, with_intervals

Reader = Callable[["Dataset"], np.ndarray]
"""Maps a result to the values of an answer."""

STIFFNESSES = ("joint_stiffness", "interface_stiffness", "solid_stiffness")
"""Stiffnesses of the joint with its bodies, of the interface and of the bodies, with a budget."""

AT_PRELOADS = (*STIFFNESSES, "tangential_stiffness", "real_pressure")
IN_CYCLES = ("cycle_slip", "cycle_loss", "secant_stiffness")
AT_END = {"cycle_slip": "slipping_load", "cycle_loss": "cycle_energy"}
"""Answers that have an error budget: at the preloads, in the cycles of every preload and amplitude,
and names of the answers of the last cycle at the end of the path."""


@dataclass(frozen=True, eq=False)
class CycleAnswers:
    """Answers of closed cycles that have an error budget."""

    read: Mapping[str, Reader]  # by the name of an answer, its values in every cycle
    slip: str  # name of the share of the load that slips
    loss: str  # name of the dissipated energy
    steps: np.ndarray  # (cycles,), steps of the result with the pressure of each cycle
    slope: np.ndarray  # (cycles,), logarithmic, of the slipping share over the amplitude
    density: np.ndarray  # (cycles, points), dissipated energy, J/m²
    finer: float  # load steps of a cycle over the steps of paths that are solved again


@dataclass(frozen=True, eq=False)
class JointAnswers:
    """Answers of joints that have an error budget, and their steps."""

    read: Mapping[str, Reader]  # by the name of an answer at rest, its values over the steps
    real: Mapping[str, tuple[int, ...]]  # joints of which an answer is the real pressure
    rests: np.ndarray  # steps of these answers
    place: Callable[[Dataset, Dataset], Dataset]  # adds a budget of rests, then cycles, to a result
    cycles: CycleAnswers | None = None


def joint_answers(result: Dataset) -> JointAnswers:
    """Return the answers of joints at their preloads, then in the cycles of every amplitude."""
    known = result["known"].to_numpy() == 1
    rests = np.flatnonzero(np.isfinite(result["joint_stiffness"].to_numpy()))
    names = [name for name in AT_PRELOADS if name in result]  # real pressure may be missing
    read = {name: answer_at(name) for name in names}
    joints = tuple(np.unique(result["point_joint"].to_numpy()).astype(int).tolist())
    real = {"real_pressure": joints} if "real_pressure" in result else {}
    level, amplitude = np.zeros((2, 0), dtype=int)
    if "cycle_loss" in result and result["converged"].to_numpy().all():
        level, amplitude = np.nonzero(result["cycle_loss"].to_numpy() > 0.0)  # others do not slip
    cycles = None
    if level.size:
        cycles = CycleAnswers(
            {name: answer_at(name, level, amplitude) for name in IN_CYCLES},
            "cycle_slip",
            "cycle_loss",
            level,  # a preload is the step of its number
            _slip_slope(result)[level, amplitude],
            result["loss_density"].to_numpy()[level, amplitude],
            substructures.FEW_STEPS,
        )
    ended = bool(level.size) and bool(known[-1])
    ended = ended and bool(result["cycle_loss"].to_numpy()[-1, -1] > 0.0)

    def place(result: Dataset, budget: Dataset) -> Dataset:
        """Add the intervals of every cycle, and of the last cycle at the last step."""
        values, errors = {}, interval_errors(budget)
        for row, name in enumerate(map(str, budget["quantity"].values)):
            for kind, error in errors.items() if name in IN_CYCLES else ():
                half = np.full(result[name].shape, np.nan)
                half[level, amplitude] = error[row, -level.size :]
                values[f"{name}_{kind}"] = limits(result[name].to_numpy(), half)
        result, at = MACRO_RESULT.assign(result, values), rests[known[rests]]
        columns = [*range(at.size), *([-1] if ended else [])]
        at = np.append(at, known.size - 1) if ended else at
        names = [name for name in map(str, budget["quantity"].values) if name not in IN_CYCLES[2:]]
        selected = budget.isel(step=columns).sel(quantity=names)
        selected = selected.assign_coords(quantity=[AT_END.get(name, name) for name in names])
        return with_intervals(with_budget(result, over_steps(selected, at, known.size)))

    return JointAnswers(read, real, rests, place, cycles)


def load_answers(result: Dataset, rise: int, few: int) -> JointAnswers:
    """Return the answers of bodies under named loads, then of the last cycle."""
    name, stiffness = "load_stiffness", result["load_stiffness"].to_numpy()
    loads = {f"{name} {load}": (name, k) for k, load in enumerate(map(str, result["load"].values))}
    real = {}
    if "interface_real_pressure" in result:
        known_area = np.isfinite(result["interface_real_pressure"].to_numpy()).any(axis=0)
        real = {
            f"real pressure of interface {k}": ("interface_real_pressure", int(k))
            for k in np.flatnonzero(known_area)
        }
    rests = np.flatnonzero(np.isfinite(stiffness).all(axis=1))
    known, last = result["known"].to_numpy() == 1, np.array([result.sizes["step"] - 1])
    lost = result["cycle_energy"].to_numpy() if "cycle_energy" in result else np.full(1, np.nan)
    cycles = None
    if rise and known[-1] and lost[-1] > 0.0:
        share = result["slipping_load"].to_numpy()[-2:]
        slope = np.full(1, np.nan)
        if rise > 1 and share.min() > 0.0:
            slope[:] = np.log(share[1] / share[0]) / np.log(rise / (rise - 1))
        density = result["dissipation"].to_numpy()[-4 * rise :].sum(axis=0, keepdims=True)
        read = {name: answer_at(name, slice(-1, None)) for name in AT_END.values()}
        cycles = CycleAnswers(
            read, "slipping_load", "cycle_energy", last, slope, density, rise / few
        )

    def place(result: Dataset, budget: Dataset) -> Dataset:
        """Add the budget at its steps."""
        steps = np.append(rests[known[rests]], () if cycles is None else last).astype(int)
        budget = over_steps(budget, steps, known.size)
        return with_intervals(with_budget(result, budget), {**loads, **real})

    read = {
        **{key: answer_at(name, slice(None), k) for key, (name, k) in loads.items()},
        **{key: answer_at("real_pressure") for key in real},
    }
    return JointAnswers(read, {key: (k,) for key, (_, k) in real.items()}, rests, place, cycles)


def answer_at(name: str, *place: slice | int | np.ndarray) -> Reader:
    """Return a reader of an answer at a place, or of all values, that workers can import."""
    return partial(_read, name, place)


def _read(name: str, place: tuple[Any, ...], result: Dataset) -> np.ndarray:
    """Values of an answer; the real pressure stays as it is."""
    if name == "real_pressure":
        return np.ones(result.sizes["step"])
    return np.asarray(result[name].to_numpy()[place])


def _slip_slope(result: Dataset) -> np.ndarray:
    """Logarithmic slope of the slipping share over the amplitude, shape (levels, amplitudes).

    It is from the amplitudes, or from the last steps of the path if there is only one amplitude.
    """
    share, shear = result["cycle_slip"].to_numpy(), result["cycle_shear"].to_numpy()
    with np.errstate(divide="ignore", invalid="ignore"):  # NaN where nothing slips
        if shear.size > 1:
            return np.asarray(np.gradient(np.log(share), np.log(shear), axis=1))
        at = np.log([result[name].to_numpy()[-2:] for name in ("slipping_load", "shear")])
        return np.full(share.shape, np.ptp(at[0]) / np.ptp(at[1]))
