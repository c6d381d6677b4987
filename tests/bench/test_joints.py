"""The heuristic indicator of rough joints against true errors."""

import numpy as np
import pytest

from multiscale.bench import bench
from multiscale.bench.joints_family import JOINT_SCENES as JOINTS
from multiscale.bench.joints_family import measure_effectivity
from multiscale.bench.summary import tabulate_runs


@pytest.mark.parametrize(
    "name", [pytest.param("law like the blocks", marks=pytest.mark.slow), "stiff law"]
)
def test_the_indicator_is_near_the_true_error_of_sliding_joints(name):
    steps = measure_effectivity(JOINTS[name])
    assert len(steps) == 5
    assert all(steps)
    runs = [run for step in steps for run in step]
    late = np.array([run["effectivity"] for run in runs if run["error"] < 1e-3])
    assert late.size > 30
    assert 0.8 < np.median(late) < 3.0
    assert late.min() > 0.3
    assert late.max() < 30.0


@pytest.mark.slow
def test_the_table_has_the_effectivity_at_every_decade_of_the_error():
    lines = []
    found = bench("joints", quick=True, report=lines.append)
    assert len(lines) == 2
    assert found.sizes["run"] == 2 * 5 * 6
    assert np.all(found.error > 0.0)
    assert np.all(found.effectivity > 0.0)
    head, rows = tabulate_runs(found)
    assert "effectivity" in head
    assert len(rows) == 60
