r"""Frictionless contact with a flat on meshes whose factors do not fit, by algebraic multigrid.

On an active set A the nodes of A follow the obstacle and the others are free,

.. math:: v_A = g_A - \delta, \quad K_{ff} v_f = -K_{fA} v_A, \quad \lambda_A = -(K v)_A,    \tag{1}

which conjugate gradients solve for :math:`v_f` and, under a load :math:`F = \sum \lambda_A`, for
:math:`\delta` at once: with a motion d that lowers A by one, :math:`d_A = -1`, the unknowns
:math:`v + \delta d` have a symmetric positive matrix. Their preconditioner is one cycle of smoothed
aggregation, whose coarse spaces hold the six rigid motions [1]_. It is set up for one active set
and serves those that follow, with the rows of A left out, until it gets slow.

References
----------
.. [1] P. Vaněk, J. Mandel and M. Brezina, Computing 56 (1996) 179-196, doi:10.1007/BF02238511.
.. [2] M. Hintermüller, K. Ito and K. Kunisch, SIAM J. Optim. 13 (2002) 865-888,
   doi:10.1137/S1052623401383558: the active sets.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from multiscale.convergence import Status, check_limits
from multiscale.micro.elastic_cell import ContactState, untouched
from multiscale.numerics.krylov import conjugate_gradients

__all__ = ["LargeBody", "solve_large_contact"]

LOOSE = 1e-3  # residual with which active sets are changed
SLOW = 40  # iterations of one system, after which the next active set gets cycles of its own
LINEAR_LIMIT = 4000


@dataclass(frozen=True, eq=False)
class LargeBody:
    """Stiffness of a body, and the data from which multigrid is set up.

    Attributes
    ----------
    stiffness : csr_array, shape (n, n), symmetric and positive definite, N/m
    modes : ndarray, shape (n, 6), rigid motions
    place : ndarray of int, shape (n,)
        Place 3 a + i of every unknown among the components i of the nodes a.
    contact : ndarray of int, shape (contacts,)
        Unknown of every contact node along z; -1 for nodes that cannot touch.
    """

    stiffness: sparse.csr_array
    modes: np.ndarray
    place: np.ndarray
    contact: np.ndarray


@dataclass(eq=False)
class _Cycles:
    """The preconditioner of the last active set for which one was set up."""

    body: LargeBody
    cycle: Callable[[np.ndarray], np.ndarray] | None = None
    held: np.ndarray = field(default_factory=lambda: np.empty(0))
    slow: bool = True

    def precondition(self, free: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """Return the cycle for free unknowns, set up again if the last one was slow."""
        if self.slow or self.cycle is None:
            self.cycle, self.held, self.slow = _cycle(self.body, free), ~free, False
        cycle, released = self.cycle, self.held & free
        diagonal = self.body.stiffness.diagonal()

        def apply(residual: np.ndarray) -> np.ndarray:
            moved = np.where(free, cycle(np.where(self.held, 0.0, residual)), 0.0)
            return np.asarray(np.where(released, residual / diagonal, moved))

        return apply


def _cycle(body: LargeBody, free: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """One symmetric cycle of smoothed aggregation on blocks of three unknowns a node."""
    from pyamg import smoothed_aggregation_solver

    nodes, node = np.unique(body.place // 3, return_inverse=True)
    at = 3 * node + body.place % 3
    size = 3 * len(nodes)
    keep = sparse.diags_array(free.astype(float))
    matrix = (keep @ body.stiffness @ keep).tocoo()
    unit = np.full(size, float(body.stiffness.diagonal().mean()))  # held, or no unknown
    unit[at[free]] = 0.0
    rows = np.concatenate([at[matrix.row], np.arange(size)])
    columns = np.concatenate([at[matrix.col], np.arange(size)])
    entries = np.concatenate([matrix.data, unit])
    whole = sparse.csr_matrix((entries, (rows, columns)), shape=(size, size))
    modes = np.zeros((size, body.modes.shape[1]))
    modes[at[free]] = body.modes[free]
    smoother = ("chebyshev", {"degree": 2})  # as many steps as Gauss and Seidel's, and cheaper
    levels = smoothed_aggregation_solver(
        sparse.bsr_matrix(whole, blocksize=(3, 3)),
        B=modes,
        strength=("symmetric", {"theta": 0.02}),
        presmoother=smoother,
        postsmoother=smoother,
        max_coarse=600,
        coarse_solver="splu",
        improve_candidates=None,
    )
    precondition = levels.aspreconditioner(cycle="V")

    def apply(residual: np.ndarray) -> np.ndarray:
        whole = np.zeros(size)
        whole[at] = residual
        moved: np.ndarray = precondition.matvec(whole)[at]
        return moved

    return apply


def solve_large_contact(
    body: LargeBody,
    gap: np.ndarray,
    *,
    load: float | None = None,
    approach: float | None = None,
    start: ContactState | None = None,
    tolerance: float = 1e-8,
    max_iterations: int = 60,
) -> ContactState:
    """Solve (1) with a load or an approach."""
    check_limits(tolerance, max_iterations)
    if (load is None) == (approach is None):
        raise ValueError(f"prescribe either the load or the approach, got {load=} and {approach=}")
    n, able = body.stiffness.shape[0], body.contact >= 0
    if load == 0.0 or (approach is not None and np.all(gap >= approach)):
        return untouched((n,), gap, np.ones_like(gap), approach)
    if start is None or not start.active.any():
        active = able & (gap <= np.quantile(gap[able], 0.1) if approach is None else gap < approach)
        v, delta = np.zeros(n), float(gap[active].mean())
    else:
        active, v, delta = start.active.copy(), start.displacement.copy(), start.approach
    delta, lowered = delta if approach is None else approach, np.zeros(n)
    cycles = _Cycles(body)
    residuals: list[float] = []
    linear, sharp, status = 0, False, Status.MAX_ITERATIONS
    for _ in range(max_iterations):
        held = body.contact[active]
        goal = tolerance if sharp else max(LOOSE, tolerance)
        free = np.ones(n, dtype=bool)
        free[held] = False
        precondition = cycles.precondition(free)
        if load is not None:
            lowered[held] = -1.0
            if not residuals:  # fair for the active sets that follow, too
                nothing = (np.zeros(0), None)
                lowered, _, linear = _balance(
                    body.stiffness, lowered, free, precondition, nothing, LOOSE
                )
        v[held] = gap[active] - delta  # (1)
        v, change, count = _balance(
            body.stiffness, v, free, precondition, (lowered, load), 0.3 * goal
        )
        delta += change
        linear += count
        cycles.slow |= count > SLOW
        out_of_balance = -(body.stiffness @ v)
        force = np.zeros_like(gap)
        force[active] = out_of_balance[held]
        residual = float(np.linalg.norm(out_of_balance[free]) / np.linalg.norm(force))
        if load is not None:
            residual = max(residual, abs(force.sum() / load - 1.0))
        residuals.append(residual)
        if not np.isfinite(residual):
            status = Status.NOT_FINITE
            break
        deep = np.where(able, v[body.contact] + delta - gap, -np.inf)
        room = max(residual, tolerance)
        wrong = np.where(
            active,
            force < -room * float(force.max()),
            deep > room * float(np.abs(v).max()),
        )
        if not wrong.any():
            if residual <= tolerance:
                status = Status.CONVERGED
                break
            if sharp and len(residuals) > 2 and residual > 0.5 * residuals[-2]:
                status = Status.STALLED
                break
            sharp = True
        if linear >= LINEAR_LIMIT:
            status = Status.WORK_SPENT
            break
        active = active ^ wrong
        if load is not None and not active.any():
            active = able & (gap == gap[able].min())
    return ContactState(
        v, np.maximum(force, 0.0), delta, active, force, status, tuple(residuals), linear
    )


def _balance(
    stiffness: sparse.csr_array,
    start: np.ndarray,
    free: np.ndarray,
    precondition: Callable[[np.ndarray], np.ndarray],
    pressed: tuple[np.ndarray, float | None],
    goal: float,
) -> tuple[np.ndarray, float, int]:
    """Balance the free unknowns, and a load by lowering the others as ``pressed`` tells.

    Returns displacement, change of the approach and iterations. The residual is relative to the
    forces on the others, or to the least norm that they have under the load.
    """
    lowered, load = pressed
    force = stiffness @ start
    rest = np.append(np.where(free, -force, 0.0), 0.0)
    scale = float(np.linalg.norm(force[~free])) or 1.0
    pushed, own = np.zeros_like(start), 1.0
    if load is not None:
        pushed = stiffness @ lowered
        own, rest[-1] = float(lowered @ pushed), load - float(pushed @ start)
        scale = load / float(np.sqrt(np.count_nonzero(~free)))

    def apply(y: np.ndarray) -> np.ndarray:
        moved = stiffness @ y[:-1] + y[-1] * pushed
        return np.append(np.where(free, moved, 0.0), pushed @ y[:-1] + own * y[-1])

    def improve(residual: np.ndarray) -> np.ndarray:
        return np.append(precondition(residual[:-1]), residual[-1] / own)

    y, count = conjugate_gradients(apply, rest, improve, goal=goal * scale, limit=500)
    if load is None:
        return start + y[:-1], 0.0, count
    return start + y[:-1] + y[-1] * lowered, float(y[-1]), count
