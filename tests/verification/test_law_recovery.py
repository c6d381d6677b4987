r"""A known law goes in, the same law comes out: law, stiffness and uncertainty.

Lengths are in units of the rms height or of the wave's amplitude, pressures in units of the contact
modulus times the rms slope or of the pressure of complete contact.
"""

import numpy as np
import pytest

from multiscale.laws import ConvexDecreasing
from multiscale.upscaling import area_from_dataset, fit_law, law_from_dataset
from tests.upscaling.responses import response_of


def greenwood_williamson(order, gap):
    r"""Integral of :math:`(z-g)^{order} \varphi(z)` over z > g, by z = g + t^2 and Gauss points."""
    t, weight = np.polynomial.legendre.leggauss(120)
    t, weight = 1.75 * (t + 1.0), 1.75 * weight
    density = np.exp(-((np.asarray(gap)[..., None] + t**2) ** 2) / 2.0) / np.sqrt(2.0 * np.pi)
    return np.sum(2.0 * weight * t ** (2.0 * order + 1.0) * density, axis=-1)


def greenwood_williamson_gap(pressure):
    gap = np.linspace(-1.0, 4.5, 4001)
    guess = np.interp(-np.log(pressure), -np.log(greenwood_williamson(1.5, gap)), gap)
    for _ in range(5):
        p, k = greenwood_williamson(1.5, guess), 1.5 * greenwood_williamson(0.5, guess)
        guess = guess + (p - pressure) / k
    return guess


def power(exponent):
    return (
        lambda p: 1.0 - p ** (1.0 / exponent),
        lambda p: exponent * p ** (1.0 - 1.0 / exponent),
        (0.025, 0.5),
    )


FAMILIES = {  # gap and stiffness as functions of pressure, range of pressure
    "exponential": (lambda p: 0.45 * np.log(0.4 / p), lambda p: p / 0.45, (0.005, 0.1)),
    "power 3/2": power(1.5),
    "power 2": power(2.0),
    "power 10/3": power(10.0 / 3.0),
    "Westergaard": (lambda s: 1.0 - s + s * np.log(s), lambda s: -1.0 / np.log(s), (0.025, 0.5)),
    "Greenwood-Williamson": (
        greenwood_williamson_gap,
        lambda p: 1.5 * greenwood_williamson(0.5, greenwood_williamson_gap(p)),
        tuple(greenwood_williamson(1.5, [3.0, 0.0])),  # 3 rms to mean plane, p up to 1000-fold
    ),
}


def recovered(family, n_pressures, *, length=1.0, unit=1.0):
    """Relative errors of pressure and stiffness, ends of the range included."""
    gap, stiffness, ends = FAMILIES[family]
    pressure = np.geomspace(*ends, n_pressures)
    law = law_from_dataset(fit_law(response_of(length * gap(pressure)[None], unit * pressure)))
    between = np.geomspace(*ends, 401)
    return (
        law.pressure(length * gap(between)) / (unit * between) - 1.0,
        law.stiffness(length * gap(between)) / (unit / length * stiffness(between)) - 1.0,
    )


@pytest.mark.parametrize("n_pressures", [8, 10])
@pytest.mark.parametrize("family", FAMILIES)
def test_pressure_and_stiffness_are_recovered(family, n_pressures):
    pressure_error, stiffness_error = recovered(family, n_pressures)
    assert np.max(np.abs(pressure_error)) < 0.002
    assert np.max(np.abs(stiffness_error)) < 0.02


@pytest.mark.parametrize("family", ["exponential", "power 3/2", "power 2", "power 10/3"])
def test_laws_that_the_ridge_does_not_see_are_recovered_closely(family):
    pressure_error, stiffness_error = recovered(family, 8)
    assert np.max(np.abs(pressure_error)) < 2e-4
    assert np.max(np.abs(stiffness_error)) < 2e-3


@pytest.mark.parametrize("family", ["exponential", "Westergaard"])
@pytest.mark.parametrize(
    ("length", "unit"),
    [
        pytest.param(1e9, 1e-9, id="nm and GPa"),
        pytest.param(1e-9, 1e9, id="a nanometre in m and Pa"),
        pytest.param(1e3, 1e3, id="km and kPa"),
    ],
)
def test_recovery_does_not_depend_on_the_units(family, length, unit):
    for scaled, plain in zip(
        recovered(family, 8, length=length, unit=unit), recovered(family, 8), strict=True
    ):
        np.testing.assert_allclose(scaled, plain, atol=1e-7)


def test_the_error_reported_predicts_the_error_made():
    """Westergaard close to complete contact, where the stiffness is infinite."""
    gap, _, _ = FAMILIES["Westergaard"]
    smooth, steep = (
        fit_law(response_of(gap(pressure)[None], pressure)).attrs
        for pressure in (np.geomspace(0.025, 0.5, 8), np.geomspace(0.05, 0.95, 8))
    )
    assert smooth["cross_validated_error"] < 0.02
    assert steep["cross_validated_error"] > 3.0 * smooth["cross_validated_error"]


def test_area_of_greenwood_williamson_is_recovered():
    gap, _, ends = FAMILIES["Greenwood-Williamson"]
    pressure, between = np.geomspace(*ends, 10), np.geomspace(*ends, 101)
    area = area_from_dataset(
        fit_law(
            response_of(
                gap(pressure)[None], pressure, area=greenwood_williamson(1.0, gap(pressure))[None]
            )
        )
    )
    expected = greenwood_williamson(1.0, gap(between))
    np.testing.assert_allclose(area.contact_fraction(between), expected, rtol=0.002)


def quantities(law, pressures):
    """Mean decay length, pressure at three gaps, gap at three pressures."""
    inside = np.geomspace(0.005, 0.1, 21)
    gap = law.gap_at(np.append(inside, pressures))
    decay = np.mean(inside / law.stiffness(gap[:21]))
    return np.array([decay, *law.pressure(0.45 * np.log(0.4 / pressures)), *gap[21:]])


@pytest.mark.long
@pytest.mark.parametrize("n_realisations", [4, 12, 20])
def test_bootstrap_bands_cover_the_true_law(n_realisations):
    """Realisations with 3 % scatter of the gap between them and .01 of white noise, in rms
    heights; 95 % intervals of 200 samples."""
    random, n_repeats = np.random.default_rng(seed=11), 200
    pressure, at = np.geomspace(0.005, 0.1, 8), np.array([0.008, 0.03, 0.08])
    u = 0.45 * np.log(0.4 / pressure)
    truth = np.array([0.45, *at, *(0.45 * np.log(0.4 / at))])
    inside, computed = [], []
    for repeat in range(n_repeats):
        gap = u * (1.0 + 0.03 * random.standard_normal((n_realisations, 1)))
        gap += 0.01 * random.standard_normal((n_realisations, 8))
        dataset = fit_law(response_of(gap, pressure), seed=repeat)
        knot, drawn = dataset["knot"].values, dataset["coefficient_sample"].values
        samples = [quantities(ConvexDecreasing(knot, sample), at) for sample in drawn]
        low, high = np.percentile(samples, [2.5, 97.5], axis=0)
        inside.append((low <= truth) & (truth <= high))
        computed.append(quantities(law_from_dataset(dataset), at))
    coverage, bias = np.mean(inside, axis=0), np.mean(computed, axis=0) / truth - 1.0
    assert np.all((coverage >= 0.88) & (coverage <= 0.97)), coverage
    assert np.all(np.abs(bias) < 0.02), bias
    if n_realisations == 20:
        assert np.std(computed, axis=0)[0] / 0.45 < 0.02
