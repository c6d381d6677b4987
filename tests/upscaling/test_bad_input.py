"""Insufficient data are refused in a sentence that states which data would be sufficient."""

import re

import numpy as np
import pytest

from multiscale.schema import MICRO_RESPONSE
from multiscale.upscaling import error_budget, fit_law
from tests.upscaling.responses import PRESSURE, exponential_gaps, response_of

GAPS = exponential_gaps(6, spread=0.1)


def response(n=6, **options):
    return response_of(GAPS[:n], **options)


def in_micrometres():
    data = response()
    return data.assign(mean_gap=(data["mean_gap"] * 1e6).assign_attrs(units="um"))


def tensile():
    data = response()
    return data.assign(traction=-data["traction"].assign_attrs(data["traction"].attrs))


def zigzag():
    gaps = GAPS.copy()
    gaps[:, 4] = gaps[:, 2]
    return response_of(gaps)


def lost():
    gaps = GAPS.copy()
    gaps[2, 3] = np.nan
    return response_of(gaps)


def with_heights(factor):
    return MICRO_RESPONSE.assign(response_of(factor * GAPS), {"rms_height": np.full(6, 1e-6)})


def test_a_gap_that_no_roughness_keeps_open_is_a_caution_where_heights_are_not_known():
    assert fit_law(response_of(GAPS), n_samples=0).attrs["cautions"] == ""
    caution = fit_law(response_of(1e6 * GAPS), n_samples=0).attrs["cautions"]
    assert re.match(r"the largest mean gap of 2\.\d+ m is too large for roughness", caution)


@pytest.mark.parametrize(
    ("factor", "sentence"),
    [
        (1.0, ""),
        (9.0, "is larger than 2.58, the largest possible with contact on 13 %"),
        (0.1, "needs valleys deeper than 6.99 rms heights, since the contact area is small"),
    ],
)
def test_a_slip_of_units_by_ten_is_a_caution(factor, sentence):
    """With .13 of them in contact heights leave at most sqrt(1/.13 - 1) = 2.6 times their rms."""
    caution = fit_law(with_heights(factor), n_samples=0).attrs["cautions"]
    assert sentence in caution
    assert bool(caution) == bool(sentence)


def test_no_surface_that_is_flat_but_for_its_peaks_leaves_more_than_the_bound():
    """Heights of two values, the peaks in contact, are the worst case of the bound."""
    area = PRESSURE[None] / 5e8
    worst = 1e-6 * np.sqrt(1.0 / area - 1.0)
    heights = {"rms_height": np.full(1, 1e-6)}
    for factor, cautions in ((0.999, 0), (1.001, 1)):
        data = MICRO_RESPONSE.assign(response_of(factor * worst, area=area), heights)
        assert len(fit_law(data, n_samples=0).attrs["cautions"].splitlines()) == cautions


def test_a_law_lists_its_pressures_per_decade_and_which_branches_are_measured():
    law = fit_law(response_of(GAPS), n_samples=0)
    assert law.attrs["pressures_per_decade"] == pytest.approx(7 / np.log10(20.0))
    assert law.attrs["branches"].startswith("loading: measured; unloading: assumed, along the same")
    few = np.geomspace(1e4, 1e8, 8)
    coarse = fit_law(response_of(GAPS, few, area=np.tile(few / 5e8, (6, 1))), n_samples=0)
    assert "the law has 1.8 pressures per decade" in coarse.attrs["cautions"]


def budget_of(**others):
    data = response()
    return error_budget(data, fit_law(data, n_samples=0), **others)
