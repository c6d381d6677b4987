"""Bodies condensed once onto their joints answer as whole bodies do, and near paths are short."""

from dataclasses import replace

import numpy as np
import pytest

from multiscale.fe.mesh_file import box_mesh
from multiscale.laws.bulk import Elastic
from multiscale.macro import AssembledNewton, Assembly, Body
from multiscale.macro.bodies import stacked_blocks
from multiscale.macro.substructures import (
    LoadPath,
    condense_assembly,
    follow_cut_loads,
    follow_loads,
    joint_path,
    load_joint,
    measure_loads,
    whole,
)
from tests.macro.substructures.test_bolts import AREA, BOLT, EDGE, LAW, E, sheared


def load_whole(monkeypatch, *arguments):
    """Load a joint with all unknowns of the bodies."""
    with monkeypatch.context() as patch:
        patch.setattr(whole, "DENSE", 0)
        return load_joint(*arguments, method=AssembledNewton(), extrapolate=True)


BOLTED = sheared(replace(BOLT, preload=AREA))  # by 1 Pa


def stacked(law=LAW):
    return stacked_blocks((EDGE,) * 3, (2, 2, 2), [Elastic(E, 0.3)] * 2, [law])


@pytest.mark.parametrize("assembly", [BOLTED, stacked()], ids=["bolted", "stacked"])
def test_condensed_bodies_answer_as_whole_bodies(assembly, monkeypatch):
    """Constraint modes and modes of the loads represent every displacement under these loads."""
    loading = joint_path((10e6, 20e6), 2e6, cycles=1, steps=2, amplitudes=(1e6,))
    result = load_joint(assembly, loading, method=AssembledNewton(), extrapolate=True)
    whole = load_whole(monkeypatch, assembly, loading)
    assert set(result.variables) == set(whole.variables)
    assert result.sizes == whole.sizes
    assert result.attrs == whole.attrs
    for name in set(result.data_vars) - {"residual", "iterations", "wall_time"}:
        size = np.nanmax(np.abs(whole[name].values.astype(float)))
        error = np.abs(result[name].values - whole[name].values)
        assert np.nanmax(error) <= 1e-7 * size, name
    small = condense_assembly(assembly, AssembledNewton()).small
    assert small.n < result.attrs["unknowns"]


@pytest.mark.slow
def test_a_joint_that_slides_away_is_reported_on_condensed_bodies(monkeypatch):
    loading = joint_path((10e6,), 5e6, cycles=1, steps=2)
    result = load_joint(BOLTED, loading, method=AssembledNewton(), extrapolate=True)
    whole = load_whole(monkeypatch, BOLTED, loading)
    assert result.converged.values.sum() < result.sizes["step"]
    assert "there is no equilibrium: the bodies slide on interface 0 under a load" in result.failure
    assert result.failure == whole.failure
    np.testing.assert_array_equal(
        np.isnan(result.displacement.values), np.isnan(whole.displacement.values)
    )


def test_a_changed_law_near_a_path_has_its_answer_in_fewer_steps():
    loading = joint_path((10e6, 20e6), 2e6, cycles=1, steps=2, amplitudes=(1e6,))
    method = AssembledNewton()
    joint = condense_assembly(stacked(), method).small
    changed = joint.with_laws([replace(LAW, friction=0.306)])
    base = follow_loads(joint, loading, method=method)
    alone = follow_loads(changed, loading, method=method)
    near = follow_loads(changed, loading, method=method, near=base)
    first, other = (measure_loads(item, extrapolate=True) for item in (alone, near))
    for name in ("cycle_loss", "secant_stiffness", "joint_stiffness", "traction"):
        np.testing.assert_allclose(other[name], first[name], rtol=1e-6, atol=1.0, err_msg=name)
    newton = [
        int(sum(run.result.iterations.sum() for run in item.cycles)) for item in (alone, near)
    ]
    assert newton[1] < 0.8 * newton[0]
    again = follow_loads(joint, loading, method=method, near=base)
    assert sum(int(run.result.iterations.sum()) for run in again.cycles) == 0


def test_a_body_without_interfaces_follows_its_loads_as_a_bar_does():
    fixed = {"left": (0.0, None, None), "front": (None, 0.0, None), "bottom": (None, None, 0.0)}
    pulled = {"right": (1.0, 0.0, 0.0)}
    bar = Body(box_mesh((0.1, EDGE, EDGE), (3, 1, 1)), Elastic(E, 0.3), fixed, pulled)
    path = LoadPath(("pull",), (EDGE**2,), ((1e6,), (2e6,)))
    method = AssembledNewton()
    small = condense_assembly(Assembly((bar,)), method).small
    result = follow_cut_loads(small, path, method=method)
    np.testing.assert_allclose(result.load_stiffness[:, 0], E * EDGE**2 / 0.1, rtol=1e-9)
    np.testing.assert_allclose(result.load_secant[:, 0], E * EDGE**2 / 0.1, rtol=1e-9)
    np.testing.assert_array_equal(result.interface_compliance, 0.0)
