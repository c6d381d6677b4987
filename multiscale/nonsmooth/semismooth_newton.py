r"""Semismooth Newton on the residual of Alart and Curnier, regularised for singular W."""

import numpy as np

from multiscale.nonsmooth.friction_problem import Progress, ScaledFriction, factorise_blocks
from multiscale.numerics.compiled import compiled

__all__ = ["semismooth_newton"]

SMALLEST, LARGEST = 1e-14, 1.0
"""Range of the regularisation, relative to the diagonal of W."""

PATIENCE = 10
"""Steps without progress after which the iteration gives up."""


def semismooth_newton(
    problem: ScaledFriction,
    reaction: np.ndarray,
    progress: Progress,
    max_iterations: int = 100,
    regularisation: float = 1e-8,
) -> np.ndarray:
    r"""Solve a friction problem by damped Newton steps.

    The derivative of the residual :math:`F` of Alart and Curnier is :math:`A W + B`. Where the
    impulses are not unique it is singular, and the step solves

    .. math:: \bigl(A (W + \alpha I) + B\bigr)\, \Delta r = -F    \tag{1}

    instead: a proximal step, which leaves the solutions where they are. :math:`\alpha`, relative to
    the diagonal of W and first ``regularisation``, falls tenfold with each full step and grows
    where the line search fails.
    """
    r = reaction.copy()
    u = problem.respond(r)
    residual, A, B = linearise(u, r, problem.friction)
    merit, alpha, failures = float(np.sum(residual**2)), regularisation, 0
    smallest = merit
    for _ in range(max_iterations):
        # direction, and the largest of 1, 1/2, 1/4 ... that lowers the merit enough
        solve = factorise_blocks(problem, B + alpha * A + SMALLEST * np.eye(3), A)  # (1)
        step = np.full_like(r, np.nan) if solve is None else -solve(residual)
        length = 0.0
        if np.all(np.isfinite(step)):
            change = problem.respond(step) - problem.velocity
            length = 1.0
            for _ in range(12):
                trial = linearise(u + length * change, r + length * step, problem.friction)[0]
                if float(np.sum(trial**2)) <= (1.0 - 1e-4 * length) * merit:
                    break
                length *= 0.5
            else:
                length = 0.0
        # step and regularisation of the next direction
        if length == 0.0:
            alpha = min(max(100.0 * alpha, 1e-8), LARGEST)
            failures += 1
        else:
            r = r + length * step
            u = problem.respond(r)
            residual, A, B = linearise(u, r, problem.friction)
            merit = float(np.sum(residual**2))
            if progress.note(r):
                break
            alpha = max(SMALLEST, 0.1 * alpha) if length == 1.0 else alpha
            alpha = min(10.0 * alpha, LARGEST) if length < 0.1 else alpha
            failures += merit > 0.8 * smallest
            smallest = min(smallest, merit)
        if failures > PATIENCE:
            break
    return r


@compiled
def linearise(velocity, reaction, friction):  # type: ignore[no-untyped-def]
    """Residual F of Alart and Curnier with a unit step, and the blocks of F' = A W + B."""
    contacts = friction.size
    residual = reaction.copy()
    A, B = np.zeros((contacts, 3, 3)), np.zeros((contacts, 3, 3))
    for i in range(contacts):
        mu = friction[i]
        z0 = reaction[i, 0] - velocity[i, 0]
        z1, z2 = reaction[i, 1] - velocity[i, 1], reaction[i, 2] - velocity[i, 2]
        length = np.sqrt(z1 * z1 + z2 * z2)
        if z0 <= 0.0:  # open: F = r
            B[i, 0, 0] = B[i, 1, 1] = B[i, 2, 2] = 1.0
            continue
        residual[i, 0] = velocity[i, 0]
        A[i, 0, 0] = 1.0
        if length <= mu * z0:  # stuck: F = u
            residual[i, 1], residual[i, 2] = velocity[i, 1], velocity[i, 2]
            A[i, 1, 1] = A[i, 2, 2] = 1.0
            continue
        n1, n2, share = z1 / length, z2 / length, mu * z0 / length  # sliding
        residual[i, 1] -= share * z1
        residual[i, 2] -= share * z2
        A[i, 1, 1], A[i, 2, 2] = share * (1.0 - n1 * n1), share * (1.0 - n2 * n2)
        A[i, 1, 2] = A[i, 2, 1] = -share * n1 * n2
        B[i, 1, 1], B[i, 2, 2] = 1.0 - A[i, 1, 1], 1.0 - A[i, 2, 2]
        B[i, 1, 2] = B[i, 2, 1] = -A[i, 1, 2]
        A[i, 1, 0], A[i, 2, 0] = mu * n1, mu * n2
        B[i, 1, 0], B[i, 2, 0] = -mu * n1, -mu * n2
    return residual, A, B
