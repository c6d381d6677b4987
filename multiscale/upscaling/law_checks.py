"""Admissibility of laws: sign, shape, dissipation and objectivity, each with its worst value."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import singledispatch
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws import FrictionLaw, HystereticLaw, NormalLaw
from multiscale.laws.pressure_functions import StiffnessLaw
from multiscale.units import readable

SLACK = 1e-9  # of the largest value tested
SPEEDS = (1e-6, 1e2)  # m/s, at which friction laws are tested
POINTS = 500  # at which a law is tested


@dataclass(frozen=True)
class Admissibility:
    """Checks of a law: the worst violation of each property over the largest value tested."""

    pressure_range: tuple[float, float]  # Pa
    worst: Mapping[str, float]  # of "sign", "monotone", "convex", "dissipation" and the like

    @property
    def violated(self) -> dict[str, float]:
        """Properties that do not hold up to round-off."""
        return {name: worst for name, worst in self.worst.items() if not worst <= SLACK}

    @property
    def passed(self) -> bool:
        """Whether every property holds."""
        return not self.violated

    def __str__(self) -> str:
        """Return the report as a line."""
        low, high = (readable(f"{end:.3g} Pa") for end in self.pressure_range)
        words = {
            name: f"violated by {x:.2g} of the largest value" for name, x in self.worst.items()
        }
        words |= dict.fromkeys(self.worst.keys() - self.violated.keys(), "holds")
        return f"{'; '.join(map(': '.join, words.items()))} (from {low} to {high})"


def admissibility(law: Any, pressure_range: tuple[float, float]) -> Admissibility:
    """Report whether a law is admissible.

    Parameters
    ----------
    law : NormalLaw, HystereticLaw, FrictionLaw, StiffnessLaw, or a law with a contact fraction
        Built in or defined by the user.
    pressure_range : tuple of float
        Smallest and largest pressure tested, Pa. A normal law is tested between the gaps of these
        and as far again to either side, a friction law also over :data:`SPEEDS` and at rest.

    Returns
    -------
    Admissibility
        A normal law is positive, decreasing and convex, gains no energy over a closed cycle of the
        gap, and has a traction independent of the frame of the tangent plane. A friction law has a
        coefficient and a power that are not negative, and rotates with the frame. A contact
        fraction starts at zero, never falls and stays below 1. A stiffness is positive and never
        falls. Unloading is stiffer than loading, and no cycle gains energy.

    Raises
    ------
    CaseError
        If the law is of another kind.
    """
    return Admissibility(pressure_range, _checks(law, pressure_range))


@singledispatch
def _checks(law: Any, pressure_range: tuple[float, float]) -> dict[str, float]:
    """Check a law by its kind; a contact fraction from no pressure to 100 times the largest."""
    if not hasattr(law, "contact_fraction"):
        raise CaseError(
            f"a law of type {type(law).__name__} cannot be checked; derive it from NormalLaw, "
            f"FrictionLaw or StiffnessLaw, or give it a contact_fraction"
        )
    low, high = pressure_range
    p = np.append(0.0, np.geomspace(low / 100.0, 100.0 * high, POINTS))
    a = law.contact_fraction(p)
    return {
        "zero without pressure": _worst(np.abs(a[:1]), a),
        "monotone": _worst(-np.diff(a), a),
        "at most one": _worst(a - 1.0, a),
    }


@_checks.register
def _check_normal(law: NormalLaw, pressure_range: tuple[float, float]) -> dict[str, float]:
    """Check a normal law; the secant of a convex law lies between the tangents."""
    far, near = law.gap_at(np.array(pressure_range))
    gap = np.linspace(near - (far - near), far + (far - near), POINTS)
    p, k = law.pressure(gap), law.stiffness(gap)
    secant = -np.diff(p) / np.diff(gap)
    jump = np.zeros((3, 5))
    jump[0] = np.linspace(near, far, 5) - law.gap
    jump[1:] = far - near
    traction = law.respond(jump, np.zeros((law.n_state, 5))).traction
    return {
        "sign": _worst(-np.minimum(p / _size(p), k / _size(k)), np.ones(1)),
        "monotone": _worst(np.diff(p), p),
        "convex": _worst(np.maximum(secant - k[:-1], k[1:] - secant), k),
        "dissipation": _worst(*_cycle(law, gap)),
        "objective": _worst(np.abs(traction[1:]), traction[0]),
    }


def _cycle(law: NormalLaw, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the energy that a cycle of the gap gains, and the work of its first half, J/m^2."""
    path = np.concatenate([gap[::-1], gap[1:]])
    jump = np.zeros((3, path.size))
    jump[0] = path - law.gap
    if not law.n_state:  # without history: all points at once
        p = -law.respond(jump, np.zeros((0, path.size))).traction[0]
    else:
        state, pressures = np.zeros((law.n_state, 1)), []
        for k in range(path.size):
            response = law.respond(jump[:, k : k + 1], state)
            state = response.state
            pressures.append(-response.traction[0, 0])
        p = np.array(pressures)
    work = 0.5 * (p[1:] + p[:-1]) * np.diff(path)
    return np.array([work.sum()]), np.array([work[: gap.size].sum()])


@_checks.register
def _check_unloading(law: HystereticLaw, pressure_range: tuple[float, float]) -> dict[str, float]:
    """Check the loading law, and the energy of its unloading branches, eq. (2) of the law."""
    loading = _check_normal(law.loading, pressure_range)
    peak = np.geomspace(*pressure_range, POINTS)
    corner, length = law.loading.gap_at(peak), law.branch(peak).support
    share = np.linspace(0.0, 1.0, 41)[:, None]
    gap = corner + share * length
    p = peak * (1.0 - share) ** law.exponent
    returned = peak * length / (law.exponent + 1.0)
    rate = np.diff(returned) / -np.diff(corner)  # per approach
    return {
        **{f"loading, {name}": worst for name, worst in loading.items()},
        "unloading below loading": _worst(p - law.loading.pressure(gap), peak),
        "dissipation": _worst(rate - peak[1:], peak),
    }


@_checks.register
def _check_friction(law: FrictionLaw, pressure_range: tuple[float, float]) -> dict[str, float]:
    """Check friction at many pressures, speeds and directions, in two frames."""
    random = np.random.default_rng(seed=0)
    p, speed = (
        low * (high / low) ** random.random(POINTS) for low, high in (pressure_range, SPEEDS)
    )
    speed[0] = 0.0
    angle, turn = random.uniform(0.0, 2.0 * np.pi, (2, POINTS))
    v = speed * np.array([np.cos(angle), np.sin(angle)])
    c, s = np.cos(turn), np.sin(turn)

    def turned(vector: np.ndarray) -> np.ndarray:
        return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])

    mu, t = law.coefficient(p, speed), law.traction(p, v)
    power = np.sum(t * v, axis=0) / (p * np.where(speed > 0.0, speed, 1.0))
    miss = (law.traction(p, turned(v)) - turned(t)) / p
    return {
        "sign": _worst(-mu, mu),
        "dissipation": _worst(-power, mu),
        "objective": _worst(np.abs(miss), mu),
    }


@_checks.register
def _check_stiffness(law: StiffnessLaw, pressure_range: tuple[float, float]) -> dict[str, float]:
    values = law.stiffness_at(np.geomspace(*pressure_range, POINTS))
    return {
        "sign": _worst(-values, values),
        "monotone": _worst(-np.diff(values), values),
    }


def _size(values: np.ndarray) -> float:
    """Return the largest absolute value, 1 if all are zero, NaN if any is not finite."""
    largest = float(np.max(np.abs(values)))
    return largest if largest > 0.0 else 1.0


def _worst(violation: np.ndarray, values: np.ndarray) -> float:
    """Return the largest violation over the largest value; NaN if anything is not finite."""
    if not (np.all(np.isfinite(violation)) and np.all(np.isfinite(values))):
        return float("nan")
    return float(np.max(violation)) / _size(values)
