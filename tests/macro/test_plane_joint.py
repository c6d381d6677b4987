"""Two blocks in plane strain: with a law, and with their roughness in the mesh."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.laws import Exponential
from multiscale.macro.joint.plane_joint import PlaneJoint, press_plane_joint, resolve_plane_joint
from tests.closed_forms import westergaard

E, LENGTH, HEIGHT = 1e11, 0.02, 0.01


def test_a_law_in_series_with_the_blocks():
    law = Exponential(pressure_scale=1e9, decay_length=2e-6)
    joint = PlaneJoint(LENGTH, HEIGHT, E, 0.0, approach=5e-6)
    found = press_plane_joint(joint, law, elements=4)
    p = found.mean_pressure
    np.testing.assert_allclose(found.pressure, p, rtol=1e-7)
    gap = float(law.gap_at(np.array(p)))
    assert found.mean_gap == pytest.approx(gap, rel=1e-7)
    assert p == pytest.approx((5e-6 + gap) * E / (2.0 * HEIGHT), rel=1e-7)  # nu = 0: springs


def test_a_tilted_platen_presses_one_side_more():
    law = Exponential(pressure_scale=1e9, decay_length=2e-6)
    joint = PlaneJoint(LENGTH, HEIGHT, E, 0.3, approach=5e-6, tilt=0.8)
    coarse, fine = (press_plane_joint(joint, law, elements=n) for n in (16, 32))
    order = np.argsort(fine.position)
    inner = order[np.abs(fine.position[order]) < 0.3 * LENGTH]  # edges give way
    assert np.all(np.diff(fine.pressure[inner]) > 0.0)
    assert coarse.mean_gap == pytest.approx(fine.mean_gap, rel=1e-3)


def test_a_smooth_joint_closes():
    joint = PlaneJoint(LENGTH, HEIGHT, E, 0.0, approach=5e-6)
    found = resolve_plane_joint(joint, np.zeros(8))
    np.testing.assert_allclose(found.pressure, 5e-6 * E / (2.0 * HEIGHT), rtol=1e-9)
    assert abs(found.mean_gap) < 1e-12 * HEIGHT


def test_short_waves_on_the_face_carry_what_westergaard_says():
    """Eight waves on 256 nodes; both blocks give way: 1/E* is twice that of one."""
    waves, n, amplitude = 8, 256, 2e-6
    profile = -amplitude * np.cos(2.0 * np.pi * waves * np.arange(n) / n)  # free at the edges
    joint = PlaneJoint(LENGTH, HEIGHT, E, 0.0, approach=8e-6)
    found = resolve_plane_joint(joint, profile)
    full = westergaard.full_contact_pressure(amplitude, LENGTH / waves, 0.5 * E)
    middle = np.abs(found.position) < LENGTH * (0.5 - 1.0 / waves)
    ratio = found.weight[middle] @ found.pressure[middle] / found.weight[middle].sum() / full
    gap = found.weight[middle] @ found.gap[middle] / found.weight[middle].sum() / amplitude
    assert 0.2 < ratio < 0.8
    assert gap == pytest.approx(float(westergaard.mean_gap(np.array(ratio))), rel=3e-2)


def test_a_joint_that_cannot_be_is_refused():
    with pytest.raises(CaseError, match="tilt must lie between -1 and 1"):
        PlaneJoint(LENGTH, HEIGHT, E, 0.3, approach=5e-6, tilt=1.5)
    with pytest.raises(CaseError, match=r"approach must be positive \(m\), got -1"):
        PlaneJoint(LENGTH, HEIGHT, E, 0.3, approach=-1.0)
