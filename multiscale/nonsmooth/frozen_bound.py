r"""Coulomb friction as a sequence of problems with a known friction bound."""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm

from multiscale.nonsmooth.friction_problem import ScaledFriction
from multiscale.nonsmooth.progress import Progress
from multiscale.nonsmooth.projections import project_ball, project_friction_cone
from multiscale.nonsmooth.semismooth_newton import semismooth_newton
from multiscale.nonsmooth.split_interior_point import split_interior_point

__all__ = ["frozen_bound"]

FLOOR = 1e-9
"""Bound of an open contact relative to the largest: interior points need some room."""

PATIENCE = 6
"""Problems without a better answer after which the iteration gives up."""

PRECISION = 1e-10
"""Residual to which a problem with known bound is solved, relative to the data."""

EVERY = 3
"""Problems between two attempts of Newton's method."""


def frozen_bound(
    problem: ScaledFriction,
    reaction: np.ndarray,
    progress: Progress,
    max_iterations: int = 30,
    relaxation: float = 1.0,
) -> np.ndarray:
    r"""Solve a friction problem by iterating on the friction bound.

    Parameters
    ----------
    reaction : ndarray, shape (contacts, 3), start; its normal impulses give the first bound
    relaxation : float, share of the new bound in the next one, :math:`\omega \in (0, 1]`

    Notes
    -----
    With the bound :math:`b` known, friction is a convex problem (Tresca's law) that an interior
    point always solves, and

    .. math:: b \leftarrow (1 - \omega)\, b + \omega\, \mu\, r_N(b)    \tag{1}

    gets close in a few turns where normal impulses depend little on friction, as under dead
    weight; Newton's method finishes. This succeeds where large slips make De Saxcé's term lead
    interior points astray.

    References
    ----------
    .. [1] J. Haslinger, I. Hlaváček and J. Nečas, Numerical methods for unilateral problems in
       solid mechanics, Handbook of Numerical Analysis IV, Elsevier (1996), for the iteration (1).
    """
    r = reaction
    bound = problem.friction * np.maximum(r[:, 0], 0.0)
    latest, lowest = 0, progress.smallest
    for turn in range(max_iterations):
        largest = float(np.max(bound)) or 1.0
        room = np.maximum(bound, FLOOR * largest)
        inner = split_interior_point(problem, _Tresca(problem, room), bound=room)
        if not np.all(np.isfinite(inner)):
            break
        r = project_friction_cone(inner.T, problem.friction).T
        if progress.note(r):
            break
        bound = (1.0 - relaxation) * bound + relaxation * problem.friction * inner[:, 0]  # (1)
        if turn % EVERY == EVERY - 1:
            semismooth_newton(problem, r, progress, 12, regularisation=1e-6)
            if progress.smallest <= progress.target:
                break
        if progress.smallest < 0.9 * lowest:
            latest, lowest = turn, progress.smallest
        if turn - latest >= PATIENCE:
            break
    return r


@dataclass(frozen=True)
class _Tresca:
    """Says when the problem with a known bound is solved well enough."""

    problem: ScaledFriction
    bound: np.ndarray

    def note(self, reaction: np.ndarray) -> bool:
        """Compare the residual of Tresca's law with the target; the data have norm one."""
        ahead = (reaction - self.problem.respond(reaction)).T
        normal = reaction[:, 0] - np.maximum(ahead[0], 0.0)
        tangent = reaction[:, 1:].T - project_ball(ahead[1:], self.bound)
        return float(norm(normal) ** 2 + norm(tangent) ** 2) <= PRECISION**2
