r"""Contact on a flat reference surface, by projected gradients on its compliance."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from multiscale.convergence import Solution, Status
from multiscale.errors import CaseError

__all__ = ["FlatSolution", "solve_flat"]

_REFRESH = 25  # iterations after which rounding in the response is wiped out


@dataclass(frozen=True)
class FlatSolution(Solution):
    """Contact forces, N, as ``value``, and the approach, m."""

    approach: float = 0.0


def solve_flat(
    compliance: Callable[[np.ndarray], np.ndarray],
    gap: np.ndarray,
    closing: np.ndarray,
    *,
    load: float | None = None,
    approach: float | None = None,
    cap: float = np.inf,
    start: np.ndarray | None = None,
    max_iterations: int = 500,
    tolerance: float = 1e-4,
) -> FlatSolution:
    r"""Minimise the complementary energy of contact forces on a surface.

    Find :math:`\lambda` and :math:`\delta` with

    .. math::
        0 \le \lambda \perp C \lambda + g - b\,\delta \ge 0, \qquad b^t \lambda = F.    \tag{1}

    With a cap, :math:`\lambda \le \lambda_{max}` and the surfaces may overlap where it is reached.

    Parameters
    ----------
    compliance : callable
        :math:`C`, m/N.
    gap, closing : ndarray
        :math:`g`, m, and :math:`b`.
    load, approach : float
        :math:`F`, N, or :math:`\delta`, m; exactly one of them.
    cap : float
        :math:`\lambda_{max}`, N: the hardness times the nominal area of a node.
    start : ndarray, optional
        First guess of the forces, N.
    max_iterations : int
    tolerance : float
        Bound on the overlap of contact nodes, weighted by their forces, relative to the range of
        the gap.

    Returns
    -------
    FlatSolution
        ``value`` is :math:`\lambda`, N, and ``approach`` :math:`\delta`, m. The residuals are what
        the tolerance is compared with, after each iteration.

    Raises
    ------
    CaseError
        If the load is more than all nodes carry at the cap.

    Notes
    -----
    Projected gradients on the box of forces that carry the load, with the two step lengths of
    Barzilai and Borwein in turn, each in the tangent of the box, and the exact minimum along the
    feasible direction: one application of :math:`C` in each iteration, a half to a third of what
    projected conjugate gradients take.

    References
    ----------
    .. [1] Y.-H. Dai and R. Fletcher, Math. Program. 106 (2006) 403-421,
       doi:10.1007/s10107-005-0595-2: the same problem.
    """
    if load is not None and load > cap * float(np.sum(closing)):
        raise CaseError(
            f"the load of {load:.4g} N is more than the {cap * float(np.sum(closing)):.4g} N that "
            f"the whole surface carries at its hardness; lower the pressure"
        )
    delta = 0.0 if approach is None else approach
    force = closing * delta - gap if load is None else np.ones_like(gap)
    force = np.clip(force if start is None or not start.any() else start, 0.0, cap)
    if load is not None:
        force, _ = _carry(force * (load / np.vdot(closing, force)), load, closing, cap, 0.0)
    elif start is None or not start.any():
        force *= float(np.vdot(force, force)) / float(np.vdot(force, compliance(force)))
        force = np.minimum(force, cap)
    response = compliance(force)
    scale = float(np.ptp(gap)) or float(np.max(np.abs(response))) or 1.0
    step = float(np.vdot(force, force)) / float(np.vdot(force, response))
    if load is not None:
        delta = float(np.vdot(force, response + gap)) / load
    status, residuals = Status.MAX_ITERATIONS, list[float]()
    for iteration in range(max_iterations):
        opening = response + gap
        if load is None:
            moved = _boxed(force - step * (opening - closing * delta), cap)
        else:
            moved, lift = _carry(force - step * opening, load, closing, cap, step * delta)
            delta = lift / step
        opening -= closing * delta
        overlap, distance = opening, np.abs(opening)
        if cap < np.inf:
            full = force >= cap  # here the surfaces may overlap
            overlap = np.where(full, 0.0, opening)
            distance = np.where(full, np.maximum(opening, 0.0), distance)
        weighted = float(np.vdot(force, distance)) / (float(np.sum(force)) or 1.0)
        deepest = -float(np.min(overlap))
        residuals.append(max(weighted, deepest) / scale)
        if residuals[-1] <= tolerance:
            status = Status.CONVERGED
            break
        direction = moved - force
        change = compliance(direction)
        curvature = float(np.vdot(direction, change))
        if not curvature > 0.0:  # these are the forces of the minimum, to rounding
            status = Status.STALLED
            break
        share = min(1.0, -float(np.vdot(direction, opening)) / curvature)
        force += share * direction
        if iteration % _REFRESH == 0:
            response = compliance(force)
        else:
            response += share * change

        step = float(np.vdot(direction, direction)) / curvature
        if iteration % 2:
            free = _inside(moved, cap)
            tangent = free * change
            if load is not None and free.any():
                b = free * closing
                tangent -= b * (float(np.vdot(b, change)) / float(np.vdot(b, b)))
            along = float(np.vdot(direction, tangent))
            step = along / float(np.vdot(tangent, tangent)) if along > 0.0 else step
    return FlatSolution(force, status, tuple(residuals), approach=delta)


def _carry(
    force: np.ndarray, load: float, closing: np.ndarray, cap: float, lift: float
) -> tuple[np.ndarray, float]:
    """Project onto the forces between 0 and the cap that carry the load.

    The nearest ones are ``clip(force + lift closing, 0, cap)``; Newton's method within a bracket
    finds the lift from the one given.
    """
    low, high = -np.inf, np.inf
    reach = 0.0
    for _ in range(200):
        carried = _boxed(force + lift * closing, cap)
        excess = float(np.vdot(closing, carried)) - load
        if abs(excess) <= 1e-14 * load:
            break
        low, high = (low, lift) if excess > 0.0 else (lift, high)
        slope = float(np.vdot(closing, _inside(carried, cap) * closing))
        new = lift - excess / slope if slope > 0.0 else np.nan
        if not low < new < high:
            reach = 2.0 * reach or float(np.ptp(force)) or load
            new = 0.5 * (low + high) if np.isfinite(low + high) else lift - np.sign(excess) * reach
        if new == lift:
            break
        lift = new
    return carried, lift


def _boxed(force: np.ndarray, cap: float) -> np.ndarray:
    """Move forces into the box between 0 and the cap, in place."""
    np.maximum(force, 0.0, out=force)
    return np.minimum(force, cap, out=force) if cap < np.inf else force


def _inside(force: np.ndarray, cap: float) -> np.ndarray:
    """Tell which forces are neither 0 nor at the cap."""
    inside = force > 0.0
    return inside & (force < cap) if cap < np.inf else inside
