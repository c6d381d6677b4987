"""Loose packings: no grain touches another grain or a wall."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from multiscale.macro.granulate import ContactLaw, column, draw_radii, release, silo

LAW = ContactLaw(0.4)


def overlap(grains):
    """Largest overlap of two grains, m."""
    i, j = np.triu_indices(grains.n, 1)
    return np.max(grains.radius[i] + grains.radius[j] - pdist(grains.position))


@pytest.mark.parametrize(("diameter", "least_extent"), [(0.023, 0.0), (0.05, 0.0), (0.11, 0.06)])
def test_grains_in_a_silo_fill_the_pipe_and_touch_nothing(diameter, least_extent):
    grains = silo(draw_radii(80, 8e-3, 10e-3), diameter, LAW).grains
    across = np.hypot(*grains.position[:, :2].T) + grains.radius
    assert np.all(across < 0.5 * diameter)
    assert np.ptp(grains.position[:, 0]) >= least_extent
    assert np.all(grains.position[:, 2] > grains.radius)
    assert overlap(grains) < 0.0


def test_discs_of_a_column_stand_between_wall_and_gate_until_it_is_gone():
    model = column(draw_radii(30, 8e-3, 10e-3), 0.15, LAW)
    x, radius = model.grains.position[:, 0], model.grains.radius
    assert np.all((x > radius) & (x < 0.15 - radius))
    assert overlap(model.grains) < 0.0
    free = release(model, model.grains)
    assert [wall.point for wall in free.walls] == [wall.point for wall in model.walls[:2]]
    assert not free.grains.velocity.any()
