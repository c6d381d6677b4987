"""Observations against the law that was fitted to them: within its error, left out, or refused."""

import re

import numpy as np
import pytest
import xarray as xr

from multiscale.errors import CaseError
from multiscale.laws import Exponential
from multiscale.macro import Block, RoughJoint, press_joint
from multiscale.micro import Cell, Path, run_ensemble
from multiscale.pipeline.real_contact import negative_gap
from multiscale.schema import MICRO_RESPONSE, UNLOADING
from multiscale.upscaling import (
    area_from_dataset,
    error_budget,
    fit_law,
    law_from_dataset,
    loading_branch,
    observe,
)
from multiscale.upscaling.branches import take_sliding_friction, with_sliding, with_unloading
from multiscale.upscaling.shear_fit import with_shear
from multiscale.upscaling.transport import with_leakage
from tests.support import rough_square
from tests.upscaling.responses import DECAY, SCALE, response_of, sheared_exponentials, slid

HARDNESS = 1e9  # Pa
PRESSURE = np.array([0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, 0.95]) * HARDNESS
STIFFEST = 0.4 * HARDNESS  # pressure up to which the gaps below are convex


def softening_gaps(pressure, spread=0.01):
    """Three gaps that fall as an exponential law up to a pressure, and ever faster above."""
    above = np.maximum(0.0, np.log(pressure / STIFFEST))
    gap = DECAY * (np.log(4.0 * HARDNESS / pressure) - 8.0 * above**2)
    return gap * (1.0 + spread * np.array([[-1.0], [0.0], [1.0]]))


@pytest.fixture(scope="module")
def softening():
    """A response with a stiffness that falls above a pressure."""
    return response_of(softening_gaps(PRESSURE), PRESSURE, area=np.tile(PRESSURE / 2e9, (3, 1)))


def test_a_convex_law_ends_where_the_stiffness_falls(softening):
    law = fit_law(softening, n_samples=20)
    stored = PRESSURE < STIFFEST  # where the gaps on both sides are softer than the law
    np.testing.assert_allclose(law["fit_pressure"], PRESSURE[stored])
    assert law.attrs["pressure_max"] == law.attrs["pressure_limit"] == PRESSURE[stored][-1]
    assert "400 MPa, 600 MPa, 800 MPa and 950 MPa are left out" in law.attrs["cautions"]
    single_law = law_from_dataset(law)
    exact = Exponential(4.0 * HARDNESS, DECAY)
    p = PRESSURE[stored]
    np.testing.assert_allclose(single_law.gap_at(p), exact.gap_at(p), atol=0.01 * DECAY)
    np.testing.assert_allclose(single_law.stiffness(single_law.gap_at(p)), p / DECAY, rtol=0.05)
    np.testing.assert_allclose(area_from_dataset(law).contact_fraction(p), p / 2e9)
    budget = error_budget(softening, law)
    half = budget["error_total"].sel(quantity="mean_gap").values * law["fit_mean_gap"].values
    assert np.all(np.abs(single_law.gap_at(p) - law["fit_mean_gap"].values) <= half)


def test_a_structure_is_unknown_under_pressures_that_contradict_the_law(softening):
    law = law_from_dataset(fit_law(softening, n_samples=0))
    joint = RoughJoint((0.01, 0.01), *2 * [Block(0.005, 2e11, 0.3)])
    result = press_joint(joint, law, np.array([0.2, 0.3, 0.4]) * HARDNESS)
    np.testing.assert_array_equal(result["known"], [1, 1, 0])
    assert np.isnan(result["joint_stiffness"][2])
    assert "above which the cells contradict the law" in result.attrs["cautions"]


def test_gaps_without_three_pressures_of_a_convex_law_are_refused():
    some = PRESSURE[[0, 5, 7, 8]]
    response = response_of(softening_gaps(some), some, area=np.tile(some / 2e9, (3, 1)))
    with pytest.raises(CaseError, match="from 400 MPa on the stiffness of the interface falls"):
        fit_law(response, n_samples=0)


def test_errors_of_gaps_that_pass_through_zero_are_not_over_the_gaps():
    """A decay length too much of all gaps moves the law, and no error by its shape."""
    p = np.geomspace(1e7, 1e9, 9)
    budgets = []
    for shift in (0.0, 2.0 * DECAY, np.log(SCALE / 1e8 * 1.001) * DECAY):
        gap = DECAY * np.log(SCALE / p) - shift - 0.05 * DECAY * np.sin(3.0 * np.log(p))
        response = response_of(gap + 0.0 * np.zeros((3, 1)), p, area=np.tile(p / 2e9, (3, 1)))
        law = fit_law(response, n_samples=0)
        fit = error_budget(response, law)["error_half_width"].sel(error_term="fit")
        budgets.append(fit.sel(quantity="mean_gap").values * np.abs(gap))
    np.testing.assert_allclose(budgets[2], budgets[1], rtol=1e-3)


@pytest.mark.parametrize("family", ["exponential", "power"])
def test_a_family_that_misses_measurements_reports_where(family):
    """Stiffness over a power of the pressure above 1: no law of either family."""
    p = np.geomspace(1e6, 1e8, 9)
    seen = observe("normal_stiffness", p, 1e13 * (p / 1e6) ** 1.5)
    law = fit_law(seen, family=family, n_samples=0)
    assert re.search(
        r"misses the observed normal stiffness by up to 3[01]\d %", law.attrs["cautions"]
    )
    assert "8 pressures from 1 MPa to 100 MPa" in law.attrs["cautions"]
    assert "such as 'convex_decreasing'" in law.attrs["cautions"]
    assert not fit_law(seen, n_samples=0).attrs["cautions"]


def unloaded(pressure, back):
    """A response of cells that are loaded and spring back by a share of the loading curve."""
    up = DECAY * np.log(4.0 * HARDNESS / pressure)
    gap = np.concatenate([up, up[-1] + back * (up[-2::-1] - up[-1])])
    path = np.concatenate([pressure, pressure[-2::-1]])
    return response_of(np.tile(gap, (3, 1)), path, area=np.tile(path / 5e9, (3, 1)))


def branches_of(response):
    """Loading and unloading of a response."""
    return with_unloading(fit_law(loading_branch(response), n_samples=0), response, n_samples=0)


def test_cells_that_spring_back_as_they_were_loaded_have_no_unloading_branch():
    law = branches_of(unloaded(np.geomspace(1e7, 4e8, 8), 1.0))
    assert "unloading_exponent" not in law
    assert "unloading: along the loading curve" in law.attrs["branches"]
    assert "the cells spring back along it" in law.attrs["cautions"]


def test_a_spring_back_as_exponential_as_the_loading_has_an_exponent_with_an_end():
    """A share of an exponential curve is a power of infinite exponent, as stiff by its inverse."""
    law = branches_of(unloaded(np.geomspace(1e7, 4e8, 8), 0.5))
    assert float(law["unloading_exponent"]) == 1000.0
    assert float(law["unloading_stiffness_ratio"]) == pytest.approx(2.0, rel=5e-3)
    assert not law.attrs["cautions"]


def test_a_spring_back_that_no_branch_describes_is_refused():
    law = branches_of(unloaded(np.geomspace(1e7, 4e8, 8), 1.3))
    assert "unloading_exponent" not in law
    assert "unloading: refused" in law.attrs["branches"]
    assert "up to 23 % of its length from it" in law.attrs["cautions"]


def test_cells_unloaded_from_beyond_the_law_are_refused():
    path = np.concatenate([PRESSURE, PRESSURE[-2::-1]])
    gap = softening_gaps(PRESSURE)
    gap = np.hstack([gap, gap[:, -1:] + 0.3 * (gap[:, -2::-1] - gap[:, -1:])])
    response = response_of(gap, path, area=np.tile(path / 2e9, (3, 1)))
    assert (response["branch"] == UNLOADING).sum() == PRESSURE.size - 1
    with pytest.raises(CaseError, match="the law of the loading ends at 300 MPa"):
        branches_of(response)


def test_a_bed_that_misses_the_sheared_cells_reports_at_which_pressures():
    pressure = np.geomspace(5e6, 1e8, 8)
    gap = DECAY * np.log(SCALE / pressure) + np.zeros((3, 1))
    response = response_of(gap, pressure)
    decay, ratio, friction = [DECAY] * 3, np.full((3, 2), 0.8), [0.3] * 3
    shear = sheared_exponentials(decay, ratio, friction)
    law = fit_law(response, n_samples=0)
    assert not with_shear(law, response, shear).attrs["cautions"]
    before_slip = shear["slip_fraction"].values < 1.0
    shear["traction"].values[..., 1:] *= np.where(before_slip, 0.6, 1.0)[..., None]
    text = with_shear(law, response, shear).attrs["cautions"]
    assert "the bed of sliders misses the sheared cells by up to" in text
    assert "20 MPa and 80 MPa" in text


def test_friction_beyond_the_pressures_that_cells_slid_under_is_reported():
    law = fit_law(response_of(DECAY * np.log(SCALE / np.geomspace(5e6, 1e8, 8))[None]))
    law = with_sliding(law, slid([0.2, 0.3], pressures=[4e7, 1e7]))
    assert "no cell slid" not in take_sliding_friction(law, 2e7).attrs["cautions"]
    assert "no cell slid at 80 MPa" in take_sliding_friction(law, 8e7).attrs["cautions"]
    assert "is taken from 40 MPa" in take_sliding_friction(law, 8e7).attrs["cautions"]


def test_an_aperture_that_rises_with_the_pressure_is_reported():
    pressure = np.geomspace(1e6, 1e8, 9)
    gap = 1e-6 - 0.2e-6 * np.log(pressure / 1e6) + 1e-9 * np.arange(4)[:, None]
    response = response_of(gap, pressure)
    aperture = np.repeat(0.5 * gap[..., None], 2, axis=-1)
    aperture[:, 5] *= 2.0
    given = {"hydraulic_aperture": aperture, "percolating_share": aperture > 0.0}
    law = fit_law(response, n_samples=20).assign_attrs(cell_size=8e-4, longest_wave=2e-4)
    text = with_leakage(law, MICRO_RESPONSE.assign(response, given)).attrs["cautions"]
    assert "the aperture rises as the pressure rises by up to" in text


@pytest.fixture(scope="module")
def soft_cells():
    """Coarse cells with a largest local pressure, pressed until hardly anything is elastic."""
    hardness = 0.06  # of the modulus of a surface with the rms slope .08
    shares = (0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.625, 0.75, 0.9, 0.99)
    cells = (
        Cell(rough_square(32, 0.5, 0.25, 0.08, seed=k), 1.0, 8, 1.0, 0.3,
             geometry="flat", hardness=hardness)
        for k in range(3)
    )  # fmt: skip
    return run_ensemble(cells, Path(pressure=tuple(hardness * np.array(shares)))), hardness


@pytest.mark.parametrize("highest", [0.5, 0.75, 0.9, 0.99])
def test_the_law_of_cells_near_full_plastic_contact_has_their_gaps(soft_cells, highest):
    """Whatever the highest pressure: the cells lie in the intervals of the law up to its end."""
    response, hardness = soft_cells
    share = response["nominal_pressure"].values / hardness
    some = response.isel(step=np.flatnonzero(share <= highest * (1.0 + 1e-9)))
    law = fit_law(some, n_samples=0)
    p, gap = law["fit_pressure"].values, law["fit_mean_gap"].values
    single_law = law_from_dataset(law)
    budget = error_budget(some, law)["error_total"]
    half = budget.sel(quantity="mean_gap").values * np.abs(gap)
    assert np.all(np.abs(single_law.gap_at(p) - gap) <= half)
    area = some["contact_fraction"].values.mean(axis=0)[: p.size]
    np.testing.assert_allclose(area_from_dataset(law).contact_fraction(p), area, rtol=1e-9)
    # cells give the stiffness at inner pressures by their gaps on both sides
    every = response["mean_gap"].values.mean(axis=0)
    direct = response["nominal_pressure"].values
    cells = (-direct / np.gradient(every, np.log(direct)))[: p.size]
    wrong = np.abs(single_law.stiffness(gap) / cells - 1.0)[1:-1]
    assert np.all(wrong <= np.maximum(budget.sel(quantity="stiffness").values[1:-1], 0.1))
    left_out = "are left out" in law.attrs["cautions"]
    assert left_out == (p[-1] < direct[share <= highest * (1.0 + 1e-9)][-1])


def test_a_negative_mean_gap_is_explained():
    law = xr.Dataset()  # of cells
    assert negative_gap(np.array([1e-6, 0.0]), law) == []
    (sentence,) = negative_gap(np.array([1e-6, -1e-9]), law)
    assert "points at the limit of the hardness" in sentence
