"""Jumps over cycles of fatigue that change the state slowly, with an error control."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Self

import numpy as np

from multiscale.micro.damage.fatigue_material import FatigueMaterial

__all__ = ["FatigueProgress", "pass_cycles"]

LARGEST_GROWTH = 4.0  # largest ratio of a jump to the jump before
SHORTEST_JUMP = 4  # cycles of the shortest jump that is worth its two trial cycles


@dataclass
class FatigueProgress:
    """Progress of the fatigue lives of some inclusions, changed in place with every pass.

    Attributes
    ----------
    state : ndarray, shape (points, 20)
        State of each inclusion, see :mod:`~multiscale.micro.damage.inclusion`.
    number : ndarray of int, shape (points,), number of each inclusion among all
    cycles : ndarray, shape (points,), cycles done, with jumps
    computed : ndarray, shape (points,), cycles whose stress path was computed
    broken : ndarray of bool, shape (points,), whether the critical damage was reached
    elastic : ndarray of bool, shape (points,), whether an inclusion stays elastic from now on
    """

    state: np.ndarray
    number: np.ndarray
    cycles: np.ndarray
    computed: np.ndarray
    broken: np.ndarray
    elastic: np.ndarray

    @classmethod
    def begin(cls, state: np.ndarray) -> Self:
        """Begin at some states, shape (points, 20), with no cycle done."""
        n = len(state)
        zeros, no = np.zeros((2, n)), np.zeros((2, n), dtype=bool)
        return cls(state.copy(), np.arange(n), *zeros, *no)

    def take(self, index: np.ndarray) -> Self:
        """Copy the progress of some inclusions."""
        return type(self)(*(getattr(self, one.name)[index] for one in fields(self)))

    def put(self, index: np.ndarray, part: "FatigueProgress") -> None:
        """Write the progress of some inclusions."""
        for one in fields(self):
            getattr(self, one.name)[index] = getattr(part, one.name)


Pass = Callable[[FatigueProgress], None]


def pass_cycles(
    run: FatigueProgress,
    once: Pass,
    count: int,
    material: FatigueMaterial,
    tolerance: float,
    note: Callable[[], None] = lambda: None,
) -> None:
    r"""Pass through a program ``count`` times, with jumps under an error control.

    Every inclusion has jumps of its own length.

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
    jump, done = np.full(len(run.state), float(SHORTEST_JUMP)), np.zeros(len(run.state))

    def going() -> np.ndarray:
        return np.flatnonzero(~(run.broken | run.elastic) & (done < count))

    while (passing := going()).size:
        part = run.take(passing)
        before, start = _slow(part.state, material), part.cycles.copy()
        once(part)
        run.put(passing, part)
        done[passing] += 1
        note()
        y = _slow(part.state, material)
        first, length = y - before, part.cycles - start
        at = np.flatnonzero(np.isin(passing, going()))  # places among those that have passed
        while at.size:
            all_at = passing[at]
            J = np.minimum(jump[all_at], count - done[all_at])
            J = np.floor(np.minimum(J, _longest(part.state[at], first[at], material)))
            short = J < SHORTEST_JUMP
            jump[all_at[short]] = np.maximum(jump[all_at[short]], SHORTEST_JUMP)
            at, all_at, J = at[~short], all_at[~short], J[~short]
            if not at.size:
                break
            near = y[at] + J[:, None] * first[at]
            trial = part.take(at)
            trial.computed[:] = 0.0
            for _ in range(2):
                _set_slow(trial.state, near, material)
                once(trial)
            run.computed[all_at] += trial.computed
            second = _slow(trial.state, material) - near
            size = np.maximum(np.abs(first[at]), np.abs(second))[:, :2]  # damage, plastic strain
            half = 0.5 * np.abs(second - first[at])[:, :2]
            change = np.max(half / np.where(size > 0.0, size, 1.0), axis=1)
            ahead = y[at] + 0.5 * J[:, None] * (first[at] + second)
            broken = trial.broken | (ahead[:, 0] >= material.critical_damage)
            fits = ~broken & (change <= tolerance)
            ratio = 0.8 * tolerance / np.maximum(change, 1e-300)
            again = np.where(broken, 0.5, np.maximum(0.2, ratio))
            jump[all_at] = J * np.where(fits, np.minimum(LARGEST_GROWTH, ratio), again)
            _set_slow(trial.state, ahead, material)
            taken = all_at[fits]
            run.state[taken] = trial.state[fits]
            run.cycles[taken] += J[fits] * length[at[fits]]
            done[taken] += J[fits]
            if taken.size:
                note()
            at = at[~fits]


def _slow(state: np.ndarray, material: FatigueMaterial) -> np.ndarray:
    """Damage, accumulated plastic strain and drift of the back stress, shape (points, 8)."""
    modulus = 2.0 / 3.0 * material.hardening * (1.0 - state[:, :1] * material.feedback)
    return np.concatenate([state[:, :2], state[:, 8:14] - modulus * state[:, 2:8]], axis=1)


def _set_slow(state: np.ndarray, slow: np.ndarray, material: FatigueMaterial) -> None:
    """Write slow variables into states and keep their plastic strain."""
    modulus = 2.0 / 3.0 * material.hardening * (1.0 - slow[:, :1] * material.feedback)
    state[:, :2], state[:, 8:14] = slow[:, :2], slow[:, 2:] + modulus * state[:, 2:8]


def _longest(state: np.ndarray, change: np.ndarray, material: FatigueMaterial) -> np.ndarray:
    """Count the passes that may be jumped before the threshold or the critical damage."""
    waits = state[:, 1] < material.threshold
    left = np.where(waits, material.threshold - state[:, 1], material.critical_damage - state[:, 0])
    rate = np.where(waits, change[:, 1], change[:, 0])
    passes = left // np.where(rate > 0.0, rate, 1.0) - waits
    return np.asarray(np.where(rate > 0.0, passes, np.inf))
