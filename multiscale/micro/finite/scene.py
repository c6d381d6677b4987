"""What is solved on a cell beyond linear elasticity, where a step goes, and its states."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from multiscale.convergence import Status
from multiscale.micro.finite.body import Body
from multiscale.micro.finite.obstacle import Obstacle
from multiscale.micro.finite.reference import Reference

__all__ = ["CellState", "Scene", "Target"]


@dataclass(frozen=True, eq=False)
class Scene:
    r"""What does not change along a path.

    Attributes
    ----------
    body : Body
    reference : Reference
    obstacle : Obstacle
    friction : float
        Local friction coefficient; 0 leaves out everything tangential.
    weights : tuple of float
        :math:`\rho_n` and :math:`\rho_t`, N/m.
    """

    body: Body
    reference: Reference
    obstacle: Obstacle
    friction: float
    weights: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Target:
    """Where an increment ends: the load (N) or the approach (m), the slide (m) and its duration."""

    load: float | None
    approach: float | None
    slide: np.ndarray
    time_step: float = 0.0


@dataclass(frozen=True, eq=False)
class CellState:
    """A state of the cell in equilibrium, or the last iterate.

    Attributes
    ----------
    displacement : ndarray, shape (nx, layers, 3, ny)
        m.
    approach : float
        m.
    slide : ndarray, shape (2,)
        Of the obstacle, m.
    material : Any
        Internal variables of the body; None without any.
    force : ndarray, shape (nx, 3, ny)
        Of the obstacle on the body, N.
    active, slipping : ndarray of bool, shape (nx, ny)
        Contact nodes, and those of them that slip.
    dissipation : float
        Work of friction since the first state, J.
    status : Status
    residuals : tuple of float
        Forces out of balance and violations of contact, relative to the contact forces.
    linear_iterations : int
    flowing : float
        Share of the Gauss points that flow.
    peak : float
        Largest norm of the contact forces so far, N.
    """

    displacement: np.ndarray
    approach: float
    slide: np.ndarray
    material: Any
    force: np.ndarray
    active: np.ndarray
    slipping: np.ndarray
    dissipation: float = 0.0
    status: Status = Status.MAX_ITERATIONS
    residuals: tuple[float, ...] = ()
    linear_iterations: int = 0
    flowing: float = 0.0
    peak: float = 0.0
