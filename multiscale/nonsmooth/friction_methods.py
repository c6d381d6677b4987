"""Sweeps and Newton's method for friction problems, with the kernels of a single contact."""

import numpy as np

from multiscale.nonsmooth.friction_problem import Progress, ScaledFriction, factorise_blocks
from multiscale.numerics.compiled import compiled

BURST = 20  # sweeps between two measurements of the error
SMALLEST, LARGEST = 1e-14, 1.0  # range of the regularisation, relative to the diagonal of W
PATIENCE = 10  # steps without progress after which the iteration ends


def gauss_seidel(
    problem: ScaledFriction, reaction: np.ndarray, progress: Progress, max_iterations: int = 20000
) -> np.ndarray:
    """Solve a friction problem by sweeps over its contacts (M. Jean, CMAME 177 (1999) 235-257)."""
    r = reaction.copy()
    for done in range(0, max_iterations, BURST):
        sweep(
            problem.blocks,
            problem.columns,
            problem.starts,
            problem.diagonal,
            problem.velocity,
            problem.friction,
            r,
            min(BURST, max_iterations - done),
        )
        if progress.note(r):
            break
    return r


@compiled
def sweep(blocks, columns, starts, diagonal, velocity, friction, reaction, sweeps):  # type: ignore[no-untyped-def]
    """Solve the contacts in turn, ``sweeps`` times, in place."""
    for _ in range(sweeps):
        for i in range(friction.size):
            # velocity without the impulse of contact i
            q0, q1, q2 = velocity[i, 0], velocity[i, 1], velocity[i, 2]
            for k in range(starts[i], starts[i + 1]):
                if k != diagonal[i]:
                    j = columns[k]
                    x, y, z = reaction[j, 0], reaction[j, 1], reaction[j, 2]
                    q0 += blocks[k, 0, 0] * x + blocks[k, 0, 1] * y + blocks[k, 0, 2] * z
                    q1 += blocks[k, 1, 0] * x + blocks[k, 1, 1] * y + blocks[k, 1, 2] * z
                    q2 += blocks[k, 2, 0] * x + blocks[k, 2, 1] * y + blocks[k, 2, 2] * z
            r0, r1, r2 = solve_one_contact(blocks[diagonal[i]], q0, q1, q2, friction[i])
            reaction[i, 0], reaction[i, 1], reaction[i, 2] = r0, r1, r2


@compiled
def solve_one_contact(block, q0, q1, q2, mu):  # type: ignore[no-untyped-def]
    """Solve the friction problem of a single contact: open, stuck at -W^-1 q, or sliding."""
    if q0 >= 0.0:
        return 0.0, 0.0, 0.0
    w = block[0, 0]
    n1, n2 = block[0, 1], block[0, 2]
    t1, t2 = block[1, 0] / w, block[2, 0] / w
    s11, s12 = block[1, 1] - t1 * n1, block[1, 2] - t1 * n2
    s21, s22 = block[2, 1] - t2 * n1, block[2, 2] - t2 * n2
    b1, b2 = q1 - t1 * q0, q2 - t2 * q0
    size = np.sqrt(b1 * b1 + b2 * b2)
    noise = abs(q1) + abs(q2) + (abs(t1) + abs(t2)) * -q0
    if mu == 0.0 or size <= 1e-15 * noise:
        return -q0 / w, 0.0, 0.0

    # sliding, u_T = -alpha r_T and u_N = 0: with S = W_TT - W_TN W_NT / W_NN and
    #     b = q_T - W_TN q_N / W_NN,
    #     r_T = -(S + alpha I)^-1 b,  r_N = -(q_N + W_NT r_T) / W_NN,
    #     g = mu r_N / |r_T| - 1 = 0;  (1)
    # g is negative at 0 and positive beyond |b| (W_NN + mu |W_NT|) / (-mu q_N) (2)
    low, high = 0.0, size * (w + mu * np.sqrt(n1 * n1 + n2 * n2)) / (-mu * q0)  # (2)
    mobility = block[1, 1] + block[2, 2]
    floor = 1e-14 * (mobility if mobility > 0.0 else w)
    alpha = 0.0
    if (s11 + s22) * floor >= s11 * s22 - s12 * s21:
        alpha = min(floor, 0.5 * high)  # S is singular: a soft spring
    r0, r1, r2 = 0.0, 0.0, 0.0
    for turn in range(60):
        r1, r2 = _solve_pair(s11 + alpha, s12, s21, s22 + alpha, -b1, -b2)
        r0 = -(q0 + n1 * r1 + n2 * r2) / w
        length = np.sqrt(r1 * r1 + r2 * r2)
        if turn == 0 and length <= mu * r0:
            return r0, r1, r2  # stuck
        g = mu * r0 / length - 1.0  # (1)
        if abs(g) <= 1e-15:
            break
        if g < 0.0:
            low = alpha
        else:
            high = alpha
        d1, d2 = _solve_pair(s11 + alpha, s12, s21, s22 + alpha, -r1, -r2)
        slope = -mu * (n1 * d1 + n2 * d2) / w / length
        slope -= mu * r0 * (r1 * d1 + r2 * d2) / length**3
        step = -g / slope if slope > 0.0 else np.inf
        if abs(step) <= 1e-15 * alpha or high - low <= 1e-15 * high:
            break
        alpha += step
        if not low < alpha < high:
            alpha = 0.5 * (low + high) if low > 0.0 else 0.1 * high
    shrink = mu * r0 / np.sqrt(r1 * r1 + r2 * r2) if r0 > 0.0 else 0.0
    return max(r0, 0.0), shrink * r1, shrink * r2


@compiled(inline="always")
def _solve_pair(a11, a12, a21, a22, b1, b2):  # type: ignore[no-untyped-def]
    """Solve two equations by elimination with pivoting: backward stable, unlike Cramer's rule."""
    if abs(a11) >= abs(a21):
        factor = a21 / a11
        x2 = (b2 - factor * b1) / (a22 - factor * a12)
        return (b1 - a12 * x2) / a11, x2
    factor = a11 / a21
    x2 = (b1 - factor * b2) / (a12 - factor * a22)
    return (b2 - a22 * x2) / a21, x2


def semismooth_newton(
    problem: ScaledFriction,
    reaction: np.ndarray,
    progress: Progress,
    max_iterations: int = 100,
    regularisation: float = 1e-8,
) -> None:
    """Solve a friction problem by damped Newton steps on the residual F of Alart and Curnier."""
    r = reaction.copy()
    u = problem.respond(r)
    residual, A, B = linearise(u, r, problem.friction)
    merit, alpha, failures = float(np.sum(residual**2)), regularisation, 0
    smallest = merit
    for _ in range(max_iterations):
        # direction, and the largest of 1, 1/2, 1/4 ... that lowers the merit enough
        # F' = A W + B; a proximal term makes it regular: (A (W + alpha I) + B) dr = -F (1)
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
