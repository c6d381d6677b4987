r"""Stated 95 % totals of few realisations against the means of many of the same cells.

Ten scenes of flat cells that differ in Hurst's exponent, band, slope, pressures and family of the
law. The truth of a scene are 96 realisations, pressed in half the steps and beyond the ends of the
data; 60 others are divided into ensembles of 3, 4, 5 and 6. A total covers an error at a step of an
ensemble. Steps and ensembles of one scene share its truth and its fit, so that the interval of the
coverage is Student's over the scenes.
"""

import logging
from dataclasses import dataclass

import numpy as np
import pytest

from multiscale.upscaling import (
    area_from_dataset,
    error_budget,
    fit_law,
    law_from_dataset,
)
from tests.support import press_flat, rough_square

MODULUS, NU, EDGE = 1e9, 0.3, 1e-3
TRUTH, OTHERS = 96, 60
QUANTITIES = ("mean gap", "contact fraction", "stiffness")


@dataclass(frozen=True)
class Scene:
    """Waves per edge, longest over shortest wave, and pressures over E* times the slope."""

    hurst: float
    waves: int
    band: int
    slope: float
    pressures: np.ndarray
    points: int
    family: str | None = None


SCENES = (
    Scene(0.8, 2, 4, 0.1, np.geomspace(0.01, 0.5, 8), 32),
    Scene(0.5, 2, 3, 0.05, np.geomspace(0.02, 0.3, 6), 24),
    Scene(0.3, 3, 2, 0.1, np.array([0.01, 0.025, 0.05, 0.1, 0.2]), 24),
    Scene(0.9, 2, 4, 0.2, np.geomspace(0.005, 0.3, 9), 32),
    Scene(0.8, 4, 2, 0.1, np.geomspace(0.02, 0.4, 8), 32),
    Scene(0.6, 1, 6, 0.15, np.geomspace(0.01, 0.4, 7), 24),
    Scene(0.4, 2, 2, 0.02, np.geomspace(0.03, 0.3, 5), 24),
    Scene(0.7, 3, 2, 0.1, np.geomspace(0.003, 0.1, 10), 24),
    Scene(0.8, 2, 4, 0.1, np.geomspace(0.02, 0.2, 5), 32, "exponential"),
    Scene(0.5, 3, 2, 0.08, np.geomspace(0.01, 0.3, 7), 24, "power"),
)


def halved(pressure):
    """The pressures, those half way between them, and half a step beyond either end."""
    x = np.log(pressure)
    places = np.arange(-0.5, x.size, 0.5)
    inner = np.interp(places, np.arange(x.size), x)
    inner[0], inner[-1] = 1.5 * x[0] - 0.5 * x[1], 1.5 * x[-1] - 0.5 * x[-2]
    return np.exp(inner)


def press(number, scene):
    """Response of all realisations of a scene at the halved steps."""
    band = EDGE / scene.waves, EDGE / scene.waves / scene.band, scene.slope
    options = {"size": EDGE, "hurst": scene.hurst}
    surfaces = [
        rough_square(scene.points, *band, seed=100_000 * number + seed, **options)
        for seed in [*range(TRUTH), *range(192, 192 + OTHERS)]
    ]
    pressure = MODULUS / (1.0 - NU**2) * scene.slope * halved(scene.pressures)
    return press_flat(surfaces, pressure, MODULUS, NU)


def values_of(law, pressure):
    single_law = law_from_dataset(law)
    gap = single_law.gap_at(pressure)
    return np.array(
        [gap, area_from_dataset(law).contact_fraction(pressure), single_law.stiffness(gap)]
    )


def coverage(number, scene, sizes):
    """Share of the steps of ensembles that is covered, (sizes, quantities)."""
    response = press(number, scene)
    many = response.isel(realisation=slice(TRUTH))
    data = response.isel(step=slice(1, None, 2))
    pressure = data["nominal_pressure"].values
    gap, area = (
        many[name].where(many["converged"] == 1).mean("realisation").to_numpy()[1::2]
        for name in ("mean_gap", "contact_fraction")
    )
    truth = np.array([gap, area, values_of(fit_law(many, n_samples=0), pressure)[2]])
    results = []
    for n in sizes:
        covered = []
        for first in range(TRUTH, TRUTH + OTHERS, n):
            few = data.isel(realisation=slice(first, first + n))
            law = fit_law(few, family=scene.family, n_samples=0)
            value, total = values_of(law, pressure), error_budget(few, law)["error_total"].values
            covered.append(np.abs(value - truth) <= total * np.abs(value))
        results.append(np.mean(covered, axis=(0, 2)))
    return np.array(results)


@pytest.mark.long
def test_totals_of_three_to_six_realisations_hold_in_95_of_100():
    """The interval of the coverage over the scenes contains .95 for each quantity and number."""
    sizes = (3, 4, 5, 6)
    result = np.array([coverage(k, scene, sizes) for k, scene in enumerate(SCENES)])
    mean = result.mean(axis=0)
    half = 2.2622 * result.std(axis=0, ddof=1) / np.sqrt(len(SCENES))
    logging.getLogger(__name__).info(
        "coverage of %s by %s: %s +- %s", QUANTITIES, sizes, mean, half
    )
    assert np.all(np.abs(mean - 0.95) <= half), (mean, half)
