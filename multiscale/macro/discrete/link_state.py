"""Result of a static solver, and the scales of its residual."""

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
    solution : Solution, ``value`` is the displacement, shape (n,), m
    tension : ndarray, shape (rows,), N; for the modes of beams their force
    slack : ndarray, shape (rows,), m; never negative
    """

    solution: Solution
    tension: np.ndarray
    slack: np.ndarray


def state_of(
    model: LinkEquations, solution: Solution, change: np.ndarray | None = None
) -> LinkState:
    """Return the state with the tensions (14), (15) of the source and the slacks."""
    if change is None:
        change = model.stiffness * model.elongate(solution.value)
    elastic = model.prestress + change
    tension = np.clip(elastic, model.lower, model.upper)
    return LinkState(solution, tension, np.abs(tension - elastic) / model.stiffness)


def force_scale(model: LinkEquations, load: np.ndarray) -> float:
    """Return the reference force of residuals, N: the largest load, else the largest prestress."""
    return float(np.abs(load).max(initial=0.0)) or float(np.abs(model.prestress).max()) or 1.0


def round_off(tension: np.ndarray) -> float:
    """Return the force out of balance due to the rounding of the tensions, N."""
    return float(8.0 * np.finfo(float).eps * np.abs(tension).max())
