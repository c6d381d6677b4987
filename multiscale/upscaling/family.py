"""Families of laws with a few parameters, built in or defined by the user."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from multiscale.laws import (
    BellFriction,
    Coulomb,
    DecayingFriction,
    Dilatant,
    ErrorFunctionArea,
    Exponential,
    HystereticLaw,
    NormalLaw,
    PowerLaw,
    PowerStiffness,
)
from multiscale.upscaling.observations import Observations


@dataclass(frozen=True)
class Parameter:
    """Unit (UDUNITS spelling) and lower end of the open range of a parameter."""

    unit: str
    lower: float = 0.0


@dataclass(frozen=True)
class Family:
    """Laws of the same formula with a few parameters.

    Parameters
    ----------
    quantities : tuple of str
        Quantities that the family can be fitted to: keys of ``QUANTITIES``.
    make : callable
        Builds the law from the parameters and the ``held`` values, as keywords. A normal law gets
        the pressures of the data as its ``pressure_range``.
    start : callable, estimates of the parameters, SI, inside their ranges, from observations
    held : callable, optional
        Keywords of ``make`` that follow from the data and are not fitted, such as a reference
        pressure: from observations to a mapping of name to (value, unit).

    Examples
    --------
    A user family, an exponential law of given decay length:

    >>> from multiscale.laws import Exponential
    >>> rigid = Family(
    ...     "exponential, 0.5 um",
    ...     ("gap",),
    ...     {"pressure_scale": Parameter("Pa")},
    ...     make=lambda pressure_scale: Exponential(pressure_scale, 0.5e-6),
    ...     start=lambda seen: {"pressure_scale": float(seen.pressure.max())},
    ... )
    """

    name: str
    quantities: tuple[str, ...]
    parameters: Mapping[str, Parameter]
    make: Callable[..., Any]
    start: Callable[[Observations], Mapping[str, float]]
    held: Callable[[Observations], Mapping[str, tuple[float, str]]] = field(
        default=lambda observations: {}
    )
    even: bool = False  # whether parts scatter alike at all pressures


def gaps_of(observations: Observations, values: np.ndarray) -> np.ndarray:
    """Return gaps, m, of values (..., points); a stiffness is integrated from the top."""
    if observations.quantity == "normal_stiffness":
        return integrate_stiffness(observations.pressure, values)
    return values


def integrate_stiffness(pressure: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Integrate gaps, m, (..., points), from stiffnesses, Pa/m, powers of the rising pressure."""
    # g(p) = integral of dp' / K(p') from p to the largest pressure (1)
    p, compliance = pressure, pressure / stiffness  # p / K: dg = (p / K) d ln p
    ratio = compliance[..., 1:] / compliance[..., :-1]
    flat = np.abs(ratio - 1.0) < 1e-6
    mean = np.where(
        flat,
        0.5 * (compliance[..., 1:] + compliance[..., :-1]),
        np.diff(compliance, axis=-1) / np.where(flat, 1.0, np.log(np.where(flat, 2.0, ratio))),
    )
    steps = mean * np.diff(np.log(p))
    total = np.cumsum(steps[..., ::-1], axis=-1)[..., ::-1]
    return np.concatenate([total, np.zeros((*total.shape[:-1], 1))], axis=-1)


def _start_exponential(observations: Observations) -> dict[str, float]:
    """Fit a line through the gap over the logarithm of the pressure."""
    p, gap = observations.pressure, gaps_of(observations, observations.mean)
    slope, offset = np.polyfit(np.log(p), gap, 1)
    decay = max(-float(slope), 1e-6 * float(np.ptp(gap)))
    return {"decay_length": decay, "pressure_scale": float(np.exp(min(offset / decay, 700.0)))}


def _start_power(observations: Observations) -> dict[str, float]:
    """Estimate the exponent from the change of the decay length with the pressure."""
    p, gap = observations.pressure, gaps_of(observations, observations.mean)
    x = np.log(p)
    decay = -np.diff(gap) / np.diff(x)
    beta = np.polyfit(0.5 * (x[1:] + x[:-1]), np.log(np.maximum(decay, 1e-3 * decay.max())), 1)[0]
    m = 1.0 / float(np.clip(beta, 0.05, 0.95))
    # g = s - b p^(1/m)
    slope, support = np.polyfit(p ** (1.0 / m), gap, 1)
    support = max(float(support), float(gap.max()) + 0.05 * float(np.ptp(gap)))
    return {
        "support": support,
        "exponent": m,
        "pressure_scale": float((support / max(-slope, 1e-300)) ** m),
    }


def _start_dilatant(observations: Observations) -> dict[str, float]:
    """Fit a line through the gap over the inverse root of the pressure."""
    slope, height = np.polyfit(observations.pressure**-0.5, observations.mean, 1)
    slope = max(float(slope), 1e-6 * float(height))
    return {"pressure_scale": (slope / float(height)) ** 2, "solid_height": float(height)}


def _start_error_function(observations: Observations) -> dict[str, float]:
    """Invert the mean area at each pressure."""
    from scipy.special import erfinv

    area = np.clip(observations.mean, 1e-6, 0.999)
    return {"pressure_scale": float(np.median(observations.pressure / erfinv(area)))}


def _reference(observations: Observations) -> dict[str, tuple[float, str]]:
    """Return the geometric mean of the pressures, where the parameters are least correlated."""
    return {"reference_pressure": (float(np.exp(np.mean(np.log(observations.pressure)))), "Pa")}


def _start_stiffness(observations: Observations) -> dict[str, float]:
    x = np.log(observations.pressure / _reference(observations)["reference_pressure"][0])
    slope, level = np.polyfit(x, np.log(observations.mean), 1)
    return {"stiffness_scale": float(np.exp(level)), "exponent": max(float(slope), 0.05)}


def _start_decaying(observations: Observations) -> dict[str, float]:
    """Estimate from both ends of the range of speeds, and the speed of the mean coefficient."""
    mean, speed = observations.mean, observations.conditions[1]
    order = np.argsort(speed)
    share = max(1, mean.size // 5)
    slow, fast = mean[order[:share]].mean(), mean[order[-share:]].mean()
    half = np.argmin(np.abs(mean[order] - 0.5 * (slow + fast)))
    speeds = speed[speed > 0.0]
    decay = float(max(speed[order[half]], speeds.min())) / np.log(2.0)
    return {
        "static_coefficient": float(slow),
        "kinetic_coefficient": float(fast),
        "decay_speed": decay,
    }


def _start_bell(observations: Observations) -> dict[str, float]:
    """Estimate from the peak, and mean slopes of the logarithm to the slowest and the fastest."""
    mean, speed = observations.mean, observations.conditions[1]
    x = np.log(np.maximum(speed, speed[speed > 0.0].min()))
    level = np.log(np.maximum(mean, 1e-3 * mean.max()))
    peak, slowest, fastest = np.argmax(mean), np.argmin(x), np.argmax(x)

    def slope(end: np.intp) -> float:
        away = abs(float(x[end] - x[peak])) or 1.0
        return float(np.clip((level[peak] - level[end]) / away, 0.1, 1.0))

    return {
        "peak_coefficient": float(mean.max()),
        "peak_speed": float(np.exp(x[peak])),
        "rise_exponent": slope(slowest),
        "fall_exponent": slope(fastest),
        "pressure_exponent": 0.0,
        "speed_exponent": 0.0,
    }


_FAMILIES = (
    Family(
        "exponential",
        ("gap", "normal_stiffness"),
        {"pressure_scale": Parameter("Pa"), "decay_length": Parameter("m")},
        Exponential,
        _start_exponential,
    ),
    Family(
        "power",
        ("gap", "normal_stiffness"),
        {
            "pressure_scale": Parameter("Pa"),
            "support": Parameter("m"),
            "exponent": Parameter("1", lower=1.0),
        },
        PowerLaw,
        _start_power,
    ),
    Family(
        "dilatant",
        ("gap",),
        {"pressure_scale": Parameter("Pa"), "solid_height": Parameter("m")},
        Dilatant,
        _start_dilatant,
        even=True,
    ),
    Family(
        "error_function",
        ("contact_fraction",),
        {"pressure_scale": Parameter("Pa")},
        ErrorFunctionArea,
        _start_error_function,
    ),
    Family(
        "power_stiffness",
        ("tangential_stiffness",),
        {"stiffness_scale": Parameter("Pa m-1"), "exponent": Parameter("1")},
        PowerStiffness,
        _start_stiffness,
        _reference,
    ),
    Family(
        "coulomb",
        ("friction_coefficient",),
        {"friction_coefficient": Parameter("1")},
        Coulomb,
        lambda observations: {"friction_coefficient": float(np.mean(observations.mean))},
    ),
    Family(
        "decaying",
        ("friction_coefficient",),
        {
            "static_coefficient": Parameter("1"),
            "kinetic_coefficient": Parameter("1"),
            "decay_speed": Parameter("m s-1"),
        },
        DecayingFriction,
        _start_decaying,
    ),
    Family(
        "bell",
        ("friction_coefficient",),
        {
            "peak_coefficient": Parameter("1"),
            "peak_speed": Parameter("m s-1"),
            "rise_exponent": Parameter("1"),
            "fall_exponent": Parameter("1"),
            "pressure_exponent": Parameter("1", lower=-np.inf),
            "speed_exponent": Parameter("1", lower=-np.inf),
        },
        BellFriction,
        _start_bell,
        _reference,
    ),
)
FAMILIES = {family.name: family for family in _FAMILIES}
"""The built-in families with parameters, by name."""


def families_of(quantity: str) -> list[Family]:
    """Return the families that are compared for a quantity; even scatter is of grains only."""
    return [each for each in _FAMILIES if quantity in each.quantities and not each.even]


def unloading_family(loading: NormalLaw) -> Family:
    """Return the family of the unloading branches of an interface with this loading law."""
    return Family(
        "unloading",
        ("recovery",),
        {"stiffness_ratio": Parameter("1", lower=1.0), "exponent": Parameter("1", lower=1.0)},
        lambda stiffness_ratio, exponent: HystereticLaw(loading, stiffness_ratio, exponent),
        lambda observations: {"stiffness_ratio": 2.0, "exponent": 1.5},
    )
