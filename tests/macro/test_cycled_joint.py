"""A joint that loses stiffness over its life: springs in series, one of which is softer."""

import numpy as np
import pytest

from multiscale.errors import CaseError, SchemaError
from multiscale.laws import Damaged, Exponential
from multiscale.macro import Block, RoughJoint, cycled_joint, rough_joint, soften
from multiscale.reference import joint as closed_form
from multiscale.schema import FATIGUE, MACRO_RESULT

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
    found = cycled_joint(
        JOINT, LAW, PRELOAD, LIFE, stiffness_factor=0.9, damage_interface=damage_interface, steps=4
    )
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
