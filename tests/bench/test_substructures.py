"""Cut structures by every method: the same answer, and histories that end there."""

import numpy as np
import pytest

from multiscale.bench import bench, substructures
from multiscale.bench.substructures import CUT_METHODS, RIGHT, make_scenes
from multiscale.bench.summary import tabulate_runs
from multiscale.macro.substructures import assemble


@pytest.fixture(scope="module")
def scenes():
    return {scene.name.split()[0].strip(","): scene for scene in make_scenes(quick=True)}


@pytest.mark.parametrize("name", ["grid", "plate", "rough"])
def test_every_method_finds_the_same_and_its_history_ends_there(scenes, name):
    scene = scenes[name]
    whole = scene.solve(CUT_METHODS[0])
    assert whole.converged
    for method in CUT_METHODS[1:]:
        answer = scene.solve(method, whole)
        assert answer.converged
        assert answer.unknowns == whole.unknowns
        error = scene.error(answer.value, whole.value)
        assert error <= RIGHT
        seconds, errors = answer.history.T
        assert np.all(np.diff(seconds) > 0.0)
        assert errors[0] > 1e-2
        assert errors[-1] == pytest.approx(error, rel=0.5, abs=1e-12)
        assert len(errors) >= answer.iterations


def test_the_rough_joint_slips_in_part(scenes):
    scene = scenes["rough"]
    whole = assemble(scene.structure)
    law = scene.structure.joints[0].law
    jump = (whole.jump @ scene.solve(CUT_METHODS[0]).value).reshape(3, -1)
    slipping = law.sliding(jump, np.zeros((law.n_state, whole.weight.size))).slipping
    assert 0.2 < whole.weight @ slipping / whole.weight.sum() < 0.8


def test_errors_of_bodies_are_those_of_their_stresses(scenes):
    scene = scenes["plate"]
    u = scene.solve(CUT_METHODS[0]).value
    assert scene.error(1.003 * u, u) == pytest.approx(3e-3, rel=1e-9)
    assert scene.error(u, u) == 0.0


@pytest.mark.slow
def test_a_lost_process_leaves_a_row_without_values_and_the_rest_is_drawn(
    in_this_process, monkeypatch, stored
):
    in_this_process.append(
        lambda scene, method, *_: scene.name.startswith("plate") and method == CUT_METHODS[2]
    )
    monkeypatch.setattr(substructures, "QUICK_MODULES", (4,))
    lines = []
    found = bench("substructures", quick=True, report=lines.append)
    assert len(lines) == found.sizes["run"] == 9
    lost = np.arange(9) == 5
    np.testing.assert_array_equal(found["converged"], np.where(lost, 0, 1))
    assert np.all(found["error"].values[~lost] <= RIGHT)
    for name in ("error", "wall_time", "iterations", "unknowns"):
        assert np.isnan(found[name][lost]).all()
    assert set(found["history_run"].values) == {1, 2, 4, 7, 8}

    head, rows = tabulate_runs(stored(found, 20_000))
    assert "unknowns" in head
    assert sum("not converged" in " ".join(row) for row in rows) == 1
