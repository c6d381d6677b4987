"""Bodies for the Newton iteration: forces, tangent and state of one time step."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_array

__all__ = ["BodyResponse", "FiniteBody", "Increment", "linear_body"]


@dataclass(frozen=True, eq=False)
class BodyResponse:
    """Response of a body to a displacement.

    Attributes
    ----------
    force : ndarray, shape (nx, layers, 3, ny), internal forces, N
    tangent : callable
        ``tangent(v)``, their derivative times a displacement v, N; valid until the next response of
        the body is computed.
    least_dilatation : float
        Smallest det F of all Gauss points, dimensionless. The forces are undefined unless it is
        positive.
    flowing : float, share of the Gauss points that flow, 0 to 1
    matrix : csr_array, optional
        The tangent as a matrix, of a body that assembles one, N/m.
    """

    force: np.ndarray
    tangent: Callable[[np.ndarray], np.ndarray]
    least_dilatation: float
    flowing: float
    matrix: csr_array | None = None


@dataclass(frozen=True, eq=False)
class Increment:
    """One step in time from a known state.

    Attributes
    ----------
    respond : callable
        ``respond(displacement)``, displacement in m, returns a :class:`BodyResponse`.
    finish : callable
        ``finish(displacement)`` returns the internal variables at the end of the step.
    """

    respond: Callable[[np.ndarray], BodyResponse]
    finish: Callable[[np.ndarray], Any]


@dataclass(frozen=True, eq=False)
class FiniteBody:
    """A deformable body.

    Attributes
    ----------
    shape : tuple of int
    begin : callable
        ``begin(state, time_step)``, time step in s, returns an :class:`Increment`.
    rest : callable
        ``rest()`` returns the internal variables before any load; None for a body without any.
    """

    shape: tuple[int, ...]
    begin: Callable[[Any, float], Increment]
    rest: Callable[[], Any]


def linear_body(apply: Callable[[np.ndarray], np.ndarray], shape: tuple[int, ...]) -> FiniteBody:
    """Return a linear elastic body without internal variables.

    ``apply(u)`` multiplies a displacement of the given shape, m, by the stiffness; N.
    """
    increment = Increment(
        respond=lambda u: BodyResponse(apply(u), apply, 1.0, 0.0), finish=lambda u: None
    )
    return FiniteBody(shape, lambda state, time_step: increment, lambda: None)
