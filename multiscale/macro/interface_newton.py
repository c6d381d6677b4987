r"""Newton's method for elastic bodies joined by an interface law, whatever their matrices.

On a law much stiffer than the bodies, or with friction, the energy along a Newton step bends within
a small share of the step, so that a line search crawls. There the bodies take the whole step, and
the law goes on from another jump: from the traction :math:`t^*` of its tangent at the jump
:math:`y` and the new jump :math:`j` of the bodies, along the search direction of the stiffness k of
the bodies, to the next :math:`y` on the law,

.. math:: t(y) + k y = t^* + k j, \qquad t^* = t(y_0) + D(y_0) (j - y_0).    \tag{1}

The next tangent is that at y. This is the local stage of LATIN with the tangent of the law as the
direction of its linear stage; at the solution y = j. On the way the bodies are out of balance with
the traction of the law at y by :math:`k (j - y)` per area, so that one residual tells how far the
traction and the jump are from the solution, however stiff the law is.
"""

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array

from multiscale.errors import ConvergenceError
from multiscale.laws.interface_law import InterfaceLaw, Response

__all__ = [
    "FLOOR",
    "GROWTH",
    "PATIENCE",
    "ROUNDS",
    "face_stiffness",
    "go_on_along_law",
    "soften_tangent",
    "tangent_traction",
]

PATIENCE = 30
"""Iterations without a smaller residual after which the solver gives up."""

SOFT = 0.25
"""Stiffness of the bodies along a jump over their mean diagonal stiffness: the sides stand in
series, and the material around a node gives way. With the whole stiffness, iterations on metal that
flows and slips go round in circles."""

FLOOR = 1e-8
"""Stiffness lent to an open or frictionless interface in a singular tangent, relative to the
stiffness of the bodies."""

STIFFEST = 1e8
"""Stiffness of a tangent over the stiffness of the bodies, above which a spring in series softens
it: beside a stiffer one, the stiffness of the bodies is rounded away."""

GROWTH, ROUNDS = 1e4, 8
"""Factor of the residual beyond which a whole step has left all that is known of the law, and steps
without a smaller residual after which the iteration may go round in circles: the energy then tells
the length of the step."""


def soften_tangent(response: Response, stiffness: float) -> Response:
    """Put a spring in series with the tangent where it is far stiffer than the bodies, Pa/m."""
    most = STIFFEST * stiffness
    largest = np.abs(response.tangent).max(axis=(0, 1))
    stiff = (most > 0.0) & (largest > most) & np.isfinite(largest)
    if not np.any(stiff):
        return response
    D = np.moveaxis(
        response.tangent[..., stiff] / np.maximum(largest[stiff] / (1e6 * most), 1.0), -1, 0
    )
    tangent = response.tangent.copy()
    tangent[..., stiff] = np.moveaxis(np.linalg.solve(np.eye(D.shape[1]) + D / most, D), 0, -1)
    return replace(response, tangent=tangent)


def tangent_traction(response: Response, at: np.ndarray, jump: np.ndarray) -> np.ndarray:
    """Traction of the tangent of a law at one jump, for another, shape (d, points), Pa."""
    change = np.einsum("ijp,jp->ip", response.tangent, jump - at)
    return np.asarray(response.traction + change)


def go_on_along_law(
    law: InterfaceLaw, at: np.ndarray, jump: np.ndarray, stiffness: float, state: np.ndarray
) -> np.ndarray:
    """Find the next jump (1) on the law, m."""
    traction = tangent_traction(soften_tangent(law.respond(at, state), stiffness), at, jump)
    try:
        found = law.resolvent(traction + stiffness * jump, stiffness, state)
    except ConvergenceError:  # a whole step may end where the law has no numbers
        return jump
    return np.asarray(found)


def face_stiffness(diagonal: np.ndarray, normal_jump: csr_array, weight: np.ndarray) -> float:
    """Stiffness of bodies per area of an interface, Pa/m, from their own at its unknowns, N/m."""
    touched = abs(normal_jump).T @ weight
    return SOFT * float(np.sum(np.abs(diagonal)[touched > 0.0]) / np.sum(touched))
