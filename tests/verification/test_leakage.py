"""Gaps of random surfaces and patchworks, against published percolation and effective media."""

import numpy as np
import pytest

from multiscale.micro.averages import gap_flow
from multiscale.upscaling.transport import effective_permeability
from tests.support import press_flat, rough_square


@pytest.mark.slow
def test_the_gap_of_random_surfaces_percolates_up_to_42_per_cent_of_contact():
    """W. B. Dapp and others, Phys. Rev. Lett. 108 (2012) 244301; cells of 4 waves: .400 +- .010."""
    surfaces = [rough_square(128, 0.25, 0.0625, 0.1, seed=seed) for seed in range(8)]
    pressure = 0.1 * np.arange(0.17, 0.3, 0.02)  # over the slope times E*: .17 to .29
    response = press_flat(surfaces, pressure, keep_flow=True)
    area = response["contact_fraction"].to_numpy()[..., None]
    opened = response["hydraulic_aperture"].to_numpy() > 0.0
    assert opened[:, 0].all()
    assert not opened[:, -1].any()
    assert np.all(np.diff(opened.astype(int), axis=1) <= 0)  # closed points stay closed
    last, first = np.max(area * opened, axis=1), np.min(np.where(opened, 1.0, area), axis=1)
    assert np.mean(0.5 * (last + first)) == pytest.approx(0.42, abs=0.03)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_patchwork_of_cells_conducts_like_its_effective_medium(axis):
    """Permeabilities of 32 x 32 cells are lognormal, their mean is 4 % too large."""
    k = np.exp(0.3 * np.random.default_rng(1).normal(size=(32, 32)))
    gap = np.cbrt(np.kron(k, np.ones((4, 4))))
    expected = effective_permeability(k.reshape(-1, 1), np.ones((1, k.size, 1))).item()
    assert gap_flow(gap, (1.0, 1.0), axis).aperture ** 3 == pytest.approx(expected, rel=3e-3)
    assert np.mean(k) > 1.03 * expected
