"""Newton's method for elastic bodies joined by an interface law, whatever their matrices."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from multiscale.convergence import Solution, Status
from multiscale.numerics.line_search import step_length
from multiscale.numerics.newton import Limits, NewtonRun

__all__ = ["Equations", "InterfaceIterate", "find_equilibrium"]

PATIENCE = 30
"""Iterations without a smaller residual after which the solver gives up."""

FLOOR = 1e-8
"""Stiffness lent to an open interface in a singular tangent, relative to the bodies' own."""

GROWTH, HALVINGS = 100.0, 40
"""Factor by which a step may raise the residual, and how often it is halved to keep to that: along
a step the energy of a law without potential may fall while its forces grow beyond all numbers."""


@dataclass(frozen=True, eq=False)
class InterfaceIterate:
    """The equations at one value of their unknowns.

    Attributes
    ----------
    value, gradient : ndarray, shape (n,)
        The unknowns, and the derivative of the total energy by each of them.
    force : ndarray
        Nodal force of the interface, N.
    tangent : ndarray, shape (..., points)
        Tangent of the law, times the weights of the points, N/m.
    """

    value: np.ndarray
    gradient: np.ndarray
    force: np.ndarray
    tangent: np.ndarray


class Equations(Protocol):
    """Equilibrium of bodies and interface, in full or condensed."""

    def linearise(self, value: np.ndarray) -> InterfaceIterate:
        """Evaluate the law."""

    def residual(self, here: InterfaceIterate) -> float:
        """Fault that the tolerance bounds, dimensionless."""

    def direction(self, here: InterfaceIterate, floor: float) -> np.ndarray | None:
        """Newton direction, the normal tangent raised by a share of the stiffness of the bodies.

        None if the matrix is singular.
        """


@np.errstate(over="ignore", invalid="ignore")  # an overflow shows in the residual
def find_equilibrium(equations: Equations, start: np.ndarray, limits: Limits) -> Solution:
    """Solve the equations from a start; the value holds their unknowns.

    If the law derives from a convex potential, the derivative of the total energy along a Newton
    step decides the length of the step, so that any start converges. A law without potential gets
    full steps where the energy argument fails. Steps that raise the residual a hundredfold are
    halved.
    """
    here = equations.linearise(start)
    residual, run = equations.residual(here), NewtonRun(limits, PATIENCE)
    while run.goes_on(residual):
        direction = _descent(equations, here)
        if direction is None:
            run.stop(Status.STALLED)
            break
        there, slope = _along(equations, here.value, direction)
        step = step_length(slope, float(direction @ here.gradient))
        for _ in range(HALVINGS):
            here = there(step)
            residual = equations.residual(here)
            if residual <= GROWTH * run.residuals[-1]:
                break
            step *= 0.5

    return run.solution(here.value)


def _descent(equations: Equations, here: InterfaceIterate) -> np.ndarray | None:
    """Newton direction; with a floor under the tangent where it is singular."""
    fallback = None
    for floor in (0.0, FLOOR):
        direction = equations.direction(here, floor)
        if direction is not None and direction @ here.gradient < 0.0:
            return direction
        fallback = fallback if direction is None else direction
    return fallback


def _along(
    equations: Equations, value: np.ndarray, direction: np.ndarray
) -> tuple[Callable[[float], InterfaceIterate], Callable[[float], float]]:
    """Iterate after a step, evaluated once for the same step in a row, and slope of the energy."""
    there = lru_cache(maxsize=1)(lambda step: equations.linearise(value + step * direction))
    return there, lambda step: float(direction @ there(step).gradient)
