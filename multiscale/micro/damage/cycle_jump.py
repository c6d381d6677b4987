"""Jumps over cycles of fatigue that change the state slowly, with an error control."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from multiscale.micro.damage.fatigue_material import FatigueMaterial

__all__ = ["FatigueProgress", "pass_cycles"]

LARGEST_GROWTH = 4.0  # largest ratio of a jump to the jump before
SHORTEST_JUMP = 4  # cycles of the shortest jump that is worth its two trial cycles


@dataclass
class FatigueProgress:
    """Progress of a fatigue life, changed in place with every pass.

    Attributes
    ----------
    state : ndarray, shape (20,)
        State of the inclusion, see :mod:`~multiscale.micro.damage.inclusion`.
    cycles : float, cycles done, with jumps
    computed : float, cycles whose stress path was computed
    initiation : float, cycles at which damage began; infinite before
    broken : bool, whether the critical damage was reached
    elastic : bool, whether the inclusion stays elastic from now on
    """

    state: np.ndarray
    cycles: float = 0.0
    computed: float = 0.0
    initiation: float = np.inf
    broken: bool = False
    elastic: bool = False


Pass = Callable[[FatigueProgress], None]


def pass_cycles(
    run: FatigueProgress,
    once: Pass,
    count: int,
    material: FatigueMaterial,
    tolerance: float,
    note: Callable[[], None],
) -> None:
    r"""Pass through a program ``count`` times, with jumps under an error control.

    Parameters
    ----------
    run : FatigueProgress, changed in place
    once : callable
        ``once(run)`` computes one pass.
    count, material
        Number of passes; volume and inclusion.
    tolerance : float, bound on the relative error of the change over a jump, dimensionless
    note : callable, called without arguments after every computed pass and every jump

    Notes
    -----
    Slow variables are damage, accumulated plastic strain and the drift :math:`X - \tfrac23 C (1-D)
    \varepsilon^p` of the back stress. Let :math:`y` be their values after a pass that changed them
    by :math:`d_1`. A trial pass from :math:`y + J d_1` brings the plastic strain, which is fast and
    not extrapolated, to its cycle there; a second pass from the same :math:`y + J d_1` changes the
    slow variables by :math:`d_2`. The jump over J passes is accepted if :math:`|d_2 - d_1| / 2` is
    at most the tolerance times the larger of both changes, in damage and in accumulated strain,
    and takes the slow variables to :math:`y + J (d_1 + d_2)/2`.
    """
    jump, done = float(SHORTEST_JUMP), 0
    while done < count:
        before, start = _slow(run.state, material), run.cycles
        once(run)
        done += 1
        note()
        if run.broken or run.elastic:
            return
        y, length = _slow(run.state, material), run.cycles - start
        first = y - before
        while True:
            J = int(min(jump, count - done, _longest(run.state, first, material)))
            if J < SHORTEST_JUMP:
                jump = max(jump, float(SHORTEST_JUMP))
                break
            trial = FatigueProgress(run.state.copy(), run.cycles)
            for _ in range(2):
                _set_slow(trial.state, y + J * first, material)
                once(trial)
            run.computed += trial.computed
            second = _slow(trial.state, material) - y - J * first
            size = np.maximum(np.abs(first), np.abs(second))[:2]  # damage and plastic strain
            half = 0.5 * np.abs(second - first)[:2]
            change = float(np.max(half / np.where(size > 0.0, size, 1.0)))
            ahead = y + 0.5 * J * (first + second)
            broken = trial.broken or ahead[0] >= material.critical_damage
            if broken or change > tolerance:
                jump = 0.5 * J if broken else J * max(0.2, 0.8 * tolerance / change)
                continue
            run.state[:] = trial.state
            _set_slow(run.state, ahead, material)
            run.cycles += J * length
            done += J
            note()
            jump = J * min(LARGEST_GROWTH, 0.8 * tolerance / max(change, 1e-300))
            break


def _slow(state: np.ndarray, material: FatigueMaterial) -> np.ndarray:
    """Damage, accumulated plastic strain and drift of the back stress, shape (8,)."""
    modulus = 2.0 / 3.0 * material.hardening * (1.0 - state[0] * material.feedback)
    return np.concatenate([state[:2], state[8:14] - modulus * state[2:8]])


def _set_slow(state: np.ndarray, slow: np.ndarray, material: FatigueMaterial) -> None:
    """Write slow variables into a state and keep its plastic strain."""
    modulus = 2.0 / 3.0 * material.hardening * (1.0 - slow[0] * material.feedback)
    state[:2], state[8:14] = slow[:2], slow[2:] + modulus * state[2:8]


def _longest(state: np.ndarray, change: np.ndarray, material: FatigueMaterial) -> float:
    """Count the passes that may be jumped before the threshold or the critical damage."""
    if state[1] < material.threshold:
        return float((material.threshold - state[1]) // change[1] - 1.0) if change[1] else np.inf
    left = material.critical_damage - state[0]
    return float(left // change[0]) if change[0] > 0.0 else np.inf
