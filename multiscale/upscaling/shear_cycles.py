"""What cells lose in closed cycles of shear, over what the bed of sliders loses."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from multiscale.laws import NormalLaw
from multiscale.schema import Dataset

__all__ = ["LossRatio", "bed_loss", "closed_cycles", "measure_loss"]

CLOSED = 0.1  # distance from the first turn, over the amplitude, at which a cycle counts as closed
SIDEWAYS = 0.05  # slip over the largest one that cells make across the direction of their shear
WHOLE = 0.95  # of full slip, from which on the traction does not tell the slip
NODES = np.polynomial.legendre.leggauss(48)  # of an integral over the amplitude


@dataclass(frozen=True, eq=False)
class LossRatio:
    """Loss of cells over the loss of the bed.

    Attributes
    ----------
    pressure : ndarray, shape (cycles,), mean pressure, Pa
    amplitude : ndarray, shape (cycles,), of the traction of the mean cell, over full slip
    ratio : ndarray, shape (realisations, cycles, 2)
        With the bed in a cycle of the same slip, and in a cycle of the same traction.
    """

    pressure: np.ndarray
    amplitude: np.ndarray
    ratio: np.ndarray


def measure_loss(
    shear: Dataset,
    pressure: np.ndarray,
    laws: list[NormalLaw],
    stiffness_ratio: np.ndarray,
    friction: float,
) -> LossRatio | None:
    """Compare the work of friction of cells over closed cycles with the loss of their beds."""
    if "friction_work" not in shear.variables:
        return None
    slip, traction = (shear[name].to_numpy()[..., 1:] for name in ("displacement_jump", "traction"))
    lost = shear["friction_work"].to_numpy()
    found = [(axis, *turns) for axis, turns in closed_cycles(slip.mean(axis=0), pressure)]
    if not found:
        return None
    ratio = np.empty((len(laws), len(found), 2))
    amplitude = np.empty(ratio.shape[:2])
    for c, (axis, first, back, last) in enumerate(found):
        turns, kappa, p = [first, back, last], stiffness_ratio[axis], pressure[first]
        swing = np.array([0.25, -0.5, 0.25])
        reached = np.abs(slip[:, turns, axis] @ swing)
        carried = np.abs(traction[:, turns, axis] @ swing)
        amplitude[:, c] = carried / (friction * p)
        for r, law in enumerate(laws):
            far = reached[r]
            if amplitude[r, c] < WHOLE:
                far = law.gap_at(p * (1.0 - amplitude[r, c])) - law.gap_at(p)
                far *= friction / kappa
            bed = [bed_loss(law, float(p), a, kappa, friction) for a in (reached[r], far)]
            ratio[r, c] = (lost[r, last] - lost[r, first]) / np.array(bed)
    at = np.array([pressure[first] for _, first, *_ in found])
    return LossRatio(at, amplitude.mean(axis=0), ratio)


def bed_loss(
    law: NormalLaw, pressure: float, amplitude: float, stiffness_ratio: float, friction: float
) -> float:
    r"""Loss of a bed of sliders in a closed cycle at a constant pressure, J/m2.

    The first loading :math:`t(u) = \mu [p(g) - p(g + \kappa u / \mu)]` and Masing's rule give

    .. math:: W = 8 \int_0^a t\, \mathrm{d}u - 4\, a\, t(a).    \tag{1}
    """
    gap = float(law.gap_at(np.array(pressure)))
    u = 0.5 * amplitude * (1.0 + np.append(NODES[0], 1.0))
    t = friction * (pressure - law.pressure(gap + stiffness_ratio * u / friction))
    return float(4.0 * amplitude * (NODES[1] @ t[:-1] - t[-1]))  # (1)


def closed_cycles(slip: np.ndarray, pressure: np.ndarray) -> list[tuple[int, list[int]]]:
    """Find the closed cycles of a path, slips (steps, 2), m, at held pressures, Pa.

    Of each cycle its direction, 0 or 1, and its steps: first turn, second turn and end.
    """
    ends = np.flatnonzero(np.diff(pressure)) + 1
    found = []
    for held in np.split(np.arange(len(pressure)), ends):
        for axis in (0, 1):
            u = slip[held, axis]
            if pressure[held[0]] <= 0.0 or np.ptp(u) <= SIDEWAYS * np.ptp(slip[held]):
                continue
            turns = 1 + np.flatnonzero(np.diff(u)[1:] * np.diff(u)[:-1] < 0.0)
            for first, back in pairwise(turns):
                near = np.abs(u[back + 1 :] - u[first]) < CLOSED * 0.5 * abs(u[first] - u[back])
                if np.any(near):
                    last = back + 1 + int(np.argmax(near))
                    found.append((axis, held[[first, back, last]].tolist()))
    return found
