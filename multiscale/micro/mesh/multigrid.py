r"""Algebraic multigrid as the inverse of large meshes in contact with a flat.

On an active set A the unknowns are the free displacements :math:`v_f` and, under a load, the
approach :math:`\delta`: with a motion d that lowers A by a unit, :math:`d_A = -1`, the
displacements are :math:`v + \delta d`. Their stiffness is inverted approximately by

.. math:: V r + \frac{d\, d^t r}{d^t K d},    \tag{1}

with V a cycle of smoothed aggregation, with coarse spaces that contain the six rigid motions [1]_.
It is set up for an active set and used for the following active sets, without the rows of A, until
the iteration gets slow.

References
----------
.. [1] P. Vaněk, J. Mandel and M. Brezina, Computing 56 (1996) 179-196, doi:10.1007/BF02238511.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from multiscale.micro.elastic.active_set import Constrained
from multiscale.micro.elastic_cell import ContactState
from multiscale.numerics.krylov import conjugate_gradients

Operator = Callable[[np.ndarray], np.ndarray]

MOTION_TOLERANCE = 1e-3  # residual of the motion d, relative to its forces on the active set
SLOW = 40  # iterations on an active set, above which the next set gets a new cycle
FIRST = 0.1  # share of the nodes in the first active set under a load


@dataclass(eq=False)
class MultigridInverse:
    """Stiffness of a body, and the data from which multigrid is set up."""

    stiffness: sparse.csr_array  # (n, n), symmetric and positive definite, N/m
    modes: np.ndarray  # (n, 6), rigid motions
    place: np.ndarray  # (n,), place 3 a + i of every unknown among the components i of nodes a
    contact: np.ndarray  # (contacts,), unknown of every contact node along z; -1 if it cannot touch
    _cycle: Operator | None = None
    _fixed: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=bool))
    _lowered: np.ndarray | None = None  # d of the present solve
    _count: int = 0  # iterations on the last active set

    def guess(
        self,
        gap: np.ndarray,
        closing: np.ndarray,
        *,
        load: float | None,
        approach: float | None,
        start: ContactState,
    ) -> tuple[np.ndarray, float]:
        """Begin with the contact nodes of the previous step, else with the highest nodes."""
        self._lowered = None
        if start.active.any():
            return start.reference_force, start.approach if approach is None else approach
        able = self.contact >= 0
        delta = float(np.quantile(gap[able], FIRST)) if approach is None else approach
        touching = able & (gap <= delta)
        forces = np.where(touching, float(self.stiffness.diagonal().mean()), 0.0)
        forces *= np.maximum(delta - gap, 0.0) if load is None else load / forces.sum()
        return forces, delta if load is None else float(gap[touching].mean())

    def constrain(self, closing: np.ndarray, active: np.ndarray, *, loaded: bool) -> Constrained:
        """Return the inverse (1) on an active set, under a load or at a fixed approach."""
        K, at = self.stiffness, self.contact[active]
        free = np.ones(K.shape[0], dtype=bool)
        free[at] = False
        if self._cycle is None or self._count > SLOW:
            self._cycle, self._fixed = _cycle(self, free), ~free
        cycle, fixed, released = self._cycle, self._fixed, self._fixed & free
        diagonal = K.diagonal()
        self._count = 0

        def among_free(residual: np.ndarray) -> np.ndarray:
            moved = np.where(free, cycle(np.where(fixed, 0.0, residual)), 0.0)
            return np.asarray(np.where(released, residual / diagonal, moved))

        # motion d and its stiffness
        lowered, stiffness = np.zeros(K.shape[0]), np.inf
        if loaded:
            lowered = lowered if self._lowered is None else self._lowered
            lowered[at] = -1.0
            if self._lowered is None:  # solved once: accurate enough for the following active sets
                force = K @ lowered
                lowered += conjugate_gradients(
                    lambda y: np.where(free, K @ y, 0.0),
                    np.where(free, -force, 0.0),
                    among_free,
                    goal=MOTION_TOLERANCE * float(np.linalg.norm(force[at])),
                    limit=500,
                )[0]
                self._lowered = lowered
            stiffness = float(lowered @ (K @ lowered))

        def invert(
            out_of_balance: np.ndarray,
            missing: float,
            out: np.ndarray,
            distance: np.ndarray | None = None,
        ) -> tuple[np.ndarray, float]:
            self._count += 1
            moved, residual = np.zeros(K.shape[0]), out_of_balance
            if distance is not None:
                moved[at] = distance[active]
                residual = residual - K @ moved
                missing = missing + float((K @ moved)[at].sum())
            residual = np.where(free, residual, 0.0)
            shift = (missing + float(lowered @ residual)) / stiffness
            out[:] = moved + among_free(residual) + shift * lowered  # (1)
            return out, shift

        return invert


def _cycle(body: "MultigridInverse", free: np.ndarray) -> Operator:
    """Set up a symmetric cycle of smoothed aggregation on blocks of three unknowns a node."""
    from pyamg import smoothed_aggregation_solver

    nodes, node = np.unique(body.place // 3, return_inverse=True)
    at = 3 * node + body.place % 3
    size = 3 * len(nodes)
    keep = sparse.diags_array(free.astype(float))
    matrix = (keep @ body.stiffness @ keep).tocoo()
    unit = np.full(size, float(body.stiffness.diagonal().mean()))  # fixed components
    unit[at[free]] = 0.0
    rows = np.concatenate([at[matrix.row], np.arange(size)])
    columns = np.concatenate([at[matrix.col], np.arange(size)])
    entries = np.concatenate([matrix.data, unit])
    padded = sparse.csr_matrix((entries, (rows, columns)), shape=(size, size))
    modes = np.zeros((size, body.modes.shape[1]))
    modes[at[free]] = body.modes[free]
    smoother = ("chebyshev", {"degree": 2})  # as many iterations as with Gauss-Seidel, and cheaper
    levels = smoothed_aggregation_solver(
        sparse.bsr_matrix(padded, blocksize=(3, 3)),
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
        spread = np.zeros(size)
        spread[at] = residual
        moved: np.ndarray = precondition.matvec(spread)[at]
        return moved

    return apply
