"""Problems without an answer: out of range, indefinite, infeasible or jammed with a certificate."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import eigh_tridiagonal
from scipy.sparse import bsr_array, csc_array, csr_array, diags_array, eye_array, vstack

from multiscale.convergence import Status
from multiscale.errors import CaseError
from multiscale.nonsmooth.friction_problem import ScaledFriction

LARGEST_EXPONENT = 300
"""Power of ten of the unknowns beyond which fractions of 1e-8 of them have rounding errors or
overflow."""

FIRST_LOOK, THOROUGH = 40, 200
"""Lanczos steps before a problem is solved, and after no method has solved it."""

SMALL = 100  # size up to which Lanczos takes as many steps as there are eigenvalues

BREAKDOWN = 1e-12
"""New direction, relative to the largest product, below which the space is invariant."""

FARTHEST = 1e9
"""Sum of the scaled unknowns, relative to the data, beyond which a solution does not count."""

LARGEST_PROGRAM = 2000
"""Number of constraints up to which a linear program looks for the certificate."""

LARGEST_CONIC, CONIC_TOLERANCE = 20_000, 1e-12
"""Blocks of W up to which a conic program looks for the certificate, and its gap."""


def refuse_out_of_range(vector: np.ndarray, stiffness: np.ndarray) -> None:
    r"""Raise if :math:`-q_i / M_{ii}` under- or overflows in the row where it is largest."""
    rows = (vector < 0.0) & (stiffness > 0.0)
    if not rows.any():
        return
    exponent = float(np.max(np.log10(-vector[rows]) - np.log10(stiffness[rows])))
    if abs(exponent) > LARGEST_EXPONENT:
        raise CaseError(
            f"the unknowns are about 10^{exponent:.0f} in the units of the data, which is outside "
            f"of the floating-point numbers; choose other units"
        )


def refuse_indefinite(
    apply: Callable[[np.ndarray], np.ndarray],
    size: int,
    steps: int,
    sentence: str,
    *,
    width: int = 1,
    atol: float = 0.0,
    rtol: float = 0.0,
) -> None:
    """Raise if Lanczos meets a clearly negative eigenvalue of a symmetric operator."""
    values, vectors = lanczos(apply, size, steps)
    if values[0] >= -max(atol, rtol * abs(values[-1])):
        return
    # more steps, because the first few may name another row
    values, vectors = lanczos(apply, size, THOROUGH)
    shares = np.sum(vectors[:, 0].reshape(-1, width) ** 2, axis=1)
    worst = int(np.argmax(shares))
    raise CaseError(sentence.format(value=values[0], worst=worst, share=shares[worst]))


def lanczos(
    apply: Callable[[np.ndarray], np.ndarray], size: int, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Ritz values and vectors of a symmetric operator, with full orthogonalisation."""
    steps = min(steps, size)
    basis = np.empty((steps, size))
    diagonal, off = np.empty(steps), np.empty(steps)
    vector = np.random.default_rng(seed=0).standard_normal(size)
    off_before = np.linalg.norm(vector)
    for k in range(steps):
        basis[k] = vector / off_before
        vector = apply(basis[k])
        diagonal[k] = basis[k] @ vector
        for _ in range(2):  # orthogonal to all vectors before, twice against rounding
            vector = vector - basis[: k + 1].T @ (basis[: k + 1] @ vector)
        off[k] = off_before = np.linalg.norm(vector)
        if off[k] <= BREAKDOWN * np.abs(diagonal[: k + 1]).max():
            break
    values, weights = eigh_tridiagonal(diagonal[: k + 1], off[:k])
    return values, basis[: k + 1].T @ weights


def infeasibility_detail(
    matrix: csr_array | np.ndarray, vector: np.ndarray, directions: Iterable[np.ndarray]
) -> str:
    """Return a sentence on a Farkas certificate y of a scaled problem; empty if there is none."""
    from scipy.optimize import linprog

    transposed = matrix.T

    def judge(y: np.ndarray) -> str:
        largest = float(np.max(y, initial=0.0))
        if largest == 0.0:
            return ""
        y = np.maximum(y / largest, 0.0)
        power, reach = float(vector @ y), float(np.max(transposed @ y))
        # y >= 0, A^T y <= 0, b^T y < 0 (1): every admissible x has a sum of at least
        # -b^T y / max(A^T y)
        if power >= 0.0 or -power <= FARTHEST * reach:
            return ""
        return (
            f"constraint {int(np.argmax(y))} carries the largest entry of the Farkas certificate "
            f"(y >= 0, M^T y <= 0, q^T y < 0); relieve that constraint or support the body it "
            f"pushes"
        )

    for y in directions:
        if np.all(np.isfinite(y)) and (detail := judge(y)):
            return detail
    if vector.size > LARGEST_PROGRAM:
        return ""
    answer = linprog(
        vector,
        A_ub=transposed,
        b_ub=np.zeros(vector.size),
        bounds=(0.0, 1.0),
        method="highs",
        options={"primal_feasibility_tolerance": 1e-10},
    )
    return judge(answer.x) if answer.x is not None else ""


def jamming(problem: ScaledFriction) -> tuple[Status, str] | None:
    """Return why a problem has, or may have, no solution; None without a certificate."""
    if problem.columns.size > LARGEST_CONIC:
        return None
    response = replace(problem, velocity=np.zeros_like(problem.velocity))
    for rubs, status, impulses, remedy in (
        (False, Status.INFEASIBLE, "normal impulses", "make a body between them deformable"),
        (
            True,
            Status.JAMMED,
            "impulses with friction",
            "make a body deformable, or lower the friction",
        ),
    ):
        # W y = 0 (1) and q^T y < 0, with 0 <= q^T y + sum mu |u_T| y_N: no solution if y is normal
        # (Farkas); with friction the condition of Acary and others (2011) for existence fails
        y = _least_work(problem, rubs)
        g = response.respond(y)
        undone = float(np.max(g[:, 0] + problem.friction * np.hypot(g[:, 1], g[:, 2])))
        work = float(np.sum(problem.velocity * y))
        rounding = float(np.sum(np.abs(problem.velocity * y))) / FARTHEST
        if -work > max(FARTHEST * undone, rounding):
            carrying = np.flatnonzero(y[:, 0] > 0.1 * np.max(y[:, 0]))
            return status, (
                f"{impulses} at {carrying.size} contacts ({_listed(carrying)}) balance each other "
                f"and move nothing, while these contacts close; {remedy}"
            )
    return None


def _listed(contacts: np.ndarray, most: int = 8) -> str:
    more = ", ..." if contacts.size > most else ""
    return ", ".join(str(contact) for contact in contacts[:most]) + more


def _least_work(problem: ScaledFriction, rubs: bool) -> np.ndarray:
    """Minimum of q^T y under W y = 0 and sum y_N <= 1 in the cone or on its axis."""
    n = problem.friction.size
    W = csc_array(bsr_array((problem.blocks, problem.columns, problem.starts)))
    carries = np.arange(3 * n) % 3 == 0
    total = csc_array(carries[None].astype(float))
    cone = diags_array(-np.where(carries, np.repeat(problem.friction, 3), 1.0))
    if not rubs:
        W, total, cone = W[:, carries], total[:, carries], -eye_array(n)
    constraints = csc_array(vstack([W, total, cone]))
    limits = np.zeros(constraints.shape[0])
    limits[3 * n] = 1.0
    size = constraints.shape[1]
    velocity = problem.velocity.ravel() if rubs else problem.velocity[:, 0]
    answer = solve_conic(
        csc_array((size, size)),
        velocity,
        constraints,
        limits,
        zero=3 * n,
        positive=1 if rubs else n + 1,
        friction=n if rubs else 0,
    )
    y = np.zeros((n, 3))
    y.reshape(-1)[slice(None) if rubs else carries] = answer.x
    y[:, 0] = np.maximum(y[:, 0], 0.0)
    return y / (np.max(y[:, 0]) or 1.0)


def solve_conic(
    quadratic: csc_array,
    linear: np.ndarray,
    constraints: csc_array,
    limits: np.ndarray,
    *,
    zero: int = 0,
    positive: int = 0,
    friction: int = 0,
    tolerance: float = CONIC_TOLERANCE,
) -> Any:
    """Return clarabel's answer to min x^T P x / 2 + q^T x with b - A x in {0} x R+ x K."""
    import clarabel

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    cones = [clarabel.ZeroConeT(zero)] if zero else []
    cones += [clarabel.NonnegativeConeT(positive)] if positive else []
    cones += [clarabel.SecondOrderConeT(3)] * friction
    return clarabel.DefaultSolver(
        csc_array(quadratic), linear, csc_array(constraints), limits, cones, settings
    ).solve()
