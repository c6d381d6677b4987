r"""A flat cell held at a mean gap: its pressure and its stiffness, to round-off.

The compliance :math:`\tilde C` of the cell without its mean, which belongs to the bulk, leaves the
mean height of the surface where it is. An approach :math:`\delta` of the obstacle from first touch
then *is* a change of the mean gap,

.. math::
    0 \le \lambda \perp \tilde C \lambda + g_0 - \delta \ge 0, \qquad
    \bar g = \operatorname{mean} g_0 - \delta,    \tag{1}

and with the contact nodes :math:`A` of (1)

.. math::
    \tilde C_{AA}\, \lambda_A = \delta - g_{0,A}, \qquad
    p = \frac{\sum \lambda_A}{A_0}, \qquad
    -\frac{\mathrm{d} p}{\mathrm{d} \bar g}
      = \frac{1^t\, \tilde C_{AA}^{-1}\, 1}{A_0}.    \tag{2}
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from multiscale.convergence import Status
from multiscale.errors import CaseError
from multiscale.micro.cell import FlatCell
from multiscale.micro.contact_area import contact_fraction
from multiscale.micro.flat import solve_flat
from multiscale.micro.flat_cell import flat_gap
from multiscale.micro.lateral_fft import SurfaceFilter
from multiscale.numerics.krylov import conjugate_gradients

__all__ = ["GapCell", "GapState", "assemble_gap_cell"]

_START = 1e-3  # tolerance of the projected gradients that find the first contact nodes
_LINEAR_LIMIT = 5000  # conjugate-gradient iterations on all sets of contact nodes together

Operator = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class GapState:
    """What a cell answers at a mean gap.

    Attributes
    ----------
    mean_gap : float
        m.
    pressure : float, mean pressure, Pa
    stiffness : float, minus the derivative of the pressure with respect to the mean gap, Pa/m
    contact_fraction : float, real over nominal contact area
    node : ndarray of int, contact nodes, in the flattened grid
    force : ndarray, their contact forces, N
    status : Status
    iterations : int
        Conjugate-gradient iterations in all.
    """

    mean_gap: float
    pressure: float
    stiffness: float
    contact_fraction: float
    node: np.ndarray
    force: np.ndarray
    status: Status
    iterations: int


@dataclass(frozen=True, eq=False)
class GapCell:
    """A flat cell made ready for (1).

    Attributes
    ----------
    gap : ndarray, shape (nx, ny)
        :math:`g_0`, at first touch, m.
    node_area : float, nominal area of a node, m²
    compliance : callable
        :math:`C`, without its mean, m/N.
    preconditioner : callable, an approximate inverse of it
    """

    gap: np.ndarray
    node_area: float
    compliance: Operator
    preconditioner: Operator

    @property
    def touch(self) -> float:
        """Mean gap at first touch, m: beyond it the pressure is zero."""
        return float(np.mean(self.gap))

    def solve(
        self,
        mean_gap: float,
        start: GapState | None = None,
        *,
        max_iterations: int = 60,
        tolerance: float = 1e-11,
    ) -> GapState:
        """Solve (1) at a mean gap and evaluate (2).

        Parameters
        ----------
        mean_gap : float
            m, positive: at zero the surfaces are in full contact, which any pressure can hold.
        start : GapState, optional
            State at another gap. It changes the time, not the answer.
        max_iterations : int, limit of changes of the contact nodes
        tolerance : float
            Tolerance of the conjugate gradients, relative to the norm of the right-hand side.

        Raises
        ------
        CaseError
            If the mean gap is not positive.
        """
        if not mean_gap > 0.0:
            raise CaseError(
                f"a cell is held at a positive mean gap (m), got {mean_gap:g}: in full contact "
                f"the pressure is not a function of the gap"
            )
        approach = self.touch - mean_gap
        if approach <= 0.0:
            nothing, node = np.zeros(0), np.zeros(0, dtype=int)
            return GapState(mean_gap, 0.0, 0.0, 0.0, node, nothing, Status.CONVERGED, 0)
        force = self._first_force(approach, start)
        active = force > 0.0
        status, n_linear = Status.MAX_ITERATIONS, 0
        for _ in range(max_iterations):
            most = _LINEAR_LIMIT - n_linear
            force, n = self._linear_stage(approach - self.gap, active, force, tolerance, most)
            n_linear += n
            if n_linear >= _LINEAR_LIMIT:
                status = Status.WORK_SPENT
                break
            opening = self.compliance(force) + self.gap - approach
            slack = 100.0 * tolerance
            pulls = active & (force < -slack * float(np.max(force)))
            overlaps = ~active & (opening < -slack * approach)
            if not np.any(pulls | overlaps):
                status = Status.CONVERGED
                break
            active = (active & ~pulls) | overlaps
        ones, nothing = np.ones_like(force), np.zeros_like(force)
        tangent, n = self._linear_stage(ones, active, nothing, 1e-9, _LINEAR_LIMIT)
        if n >= _LINEAR_LIMIT:
            status = Status.WORK_SPENT
        if not np.isfinite(np.sum(force) + np.sum(tangent)):
            status = Status.NOT_FINITE
        node = np.flatnonzero(active)
        area = self.node_area * force.size
        return GapState(
            mean_gap,
            float(np.sum(force)) / area,  # (2)
            float(np.sum(tangent)) / area,  # (2)
            contact_fraction(force, np.full(force.shape, self.node_area)),
            node,
            force.ravel()[node],
            status,
            n_linear + n,
        )

    def _first_force(self, approach: float, start: GapState | None) -> np.ndarray:
        """Find forces, N, whose support is close to the contact nodes."""
        guess = np.zeros_like(self.gap)  # solve_flat takes zeros for no guess
        if start is not None:
            guess.flat[start.node] = np.maximum(start.force, 0.0)
        force = solve_flat(
            self.compliance,
            self.gap,
            np.ones_like(self.gap),
            approach=approach,
            start=guess,
            tolerance=_START,
        ).value
        if not np.any(force > 0.0):  # a touch of one node
            force = np.where(self.gap < approach, 1.0, 0.0)
        return force

    def _linear_stage(
        self,
        distance: np.ndarray,
        active: np.ndarray,
        start: np.ndarray,
        tolerance: float,
        most: int,
    ) -> tuple[np.ndarray, int]:
        """Solve the first of (2) in ``most`` conjugate gradients; return forces and iterations."""
        target = np.where(active, distance, 0.0)
        return conjugate_gradients(
            lambda force: np.where(active, self.compliance(force), 0.0),
            target,
            lambda moved: np.where(active, self.preconditioner(moved), 0.0),
            goal=tolerance * float(np.linalg.norm(target)),
            limit=most,
            start=np.where(active, start, 0.0),
        )


def assemble_gap_cell(cell: FlatCell) -> GapCell:
    """Set up (1) for a flat cell.

    Raises
    ------
    CaseError
        If the cell is not flat, has a hardness or a ``slope_order`` of 2, or fits its obstacle
        exactly.
    """
    if not isinstance(cell, FlatCell):
        raise CaseError(
            "a cell is held at a gap with geometry='flat' only, got 'conforming'; for a conforming "
            "cell fit a law to its response at pressures"
        )
    if cell.hardness is not None:
        raise CaseError(
            "a cell with a hardness is not held at a gap; leave the hardness out, or fit a law to "
            "its response"
        )
    if cell.slope_order != 1:
        raise CaseError(
            "a cell is held at a gap with slope_order = 1 only: of higher order the mean of the "
            "compliance is not of the bulk alone"
        )
    obstacle, area, symbol = flat_gap(cell)
    symbol[0, 0] = 0.0  # the mean belongs to the bulk
    inverse = 1.0 / np.where(symbol > 0.0, symbol, np.max(symbol))
    gap = obstacle - cell.surface.heights
    if not np.ptp(gap) > 0.0:
        raise CaseError("the surface and the obstacle fit exactly: without a gap there is no law")
    return GapCell(gap, area, SurfaceFilter(symbol), SurfaceFilter(inverse))
