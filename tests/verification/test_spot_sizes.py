"""Sizes of contact spots of self-affine surfaces against the published power law."""

import numpy as np
import pytest

from multiscale.micro import Cell, Path, run_ensemble
from multiscale.pipeline import load_case
from multiscale.pipeline.case_cells import composite_material, make_surfaces
from tests.support import press_flat, rough_square

POINTS = 256


@pytest.mark.slow
def test_spots_of_ground_steel_follow_its_shortest_wave_on_every_grid():
    # too few waves for a power law: the exponent that Hill's estimator finds grows with the size
    # above which it looks, from .3 to 2, whatever the grid
    case, exponents, means = load_case("ground_steel"), [], []
    for points in (128, 256):
        cell = case.cell.model_copy(update={"points": (points, points), "geometry": "flat"})
        micro = case.micro.model_copy(update={"realisations": 4})
        surfaces = make_surfaces(case.model_copy(update={"cell": cell, "micro": micro}))
        material, depth = composite_material(case), case.cell.given_depth
        cells = [Cell(surface, depth, 14, *material, geometry="flat") for surface in surfaces]
        area = run_ensemble(cells, Path(pressure=(240e6,)), keep_spots=True)["spot_area"].values
        area = area[np.isfinite(area)] / case.body_1.surface.short_cutoff**2
        means.append(area.mean())
        above = [area[area > least] / least for least in (1 / 64, 1 / 4, 1.0)]
        exponents.append([1.0 / np.mean(np.log(level)) for level in above])
    assert means[0] == pytest.approx(means[1], rel=0.06)
    assert 0.5 < means[1] < 1.1
    np.testing.assert_allclose(exponents[0], exponents[1], rtol=0.06)
    assert np.all(np.diff(exponents[1]) > 0.3)


@pytest.mark.slow
@pytest.mark.parametrize("hurst", [0.8, 0.5])
def test_sizes_of_spots_fall_by_the_law_of_self_affine_islands(hurst):
    # ground_steel's Hurst exponent is .8. Islands of a self-affine surface have the number density
    # A^-(2 - H/2), so N(> A) falls by 1 - H/2 (Korcak's law; J. Phys.: Condens. Matter 23 (2011)
    # 215004 uses it for contacts); elastic contact keeps a power law between the size of the
    # shortest wave and a largest size (Mueser and Wang, Lubricants 6 (2018) 85), which Hill's
    # estimator above a quarter of the shortest wave's square sees as a slightly steeper fall
    band = 0.5, 8.0 / POINTS, 0.1
    surfaces = [rough_square(POINTS, *band, seed=seed, hurst=hurst) for seed in range(6)]
    response = press_flat(surfaces, (0.004,), keep_spots=True)
    area = response["spot_area"].values.ravel() * POINTS**2
    least = 16.0
    above = area[area > least]
    exponent = 1.0 / np.mean(np.log(above / least))
    assert len(above) > 150
    assert exponent == pytest.approx(1.0 - 0.5 * hurst, abs=0.1)
