"""The rough-contact scene and the boundary-element codes next to this package."""

from functools import cache, partial

import numpy as np
import pytest

from multiscale import __version__
from multiscale.bench import bench, rough_contact
from multiscale.bench.rough_contact import (
    CODES,
    Code,
    press_cell,
    press_with_contact_mechanics,
    press_with_tamaas,
)
from multiscale.bench.summary import tabulate_runs
from tests.support import rough_square

press_flat_cell, press_conforming_cell = (
    partial(press_cell, geometry) for geometry in ("flat", "conforming")
)

RELATIVE_PRESSURES = (0.01, 0.05, 0.1, 0.2, 0.5)  # p / (E* h')


def rough(points, slope, seed):
    """Waves 2 to 8: 16 points to the shortest on 128."""
    return rough_square(points, 0.5e-3, 0.125e-3, slope, seed=seed, size=1e-3)


@cache  # several tests look at the same answers
def beside_tamaas(solve, slope, seed, points=128):
    """Mean gaps over the rms height and contact fractions: of the code, of Tamaas."""
    surface = rough(points, slope, seed)
    answers = [
        [code(surface, p * 1e9 * slope, 1e9) for p in RELATIVE_PRESSURES]
        for code in (solve, press_with_tamaas)
    ]
    assert all(answer.converged for row in answers for answer in row)
    gap = np.array([[answer.mean_gap for answer in row] for row in answers])
    area = np.array([[answer.contact_fraction for answer in row] for row in answers])
    return gap / surface.heights.std(), area


@pytest.mark.parametrize("seed", [1, 2])
def test_the_flat_cell_has_gap_and_area_of_tamaas(seed):
    pytest.importorskip("tamaas")
    (gap, expected), (area, expected_area) = beside_tamaas(press_flat_cell, 0.1, seed)
    np.testing.assert_allclose(gap, expected, rtol=1e-3)
    np.testing.assert_allclose(area, expected_area, rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_the_conforming_cell_has_the_mean_gap_of_tamaas_for_small_slopes(seed):
    pytest.importorskip("tamaas")
    (gap, expected), _ = beside_tamaas(press_conforming_cell, 0.05, seed)
    np.testing.assert_allclose(gap[:4], expected[:4], rtol=0.01)
    # at 0.5 the gap is 8 % of the rms height and the difference 4 % of that gap
    np.testing.assert_allclose(gap[4], expected[4], atol=0.005)


@pytest.mark.slow
def test_the_conforming_cell_leaves_tamaas_in_proportion_to_the_slope():
    pytest.importorskip("tamaas")
    steep, shallow = (
        np.subtract(*beside_tamaas(press_conforming_cell, slope, 1)[0])
        - np.subtract(*beside_tamaas(press_flat_cell, slope, 1)[0])  # effect of the grid
        for slope in (0.1, 0.05)
    )
    np.testing.assert_allclose(steep / shallow, 2.0, rtol=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_the_conforming_cell_has_the_area_of_tamaas_for_small_slopes(seed):
    pytest.importorskip("tamaas")
    _, (area, expected) = beside_tamaas(press_conforming_cell, 0.05, seed)
    np.testing.assert_allclose(area, expected, rtol=0.03)


@pytest.mark.slow
def test_the_boundary_element_codes_agree():
    pytest.importorskip("tamaas")
    pytest.importorskip("ContactMechanics")
    surface = rough(64, 0.1, 1)
    for pressure in (0.02, 0.3):
        first, other = (
            solve(surface, pressure * 1e8, 1e9)
            for solve in (press_with_tamaas, press_with_contact_mechanics)
        )
        assert first.converged
        assert other.converged
        assert first.mean_gap == pytest.approx(other.mean_gap, rel=1e-4)
        assert first.contact_fraction == pytest.approx(other.contact_fraction, abs=1e-3)


def test_all_grids_sample_the_same_surface():
    coarse, fine = (rough_contact.scene_surface(n).heights for n in (64, 256))
    np.testing.assert_allclose(fine[::4, ::4], coarse, rtol=0.0, atol=1e-12 * np.ptp(coarse))


@pytest.fixture
def odd_codes(monkeypatch):
    """Leave out a code that is not there; fail on one grid of another code."""

    def fail_once(surface, pressure, contact_modulus):
        answer = press_flat_cell(surface, pressure, contact_modulus)
        return answer if len(surface.heights) < 256 else None

    codes = {
        "flat": CODES["multiscale flat"],
        "lost": Code(fail_once, "multiscale"),
        "absent": Code(press_flat_cell, "no_such_module"),
    }
    monkeypatch.setattr(rough_contact, "CODES", codes)


@pytest.mark.usefixtures("in_this_process", "odd_codes")
def test_missing_or_failing_codes_are_reported_and_nothing_is_invented(stored):
    lines = []
    result = bench("micro", quick=True, report=lines.append)
    assert result.attrs["cautions"] == (
        "absent is left out because it is not installed; pip install 'multiscale-contact[bench]'"
    )
    assert result.attrs["versions"].startswith(f"multiscale {__version__}")
    assert len(lines) == result.sizes["run"] == 6
    np.testing.assert_array_equal(result["converged"], [1, 1, 1, 1, 1, 0])
    assert np.isfinite(result["error"][:5]).all()
    assert np.isnan(result["error"][5])
    assert np.isnan(result["own_error"][3:]).all()  # no limit without the finest grid
    assert np.isnan(result["error_uncertainty"]).all()  # nothing checks the one limit there is
    assert np.all(np.diff(result["error"][:3]) < 0.0)
    head, rows = tabulate_runs(result)
    assert [len(row) for row in rows] == 6 * [len(head)]
    assert "not converged" in rows[5]

    again = stored(result, 10_000)
    np.testing.assert_array_equal(again["method"], result["method"])
