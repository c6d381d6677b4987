"""Bodies as the Newton loop sees them: forces, tangent and state of one time step."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

__all__ = ["BodyResponse", "FiniteBody", "Increment", "linear_body"]


@dataclass(frozen=True, eq=False)
class BodyResponse:
    """What a body answers to a displacement.

    Attributes
    ----------
    force : ndarray, shape (nx, layers, 3, ny)
        Internal forces, N.
    tangent : callable
        Their derivative times a displacement; good until the body is asked for the next one.
    least_dilatation : float
        Smallest det F of all Gauss points. Where it is not positive there are no forces.
    flowing : float
        Share of the Gauss points that flow.
    """

    force: np.ndarray
    tangent: Callable[[np.ndarray], np.ndarray]
    least_dilatation: float
    flowing: float


@dataclass(frozen=True, eq=False)
class Increment:
    """One step in time from a known state.

    Attributes
    ----------
    respond : callable
        ``respond(displacement)`` gives a :class:`BodyResponse`.
    finish : callable
        ``finish(displacement)`` gives the state at the end.
    """

    respond: Callable[[np.ndarray], BodyResponse]
    finish: Callable[[np.ndarray], Any]


@dataclass(frozen=True, eq=False)
class FiniteBody:
    """A deformable body.

    Attributes
    ----------
    shape : tuple of int
        Shape of a displacement.
    begin : callable
        ``begin(state, time_step)`` gives an :class:`Increment`.
    rest : callable
        Gives the state before any load; None for a body without memory.
    """

    shape: tuple[int, ...]
    begin: Callable[[Any, float], Increment]
    rest: Callable[[], Any]


def linear_body(apply: Callable[[np.ndarray], np.ndarray], shape: tuple[int, ...]) -> FiniteBody:
    """Return a linear elastic body from its stiffness; it carries no state."""
    increment = Increment(
        respond=lambda u: BodyResponse(apply(u), apply, 1.0, 0.0), finish=lambda u: None
    )
    return FiniteBody(shape, lambda state, time_step: increment, lambda: None)
