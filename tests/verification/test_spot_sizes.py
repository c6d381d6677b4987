"""Sizes of contact spots of self-affine surfaces against the published power law."""

import numpy as np
import pytest

from multiscale.micro import Cell, Path, run_ensemble, self_affine

POINTS = 256


@pytest.mark.slow
@pytest.mark.parametrize("hurst", [0.8, 0.5])
def test_sizes_of_spots_fall_by_the_law_of_self_affine_islands(hurst):
    # ground_steel's Hurst exponent is .8. Islands of a self-affine surface have the number density
    # A^-(2 - H/2), so N(> A) falls by 1 - H/2 (Korcak's law; J. Phys.: Condens. Matter 23 (2011)
    # 215004 uses it for contacts); elastic contact keeps a power law between the size of the
    # shortest wave and a largest size (Mueser and Wang, Lubricants 6 (2018) 85), which Hill's
    # estimator above a quarter of the shortest wave's square sees as a slightly steeper fall
    surfaces = [
        self_affine(
            (POINTS, POINTS),
            (1.0, 1.0),
            seed,
            rms_slope=0.1,
            hurst_exponent=hurst,
            long_cutoff=0.5,
            short_cutoff=8.0 / POINTS,
        )
        for seed in range(6)
    ]
    cells = [Cell(surface, 1.0, 8, 0.91, 0.3, geometry="flat") for surface in surfaces]
    found = run_ensemble(cells, Path(pressure=(0.004,)), keep_spots=True)
    area = found["spot_area"].values.ravel() * POINTS**2
    least = 16.0
    above = area[area > least]
    exponent = 1.0 / np.mean(np.log(above / least))
    assert len(above) > 150
    assert exponent == pytest.approx(1.0 - 0.5 * hurst, abs=0.1)
