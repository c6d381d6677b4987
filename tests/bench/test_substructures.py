"""Cut structures by every method: the same answer, and histories that end there."""

import numpy as np
import pytest

from multiscale.bench.substructures import CUT_METHODS, RIGHT, make_scenes
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


def test_errors_of_bodies_are_errors_of_their_stresses(scenes):
    scene = scenes["plate"]
    u = scene.solve(CUT_METHODS[0]).value
    assert scene.error(1.003 * u, u) == pytest.approx(3e-3, rel=1e-9)
    assert scene.error(u, u) == 0.0
