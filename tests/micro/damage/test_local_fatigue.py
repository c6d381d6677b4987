"""Fatigue of elements with falling stiffness: closed form, redistribution, jumps, bounds."""

import numpy as np
import pytest

from multiscale.micro.damage import (
    FatigueMaterial,
    local_fatigue,
    two_scale_fatigue,
)
from multiscale.micro.damage.element_fatigue import limit_factors
from multiscale.micro.damage.fatigue import STATE_SIZE
from multiscale.micro.damage.inclusion import run_points
from multiscale.schema import FATIGUE_LIFE

E, NU, LIMIT, STRENGTH = 200e9, 0.3, 200e6, 0.5e6
FULL = FatigueMaterial(E, NU, LIMIT, 0.2e6, 1.5, hardening=10e9, threshold=0.02, closure=0.2)
AREA, SHAPE, AROUND = np.array([1.0, 1.1, 1.2]), np.array([1.0, 1.02, 0.97]), 6.0
"""Areas of bars with ends that move together, how much more of the strain each bears, and the sound
area around them."""


def reversed_pull(amplitude):
    """Tension to and fro with an amplitude for each element, Pa."""
    cycle = np.array([1.0, 0.0, -1.0, 0.0])
    return cycle[:, None, None] * np.asarray(amplitude)[:, None] * np.eye(6)[0]


def bars(mean):
    """Bars in parallel, next to sound bars, under a given force."""

    def stress_of(cracked):
        left = AROUND + (AREA * (1.0 - cracked)).sum()
        return reversed_pull(SHAPE * mean * (AROUND + AREA.sum()) / left)

    return stress_of


def test_elements_are_independent_and_the_first_one_cracks():
    amplitudes = np.array([150e6, 230e6, 260e6, 215e6])
    fatigue = local_fatigue(lambda share: reversed_pull(amplitudes), 4, FULL)
    FATIGUE_LIFE.check(fatigue)
    assert int(fatigue["crack_element"]) == 2
    alone = [
        float(two_scale_fatigue(np.array([a, -a]), FULL)["cycles_to_rupture"]) for a in amplitudes
    ]
    np.testing.assert_allclose(fatigue["first_crack"], alone, rtol=1e-3)
    assert float(fatigue["cycles_to_crack"]) == pytest.approx(alone[2], rel=1e-3)
    np.testing.assert_allclose(fatigue["equivalent_amplitude"], amplitudes)


def every_cycle(mean, scatter):
    """Cycles to the first crack and to the first bar without sound inclusions, without jumps."""
    factors = limit_factors(scatter)
    kinds = np.tile(FULL.parameters(), (factors.size, 1))
    kinds[:, 2] *= factors
    state, share, first = np.zeros((3 * factors.size, STATE_SIZE)), np.zeros(3), 0
    for cycle in range(1, 10_000):
        stress = bars(mean)(share)[::2]  # the peaks
        path = np.ascontiguousarray(stress.swapaxes(0, 1))
        sound = np.flatnonzero(state[:, 0] < FULL.critical_damage)
        part, (bar, kind) = state[sound], np.divmod(sound, factors.size)
        run_points(part, path, bar, 1, kinds, kind, 16)
        state[sound] = part
        share = (state[:, 0] >= FULL.critical_damage).reshape(3, -1).mean(axis=1)
        first = first or cycle * int(share.max() > 0.0)
        if share.max() == 1.0:
            return first, cycle
    raise AssertionError("nothing cracks")


@pytest.mark.slow
def test_jumps_between_solves_keep_the_life_of_every_cycle():
    """Inclusions crack one after the other, and the rest bears more."""
    scatter, mean = 0.04, 225e6
    first, life = every_cycle(mean, scatter)
    assert life > 1.1 * first  # else no inclusion outlives the first
    for tolerance, error in ((0.1, 2e-3), (0.02, 1e-3)):
        jumps = local_fatigue(bars(mean), 3, FULL, scatter=scatter, tolerance=tolerance)
        assert float(jumps["cycles_to_crack"]) == pytest.approx(life, rel=error, abs=1.0)


def test_elastic_paths_run_out_and_paths_that_are_cut_off_are_unknown():
    out = local_fatigue(bars(0.9 * LIMIT), 3, FULL)
    assert float(out["cycles_to_crack"]) == np.inf
    assert int(out["run_out"]) == 1
    cut = local_fatigue(bars(1.1 * LIMIT), 3, FULL, max_cycles=50)
    assert np.isnan(float(cut["cycles_to_crack"]))
    assert int(cut["converged"]) == 0


def test_weak_inclusions_may_crack_and_the_others_stay_elastic():
    fatigue = local_fatigue(lambda share: reversed_pull([LIMIT]), 1, FULL, scatter=0.04)
    assert float(fatigue["cracked_share"][0]) == 0.5
    assert int(fatigue["run_out"]) == 1
    assert float(fatigue["cycles_to_first"]) < float(fatigue["cycles_to_crack"]) == np.inf
