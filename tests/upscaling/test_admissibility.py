"""The report lists the faults of a law, and their size."""

from dataclasses import dataclass

import numpy as np
import pytest

from multiscale.laws import (
    AreaLaw,
    BellFriction,
    ConvexDecreasing,
    Coulomb,
    ErrorFunctionArea,
    Exponential,
    FrictionLaw,
    HystereticLaw,
    PowerLaw,
    PowerStiffness,
    Response,
)
from multiscale.laws.pressure_functions import StiffnessLaw
from multiscale.upscaling import admissibility

PRESSURES = (1e6, 1e8)
GOOD = [
    Exponential(4e8, 1e-6),
    PowerLaw(4e8, 1e-6, 1.5),
    ConvexDecreasing(np.array([1e-6]), np.array([1e27])),
    Coulomb(0.0),
    BellFriction(1.0, 0.01, 0.4, 0.6, -0.3, 0.5, 1e7),
    PowerStiffness(1e13, 0.5, 1e7),
    ErrorFunctionArea(1e9),
    AreaLaw(np.array([1e6, 1e7]), np.array([0.01, 0.1])),
    HystereticLaw(Exponential(4e8, 1e-6), 1.0, 1.5),
    HystereticLaw(PowerLaw(4e8, 1e-6, 2.0), 2.0, 1.5),
]


@pytest.mark.parametrize("law", GOOD, ids=lambda law: type(law).__name__)
def test_laws_that_are_admissible_pass(law):
    report = admissibility(law, PRESSURES)
    assert report.passed, str(report)
    assert "holds" in str(report)


class Sticky(Exponential):
    """Pulls when it is far away."""

    def pressure(self, gap):
        return super().pressure(gap) - 2e6


class Bent(Exponential):
    """A stiffness that is not the derivative of the pressure."""

    def stiffness(self, gap):
        return 1.5 * super().stiffness(gap)


class Preferring(Exponential):
    """A shear traction along a fixed direction."""

    def respond(self, jump, state):
        response = super().respond(jump, state)
        traction = response.traction.copy()
        traction[1] = 0.1 * traction[0]
        return Response(traction, response.tangent, state)


@dataclass(frozen=True)
class Pump(Exponential):
    """Pushes more while it opens than while it closes: its state is the last gap."""

    n_state = 1

    def respond(self, jump, state):
        response = super().respond(jump, state)
        opening = jump[0] + self.gap > state[0]
        return Response(response.traction * np.where(opening, 1.2, 1.0), response.tangent, jump[:1])


class Driving(FrictionLaw):
    """Drives slow sliding on, and resists more along x than along y."""

    def coefficient(self, pressure, speed):
        return np.where(speed < 1e-3, -0.1, 0.3) + 0.0 * pressure

    def traction(self, pressure, velocity):
        return super().traction(pressure, velocity) * np.array([[1.2], [1.0]])


class Softening(StiffnessLaw):
    def stiffness_at(self, pressure):
        return 1e20 / pressure


class Overfull:
    def contact_fraction(self, pressure):
        return 0.01 + pressure / 1e9


@pytest.mark.parametrize(
    ("law", "broken"),
    [
        (Sticky(4e8, 1e-6), {"sign"}),
        (Bent(4e8, 1e-6), {"convex"}),
        (Preferring(4e8, 1e-6), {"objective"}),
        (Pump(4e8, 1e-6), {"dissipation"}),
        (Driving(), {"sign", "dissipation", "objective"}),
        (Softening(), {"monotone"}),
        (Overfull(), {"zero without pressure", "at most one"}),
        # a linear loading law gives back more by a power of 3 than it took
        (HystereticLaw(PowerLaw(4e8, 1e-6, 1.0), 1.0, 3.0), {"dissipation"}),
    ],
    ids=lambda value: type(value).__name__ if not isinstance(value, set) else "",
)
def test_each_fault_is_detected(law, broken):
    report = admissibility(law, PRESSURES)
    assert broken <= set(report.violated)
    assert not report.passed
    assert "violated by" in str(report)


def test_dissipation_of_unloading_turns_where_theory_predicts():
    """For a power law of exponent m loading dissipates if n (m + 1) <= beta (n + 1) m."""
    m, n = 1.5, 3.0
    limit = n * (m + 1.0) / ((n + 1.0) * m)
    for ratio, expected in ((1.01 * limit, True), (0.99 * limit, False)):
        report = admissibility(HystereticLaw(PowerLaw(4e8, 1e-6, m), ratio, n), PRESSURES)
        assert ("dissipation" not in report.violated) is expected
