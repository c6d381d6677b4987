r"""Alternating directions for Coulomb friction: factorise once, then project and solve."""

import numpy as np
from numpy.linalg import norm

from multiscale.nonsmooth.block_system import factorise_blocks
from multiscale.nonsmooth.coulomb import project_friction_cone
from multiscale.nonsmooth.friction_problem import ScaledFriction
from multiscale.nonsmooth.progress import Progress
from multiscale.numerics.anderson import Anderson

__all__ = ["admm"]

CHECK_EVERY = 5
"""Iterations between two checks of the error."""

PENALTY = 0.1
"""Penalty rho, relative to the diagonal of W."""

GROWTH = 1.5
"""Defect, relative to the last, above which an accelerated step is dropped."""


def admm(
    problem: ScaledFriction,
    reaction: np.ndarray,
    progress: Progress,
    max_iterations: int = 4000,
    memory: int = 10,
) -> np.ndarray:
    r"""Solve a friction problem by alternating directions with Anderson acceleration.

    Parameters
    ----------
    memory : int, steps that the acceleration looks back

    Notes
    -----
    One vector v carries the iteration, a fixed point of

    .. math::
        z = P_K(v), \quad \xi = v - z, \quad
        (W + \rho I)\, x = \rho\,(z - \xi - \mu \|\xi_T\| n) - q, \quad v \leftarrow x + \xi,
        \tag{1}

    where :math:`u = -\rho \xi`, so that De Saxcé's term follows at once. An accelerated step
    whose defect :math:`\|x - z\|` grows by half is dropped, and the memory with it.
    """
    solve = factorise_blocks(problem, np.tile(PENALTY * np.eye(3), (len(reaction), 1, 1)))
    if solve is None:
        return reaction
    friction, q = problem.friction, problem.velocity

    def advance(v: np.ndarray) -> np.ndarray:
        """Next v by (1)."""
        z = project_friction_cone(v.T, friction).T
        xi = v - z
        right = PENALTY * (z - xi) - q
        right[:, 0] -= PENALTY * friction * np.hypot(xi[:, 1], xi[:, 2])
        return np.asarray(solve(right) + xi)

    u = problem.respond(reaction)
    u[:, 0] += friction * np.hypot(u[:, 1], u[:, 2])
    v = reaction - u / PENALTY
    image = advance(v)
    acceleration = Anderson(memory)
    for iteration in range(1, max_iterations + 1):
        defect = image - v
        new = acceleration.next(v.ravel(), image.ravel(), defect.ravel(), float(norm(defect)))
        plain, v = image, new.reshape(v.shape)
        image = advance(v)
        if not norm(image - v) <= GROWTH * norm(defect):
            acceleration.forget()
            v, image = plain, advance(plain)
        if not np.all(np.isfinite(image)):
            break
        if iteration % CHECK_EVERY == 0 and progress.note(project_friction_cone(v.T, friction).T):
            break
    return np.asarray(project_friction_cone(v.T, friction).T)
