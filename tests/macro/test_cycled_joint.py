"""A joint that loses stiffness over its life: springs in series, one of which is softer."""

import dataclasses

import numpy as np
import pytest

from multiscale.errors import CaseError, SchemaError
from multiscale.laws import Damaged, Exponential
from multiscale.macro import Block, RoughJoint, cycled_joint, rough_joint, soften
from multiscale.micro.damage import youngs_modulus_along
from multiscale.micro.damage.rve import STRAINS
from multiscale.schema import FATIGUE, MACRO_RESULT, RVE_STIFFNESS
from tests.closed_forms import joint as closed_form
from tests.closed_forms.elastic_solids import isotropic_stiffness

E, HEIGHT, DECAY, PRELOAD = 70e9, 0.02, 2e-6, 10e6
BLOCK = Block(HEIGHT, E, 0.3, layers=1)
JOINT = RoughJoint((0.05, 0.04), BLOCK, BLOCK, elements=(2, 2))
LAW = Exponential(pressure_scale=4e9, decay_length=DECAY)


def fatigue(cycles, damage):
    zeros = np.zeros(len(cycles))
    return FATIGUE.build(
        {
            "cycles": np.array(cycles),
            "damage": np.array(damage),
            "plastic_strain": zeros,
            "cycles_to_initiation": cycles[1],
            "cycles_to_rupture": cycles[-1],
            "run_out": 0,
            "computed_cycles": 3,
            "converged": 1,
            "wall_time": 0.0,
        }
    )


LIFE = fatigue([0.0, 1e4, 2e4, 3e4], [0.0, 0.0, 0.1, 0.3])


@pytest.mark.parametrize("damage_interface", [False, True])
def test_the_joint_is_springs_in_series_at_every_time(damage_interface):
    porous = soften(BLOCK, 0.9)
    joint = dataclasses.replace(JOINT, lower=porous, upper=porous)
    found = cycled_joint(joint, LAW, PRELOAD, LIFE, damage_interface=damage_interface, steps=4)
    MACRO_RESULT.check(found)
    damage = found["damage"].values
    np.testing.assert_allclose(damage, [0.0, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(found["cycles"], [1e4, 2e4, 2.5e4, 3e4])
    # an exponential law has K = p / u0 whatever share of it is damaged
    modulus = 0.9 * E * (1.0 - damage)
    expected = closed_form.series(PRELOAD / DECAY, modulus / HEIGHT, modulus / HEIGHT)
    np.testing.assert_allclose(found["joint_stiffness"], expected, rtol=1e-8)
    if damage_interface:
        gap = DECAY * np.log(4e9 * (1.0 - damage) / PRELOAD)
        np.testing.assert_allclose(found["mean_gap"], gap, rtol=1e-8)


def random_stiffness(seed):
    """A tensor of no symmetry, near that of the solid."""
    noise = np.random.default_rng(seed).normal(size=(6, 6))
    return 0.5 * isotropic_stiffness(E, 0.3) + 0.02 * E * noise @ noise.T


def rve_stiffness(stiffness):
    normals = np.eye(3)
    return RVE_STIFFNESS.build(
        {
            "stiffness": stiffness,
            "strain": list(STRAINS),
            "other_strain": list(STRAINS),
            "normal": normals,
            "modulus_ratio": youngs_modulus_along(stiffness, normals) / E,
            "damage": np.zeros(3),
            "porosity": 0.1,
        }
    )


def test_blocks_with_the_tensor_of_a_volume_are_springs_with_its_compliance():
    """Between frictionless platens the stress is uniaxial, whatever shear comes with it."""
    C = random_stiffness(1)
    porous = soften(BLOCK, rve_stiffness(C))
    joint = dataclasses.replace(JOINT, lower=porous, upper=porous)
    found = cycled_joint(joint, LAW, PRELOAD, LIFE, steps=4)
    modulus = (1.0 - found["damage"].values) / np.linalg.inv(C)[2, 2]
    expected = closed_form.series(PRELOAD / DECAY, modulus / HEIGHT, modulus / HEIGHT)
    np.testing.assert_allclose(found["joint_stiffness"], expected, rtol=1e-8)


def test_an_isotropic_tensor_is_the_solid():
    tensor = soften(BLOCK, rve_stiffness(isotropic_stiffness(E, 0.3)))
    for eccentricity in (None, (0.01, 0.005)):
        one, other = (
            rough_joint(
                dataclasses.replace(JOINT, lower=block, upper=block, eccentricity=eccentricity),
                LAW,
                np.array([PRELOAD]),
            )
            for block in (BLOCK, tensor)
        )
        np.testing.assert_allclose(other["joint_stiffness"], one["joint_stiffness"], rtol=1e-9)


def test_a_joint_without_damage_has_one_time():
    sound = cycled_joint(JOINT, LAW, PRELOAD, fatigue([0.0, 3.0], [0.0, 0.0]))
    assert sound.sizes["step"] == 1
    plain = rough_joint(JOINT, LAW, np.array([PRELOAD]))
    assert float(sound["joint_stiffness"][0]) == pytest.approx(float(plain["joint_stiffness"][0]))


def test_softening_keeps_everything_but_the_stiffness():
    assert soften(BLOCK, 0.5) == Block(HEIGHT, 0.5 * E, 0.3, layers=1)


def test_a_damaged_law_carries_less():
    gap = np.array([0.0, 1e-6])
    np.testing.assert_allclose(Damaged(LAW, 0.4).pressure(gap), 0.6 * LAW.pressure(gap))


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (
            lambda: soften(BLOCK, rve_stiffness(np.diag([E, E, 0.0, 0.0, 0.0, E]))),
            "cut through, D = 1, and carries no load",
        ),
        (lambda: soften(BLOCK, 0.0), "must lie above 0 and up to 1, got 0; a block without"),
        (
            lambda: cycled_joint(JOINT, LAW, PRELOAD, fatigue([0.0, 1.0], [0.0, 1.0])),
            "D = 1: their stiffness is zero",
        ),
        (lambda: cycled_joint(JOINT, LAW, PRELOAD, LIFE, steps=0), "steps must be at least 1"),
    ],
)
def test_what_cannot_be_is_refused_with_a_sentence(call, sentence):
    with pytest.raises(CaseError, match=sentence):
        call()


def test_another_dataset_is_refused():
    with pytest.raises(SchemaError, match="not a 'fatigue' dataset"):
        cycled_joint(JOINT, LAW, PRELOAD, LIFE.drop_vars("damage"))
