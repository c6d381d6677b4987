"""What cells lack of a measured map counts in the budget of the law."""

import numpy as np
import pytest

from multiscale.micro import Cell, Path, run_ensemble, self_affine
from multiscale.schema import MICRO_RESPONSE
from multiscale.surfaces import low_pass, rms_height, rms_slope
from multiscale.upscaling import error_budget, fit_law
from tests.upscaling.responses import DECAY, PRESSURE, exponential_gaps, response_of

HEIGHT, SLOPE = 1e-6, 0.1
QUANTITIES = ("mean_gap", "contact_fraction", "stiffness")


def from_map(response, height, slope, bodies=1):
    """A response of cells with shares of the height and slope of alike bodies."""
    n = response.sizes["realisation"]
    part = 1.0 / np.sqrt(bodies)  # of each body
    values = {
        "rms_height": np.full(n, HEIGHT),
        "rms_slope": np.full(n, SLOPE),
        "body_rms_height": [[part * HEIGHT / height] * 2 + [part * HEIGHT]] * bodies,
        "body_rms_slope": [[part * SLOPE / slope] * 2 + [part * SLOPE]] * bodies,
    }
    return MICRO_RESPONSE.assign(response, values).assign_coords(stage=["map", "windows", "cells"])


def surface_terms(response):
    budget = error_budget(response, fit_law(response))
    return budget, budget["error_half_width"].sel(error_term="surface").values


@pytest.mark.parametrize("bodies", [1, 2])
def test_the_surface_term_of_an_exponential_law_is_a_closed_form(bodies):
    height, slope = 0.9, 0.8
    response = from_map(response_of(exponential_gaps(8)), height, slope, bodies)
    budget, (gap, area, stiffness) = surface_terms(response)
    g = response["mean_gap"].values.mean(axis=0)
    u = DECAY * np.mean(g / (DECAY * np.log(4e8 / PRESSURE)))
    inner = slice(2, -1)  # below the data the law is a power law, at the ends it bends
    shift = u * np.log(1.0 / slope) / g
    np.testing.assert_allclose(gap[inner], 2.0 * (1 / height - 1 + shift)[inner], rtol=0.03)
    np.testing.assert_allclose(area[inner], 2.0 * (1.0 - slope), rtol=0.02)
    np.testing.assert_allclose(stiffness[inner], 2.0 * (1.0 - height), atol=0.05)
    assert "0.9 of the rms height and 0.8 of the rms slope" in budget.attrs["how_surface"]


def test_surfaces_that_are_no_parts_of_maps_lack_nothing():
    budget, terms = surface_terms(response_of(exponential_gaps(8)))
    assert np.all(terms == 0.0)
    assert "surface" not in budget.attrs["unknown"]


def test_windows_that_are_rougher_than_their_map_lack_nothing():
    _, terms = surface_terms(from_map(response_of(exponential_gaps(8)), 1.3, 1.1))
    assert np.all(terms == 0.0)


@pytest.mark.parametrize(("height", "slope"), [(0.13, 0.9), (0.9, 0.4)])
def test_a_missing_share_beyond_half_is_unknown_and_not_small(height, slope):
    budget, terms = surface_terms(from_map(response_of(exponential_gaps(8)), height, slope))
    assert np.all(np.isnan(terms))
    assert "surface" in budget.attrs["unknown"].split(", ")
    assert budget.attrs["how_surface"].startswith("not known: the cells have")


@pytest.mark.long
@pytest.mark.parametrize("hurst", [0.5, 0.8])
@pytest.mark.parametrize("factor", [1.5, 2.0, 3.0])
def test_the_surface_term_holds_what_filtered_cells_miss(hurst, factor):
    """Solved twice: whole surfaces, and the same without their short waves."""
    n, shortest = 96, 6.0 / 96
    whole = [
        self_affine(
            (n, n),
            (1.0, 1.0),
            seed,
            hurst_exponent=hurst,
            long_cutoff=0.5,
            short_cutoff=shortest,
            rms_slope=0.1,
        )
        for seed in range(4)
    ]
    path = Path(pressure=tuple(1e8 * np.geomspace(0.02, 0.3, 7)))
    answers = []
    for surfaces in (whole, [low_pass(sample, factor * shortest) for sample in whole]):
        cells = [Cell(surface, 1.0, 12, 1e9, 0.0, geometry="flat") for surface in surfaces]
        answers.append((surfaces, run_ensemble(cells, path)))
    (_, truth), (surfaces, computed) = answers
    shares = [
        np.sqrt(
            np.mean([f(surface) ** 2 for surface in surfaces])
            / np.mean([f(sample) ** 2 for sample in whole])
        )
        for f in (rms_height, rms_slope)
    ]
    roughness = {
        f"body_{name}": [
            [np.sqrt(np.mean(computed[name].values ** 2)) / share] * 2
            + [np.sqrt(np.mean(computed[name].values ** 2))]
        ]
        for name, share in zip(("rms_height", "rms_slope"), shares, strict=True)
    }
    computed = MICRO_RESPONSE.assign(computed, roughness).assign_coords(
        stage=["map", "windows", "cells"]
    )
    _, terms = surface_terms(computed)

    def values(response):
        gap = response["mean_gap"].values.mean(axis=0)
        pressure = response["nominal_pressure"].values
        stiffness = -pressure / np.gradient(gap, np.log(pressure))
        return gap, response["contact_fraction"].values.mean(axis=0), stiffness

    for term, mine, true in zip(terms, values(computed), values(truth), strict=True):
        missed = np.abs(true / mine - 1.0)[1:-1]
        assert np.all(missed <= term[1:-1])
        assert np.any(missed > 0.1 * term[1:-1])  # and not by being far too wide
