r"""Contact on a flat reference surface, by projected conjugate gradients on its compliance."""

from collections.abc import Callable

import numpy as np

__all__ = ["solve_flat"]


def solve_flat(
    compliance: Callable[[np.ndarray], np.ndarray],
    gap: np.ndarray,
    closing: np.ndarray,
    *,
    load: float | None = None,
    approach: float | None = None,
    start: np.ndarray | None = None,
    max_iterations: int = 500,
    tolerance: float = 1e-4,
) -> tuple[np.ndarray, float, tuple[float, ...]]:
    r"""Minimise the complementary energy of contact forces on a surface.

    Find :math:`\lambda` and :math:`\delta` with

    .. math::
        0 \le \lambda \perp C \lambda + g - b\,\delta \ge 0, \qquad b^t \lambda = F.    \tag{1}

    Parameters
    ----------
    compliance : callable
        :math:`C`, m/N.
    gap, closing : ndarray
        :math:`g`, m, and :math:`b`.
    load, approach : float
        :math:`F`, N, or :math:`\delta`, m; exactly one of them.
    start : ndarray, optional
        First guess of the forces, N.
    max_iterations : int
        What is reached by then is returned, with residuals that tell.
    tolerance : float
        Bound on the overlap of contact nodes, weighted by their forces, relative to the range of
        the gap.

    Returns
    -------
    force : ndarray
        N.
    approach : float
        m.
    residuals : tuple of float
        What the tolerance is compared with, after each iteration.

    References
    ----------
    .. [1] I. A. Polonsky and L. M. Keer, Wear 231 (1999) 206-219,
       doi:10.1016/S0043-1648(99)00113-1.
    """
    delta = 0.0 if approach is None else approach
    force = np.zeros_like(gap) if start is None else np.maximum(start, 0.0)
    if load is not None:
        carried = float(np.vdot(closing, force))
        if carried > 0.0:
            force *= load / carried
        else:
            force = np.full_like(gap, load / float(np.sum(closing)))
    elif not force.any():
        overlap = np.maximum(closing * delta - gap, 0.0)
        force = overlap * float(np.vdot(overlap, overlap) / np.vdot(overlap, compliance(overlap)))
    scale = float(np.ptp(gap)) or float(np.max(np.abs(compliance(force)))) or 1.0

    direction = np.zeros_like(gap)
    norm_old, restart = 1.0, True
    step = float(np.vdot(force, force)) / float(np.vdot(force, compliance(force)))
    residuals: list[float] = []
    for _ in range(max_iterations):
        opening = compliance(force) + gap
        contact = force > 0.0
        if load is not None:
            delta = float(np.vdot(closing[contact], opening[contact])) / float(
                np.vdot(closing[contact], closing[contact])
            )
        opening -= closing * delta
        total = float(np.sum(force)) or 1.0
        overlap = -float(np.min(opening))
        residuals.append(max(float(np.vdot(force, np.abs(opening))) / total, overlap) / scale)
        if residuals[-1] <= tolerance:
            break
        norm = float(np.vdot(opening[contact], opening[contact]))
        direction = np.where(
            contact, opening + (0.0 if restart else norm / norm_old) * direction, 0.0
        )
        norm_old = norm
        response = compliance(direction)
        if load is not None:
            response -= closing * float(
                np.vdot(closing[contact], response[contact])
                / np.vdot(closing[contact], closing[contact])
            )
        curvature = float(np.vdot(direction, response))
        if curvature > 0.0:  # not so with a single contact node, which the load alone decides
            step = float(np.vdot(opening[contact], direction[contact])) / curvature
        force = np.maximum(force - step * direction, 0.0)
        late = (force == 0.0) & (opening < 0.0)
        force[late] -= step * opening[late]
        restart = bool(late.any())
        if load is not None:
            force *= load / float(np.vdot(closing, force))
    return force, delta, tuple(residuals)
