"""Lives by jumps against lives cycle by cycle."""

import numpy as np
import pytest

from multiscale.bench import bench
from multiscale.bench.damage_family import SCENES, life


@pytest.mark.parametrize("scene", SCENES)
def test_jumps_give_the_life_of_every_cycle_for_a_share_of_them(scene):
    every, followed = life(scene, None)
    lives, counts = np.array([life(scene, tolerance) for tolerance in (0.1, 0.01)]).T
    errors, shares = np.abs(lives / every - 1.0), counts / followed
    assert errors[1] < 1e-3
    assert errors[1] < errors[0] < 0.1
    assert shares[0] < shares[1] < 0.2


@pytest.mark.slow
@pytest.mark.usefixtures("in_this_process")
def test_every_cycle_is_nearest_to_the_reference_then_the_finer_of_both_tolerances():
    found = bench("damage", quick=True)
    by_tolerance = dict(zip(found["tolerance"].values, found["error"].values, strict=True))
    assert by_tolerance[0.0] < 1e-3
    assert by_tolerance[0.01] < by_tolerance[0.1] < 0.1


@pytest.mark.slow
def test_a_process_that_died_leaves_no_number(in_this_process):
    in_this_process.append(lambda *_: True)
    found = bench("damage", quick=True)
    assert not found["converged"].values.any()
    assert np.isnan(found["error"].values).all()
