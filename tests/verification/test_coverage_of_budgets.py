r"""Stated 95 % totals of few realisations against the means of many of the same cells.

Ten scenes of flat cells that differ in Hurst's exponent, band, slope, pressures and family of the
law. The truth of a scene are 96 realisations, pressed in half the steps and beyond the ends of the
data; 60 others are divided into ensembles of 3, 4, 5 and 6. A total covers an error at a step of an
ensemble. Steps and ensembles of one scene share its truth and its fit, so that the interval of the
coverage is Student's over the scenes.
"""

import logging
import runpy

import numpy as np
import pytest

from tests.support import SCENES as WORKFLOWS

STUDY = runpy.run_path(str(WORKFLOWS.parent / "manual" / "intervals.py"))
Scene, QUANTITIES = STUDY["Scene"], STUDY["QUANTITIES"]

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


@pytest.mark.long
def test_totals_of_three_to_six_realisations_hold_in_95_of_100():
    """The interval of the coverage over the scenes contains .95 for each quantity and number."""
    sizes = (3, 4, 5, 6)
    result = np.array(
        [STUDY["coverage"](k, scene, sizes, truth=96, others=60) for k, scene in enumerate(SCENES)]
    )
    mean = result.mean(axis=0)
    half = 2.2622 * result.std(axis=0, ddof=1) / np.sqrt(len(SCENES))
    logging.getLogger(__name__).info(
        "coverage of %s by %s: %s +- %s", QUANTITIES, sizes, mean, half
    )
    assert np.all(np.abs(mean - 0.95) <= half), (mean, half)
