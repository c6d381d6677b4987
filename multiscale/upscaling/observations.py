"""Observations for the fit of laws: values of a quantity at conditions, by realisation."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.units import readable
from multiscale.upscaling.sampling import Control, widening

ALLOWED = 0.1
"""Largest distance of a fitting law from an observation, over its scale, on top of the scatter."""

TWO_SIDED = 1.96  # standard deviations to 95 %

_P = {"pressure": "Pa"}


@dataclass(frozen=True)
class Quantity:
    """A kind of observation."""

    unit: str  # UDUNITS spelling
    conditions: Mapping[str, str]  # variables that the values depend on, pressure first, and units
    predict: Callable[..., np.ndarray]  # value of a law, from the law and the conditions
    variable: str  # name of the mean values in a dataset of the law


QUANTITIES: dict[str, Quantity] = {
    "gap": Quantity("m", _P, lambda law, p: law.gap_at(p), "fit_mean_gap"),
    "normal_stiffness": Quantity(
        "Pa m-1", _P, lambda law, p: law.stiffness(law.gap_at(p)), "fit_stiffness"
    ),
    "contact_fraction": Quantity(
        "1", _P, lambda law, p: law.contact_fraction(p), "fit_contact_fraction"
    ),
    "tangential_stiffness": Quantity(
        "Pa m-1", _P, lambda law, p: law.stiffness_at(p), "fit_stiffness"
    ),
    "friction_coefficient": Quantity(
        "1",
        _P | {"speed": "m s-1"},
        lambda law, *at: law.coefficient(*at),
        "fit_friction_coefficient",
    ),
    "recovery": Quantity(
        "m", _P | {"peak_pressure": "Pa"}, lambda law, *at: law.recovery(*at), "fit_recovery"
    ),
}
"""Quantities that can be observed, by name."""


@dataclass(frozen=True, eq=False)
class Misfit:
    """Distances of a law from its observations."""

    text: str  # names the law and the observation, such as "the bed misses the shear"
    pressure: np.ndarray  # (points,), Pa
    distance: np.ndarray  # (points,), law less observation, over the scale of the observation
    scatter: np.ndarray | float = 0.0  # standard deviation of the mean observation over its scale

    @property
    def missed(self) -> np.ndarray:
        """Whether points differ from the law by more than :data:`ALLOWED` and 95 % of chance."""
        allowed = ALLOWED + TWO_SIDED * np.nan_to_num(self.scatter)
        return np.asarray(~(np.abs(self.distance) <= allowed))

    def judge(self, advice: str) -> list[str]:
        """Return a caution with the pressures that the law misses, empty if it fits."""
        if not self.missed.any():
            return []
        largest = 100.0 * float(np.max(np.abs(self.distance[self.missed])))
        at = list_pressures(self.pressure[self.missed])
        return [f"{self.text} by up to {largest:.3g} % at {at}; {advice}"]


def list_pressures(pressure: np.ndarray) -> str:
    """Write pressures, Pa, in rising order: all of up to five, else their number and range."""
    texts = [readable(f"{value:.4g} Pa") for value in np.unique(pressure)]
    if len(texts) > 5:
        return f"{len(texts)} pressures from {texts[0]} to {texts[-1]}"
    return f"{', '.join(texts[:-1])} and {texts[-1]}" if len(texts) > 1 else texts[0]


@dataclass(frozen=True, eq=False)
class Observations:
    """Values of a quantity."""

    quantity: str  # a key of QUANTITIES
    conditions: tuple[np.ndarray, ...]  # each (points,), in the order of the quantity, SI
    values: np.ndarray  # (realisations, points), SI; NaN where there are none
    scale: np.ndarray  # (points,), an error of the mean is relative to it, SI
    attributes: Mapping[str, str | float | int] = field(default_factory=dict)  # for the law
    order: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=int))  # places in the data
    independent: bool = False  # whether errors at the points of a realisation are independent
    control: Control | None = None  # mean by many cheap values too

    @property
    def pressure(self) -> np.ndarray:
        """The first condition, Pa."""
        return self.conditions[0]

    @property
    def n_realisations(self) -> int:
        """Number of realisations."""
        return len(self.values)

    @property
    def n_further(self) -> int:
        """Number of cheap values of a control in addition to the paired values."""
        return 0 if self.control is None else len(self.control.cheap) - self.n_realisations

    @property
    def counted(self) -> np.ndarray:
        """Whether there is a value, (realisations, points)."""
        return np.asarray(np.isfinite(self.values))

    @property
    def ensembles(self) -> tuple[tuple[np.ndarray, int], ...]:
        """Values, of independent means that add up to the mean, and the freedom of each."""
        if self.control is None:
            return ((self.values, self.n_realisations - 1),)
        return self.control.ensembles

    @property
    def widening(self) -> float:
        """Factor by which the means of samples are too near to the mean; 1 with a control."""
        n = self.n_realisations
        return widening(n - 1, n=n) if self.control is None else 1.0

    @property
    def mean(self) -> np.ndarray:
        """Mean values, shape (points,), SI."""
        return np.nanmean(self.values, axis=0) if self.control is None else self.control.mean

    @property
    def scatter(self) -> np.ndarray:
        """Standard deviation of the mean over the scale, shape (points,); NaN if it is unknown."""
        square = np.zeros(self.pressure.size)
        for values, freedom in self.ensembles:
            n = np.isfinite(values).sum(axis=0)
            spread = values - np.nanmean(values, axis=0)
            variance = np.nansum(spread**2, axis=0) / np.maximum(n * (n - 1), 1)
            square += np.where((n > 1) & (freedom > 0), variance, np.nan)
        size = np.abs(self.scale)
        return np.asarray(np.divide(np.sqrt(square), size, out=0.0 * size, where=size > 0.0))

    def misses(self, law: object, text: str) -> Misfit:
        """Return the distances of a law from the mean values."""
        predicted = QUANTITIES[self.quantity].predict(law, *self.conditions)
        distance = np.divide(
            predicted - self.mean, self.scale, out=0.0 * self.mean, where=self.scale != 0.0
        )
        return Misfit(text, self.pressure, distance, self.scatter)

    def at(self, points: slice | np.ndarray) -> "Observations":
        """Return the observations at some of the points."""
        control = None if self.control is None else self.control.at(points)
        conditions = tuple(condition[points] for condition in self.conditions)
        some = replace(
            self,
            conditions=conditions,
            values=self.values[:, points],
            order=self.order[points],
            control=control,
        )
        return replace(some, scale=error_scale(self.quantity, conditions, some.mean))

    def means(self, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return means of samples by multiplicities of values, (samples, points), and weights."""
        if self.control is not None:
            return self.control.means(counts)
        counts = counts[:, : self.n_realisations]
        total = counts @ self.counted
        mean = counts @ np.nan_to_num(self.values) / np.maximum(total, 1.0)
        return mean, total / self.counted.sum(axis=0)


def observe(
    quantity: str,
    conditions: tuple[np.ndarray, ...] | np.ndarray,
    values: np.ndarray,
    **attributes: str | float | int,
) -> Observations:
    """Build observations from plain arrays.

    Parameters
    ----------
    quantity : str
        ``"gap"``, ``"normal_stiffness"``, ``"contact_fraction"``, ``"tangential_stiffness"``,
        ``"friction_coefficient"`` or ``"recovery"``.
    conditions : ndarray or tuple of ndarray, shape (points,)
        Pressure, Pa; for friction also the speed, m/s; for the recovery (gap beyond the gap at
        the largest pressure, m) also the largest pressure, Pa.
    values : ndarray, shape (realisations, points) or (points,)
        SI; NaN where a realisation has no value.
    **attributes
        Strings and numbers for the attributes of the law.

    Raises
    ------
    CaseError
        If the quantity is unknown, shapes do not agree, a pressure is not positive, or nothing or
        something negative was observed.
    """
    if quantity not in QUANTITIES:
        raise CaseError(f"there is no quantity {quantity!r}; choose from {', '.join(QUANTITIES)}")
    conditions = conditions if isinstance(conditions, tuple) else (conditions,)
    x = tuple(np.asarray(condition, dtype=float) for condition in conditions)
    y = np.atleast_2d(np.asarray(values, dtype=float))
    names = list(QUANTITIES[quantity].conditions)
    if len(x) != len(names) or any(condition.shape != y.shape[1:] for condition in x):
        raise CaseError(
            f"{quantity} depends on {' and '.join(names)}, each with an entry per observed point "
            f"({y.shape[1]}); got shapes {', '.join(str(condition.shape) for condition in x)}"
        )
    for name, values in zip(names, x, strict=True):
        allowed = values >= 0.0 if name == "speed" else values > 0.0
        if not np.all(np.isfinite(values) & allowed):
            raise CaseError(
                f"{name} must be positive and finite "
                f"({QUANTITIES[quantity].conditions[name]}), got {float(np.min(values)):g}"
            )
    observed = arrange(quantity, x, y, attributes)
    if not observed.values.size:
        raise CaseError(f"all values of {quantity} are missing")
    _check_sense(quantity, observed.pressure, observed.mean)
    return replace(observed, independent=True)


def arrange(
    quantity: str, x: tuple[np.ndarray, ...], y: np.ndarray, attributes: Mapping[str, Any]
) -> Observations:
    """Select realisations and points with values, in rising order of the conditions."""
    counted = np.isfinite(y)
    order = np.lexsort(x[::-1])
    order = order[counted.any(axis=0)[order]]
    conditions = tuple(condition[order] for condition in x)
    values = np.where(counted, y, np.nan)[counted.any(axis=1)][:, order]
    scale = error_scale(quantity, conditions, np.nanmean(values, axis=0)) if order.size else x[0]
    return Observations(quantity, conditions, values, scale, attributes, order)


def _check_sense(quantity: str, pressure: np.ndarray, mean: np.ndarray) -> None:
    unit = QUANTITIES[quantity].unit
    if quantity != "gap" and not np.all(mean > 0.0):
        at = int(np.argmin(mean))
        raise CaseError(
            f"{quantity} must be positive, got {mean[at]:.3g} {unit} at {pressure[at]:.3g} Pa; "
            f"leave out points without a value"
        )
    if quantity == "contact_fraction" and mean.max() > 1.0:
        raise CaseError(
            f"a contact fraction lies between 0 and 1, got {mean.max():.3g}; divide an area by the "
            f"nominal area, and a percentage by 100"
        )
    if quantity.endswith("stiffness") and mean.size >= 4 and np.ptp(pressure) > 0.0:
        x = np.log(pressure)
        (slope, _), covariance = np.polyfit(x, np.log(mean), 1, cov=True)
        if slope < -3.0 * float(np.sqrt(covariance[0, 0])) - 1e-3:
            raise CaseError(
                f"the stiffness falls as the pressure rises, with its power {slope:.2g}, unlike a "
                f"convex law; check that pressure and stiffness are not exchanged, and that "
                f"the data belong to one loading branch"
            )


def error_scale(quantity: str, x: tuple[np.ndarray, ...], mean: np.ndarray) -> np.ndarray:
    """Return the scale of the errors, see :class:`Observations`."""
    if quantity == "recovery":  # recovery of the same branch at its lowest pressure
        return np.array([mean[x[1] == peak].max() for peak in x[1]])
    if quantity != "gap":
        return mean
    if mean.size < 2 or np.any(np.diff(x[0]) <= 0.0):
        return np.full(mean.shape, np.nan)  # refused when a law is fitted
    return np.asarray(np.abs(np.gradient(mean, np.log(x[0]))))
