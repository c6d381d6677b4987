r"""Frictionless contact with a flat on meshes whose factors do not fit, by algebraic multigrid.

On an active set A the nodes of A follow the obstacle and the others are free,

.. math:: v_A = g_A - \delta, \quad K_{ff} v_f = -K_{fA} v_A, \quad \lambda_A = -(K v)_A,    \tag{1}

which conjugate gradients solve for :math:`v = w_0 + \delta w_1`; a prescribed load
:math:`F = \sum \lambda_A` gives :math:`\delta`. Their preconditioner is one cycle of smoothed
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

from multiscale.convergence import Status
from multiscale.micro.contact_state import ContactState, untouched
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
    stiffness : csr_array, shape (n, n)
        Symmetric and positive definite, N/m.
    modes : ndarray, shape (n, 6)
        Rigid motions.
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
    setups: int = 0

    def precondition(self, free: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """Return the cycle for free unknowns, set up again if the last one was slow."""
        if self.slow or self.cycle is None:
            self.cycle, self.held, self.slow = _cycle(self.body, free), ~free, False
            self.setups += 1
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
    """Solve (1) with a load or an approach.

    Parameters
    ----------
    body : LargeBody
    gap : ndarray, shape (contacts,)
        Gaps at first touch, m.
    load, approach : float
        N, or m; exactly one of them.
    start : ContactState, optional
        State from which the active sets and the iterations begin.
    tolerance : float
        Bound on the norm of the forces out of balance, relative to the norm of the contact forces,
        and on the error of the load, relative to the load.
    max_iterations : int
        Most active sets.

    Returns
    -------
    ContactState
    """
    if (load is None) == (approach is None):
        raise ValueError(f"prescribe either the load or the approach, got {load=} and {approach=}")
    n, able = body.stiffness.shape[0], body.contact >= 0
    if load == 0.0 or (approach is not None and np.all(gap >= approach)):
        return untouched((n,), gap, np.ones_like(gap), approach)
    if start is None:
        active = able & (gap <= np.quantile(gap[able], 0.1) if approach is None else gap < approach)
        w = np.zeros((2, n))
    else:
        active = start.active.copy()
        w = np.stack([start.displacement, np.zeros(n)])
    cycles = _Cycles(body)
    residuals: list[float] = []
    linear, sharp, status = 0, False, Status.MAX_ITERATIONS
    for _ in range(max_iterations):
        held = body.contact[active]
        goal = tolerance if sharp else max(LOOSE, tolerance)
        free = np.ones(n, dtype=bool)
        free[held] = False
        precondition = cycles.precondition(free)
        for k, motion in enumerate((gap[active], np.full(len(held), -1.0))):  # of (1)
            w[k, held] = motion
            w[k], count = _relax(body.stiffness, w[k], free, precondition, 0.3 * goal)
            linear += count
            cycles.slow |= count > SLOW
        forces = -(body.stiffness @ w.T).T
        pull = forces[:, held].sum(axis=1)
        delta = approach if approach is not None else (float(load or 0.0) - pull[0]) / pull[1]
        v, out_of_balance = w[0] + delta * w[1], forces[0] + delta * forces[1]
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


def _relax(
    stiffness: sparse.csr_array,
    start: np.ndarray,
    free: np.ndarray,
    precondition: Callable[[np.ndarray], np.ndarray],
    goal: float,
) -> tuple[np.ndarray, int]:
    """Balance the free unknowns; the residual is relative to the forces on the others."""
    force = stiffness @ start
    residual = np.where(free, -force, 0.0)
    scale = float(np.linalg.norm(force[~free])) or 1.0
    change, count = conjugate_gradients(
        lambda u: np.where(free, stiffness @ u, 0.0),
        residual,
        precondition,
        goal=goal * scale,
        limit=500,
    )
    return start + change, count
