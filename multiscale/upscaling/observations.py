"""What laws are fitted to: values of one quantity at known conditions, by realisation."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.schema import MICRO_RESPONSE, with_cautions
from multiscale.units import readable

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "QUANTITIES",
    "Observations",
    "Quantity",
    "area_observations",
    "normal_observations",
    "observe",
    "unloading_observations",
]

HIGHEST_GAP = 20.0
"""Mean gap over the rms height above which units are wrong, or a single spike is all contact."""

LIGHT, DEEPEST = 0.05, 5.0
"""Contact fraction up to which pressing leaves the heights as they are, and valleys, over the rms
height, that no surface but a scratched one has."""

_OWN_ATTRIBUTES = frozenset(
    {"schema", "schema_version", "Conventions", "source", "history", "environment"}
)


@dataclass(frozen=True)
class Quantity:
    """One kind of observation.

    Attributes
    ----------
    unit : str
        Of the values, UDUNITS spelling.
    conditions : mapping of str to str
        Names and units of what the values depend on, pressure first.
    predict : callable
        The value that a law gives, from the law and the conditions.
    variable : str
        Name of the mean values in a dataset of the law.
    """

    unit: str
    conditions: Mapping[str, str]
    predict: Callable[..., np.ndarray]
    variable: str


QUANTITIES: dict[str, Quantity] = {
    "gap": Quantity("m", {"pressure": "Pa"}, lambda law, p: law.gap_at(p), "fit_mean_gap"),
    "normal_stiffness": Quantity(
        "Pa m-1",
        {"pressure": "Pa"},
        lambda law, p: law.stiffness(law.gap_at(p)),
        "fit_stiffness",
    ),
    "contact_fraction": Quantity(
        "1", {"pressure": "Pa"}, lambda law, p: law.contact_fraction(p), "fit_contact_fraction"
    ),
    "tangential_stiffness": Quantity(
        "Pa m-1", {"pressure": "Pa"}, lambda law, p: law.stiffness_at(p), "fit_stiffness"
    ),
    "friction_coefficient": Quantity(
        "1",
        {"pressure": "Pa", "speed": "m s-1"},
        lambda law, p, v: law.coefficient(p, v),
        "fit_friction_coefficient",
    ),
    "recovery": Quantity(
        "m",
        {"pressure": "Pa", "peak_pressure": "Pa"},
        lambda law, p, peak: law.recovery(p, peak),
        "fit_recovery",
    ),
}
"""What can be observed, by name."""


@dataclass(frozen=True, eq=False)
class Observations:
    """Values of one quantity.

    Parameters
    ----------
    quantity : str
        A key of ``QUANTITIES``.
    conditions : tuple of ndarray, shape (points,)
        In the order of the quantity, SI.
    values : ndarray, shape (realisations, points)
        SI.
    counted : ndarray of bool, shape (realisations, points)
        Which values exist.
    scale : ndarray, shape (points,)
        What an error of the mean value is measured by, SI: the value itself, or for a gap the
        distance over which the pressure changes by its own size.
    attributes : mapping
        What the data say of the surface, carried into the law.
    order : ndarray of int, shape (points,)
        Place of each point in what the observations were made from.
    independent : bool
        Whether the errors of the points of one realisation are independent, as those of single
        measurements are and those of the steps of one cell are not.
    """

    quantity: str
    conditions: tuple[np.ndarray, ...]
    values: np.ndarray
    counted: np.ndarray
    scale: np.ndarray
    attributes: Mapping[str, str | float | int] = field(default_factory=dict)
    order: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=int))
    independent: bool = False

    @property
    def pressure(self) -> np.ndarray:
        """The first condition, Pa."""
        return self.conditions[0]

    @property
    def n_realisations(self) -> int:
        """Number of realisations."""
        return len(self.values)

    @property
    def masked(self) -> np.ndarray:
        """Values with NaN where there are none."""
        return np.where(self.counted, self.values, np.nan)

    def means(self, counts: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Mean values of samples, and their weights.

        Parameters
        ----------
        counts : ndarray, shape (samples, realisations), optional
            How often each realisation counts; once if not given.

        Returns
        -------
        mean, weight : ndarray, shape (samples, points)
            The weight is the share of the values that the sample has, 1 on average; the mean is 0
            where it has none.
        """
        counts = np.ones((1, self.n_realisations)) if counts is None else counts
        total = counts @ self.counted
        mean = counts @ np.where(self.counted, self.values, 0.0) / np.maximum(total, 1.0)
        return mean, total / self.counted.sum(axis=0)


def observe(
    quantity: str,
    conditions: tuple[np.ndarray, ...] | np.ndarray,
    values: np.ndarray,
    **attributes: str | float | int,
) -> Observations:
    """Make observations from plain arrays.

    Parameters
    ----------
    quantity : str
        ``"gap"``, ``"normal_stiffness"``, ``"contact_fraction"``, ``"tangential_stiffness"``,
        ``"friction_coefficient"`` or ``"recovery"``.
    conditions : ndarray or tuple of ndarray, shape (points,)
        Pressure, Pa; for friction also the speed, m/s; for the recovery (gap beyond that at the
        largest pressure, m) also the largest pressure, Pa.
    values : ndarray, shape (realisations, points) or (points,)
        SI; NaN where a realisation has no value.
    **attributes
        Strings and numbers carried into the law.

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
    if len(x) != len(names) or any(part.shape != y.shape[1:] for part in x):
        raise CaseError(
            f"{quantity} depends on {' and '.join(names)}, each with one entry per observed point "
            f"({y.shape[1]}); got shapes {', '.join(str(part.shape) for part in x)}"
        )
    for name, part in zip(names, x, strict=True):
        if not (np.all(np.isfinite(part)) and np.all(part >= 0.0 if name == "speed" else part > 0)):
            raise CaseError(
                f"{name} must be positive and finite "
                f"({QUANTITIES[quantity].conditions[name]}), got {float(np.min(part)):g}"
            )
    counted = np.isfinite(y)
    rows, columns = counted.any(axis=1), counted.any(axis=0)
    order = np.lexsort(x[::-1])
    order = order[columns[order]]
    x, y, counted = tuple(part[order] for part in x), y[rows][:, order], counted[rows][:, order]
    if not y.size:
        raise CaseError(f"no value of {quantity} was observed; all are missing")
    mean = np.where(counted, y, 0.0).sum(axis=0) / counted.sum(axis=0)
    _check_sense(quantity, x[0], mean)
    scale = _scale(quantity, x, mean)
    return Observations(quantity, x, y, counted, scale, attributes, order, independent=True)


def _check_sense(quantity: str, pressure: np.ndarray, mean: np.ndarray) -> None:
    """Refuse values that no law of the quantity has."""
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
                f"the stiffness falls as the pressure rises, as its power {slope:.2g}, which no "
                f"convex law does; check that pressure and stiffness are not exchanged, and that "
                f"the data are of one loading branch"
            )


def _scale(quantity: str, x: tuple[np.ndarray, ...], mean: np.ndarray) -> np.ndarray:
    """Return what an error is measured by, see :class:`Observations`."""
    if quantity == "recovery":  # that of the same branch at its lowest pressure
        return np.array([mean[x[1] == peak].max() for peak in x[1]])
    if quantity != "gap":
        return mean
    if mean.size < 2 or np.any(np.diff(x[0]) <= 0.0):
        return np.full(mean.shape, np.nan)  # refused when a law is fitted
    return np.asarray(np.abs(np.gradient(mean, np.log(x[0]))))


def normal_observations(response: "xr.Dataset") -> Observations:
    r"""Mean gaps of a response at its rising pressures; what failed is left out.

    Parameters
    ----------
    response : Dataset
        Follows ``MICRO_RESPONSE``; one loading branch.

    Raises
    ------
    CaseError
        If fewer than three pressures are usable, one occurs twice, or the averaged traction
        contradicts the pressure.

    Notes
    -----
    Of heights of zero mean and root mean square h that end at g, in a share A of the area, and at
    -v below, Cantelli's and the inequality of Bhatia and Davis say

    .. math:: g \le h \sqrt{1/A - 1}, \qquad g \ge h^2 / v.    \tag{1}

    Contact flattens a surface, so that h without load serves for the first, and light contact for
    the second. Mean gaps beyond either are a caution: units differ, for instance.
    """
    found = _observe_response("gap", response, "mean_gap")
    told = with_cautions(response, *_odd_gaps(response, found))
    return replace(found, attributes=inherited(told))


def _odd_gaps(response: "xr.Dataset", found: Observations) -> Iterator[str]:
    """Say which mean gaps do not fit heights and contact fractions, by (1)."""
    if "rms_height" not in response.variables:
        return
    kept = response.isel(step=found.order)
    area = kept["contact_fraction"].where(kept["converged"] == 1).mean("realisation").to_numpy()
    share = found.means()[0][0] / float(response["rms_height"].mean())
    p = [readable(f"{one:.3g} Pa") for one in found.pressure]
    most = np.sqrt(1.0 / np.where(area > 0.0, area, np.nan) - 1.0)
    if np.any(share > most):
        j = int(np.nanargmax(share / most))
        yield (
            f"the mean gap of {share[j]:.3g} rms heights at {p[j]} is larger than {most[j]:.3g}, "
            f"the most that any surface leaves that touches in {100.0 * area[j]:.3g} % of its "
            f"area: give gaps and rms heights in m"
        )
    light = np.flatnonzero(area <= LIGHT)
    if light.size and share[light].min() < 1.0 / DEEPEST:
        j = int(light[np.argmin(share[light])])
        yield (
            f"the mean gap of {share[j]:.3g} rms heights at {p[j]} needs valleys deeper than "
            f"{1.0 / max(share[j], 1e-9):.3g} of them, since little touches: if the surface has "
            f"none, give gaps and rms heights in m"
        )


def area_observations(response: "xr.Dataset") -> Observations:
    """Contact fractions of a response; see :func:`normal_observations`.

    Raises
    ------
    CaseError
        As there, or if a fraction is not between 0 and 1, or falls with the pressure by more than
        chance explains.
    """
    found = _observe_response("contact_fraction", response, "contact_fraction")
    a, counted = found.values, found.counted
    wrong = counted & ~((a >= 0.0) & (a <= 1.0))
    if np.any(wrong):
        raise CaseError(
            f"a contact fraction lies between 0 and 1, got {a[wrong][0]:.3g}; divide an area by "
            f"the nominal area, and a percentage by 100"
        )
    both = counted[:, 1:] & counted[:, :-1]
    n = both.sum(axis=0)
    change = np.where(both, np.diff(a, axis=1), 0.0)
    mean = change.sum(axis=0) / np.maximum(n, 1)
    spread = np.sqrt(np.sum(np.where(both, change - mean, 0.0) ** 2, axis=0) / np.maximum(n, 1))
    falls = (n >= 3) & (mean < -5.0 * spread / np.sqrt(np.maximum(n - 1, 1)) - 1e-3)
    if np.any(falls):
        j = int(np.argmax(falls))
        p = found.pressure
        raise CaseError(
            f"the contact fraction falls by {-mean[j]:.2g} from {p[j]:.3g} to {p[j + 1]:.3g} Pa in "
            f"all realisations alike, which no pressing does; check the order of the steps, or "
            f"select one loading branch"
        )
    return found


def _observe_response(quantity: str, response: "xr.Dataset", variable: str) -> Observations:
    """Select usable steps and realisations; pressures rising."""
    MICRO_RESPONSE.check(response)
    values = response[variable].to_numpy()
    counted, pressure = usable_steps(response)
    total = counted.sum(axis=0)
    steps = np.flatnonzero((total > 0) & (pressure > 0.0))
    steps = steps[np.argsort(pressure[steps])]
    if steps.size < 3:
        raise CaseError(
            f"a law needs at least 3 pressures with a converged realisation, found {steps.size} "
            f"of {values.shape[1]}; solve more steps or look why they failed"
        )
    pressure = pressure[steps]
    if not np.all(np.diff(pressure) > 1e-9 * pressure[1:]):
        raise CaseError(
            "a nominal pressure occurs twice in the response; a law is fitted to one loading "
            "branch, so select its steps first"
        )
    kept = counted[:, steps].any(axis=1)
    y, mask = values[np.ix_(kept, steps)], counted[np.ix_(kept, steps)]
    mean = np.where(mask, y, 0.0).sum(axis=0) / mask.sum(axis=0)
    scale = _scale(quantity, (pressure,), mean)
    return Observations(quantity, (pressure,), y, mask, scale, inherited(response), steps)


def usable_steps(response: "xr.Dataset") -> tuple[np.ndarray, np.ndarray]:
    """Which steps of which realisations count, and the pressure of every step, Pa.

    Raises
    ------
    CaseError
        If a step that is said to have converged has no value, gaps are out of proportion to the
        heights, or the averaged traction contradicts the pressure.
    """
    own = -response["traction"].sel(component="n").to_numpy()
    counted = response["converged"].to_numpy() == 1
    values = {"mean_gap": response["mean_gap"].to_numpy(), "normal traction": own}
    values["contact_fraction"] = response["contact_fraction"].to_numpy()
    for name, value in values.items():
        wrong = np.argwhere(counted & ~np.isfinite(value))
        if wrong.size:
            k, j = wrong[0]
            raise CaseError(
                f"realisation {k}, step {j}: {name} is {value[k, j]} although converged is 1; "
                f"set converged to 0 for a step that failed, or solve it again"
            )
    _check_heights(response, values["mean_gap"], counted)
    total = counted.sum(axis=0)
    mean = np.where(counted, own, 0.0).sum(axis=0) / np.maximum(total, 1)
    if "nominal_pressure" not in response.variables:
        return counted, mean
    pressure = np.asarray(response["nominal_pressure"].to_numpy(), dtype=float)
    wrong = (total > 0) & (np.abs(mean - pressure) > 0.05 * np.abs(pressure))
    if np.any(wrong):
        j = int(np.argmax(wrong))
        raise CaseError(
            f"the averaged traction of {mean[j]:.3g} Pa contradicts the nominal pressure of "
            f"{pressure[j]:.3g} Pa at step {j}; both are in Pa, and a pressure is minus the normal "
            f"traction"
        )
    return counted, pressure


def _check_heights(response: "xr.Dataset", gap: np.ndarray, counted: np.ndarray) -> None:
    """Refuse gaps that no surface of these heights keeps open."""
    if "rms_height" not in response.variables:
        return
    height = response["rms_height"].to_numpy()[:, None]
    wrong = np.argwhere(counted & (gap > HIGHEST_GAP * height))
    if wrong.size:
        k, j = wrong[0]
        raise CaseError(
            f"realisation {k}, step {j}: the mean gap of {gap[k, j]:.3g} m is "
            f"{gap[k, j] / height[k, 0]:.3g} times the rms height of {height[k, 0]:.3g} m, and "
            f"summits keep surfaces at most about 5 of them apart; convert both to m, or take "
            f"spikes out of the map"
        )


def unloading_observations(response: "xr.Dataset") -> Observations:
    """Spring back of a response that was loaded and unloaded, relative to its largest pressures.

    Parameters
    ----------
    response : Dataset
        Follows ``MICRO_RESPONSE``; every step whose pressure is below the largest one before it
        belongs to an unloading branch.

    Raises
    ------
    CaseError
        If the pressure never falls.
    """
    MICRO_RESPONSE.check(response)
    counted, pressure = usable_steps(response)
    gap = np.where(counted, response["mean_gap"].to_numpy(), np.nan)
    top = np.array([int(np.argmax(pressure[: j + 1])) for j in range(pressure.size)])
    down = np.flatnonzero((pressure < pressure[top] * (1.0 - 1e-9)) & (pressure > 0.0))
    if down.size == 0:
        raise CaseError(
            "the pressure never falls in the response, so that nothing is known of unloading; add "
            "steps at lower pressures after the largest one"
        )
    return observe(
        "recovery",
        (pressure[down], pressure[top[down]]),
        gap[:, down] - gap[:, top[down]],
        **inherited(response),
    )


def inherited(response: "xr.Dataset") -> dict[str, Any]:
    """Attributes of the response that tell about the surface, as netCDF takes them."""
    plain = {
        name: value.item() if isinstance(value, np.number) else value
        for name, value in response.attrs.items()
        if name not in _OWN_ATTRIBUTES
    }
    return {name: value for name, value in plain.items() if isinstance(value, str | int | float)}
