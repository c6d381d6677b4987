r"""Spectral projected gradients for Coulomb friction: products with W only, no factorisation."""

import numpy as np
from numpy.linalg import norm

from multiscale.nonsmooth.friction_problem import ScaledFriction
from multiscale.nonsmooth.progress import Recorder
from multiscale.nonsmooth.projections import project_ball

__all__ = ["spectral_gradient"]

LOOK = 10
"""Iterations between two looks at the error."""

LONGEST = 1e4
"""Longest step, relative to the shortest, the inverse of the largest eigenvalue of W."""


def spectral_gradient(
    problem: ScaledFriction,
    reaction: np.ndarray,
    progress: Recorder,
    max_iterations: int = 10000,
) -> np.ndarray:
    r"""Solve a friction problem by projected gradients with spectral steps.

    Parameters
    ----------
    problem : ScaledFriction
        The problem, dimensionless.
    reaction : ndarray, shape (contacts, 3)
        Start.
    progress : Recorder
        Looks at the error every 10 iterations and says when to stop.
    max_iterations : int
        Iteration limit.

    Returns
    -------
    ndarray, shape (contacts, 3)
        The last impulses.

    Notes
    -----
    The iteration projects normal and tangent one after the other, as Alart and Curnier do,

    .. math::
        z = r - \rho u, \qquad r_N \leftarrow \max(0, z_N), \qquad
        r_T \leftarrow P_{B(\mu r_N)}(z_T),    \tag{1}

    and its step follows from the last change :math:`s` of :math:`r` and :math:`W s`, in turns

    .. math:: \rho = \frac{s^T s}{s^T W s}, \qquad \rho = \frac{s^T W s}{\|W s\|^2}.    \tag{2}

    Conjugate projected gradients on the same cones failed on more than half of the problems of
    the tests, where these steps hold; neither is proved to converge with friction.

    References
    ----------
    .. [1] J. Barzilai and J. M. Borwein, IMA J. Numer. Anal. 8 (1988) 141-148,
       doi:10.1093/imanum/8.1.141, for the steps (2).
    """
    shortest = 1.0 / (_largest_eigenvalue(problem) or 1.0)
    step, r = shortest, reaction.copy()
    u = problem.respond(r)
    for iteration in range(1, max_iterations + 1):
        new = _project(r - step * u, problem.friction)  # (1)
        new_velocity = problem.respond(new)
        s, Ws = new - r, new_velocity - u
        curvature = float(np.sum(s * Ws))
        r, u = new, new_velocity
        if iteration % LOOK == 0 and progress.note(r):
            break
        if not curvature > 0.0:
            step = shortest
            continue
        squares = np.sum(s * s) / curvature, curvature / np.sum(Ws * Ws)
        step = float(np.clip(squares[iteration % 2], shortest, LONGEST * shortest))  # (2)
    return r


def _project(ahead: np.ndarray, friction: np.ndarray) -> np.ndarray:
    """Equation (1)."""
    normal = np.maximum(ahead[:, 0], 0.0)
    return np.column_stack([normal, project_ball(ahead[:, 1:].T, friction * normal).T])


def _largest_eigenvalue(problem: ScaledFriction) -> float:
    """Estimate the largest eigenvalue of W by a few steps of the power method."""
    vector = np.random.default_rng(seed=0).standard_normal(problem.velocity.shape)
    size = float(norm(vector))
    for _ in range(15):
        vector = problem.respond(vector / size) - problem.velocity
        size = float(norm(vector))
        if size == 0.0:
            break
    return size
