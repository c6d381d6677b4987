"""Laws refuse parameters outside their range in a sentence."""

from dataclasses import replace

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.laws import (
    AreaLaw,
    AsperityLaw,
    BellFriction,
    ConvexDecreasing,
    Coulomb,
    DecayingFriction,
    Exponential,
    HystereticLaw,
    ModifiedLaw,
    PowerLaw,
    PowerStiffness,
    RigidContact,
    Sliders,
    Tabulated,
    class_densities,
)  # fmt: skip
from multiscale.laws.bulk import J2, AnisotropicElastic, Elastic, NeoHookean, Prony
from tests.laws.test_asperities import ONE
from tests.laws.test_every_law import SIGNED
from tests.laws.test_sliders import NORMAL, SPLINE, bed

REFUSED = [
    # normal laws
    (lambda: Exponential(-1.0, 1.0), r"pressure_scale must be positive and finite \(Pa\)"),
    (lambda: Exponential(1.0, 0.0), r"decay_length must be positive and finite \(m\), got 0"),
    (lambda: ModifiedLaw(SIGNED, 1.0), "from 0 to below 1, got 1; remove an interface"),
    (
        lambda: ModifiedLaw(SIGNED, factor=0.0),
        r"factor must be positive and finite \(1\), got 0",
    ),
    (lambda: PowerLaw(-1.0, 1.0, 2.0), r"pressure_scale must be positive and finite \(Pa\)"),
    (lambda: PowerLaw(1.0, 0.0, 2.0), r"support must be positive and finite \(m\), got 0"),
    (lambda: PowerLaw(1.0, 1.0, 0.9), "exponent must be at least 1"),
    (lambda: ConvexDecreasing(np.ones(2), np.ones(3)), "lists of equal length"),
    (lambda: Tabulated(np.zeros(1), np.zeros(1)), "two points or more"),
    (lambda: Tabulated(np.array([1.0, 2.0]), np.array([0.0, -1.0])), "begin at the pressure"),
    (lambda: Tabulated(np.array([0.0, 2.0]), np.array([0.0, 1.0])), "point 0 to 1 of a table"),
    (lambda: Tabulated(np.arange(3.0), np.array([0.0, -1.0, -3.0])), "not convex at point 1"),
    (lambda: ConvexDecreasing(np.array([1.0, 1.0]), np.ones(2)), "must increase"),
    (lambda: ConvexDecreasing(np.array([1.0, 2.0]), np.array([np.nan, 1.0])), "be finite"),
    (lambda: ConvexDecreasing(np.array([1.0, 2.0]), np.array([-2.0, 1.0])), "below the first"),
    (lambda: ConvexDecreasing(np.array([1.0, 2.0]), np.array([1.0, 0.0])), "last knot must be"),
    # friction
    (
        lambda: Coulomb(-0.1),
        r"friction_coefficient must not be negative, but finite \(1\), got -0.1",
    ),
    (lambda: DecayingFriction(0.3, 0.2, 0.0), r"decay_speed must be positive .*\(m/s\)"),
    (lambda: BellFriction(1.0, 0.1, 0.0, 1.0, 0.0, 0.0, 1e5), "rise_exponent must be positive"),
    (lambda: BellFriction(1.0, 0.1, 1.0, -1.0, 0.0, 0.0, 1e5), "fall_exponent must be posit"),
    (
        lambda: BellFriction(1.0, 0.1, 1.0, 1.0, np.nan, 0.0, 1e5),
        "pressure_exponent must be fin",
    ),
    (lambda: BellFriction(1.0, 0.1, 1.0, 1.0, 0.0, np.inf, 1e5), "speed_exponent must be fini"),
    # sliders
    (lambda: bed(friction=-0.1), "friction must not be negative"),
    (lambda: bed(friction=np.nan), "friction must not be negative"),
    (lambda: Sliders(SPLINE, 0.3, 0.0), "stiffness_ratio must be positive"),
    (lambda: bed(slabs=0), "at least one slab, got 0"),
    (lambda: Sliders(NORMAL, 0.3), r"got 0 and inf; give pressures=\(low, high\)"),
    (lambda: bed(pressures=(1e8, 1e6)), "lowest and a highest pressure"),
    (lambda: bed(RigidContact(0.3)), "got the type RigidContact; give a NormalLaw"),
    # asperities
    (lambda: replace(ONE, density=np.zeros(1)), "give the density"),
    (lambda: replace(ONE, radius=-1.0), "radius must be positive"),
    (lambda: replace(ONE, tangent_modulus=1e12), "tangent_modulus must be from 0 to less"),
    (lambda: replace(ONE, height=np.zeros(2)), "lists of equal length"),
    (lambda: class_densities([0.0, 1.0], [0.0, 0.0], 1.0), "nor all zero"),
    (lambda: class_densities([1.0, 0.0], [1.0, 1.0], 1.0), "must rise"),
    (lambda: AsperityLaw(ONE, friction=-0.1), "friction must not be negative"),
    # bulk laws
    (lambda: Prony(1.0, 0.3, (0.5,), (1.0, 2.0)), "1 weights and 2 times"),
    (lambda: Prony(1.0, 0.3, (0.5, 0.6), (1.0, 2.0)), "add up to less than 1"),
    (lambda: Prony(1.0, 0.3, (0.5,), (0.0,)), "relaxation times must be positive"),
    (lambda: Prony(1.0, 0.3, (0.5,), (1.0,), -1.0), "time_step must not be negative"),
    (lambda: Elastic(-1.0, 0.3), "youngs_modulus must be positive"),
    (lambda: AnisotropicElastic(np.eye(3)), "6 x 6 and finite"),
    (lambda: AnisotropicElastic(np.triu(np.ones((6, 6)))), "symmetric"),
    (lambda: AnisotropicElastic(np.diag([1.0, 1, 0, 1, 1, 1])), "the solid is cut through"),
    (lambda: NeoHookean(1.0, 0.5), "poissons_ratio must lie between -1 and 0.5"),
    (lambda: J2(1.0, 0.3, 0.0), "yield_stress must be positive"),
    (
        lambda: J2(1.0, 0.3, 1.0, -1.0),
        r"hardening_modulus must not be negative \(Pa\).*softens",
    ),
    (lambda: J2(1.0, 0.3, 1.0, saturation_stress=0.5), "at least the yield_stress"),
    # plastic contact, stiffness and area
    (lambda: HystereticLaw(Exponential(1.0, 1.0), 0.9, 1.5), "stiffness_ratio must be at least 1"),
    (lambda: HystereticLaw(Exponential(1.0, 1.0), 1.5, 0.9), "exponent must be at least 1"),
    (
        lambda: PowerStiffness(0.0, 1.0, 1.0),
        r"stiffness_scale must be positive .*\(Pa/m\)",
    ),
    (lambda: PowerStiffness(1.0, -1.0, 1.0), "exponent must not be negative, but finite"),
    (lambda: AreaLaw(np.array([1.0]), np.array([0.1])), "at least two pressures"),
    (lambda: AreaLaw(np.array([0.0, 1.0]), np.array([0.0, 0.1])), "must be positive and increase"),
    (lambda: AreaLaw(np.array([2.0, 1.0]), np.array([0.1, 0.2])), "must be positive and increase"),
    (lambda: AreaLaw(np.array([1.0, 2.0]), np.array([0.2, 0.1])), "never decrease"),
    (lambda: AreaLaw(np.array([1.0, 2.0]), np.array([0.2, 1.1])), "between 0 and 1"),
    (lambda: AreaLaw(np.array([1.0, 2.0]), np.array([0.2, np.nan])), "between 0 and 1"),
]


@pytest.mark.parametrize(("make", "sentence"), REFUSED)
def test_parameters_outside_their_range_are_refused(make, sentence):
    with pytest.raises(CaseError, match=sentence):
        make()
