r"""Alternating directions for Coulomb friction: factorise once, then project and solve."""

from collections.abc import Callable

import numpy as np
from numpy.linalg import norm

from multiscale.nonsmooth.block_system import factorise_blocks
from multiscale.nonsmooth.friction_problem import ScaledFriction
from multiscale.nonsmooth.progress import Recorder
from multiscale.nonsmooth.projections import project_friction_cone

__all__ = ["admm"]

LOOK = 5
"""Iterations between two looks at the error."""


def admm(
    problem: ScaledFriction,
    reaction: np.ndarray,
    progress: Recorder,
    max_iterations: int = 4000,
    penalty: float = 0.1,
    memory: int = 10,
) -> np.ndarray:
    r"""Solve a friction problem by alternating directions with Anderson acceleration.

    Parameters
    ----------
    problem : ScaledFriction
        The problem, dimensionless.
    reaction : ndarray, shape (contacts, 3)
        Start.
    progress : Recorder
        Looks at the error every 5 iterations and says when to stop.
    max_iterations : int
        Iteration limit.
    penalty : float
        :math:`\rho`, relative to the diagonal of :math:`W`.
    memory : int
        Steps that the acceleration looks back; 0 switches it off.

    Returns
    -------
    ndarray, shape (contacts, 3)
        The last impulses, inside their cones.

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
    solve = factorise_blocks(problem, np.tile(penalty * np.eye(3), (len(reaction), 1, 1)))
    if solve is None:
        return reaction
    friction, q = problem.friction, problem.velocity

    def advance(v: np.ndarray) -> np.ndarray:
        """Next v by (1)."""
        z = project_friction_cone(v.T, friction).T
        xi = v - z
        right = penalty * (z - xi) - q
        right[:, 0] -= penalty * friction * np.hypot(xi[:, 1], xi[:, 2])
        return np.asarray(solve(right) + xi)

    u = problem.respond(reaction)
    u[:, 0] += friction * np.hypot(u[:, 1], u[:, 2])
    v = reaction - u / penalty
    image = advance(v)
    past: list[tuple[np.ndarray, np.ndarray]] = []
    for iteration in range(1, max_iterations + 1):
        v, image = _anderson(advance, v, image, past, memory)
        if not np.all(np.isfinite(image)):
            break
        if iteration % LOOK == 0 and progress.note(project_friction_cone(v.T, friction).T):
            break
    return np.asarray(project_friction_cone(v.T, friction).T)


def _anderson(
    advance: Callable[[np.ndarray], np.ndarray],
    v: np.ndarray,
    image: np.ndarray,
    past: list[tuple[np.ndarray, np.ndarray]],
    memory: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Next v and its image; ``past`` holds earlier images and defects and is brought up to date."""
    if memory == 0:
        return image, advance(image)
    past.append((image.ravel(), (image - v).ravel()))
    del past[: -memory - 1]
    if len(past) > 1:
        images = np.diff(np.array([one[0] for one in past]), axis=0)
        defects = np.diff(np.array([one[1] for one in past]), axis=0)
        gram = defects @ defects.T
        gram += (1e-12 * np.trace(gram) + 1e-300) * np.eye(len(gram))
        weights = np.linalg.solve(gram, defects @ past[-1][1])
        new = image - (weights @ images).reshape(v.shape)
        ahead = advance(new)
        if norm(ahead - new) <= 1.5 * norm(image - v):
            return new, ahead
        past.clear()
    return image, advance(image)
