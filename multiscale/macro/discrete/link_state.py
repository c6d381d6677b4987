"""What a static solver returns, and what it is measured by."""

from dataclasses import dataclass

import numpy as np

from multiscale.convergence import Solution
from multiscale.macro.discrete.compatibility import LinkEquations

__all__ = ["LinkState", "force_scale", "round_off", "state_of"]


@dataclass(frozen=True, eq=False)
class LinkState:
    """Equilibrium at a load factor.

    Attributes
    ----------
    solution : Solution
        ``value`` is the displacement, shape (n,), m.
    tension, slack : ndarray, shape (rows,)
        N; m, never negative.
    """

    solution: Solution
    tension: np.ndarray
    slack: np.ndarray


def state_of(
    model: LinkEquations, solution: Solution, change: np.ndarray | None = None
) -> LinkState:
    """Tensions (14), (15) of the source and slacks.

    Parameters
    ----------
    model : Equations
        The structure.
    solution : Solution
        The displacement.
    change : ndarray, shape (rows,), optional
        Elastic change k e of the tensions, N, if it is known better than from the displacement.
    """
    if change is None:
        change = model.stiffness * model.elongate(solution.value)
    elastic = model.prestress + change
    tension = np.clip(elastic, model.lower, model.upper)
    return LinkState(solution, tension, np.abs(tension - elastic) / model.stiffness)


def force_scale(model: LinkEquations, load: np.ndarray) -> float:
    """Force that residuals are relative to, N: the largest load, or prestress without load."""
    return float(np.abs(load).max(initial=0.0)) or float(np.abs(model.prestress).max()) or 1.0


def round_off(tension: np.ndarray) -> float:
    """Force out of balance that the rounding of the tensions brings, N."""
    return float(8.0 * np.finfo(float).eps * np.abs(tension).max())
