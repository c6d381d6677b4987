r"""The bed of sliders that is nearest to cells sheared until they slip, and to closed cycles.

The bed of :class:`~multiscale.laws.Sliders` is known but for two numbers: the ratio :math:`\kappa`
of tangential to normal stiffness and the friction coefficient :math:`\mu`. With the bed
:math:`F` of :math:`\kappa = \mu = 1` on the normal law of a realisation, along the slips
:math:`u` and the pressures :math:`p` of its path,

.. math:: t = \mu\, F(\kappa u / \mu;\ p).    \tag{1}
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws import NormalLaw, Sliders
from multiscale.schema import LOADING, MICRO_RESPONSE, Dataset, with_cautions
from multiscale.upscaling.budget import NORMAL
from multiscale.upscaling.fit import laws_of_each, with_branch
from multiscale.upscaling.observations import Misfit
from multiscale.upscaling.reading import require_law
from multiscale.upscaling.response_observations import (
    loading_branch,
    normal_observations,
    up_to_limit,
)
from multiscale.upscaling.sampling import draw_counts, student, widening

FULL_SLIP = 0.98  # share of the contact nodes that slip where friction is observed
SLABS = 192  # of the fitted beds; the ratio then errs by .03 %
RATIOS = 0.1, 3.0  # range of tangential over normal stiffness
CANDIDATES = 33  # ratios that are compared at once
STILL = 3e-3  # slip over the largest slip up to which nothing is sheared
SIDEWAYS = 0.05  # slip over the largest slip, of cells across the direction of their shear
FEWEST_BELOW = 3.0  # pressure of a shear over the lowest pressure of the normal data
SAME = 1e-6  # relative difference of pressures that are the same
RELEASED = 1e-9  # pressure of a released cell over the largest pressure

CLOSED = 0.1  # distance from the first turn, over the amplitude, at which a cycle counts as closed

WHOLE = 0.95  # of full slip, above which the slip does not follow from the traction

NODES = np.polynomial.legendre.leggauss(48)  # of an integral over the amplitude


def with_shear(
    law: Dataset, response: Dataset, shear: Dataset, *, apart: bool | None = None
) -> Dataset:
    """Add the tangential branch to a normal law: the means of the nearest beds, and samples.

    The stiffness ratios along x and y differ if ``apart``; if it is not given, only if the cells
    have a clear direction. The bootstrap draws whole realisations: sample k belongs to sample k of
    the normal law if all realisations of the normal law are sheared.
    """
    cells, cautions = _sheared_cells(law, response, shear)
    ratio, friction = _nearest_beds(cells)
    lay = _lay(ratio)
    if not (bool(lay) if apart is None else apart):
        cautions += lay
        ratio[:] = np.nanmean(ratio, axis=1, keepdims=True)
    # whole realisations, and sample k with sample k of the normal law if all are sheared
    # means and samples of both numbers
    each, n = np.column_stack([ratio, friction]), len(ratio)
    counts = draw_counts(n, int(law.sizes.get("sample", 0)), int(law.attrs["seed"]))

    def sampled(values: np.ndarray) -> np.ndarray:
        """Return the means of bootstrap samples of values of the realisations."""
        mean = values.mean(axis=0)
        return np.asarray(mean + widening(n - 1, n=n) * (counts @ values / n - mean))

    mean, drawn = each.mean(axis=0), sampled(each)
    kappa, mu = mean[:2], float(mean[2])
    values = {
        "shear_stiffness_ratio": kappa,
        "shear_stiffness_ratio_sample": drawn[:, :2],
        "shear_friction": mu,
        "shear_friction_sample": drawn[:, 2],
    }
    # mean path of the beds, and loss in closed cycles
    path, misfit = _mean_path(cells, kappa, mu)
    cautions += misfit.judge("shear by smaller steps, or on a finer grid")
    values |= path
    if lost := measure_loss(cells.response, cells.pressure, cells.laws, kappa, mu):
        loss = lost.ratio.mean(axis=1)
        values |= {
            "shear_loss_ratio": loss.mean(axis=0),
            "shear_loss_ratio_sample": sampled(loss),
            "shear_cycle_pressure": lost.pressure,
            "shear_cycle_amplitude": lost.amplitude,
            "shear_cycle_loss_ratio": lost.ratio.mean(axis=0),
            "shear_loss_pressure_error": between_pressures(lost),
        }
    law = with_branch(law, "shear", "measured", values).assign_attrs(n_sheared=n)
    return with_cautions(law, *cautions)


@dataclass(frozen=True, eq=False)
class _Sheared:
    """Cells sheared along a path of pressures, with their normal laws and beds of sliders."""

    response: Dataset
    pressure: np.ndarray  # (steps,), Pa
    lowest: float  # pressure of the normal laws, Pa
    slip: np.ndarray  # (realisations, steps, 2), m
    traction: np.ndarray  # (realisations, steps, 2), Pa
    laws: list[NormalLaw]
    beds: list[Sliders]  # with a stiffness ratio and a friction of 1
    openings: list[np.ndarray]  # (steps,) for each realisation, m


def _sheared_cells(law: Dataset, response: Dataset, shear: Dataset) -> tuple[_Sheared, list[str]]:
    """Return the cells that were sheared along their whole path, and cautions on the others."""
    MICRO_RESPONSE.check(shear)
    require_law(law, "pressure_min", "pressure_max", "seed")
    low, high = float(law.attrs["pressure_min"]), float(law.attrs["pressure_max"])
    shear, cautions = _whole_paths(shear)
    _check_pairs(response, shear)
    # the normal laws rest on the loading of the sheared cells, or of the same cells without shear
    pressed = up_to_limit(loading_branch(shear), law)
    if float(pressed["nominal_pressure"].min()) <= low * (1.0 + SAME):
        shear = shear.isel(step=np.flatnonzero(shear["branch"] != LOADING))
    else:
        pressed = up_to_limit(response, law).sel(realisation=shear["realisation"].to_numpy())
    pressure, laws = _pressures(shear, low, high), _normal_laws(law, pressed)
    slip, traction = (shear[name].to_numpy()[..., 1:] for name in ("displacement_jump", "traction"))
    loaded = np.maximum(pressure, RELEASED * pressure.max())
    openings = [normal.gap_at(loaded) - normal.gap for normal in laws]
    beds = [Sliders(normal, 1.0, 1.0, pressures=(low, high), slabs=SLABS) for normal in laws]
    return _Sheared(shear, pressure, low, slip, traction, laws, beds, openings), cautions


def _nearest_beds(cells: _Sheared) -> tuple[np.ndarray, np.ndarray]:
    """Fit stiffness ratios along x and y, (realisations, 2), and the friction of every cell."""
    # friction where all contact slips
    loaded, size = cells.pressure > 0.0, np.linalg.norm(cells.traction, axis=-1)
    per_pressure = 1.0 / np.where(loaded, cells.pressure, np.inf)
    full = loaded & (cells.response["slip_fraction"].to_numpy() >= FULL_SLIP)
    friction = np.sum(full * size * per_pressure, axis=1) / full.sum(axis=1)
    # ratios from the steps below, without closed cycles
    # least squares of the distance from (1), over p, on the normal law of the cell; beyond
    # t = mu (p - p_min) springs that stick lie outside the pressures of the law
    inside = loaded & (size < friction[:, None] * (cells.pressure - cells.lowest))
    for _, (first, _, last) in closed_cycles(cells.slip.mean(axis=0), cells.pressure):
        inside[:, first + 1 : last + 1] = False
    fitted = zip(
        cells.beds,
        cells.openings,
        cells.slip,
        cells.traction,
        friction,
        inside * per_pressure,
        strict=True,
    )
    return np.array([_nearest_ratio(*arguments) for arguments in fitted]), friction


def _mean_path(
    cells: _Sheared, ratio: np.ndarray, friction: float
) -> tuple[dict[str, np.ndarray], Misfit]:
    """Return the mean path of cells and beds, and the distance of both over full slip."""
    slip, traction, n = cells.slip, cells.traction.mean(axis=0), len(cells.slip)
    stretch = np.nan_to_num(ratio) / friction
    bed = friction * np.mean(
        [
            bed_traction(bed, opening, u * stretch)
            for bed, opening, u in zip(cells.beds, cells.openings, slip, strict=True)
        ],
        axis=0,
    )
    moved = np.any(np.abs(slip).max(axis=0) > STILL * np.abs(slip).max(), axis=-1)
    sheared = (cells.pressure > 0.0) & moved
    scale = friction * cells.pressure[sheared]
    spread = np.linalg.norm(cells.traction.std(axis=0), axis=-1) / np.sqrt(max(n - 1, 1))
    values = {
        "shear_pressure": cells.pressure,
        "shear_slip": slip.mean(axis=0),
        "shear_traction": traction,
        "shear_bed_traction": bed,
    }
    misfit = Misfit(
        "the bed of sliders misses the sheared cells",
        cells.pressure[sheared],
        np.linalg.norm(traction - bed, axis=-1)[sheared] / scale,
        spread[sheared] / scale,
    )
    return {name: value[sheared] for name, value in values.items()}, misfit


def bed_traction(bed: Sliders, opening: np.ndarray, slip: np.ndarray) -> np.ndarray:
    """Evaluate the tangential traction of a bed along paths from rest, Pa, shaped as the slip."""
    paths = slip.reshape(*slip.shape[:2], -1)
    state, traction = np.zeros((bed.n_state, paths.shape[2])), np.empty(paths.shape)
    for k, moved in enumerate(paths):
        jump = np.concatenate([np.full((1, paths.shape[2]), opening[k]), moved])
        response = bed.respond(jump, state)
        state, traction[k] = response.state, response.traction[1:]
    return traction.reshape(slip.shape)


def _nearest_ratio(
    bed: Sliders,
    opening: np.ndarray,
    slip: np.ndarray,
    traction: np.ndarray,
    friction: float,
    weight: np.ndarray,
) -> np.ndarray:
    """Fit the stiffness ratios along x and y of the nearest path (1); NaN where nothing shears."""
    sheared = np.abs(slip).max(axis=0) > SIDEWAYS * np.abs(slip).max()
    low, high = np.log(RATIOS)
    middle, reach = np.full(2, 0.5 * (low + high)), 0.5 * (high - low)
    for _ in range(2):
        x = middle[:, None] + reach * np.linspace(-1.0, 1.0, CANDIDATES)
        path = friction * bed_traction(bed, opening, slip[..., None] * np.exp(x) / friction)
        error = weight[:, None, None] * (path - traction[..., None])
        square = np.sum(error**2, axis=0)  # (2, candidates)
        # vertex of the parabola through the best and its neighbours
        at = np.clip(np.argmin(square, axis=1), 1, CANDIDATES - 2)
        before, least, after = (square[(0, 1), at + k] for k in (-1, 0, 1))
        bend, fall = before - 2.0 * least + after, 0.5 * (before - after)
        inside = np.abs(fall) < bend
        shift = np.where(inside, fall / np.where(inside, bend, 1.0), np.sign(fall))
        reach *= 2.0 / (CANDIDATES - 1)
        middle = x[(0, 1), at] + reach * shift
    if not np.all(((low < middle) & (middle < high))[sheared]):
        raise CaseError(
            f"no bed with a tangential over normal stiffness from {RATIOS[0]:g} to {RATIOS[1]:g} "
            f"follows the sheared cells; check that they have the surfaces and moduli of the "
            f"normal law, and slide by small steps at first"
        )
    return np.where(sheared, np.exp(middle), np.nan)


def _whole_paths(shear: Dataset) -> tuple[Dataset, list[str]]:
    """Return the realisations that converged along the whole path, and the number of the others."""
    needed = ("nominal_pressure", "slip_fraction")
    missing = [name for name in needed if name not in shear.variables]
    if missing:
        raise CaseError(
            f"the sheared response has no {' and no '.join(missing)}; shear cells with friction "
            f"under prescribed pressures"
        )
    whole = (shear["converged"] == 1).all("step").to_numpy()
    if not np.any(whole):
        raise CaseError("no sheared realisation converged along its whole path; use more steps")
    if np.all(whole):
        return shear, []
    caution = (
        f"{np.sum(~whole)} of {whole.size} sheared realisations did not reach the end of the path "
        f"and are left out"
    )
    return shear.isel(realisation=np.flatnonzero(whole)), [caution]


def _check_pairs(response: Dataset, shear: Dataset) -> None:
    pressed, sheared = ({*data["realisation"].to_numpy().tolist()} for data in (response, shear))
    if missing := sorted(sheared - pressed):
        raise CaseError(
            f"the sheared realisations {missing} were not pressed, so they have "
            f"no normal law; shear cells on the same surfaces, with the same numbers"
        )


def _normal_laws(law: Dataset, pressed: Dataset) -> list[NormalLaw]:
    laws = laws_of_each(normal_observations(pressed), law)
    if len(laws) != pressed.sizes["realisation"] or None in laws:
        raise CaseError(
            "a sheared realisation has no normal law, since it did not converge under pressure; "
            "leave it out of the sheared realisations"
        )
    return laws


def _pressures(shear: Dataset, low: float, high: float) -> np.ndarray:
    """Return the pressures of the steps, Pa, and refuse a path that does not determine the bed."""
    slipping = shear["slip_fraction"].max("step").to_numpy()
    if slipping.min() < FULL_SLIP:
        raise CaseError(
            f"at most {100.0 * slipping.min():.3g} % of the contact slips in a sheared "
            f"realisation, too little to measure friction; slide farther"
        )
    pressure = np.asarray(shear["nominal_pressure"].to_numpy(), dtype=float)
    moved = np.abs(shear["displacement_jump"].to_numpy()[..., 1:]).max((0, 2))
    sheared = pressure[(pressure > 0.0) & (moved > STILL * moved.max())]
    if sheared.min() < FEWEST_BELOW * low * (1.0 - SAME) or sheared.max() > high * (1.0 + SAME):
        raise CaseError(
            f"the cells are sheared from {sheared.min():.3g} to {sheared.max():.3g} Pa and the "
            f"normal law has data from {low:.3g} to {high:.3g} Pa; shear between "
            f"{FEWEST_BELOW:g} times the lowest and the highest, since springs that slip last "
            f"belong to lower pressures"
        )
    return pressure


def _lay(ratio: np.ndarray) -> list[str]:
    """Return a caution if the stiffness along x and y differs by more than chance."""
    n, change = len(ratio), ratio[:, 0] - ratio[:, 1]
    if n < 3 or np.any(np.isnan(change)):
        return []
    if abs(change.mean()) <= student(n - 1, 0.995) * change.std(ddof=1) / np.sqrt(n):
        return []
    return [
        f"the tangential stiffness ratios along x and y, {ratio[:, 0].mean():.3g} and "
        f"{ratio[:, 1].mean():.3g}, differ by more than chance: if the surface has a lay, fit them "
        f"apart"
    ]


@dataclass(frozen=True, eq=False)
class LossRatio:
    """Loss of cells over the loss of the bed."""

    pressure: np.ndarray  # (cycles,), Pa
    amplitude: np.ndarray  # (cycles,), of the traction of the mean cell over full slip
    ratio: np.ndarray  # (realisations, cycles, 2), at equal slip and at equal traction


def measure_loss(
    shear: Dataset,
    pressure: np.ndarray,
    laws: list[NormalLaw],
    stiffness_ratio: np.ndarray,
    friction: float,
) -> LossRatio | None:
    """Compare the work of friction of cells over closed cycles with the loss of their beds."""
    if "friction_work" not in shear.variables:
        return None
    slip, traction = (shear[name].to_numpy()[..., 1:] for name in ("displacement_jump", "traction"))
    lost = shear["friction_work"].to_numpy()
    cycles = [(axis, *turns) for axis, turns in closed_cycles(slip.mean(axis=0), pressure)]
    if not cycles:
        return None
    ratio = np.empty((len(laws), len(cycles), 2))
    amplitude = np.empty(ratio.shape[:2])
    for c, (axis, first, back, last) in enumerate(cycles):
        # amplitudes of slip and of traction between the turns
        turns, kappa, p = [first, back, last], stiffness_ratio[axis], pressure[first]
        swing = np.array([0.25, -0.5, 0.25])
        reached = np.abs(slip[:, turns, axis] @ swing)
        carried = np.abs(traction[:, turns, axis] @ swing)
        amplitude[:, c] = carried / (friction * p)
        for r, law in enumerate(laws):
            alike = reached[r]  # slip of the bed at the traction of the cell
            if amplitude[r, c] < WHOLE:
                alike = law.gap_at(p * (1.0 - amplitude[r, c])) - law.gap_at(p)
                alike *= friction / kappa
            bed = [bed_loss(law, float(p), a, kappa, friction) for a in (reached[r], alike)]
            ratio[r, c] = (lost[r, last] - lost[r, first]) / np.array(bed)
    at = np.array([pressure[first] for _, first, *_ in cycles])
    return LossRatio(at, amplitude.mean(axis=0), ratio)


def between_pressures(lost: LossRatio) -> float:
    """Return the 95 % half-width of the ratio between pressures, less the chance of few cells."""
    of_cells, at = lost.ratio.mean(axis=2), np.unique(lost.pressure)
    each = np.array([of_cells[:, lost.pressure == p].mean(axis=1) for p in at])
    means, rest = each.mean(axis=1), each - each.mean(axis=0)
    degrees, n = (len(at) - 1) * (each.shape[1] - 1), each.shape[1]
    if not degrees:
        return 0.5 * float(np.ptp(means))
    chance = np.sum((rest - rest.mean(axis=1, keepdims=True)) ** 2) / (degrees * n)
    return float(NORMAL * np.sqrt(max(means.var(ddof=1) - chance, 0.0)))


def bed_loss(
    law: NormalLaw, pressure: float, amplitude: float, stiffness_ratio: float, friction: float
) -> float:
    """Integrate the loss of a bed of sliders in a closed cycle at a constant pressure, J/m2."""
    gap = float(law.gap_at(np.array(pressure)))
    u = 0.5 * amplitude * (1.0 + np.append(NODES[0], 1.0))
    # first loading and Masing's rule: W = 8 ∫ t du - 4 a t(a) (1)
    t = friction * (pressure - law.pressure(gap + stiffness_ratio * u / friction))
    return float(4.0 * amplitude * (NODES[1] @ t[:-1] - t[-1]))  # (1)


def closed_cycles(slip: np.ndarray, pressure: np.ndarray) -> list[tuple[int, list[int]]]:
    """Return direction, first turn, second turn and end of the closed cycles of a path of slips."""
    ends = np.flatnonzero(np.diff(pressure)) + 1
    cycles = []
    for steps in np.split(np.arange(len(pressure)), ends):  # of constant pressure
        for axis in (0, 1):
            u = slip[steps, axis]
            if pressure[steps[0]] <= 0.0 or np.ptp(u) <= SIDEWAYS * np.ptp(slip[steps]):
                continue
            turns = 1 + np.flatnonzero(np.diff(u)[1:] * np.diff(u)[:-1] < 0.0)
            for first, back in pairwise(turns):
                near = np.abs(u[back + 1 :] - u[first]) < CLOSED * 0.5 * abs(u[first] - u[back])
                if np.any(near):
                    last = back + 1 + int(np.argmax(near))
                    cycles.append((axis, steps[[first, back, last]].tolist()))
    return cycles
