"""Shares of the load outside the data of the laws; results are unknown where they are large."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from multiscale.schema import MACRO_RESULT, Dataset, with_cautions
from multiscale.units import readable

if TYPE_CHECKING:
    from multiscale.laws.interface_law import InterfaceLaw

FAR_FACTOR = 2.0  # factor outside the data beyond which a law is no longer valid
FAR_SHARE = 0.05  # largest allowed share of the load of an interface beyond this factor
NEGLIGIBLE_LOAD = 0.01  # share of the load outside the data below which no caution is given
RUNG = 1.2  # factor between the pressures of cells that serve the points of a structure
ROUNDS = 6  # solves of a structure, at most, between which the data of its laws are extended
ROUND_OFF = 1e-6  # relative distance up to which a pressure outside the data counts as their end

LOAD_SHARES = ("load_below", "load_above", "load_far")
"""Shares of the load below, above and far outside the data of a law, in a result."""

INPUT_VARIABLES = frozenset(
    {
        "preload",
        "shear",
        "load_factor",
        "factor",
        "path_step",
        "cycles",
        "damage",
        "sliding_speed",
        "temperature",
        "residual",
        "wall_time",
        *LOAD_SHARES,
    }
)
"""Variables of a step that are input or cost, and stay if the results are unknown."""


def data_ends(law: "InterfaceLaw") -> tuple[float, float, float]:
    """Return the lowest and highest pressure of the data of a law and its limit of validity, Pa."""
    low, high = law.pressure_range
    return low, high, min(FAR_FACTOR * high, law.pressure_limit)


def further_pressures(
    data: tuple[float, float, float] | np.ndarray, shares: np.ndarray
) -> tuple[float, ...]:
    """Return two pressures beyond each end of the data of a law that the load leaves, Pa."""
    low, high, limit = data
    below, above, _ = np.nan_to_num(shares).reshape(3, -1).max(axis=1, initial=0.0)
    reach = FAR_FACTOR ** np.arange(1, 3)
    lower = low / reach[::-1] if below > NEGLIGIBLE_LOAD else np.empty(0)
    higher = high * reach if above > NEGLIGIBLE_LOAD and limit >= FAR_FACTOR * high else np.empty(0)
    return tuple(map(float, (*lower, *higher)))


def pressures_of_points(
    data: tuple[float, float, float] | np.ndarray, pressure: np.ndarray, area: np.ndarray
) -> tuple[float, ...]:
    """Return the pressures of a ladder between which the points of an interface lie, Pa."""
    # points that together carry less than NEGLIGIBLE_LOAD are left out, like contradicted pressures
    load = np.maximum(np.nan_to_num(pressure), 0.0) * area
    order = np.argsort(pressure, axis=1)
    sums = np.cumsum(np.take_along_axis(load, order, axis=1), axis=1)
    borne = np.take_along_axis(pressure, order, axis=1)[sums > NEGLIGIBLE_LOAD * sums[:, -1:]]
    _, high, limit = data
    borne = borne[borne <= (np.inf if limit >= FAR_FACTOR * high else high)]
    below = np.floor(np.log(borne) / np.log(RUNG))
    return tuple(map(float, RUNG ** np.unique([below, below + 1.0])))


def pressures_between(
    data: np.ndarray, unsure: np.ndarray, pressure: np.ndarray, area: np.ndarray, most: int
) -> tuple[float, ...]:
    """Return up to ``most`` middles of loaded intervals of data with an unsure end, Pa."""
    load = np.maximum(np.nan_to_num(pressure), 0.0) * area
    total = load.sum(axis=1)
    place = np.searchsorted(data, np.nan_to_num(pressure), side="right")
    middles = np.sqrt(data[1:] * data[:-1])
    borne = np.array([(load * (place == k + 1)).sum(axis=1) for k in range(middles.size)])
    share = np.max(borne / np.where(total > 0.0, total, 1.0), axis=1)
    asked = np.flatnonzero((share > NEGLIGIBLE_LOAD) & (unsure[1:] | unsure[:-1]))
    largest = np.argsort(-share[asked], kind="stable")[:most]
    return tuple(map(float, middles[np.sort(asked[largest])]))


def load_shares(
    pressure: np.ndarray, area: np.ndarray, data: tuple[float, ...] | np.ndarray
) -> np.ndarray:
    """Return the shares of the load of an interface below, above and far outside the data."""
    low, high, limit = np.moveaxis(np.asarray(data, dtype=float), -1, 0)[..., None]
    load = np.maximum(pressure, 0.0) * area
    total = np.sum(load, axis=1)
    where = (
        pressure < (1.0 - ROUND_OFF) * low,
        pressure > (1.0 + ROUND_OFF) * high,
        (pressure < (1.0 - ROUND_OFF) * low / FAR_FACTOR) | (pressure > (1.0 + ROUND_OFF) * limit),
    )
    return np.array(
        [(load * mask).sum(axis=1) / np.where(total > 0.0, total, 1.0) for mask in where]
    )


def without_steps(result: Dataset, wrong: np.ndarray, names: Sequence[str]) -> Dataset:
    """Return a result in which wrong steps, (steps,), did not converge and lack some variables."""
    converged = result["converged"].copy(data=np.where(wrong, 0, result["converged"]))
    fields = result[[name for name in names if name in result]]
    return result.assign(fields.where(converged == 1)).assign(converged=converged)


def with_load_shares(
    result: Dataset,
    shares: np.ndarray,
    data: np.ndarray,
    *,
    extrapolate: bool = False,
    loads: Sequence[str] = (),
) -> Dataset:
    """Return a result with the shares of its load outside the data of the laws."""
    known = np.all(shares[2] <= FAR_SHARE, axis=1)
    values = dict(zip(LOAD_SHARES, shares, strict=True)) | {"known": known.astype(int)}
    result = MACRO_RESULT.assign(result, values).assign_coords(interface=range(shares.shape[2]))
    if not extrapolate and not known.all():
        answers = [
            name
            for name, value in result.data_vars.items()
            if "step" in value.dims and value.dtype.kind == "f" and name not in INPUT_VARIABLES
        ]
        valid = result["known"] == 1
        result = result.assign({name: result[name].where(valid) for name in answers})
    if not loads:
        preloads = result["preload"].to_numpy()
        loads = [f"the preload {readable(f'{preload:.4g} Pa')}" for preload in preloads]
    return with_cautions(result, *_cautions(result, data, extrapolate, loads))


def _cautions(
    result: Dataset, data: np.ndarray, extrapolate: bool, loads: Sequence[str]
) -> Iterator[str]:
    """Yield a sentence for each interface with load outside the data of its law."""
    below, above, far = (result[name].values for name in LOAD_SHARES)
    for number, (low, high, limit) in enumerate(data):
        name = f" of interface {number}" if len(data) > 1 else ""
        ends = " to ".join(readable(f"{end:.4g} Pa") for end in (low, high))
        range_ = f"the pressures of the law{name}, {ends}"
        lost = np.flatnonzero(far[:, number] > FAR_SHARE)
        if lost.size:
            then = "only extrapolated, and its error is unknown" if extrapolate else "unknown"
            share = f"up to {100.0 * far[lost, number].max():.3g} % of the load lies"
            steps = f"at {lost.size} of {len(far)} steps, first at step {lost[0]} with "
            steps += f"{loads[lost[0]]}: the answer there is {then}"
            further = "" if extrapolate else ", or set extrapolate = true with the law"
            if limit < FAR_FACTOR * high:
                yield (
                    f"{share} outside {range_}, above which the cells contradict the law, {steps}; "
                    f"reduce the pressure of the interface{further}"
                )
            else:
                yield (
                    f"{share} more than a factor of {FAR_FACTOR:g} outside {range_}, {steps}; "
                    f"press the cells at these pressures, or state a law for them{further}"
                )
        near = np.setdiff1d(
            np.flatnonzero(below[:, number] + above[:, number] > NEGLIGIBLE_LOAD), lost
        )
        if near.size:
            step = near[np.argmax((below + above)[near, number])]
            sides = {"below": below[step, number], "above": above[step, number]}
            outside = (
                f"{100.0 * share:.3g} % of the load lies {side}"
                for side, share in sides.items()
                if share > 0.0
            )
            yield (
                f"the law extrapolates: up to {' and '.join(outside)} {range_}, at step {step} "
                f"with {loads[step]}"
            )
