"""Lives by jumps against lives cycle by cycle, and the dataset and figure of both."""

import numpy as np
import pytest

from multiscale.bench import bench, tabulate_runs, trials
from multiscale.bench.damage_family import SCENES, life
from multiscale.bench.measure import Measurement
from multiscale.schema import WORK_PRECISION


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
def test_the_family_leaves_a_dataset_and_a_figure(stored):
    lines = []
    found = bench("damage", quick=True, report=lines.append)
    WORK_PRECISION.check(found)
    assert found["converged"].values.all()
    assert len(lines) == found.sizes["run"] == 3
    # every cycle is nearest to the reference, then the finer of both tolerances
    by_tolerance = dict(zip(found["tolerance"].values, found["error"].values, strict=True))
    assert by_tolerance[0.0] < 1e-3
    assert by_tolerance[0.01] < by_tolerance[0.1] < 0.1
    assert len(tabulate_runs(found)[1]) == 3
    stored(found, 1000)


@pytest.mark.slow
def test_a_process_that_died_leaves_no_number(monkeypatch):
    monkeypatch.setattr(trials, "measure", lambda *_, **__: Measurement(None, np.nan, np.nan))
    found = bench("damage", quick=True)
    assert not found["converged"].values.any()
    assert np.isnan(found["error"].values).all()
