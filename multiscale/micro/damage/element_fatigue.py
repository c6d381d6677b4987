r"""Fatigue of a structure, element by element, until the first element has cracked.

An element with the share :math:`c_e` of cracked inclusions has the stiffness
:math:`C_e = (1 - c_e)\, C` (1); uncracked inclusions see the stress of the sound material.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from multiscale.convergence import check_limits
from multiscale.errors import require
from multiscale.micro.damage.fatigue import (
    STATE_SIZE,
    FatigueMaterial,
    FatigueProgress,
    Inclusions,
)
from multiscale.schema import FATIGUE_LIFE, Dataset

StressOf = Callable[[np.ndarray], np.ndarray]
"""From the cracked share of every element to the corners of its stress in a cycle, of shape
(corners, elements, 6), Pa: the stress of the sound material at the strain of the element."""

MOST_SOLVES = 200  # of the structure
INCLUSIONS = 8  # inclusions of an element with a scatter of fatigue limits


def limit_factors(scatter: float) -> np.ndarray:
    """Fatigue limits over their median, rising: middles of equal shares of a lognormal scatter."""
    from scipy.special import ndtri

    require("scatter of the fatigue limit", scatter, "[0, 1)")
    n = INCLUSIONS if scatter else 1
    return np.asarray(np.exp(scatter * ndtri((np.arange(n) + 0.5) / n)))


def first_cracks(
    stress: np.ndarray,
    material: FatigueMaterial,
    *,
    scatter: float = 0.0,
    max_cycles: float = 1e9,
) -> np.ndarray:
    """Cycles at which the weakest inclusion of each element cracks; stress (corners, n, 6)."""
    return Inclusions(material, limit_factors(scatter)[:1]).lives(stress, max_cycles)


def local_fatigue(
    stress_of: StressOf,
    elements: int,
    material: FatigueMaterial,
    *,
    scatter: float = 0.0,
    tolerance: float = 0.05,
    jump_tolerance: float | None = 0.02,
    max_cycles: float = 1e9,
    substeps: int = 16,
) -> Dataset:
    r"""Follow the inclusions of all elements until an element has cracked through.

    Parameters
    ----------
    stress_of : callable
        Solves the structure: from the cracked share :math:`c_e` of every element, shape
        (elements,), to the corners of the stress of a cycle, shape (corners, elements, 6), Pa.
    material : FatigueMaterial, material with the median of the fatigue limits
    scatter : float, scatter of the fatigue limits in an element, see :func:`limit_factors`
    tolerance : float
        Bound on the relative error of the change of damage and plastic strain over a jump of
        cycles between two solves of the structure.
    jump_tolerance, substeps : see :func:`~.fatigue.two_scale_fatigue`; between two solves

    Returns
    -------
    Dataset
        Follows ``FATIGUE_LIFE``, without the mesh. ``cycles_to_crack`` is infinite where every
        inclusion stays elastic (``run_out`` 1), NaN where ``max_cycles`` or the largest number of
        solves was reached before (``converged`` 0).

    Notes
    -----
    The stress is constant until the share of an element changes. A jump of J cycles is computed
    with the stress at its start, then with the stress at its end; half the difference of both
    changes is bounded by ``tolerance`` times the larger change, and half the difference of the
    lives of inclusions that crack in both by ``tolerance`` times the longer life. The accepted jump
    has the mean of both stresses. An element that has cracked through keeps the stiffness of an
    inclusion, as the search ends there.
    """
    check_limits(tolerance)
    factors = limit_factors(scatter)
    inclusions = Inclusions(material, factors, jump_tolerance, substeps)
    most = 1.0 - 1.0 / factors.size  # largest share in a solve of the structure

    # sound structure: stress, first cracks and equivalent amplitude
    share, stress = np.zeros(elements), stress_of(np.zeros(elements))
    state, solves, cycles = np.zeros((elements * factors.size, STATE_SIZE)), 1, 0.0
    first = replace(inclusions, factors=factors[:1]).lives(stress, max_cycles)
    weakest = float(first.min())
    # half the largest von Mises stress between two corners
    ranges = [von_mises(stress[k:] - stress[k]).max(axis=0) for k in range(len(stress))]
    amplitude = 0.5 * np.max(ranges, axis=0)
    record = [(0.0, 0.0, 0.0)]
    crack, life, elastic = -1, np.nan, False
    jump = max(1, int(min(weakest, max_cycles)) - 1)
    while solves < MOST_SOLVES and cycles < max_cycles:
        # a jump with the stress of its start
        jump = int(max(1, min(jump, max_cycles - cycles)))
        run = inclusions.follow(state, stress, jump)
        grown, after, error = inclusions.cracked(run), stress, 0.0
        # if elements crack: repeat it with the stress of its end, then with the mean of both
        if np.any(grown > share) and most > 0.0:
            after = stress_of(np.minimum(grown, most))
            solves += 1
            other = inclusions.follow(state, after, jump)
            error = _difference(state, cycles, run, other)
            if error > tolerance and jump > 1:
                jump = int(jump * max(0.2, 0.8 * tolerance / error))
                continue
            run = inclusions.follow(state, 0.5 * (stress + after), jump)
            again = inclusions.cracked(run)
            if np.any(again != grown):
                after = stress_of(np.minimum(again, most))
                solves += 1
            grown = again
        # first element that has cracked through
        if (grown == 1.0).any():
            last = run.cycles.reshape(elements, -1).max(axis=1)
            crack = int(np.argmin(np.where(grown == 1.0, last, np.inf)))
            life = cycles + float(last[crack])
        elastic = bool(np.all(run.elastic | run.broken) and np.all(grown == share))
        state, stress, share, cycles = run.state, after, grown, cycles + jump
        damage = state[:, 0].reshape(elements, -1)
        record.append((cycles if crack < 0 else life, float(share.max()), float(damage.max())))
        if crack >= 0 or elastic:
            break
        jump = int(jump * min(4.0, 0.8 * tolerance / max(error, 1e-300)))
    passed, shares, damages = np.array(record).T
    strain = state[:, 1].reshape(elements, -1)
    return FATIGUE_LIFE.build(
        {
            "cycles": passed,
            "largest_share": shares,
            "largest_damage": damages,
            "cracked_share": share,
            "damage": state[:, 0].reshape(elements, -1).mean(axis=1),
            "plastic_strain": strain.mean(axis=1),
            "first_crack": first,
            "equivalent_amplitude": amplitude,
            "crack_element": crack,
            "cycles_to_first": min(weakest, life) if crack >= 0 else weakest,
            "cycles_to_crack": np.inf if elastic and crack < 0 else life,
            "run_out": int(elastic and crack < 0),
            "solves": solves,
            "converged": int(crack >= 0 or elastic),
        }
    )


def _difference(
    state: np.ndarray, cycles: float, first: FatigueProgress, other: FatigueProgress
) -> float:
    """Half the relative difference of two jumps: of changes, or of lives if both crack."""
    changes = [run.state[:, :2] - state[:, :2] for run in (first, other)]
    cracks = (first.broken & other.broken)[:, None]
    lives = [cycles + run.cycles[:, None] for run in (first, other)]
    pairs = [np.where(cracks, *both) for both in zip(lives, changes, strict=True)]
    size = np.maximum(np.abs(pairs[0]), np.abs(pairs[1]))
    half = 0.5 * np.abs(pairs[1] - pairs[0])
    return float(np.max(half / np.where(size > 0.0, size, 1.0), initial=0.0))


def von_mises(stress: np.ndarray) -> np.ndarray:
    """Von Mises stress, shape (...), of stresses xx, yy, zz, yz, xz, xy, shape (..., 6), Pa."""
    direct = stress[..., :3] - stress[..., :3].mean(axis=-1, keepdims=True)
    squares = np.sum(direct**2, axis=-1) + 2.0 * np.sum(stress[..., 3:] ** 2, axis=-1)
    return np.asarray(np.sqrt(1.5 * squares))
