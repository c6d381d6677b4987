"""Joints of softened blocks: springs in series, some of which are softer."""

import dataclasses

import numpy as np
import pytest

from multiscale.laws import Exponential, ModifiedLaw
from multiscale.macro import Block, press_joint, soften
from tests.closed_forms import joint as closed_form
from tests.closed_forms.elastic_solids import isotropic_stiffness
from tests.pressed_joint import ElementJoint, press_blocks

E, HEIGHT, DECAY, PRELOAD = 70e9, 0.02, 2e-6, 10e6
BLOCK = Block(HEIGHT, E, 0.3)
JOINT = ElementJoint((0.05, 0.04), BLOCK, BLOCK, elements=(2, 2), layers=(1, 1))
LAW = Exponential(pressure_scale=4e9, decay_length=DECAY)


def pressed(block, law=LAW):
    """Press two of a block against each other."""
    joint = dataclasses.replace(JOINT, lower=block, upper=block)
    return press_joint(joint, law, np.array([PRELOAD]))


@pytest.mark.parametrize("damage", [0.0, 0.3])
def test_the_joint_is_springs_in_series(damage):
    porous = soften(BLOCK, 0.9)
    result = pressed(porous, ModifiedLaw(LAW, damage))
    # an exponential law has K = p / u0 whatever share of it is damaged
    modulus = 0.9 * E
    expected = closed_form.series(PRELOAD / DECAY, modulus / HEIGHT, modulus / HEIGHT)
    np.testing.assert_allclose(result["joint_stiffness"], expected, rtol=1e-8)
    gap = DECAY * np.log(4e9 * (1.0 - damage) / PRELOAD)
    np.testing.assert_allclose(result["mean_gap"], gap, rtol=1e-8)


def random_stiffness(seed):
    """A tensor of no symmetry, near the tensor of the solid."""
    noise = np.random.default_rng(seed).normal(size=(6, 6))
    return 0.5 * isotropic_stiffness(E, 0.3) + 0.02 * E * noise @ noise.T


def test_blocks_with_the_tensor_of_a_volume_are_springs_with_its_compliance():
    """Between frictionless platens the stress is uniaxial, whatever shear comes with it."""
    C = random_stiffness(1)
    result = pressed(soften(BLOCK, C))
    modulus = 1.0 / np.linalg.inv(C)[2, 2]
    expected = closed_form.series(PRELOAD / DECAY, modulus / HEIGHT, modulus / HEIGHT)
    np.testing.assert_allclose(result["joint_stiffness"], expected, rtol=1e-8)


def test_an_isotropic_tensor_is_the_solid():
    tensor = soften(BLOCK, isotropic_stiffness(E, 0.3))
    for eccentricity in (None, (0.01, 0.005)):
        first, other = (
            press_blocks(
                dataclasses.replace(JOINT, lower=block, upper=block, eccentricity=eccentricity),
                LAW,
                np.array([PRELOAD]),
            )
            for block in (BLOCK, tensor)
        )
        np.testing.assert_allclose(other.joint_stiffness, first.joint_stiffness, rtol=1e-9)


def test_softening_keeps_everything_but_the_stiffness():
    assert soften(BLOCK, 0.5) == Block(HEIGHT, 0.5 * E, 0.3)


def test_a_damaged_law_carries_less():
    gap = np.array([0.0, 1e-6])
    np.testing.assert_allclose(ModifiedLaw(LAW, 0.4).pressure(gap), 0.6 * LAW.pressure(gap))
