"""A rough wave and a joint of two blocks: springs in series and Westergaard's wave."""

import numpy as np
import pytest

from multiscale.laws import Exponential
from multiscale.laws.bulk import Elastic
from tests.closed_forms import westergaard
from workflows.three_ways import RoughWave, TiltedJoint, half_space_stiffness

LENGTH, MODULUS = 1e-3, 1e11
LAW = Exponential(pressure_scale=1e9, decay_length=2e-6)


class EvenJoint(TiltedJoint):
    """The joint without tilt and lateral strain: springs in series."""

    tilt = 0.0
    bulk = Elastic(MODULUS, 0.0)


@pytest.mark.parametrize("waves", [1, 3, 7])
def test_a_wave_meets_half_its_wavenumber(waves):
    x = LENGTH * np.arange(32) / 32
    q = 2.0 * np.pi * waves / LENGTH
    K = half_space_stiffness(32, LENGTH, MODULUS)
    force = K @ np.cos(q * x)  # per metre of width
    np.testing.assert_allclose(
        force * 32 / LENGTH, 0.5 * MODULUS * q * np.cos(q * x), atol=1e-9 * MODULUS * q
    )
    assert np.abs(K @ np.ones(32)).max() < 1e-9 * MODULUS


def test_a_wave_with_a_law_tends_to_westergaards_as_the_roughness_vanishes():
    wave, errors = RoughWave(1 / 4), []
    for height in (0.1, 0.01, 0.001):
        law = Exponential(2.0 * wave.pressure, decay_length=height * wave.amplitude)
        result = wave.solve(law)
        expected = wave.amplitude * float(westergaard.mean_gap(np.array(0.5)))
        errors.append(abs(result.mean_gap - expected) / wave.amplitude)
        assert np.mean(result.pressure) == pytest.approx(wave.pressure, rel=1e-8)
    assert errors[2] < 0.2 * errors[1] < 0.04 * errors[0] * 5.0
    assert errors[2] < 6e-3


def test_a_law_in_series_with_the_blocks():
    joint = EvenJoint(1 / 4)
    result = joint.solve(LAW)
    p = float(np.mean(result.pressure))
    np.testing.assert_allclose(result.pressure, p, rtol=1e-7)
    gap = float(LAW.gap_at(np.array(p)))
    assert result.mean_gap == pytest.approx(gap, rel=1e-7)
    assert p == pytest.approx((joint.approach + gap) * MODULUS / joint.length, rel=1e-7)


def test_a_tilted_platen_presses_one_side_more():
    joint = TiltedJoint(1 / 4)
    coarse, fine = (joint.solve(LAW, refined=n) for n in (1, 2))
    order = np.argsort(fine.position)
    inner = order[np.abs(fine.position[order]) < 0.3 * joint.length]  # edges give way
    assert np.all(np.diff(fine.pressure[inner]) > 0.0)
    assert coarse.mean_gap == pytest.approx(fine.mean_gap, rel=1e-3)


def test_a_smooth_joint_closes():
    joint = EvenJoint(1 / 4)
    mesh = joint.mesh_profile(np.zeros(8))
    np.testing.assert_allclose(mesh.pressure, joint.approach * MODULUS / joint.length, rtol=1e-9)
    assert abs(mesh.mean_gap) < 1e-12 * joint.length


def test_short_waves_on_the_face_carry_the_pressure_of_westergaard():
    """Eight waves on 256 nodes; both blocks give way: 1/E* is twice the value of one block."""
    joint, waves, n, amplitude = EvenJoint(1 / 4), 8, 256, 5e-6
    profile = -amplitude * np.cos(2.0 * np.pi * waves * np.arange(n) / n)  # free at the edges
    mesh = joint.mesh_profile(profile)
    full = westergaard.full_contact_pressure(amplitude, joint.length / waves, 0.5 * MODULUS)
    middle = np.abs(mesh.position) < joint.length * (0.5 - 1.0 / waves)
    ratio = np.mean(mesh.pressure[middle]) / full
    assert 0.2 < ratio < 0.8
    gap = float(westergaard.mean_gap(np.array(ratio))) * amplitude
    assert mesh.mean_gap == pytest.approx(gap, rel=6e-2)  # mean gap of all waves
