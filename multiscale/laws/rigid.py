"""Unilateral contact with Coulomb friction, without compliance."""

from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.interface_law import InterfaceLaw, Response

__all__ = ["RigidContact", "limit_traction"]

MAX_ITERATIONS, RELATIVE_CHANGE = 60, 1e-15
"""Iteration limit of Newton's method, and the relative change at which it stops."""

NEGLIGIBLE_LIMIT, LEAST_DIVISOR = 1e-14, 1e-150
"""Limit below which the traction is zero, relative to the unlimited traction; least divisor."""


@dataclass(frozen=True)
class RigidContact(InterfaceLaw):
    r"""Unilateral contact without penetration and adhesion, with Coulomb friction.

    Parameters
    ----------
    friction : float, friction coefficient :math:`\mu \ge 0`, dimensionless
    gap : float, default 0.0, initial gap :math:`g_0`, m

    Raises
    ------
    CaseError
        If a parameter is outside its range.

    Notes
    -----
    With the gap :math:`g = [\![u_N]\!] + g_0` and the slip :math:`s` of the step, the change of
    :math:`[\![u_T]\!]`,

    .. math::
        0 \le g \perp p = -t_N \ge 0, \qquad |t_T| \le \mu p, \qquad
        s = \lambda\, t_T, \quad 0 \le \lambda \perp \mu p - |t_T| \ge 0,    \tag{1}

    the inequalities of (4) of the source. The jump does not determine the traction of a closed
    point: :meth:`respond` returns NaN there, and only solvers that use the resolvent, such as
    :func:`multiscale.macro.solve_latin`, accept this law. The state is the tangential jump of the
    last step, m.
    """

    friction: float = 0.0
    gap: float = 0.0

    n_state, compliant = 2, False

    def __post_init__(self) -> None:
        if not (self.friction >= 0.0 and np.isfinite(self.friction)):
            raise CaseError(f"friction must not be negative, got {self.friction:g}")
        if not np.isfinite(self.gap):
            raise CaseError(f"the initial gap must be finite (m), got {self.gap:g}")

    def friction_limit(self, pressure: np.ndarray) -> np.ndarray:
        """Return Coulomb's limit, Pa, at a pressure, Pa."""
        return self.friction * pressure

    def respond(self, jump: np.ndarray, state: np.ndarray) -> Response:
        """Return zero traction at open points, NaN at closed points, and the new state."""
        apart = np.where(jump[0] + self.gap > 0.0, 0.0, np.nan)
        return Response(apart + np.zeros_like(jump), apart + np.zeros((3, *jump.shape)), jump[1:])

    def resolvent(
        self, source: np.ndarray, stiffness: float | np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Find the jump that satisfies (1) and t + k [u] = source; see :func:`limit_traction`."""
        k = np.broadcast_to(stiffness, source.shape)
        if not np.all(k > 0.0):
            raise ValueError("the stiffness of a search direction must be positive (Pa/m)")
        pressure = np.maximum(0.0, -source[0] - k[0] * self.gap)
        held = source[1:] - k[1:] * state  # traction that prevents slip
        limit = self.friction_limit(pressure)
        traction = limit_traction(held / k[1:], 1.0 / k[1:], limit)
        slides = np.sqrt(np.sum(held**2, axis=0)) > limit
        slip = np.where(slides, (held - traction) / k[1:], 0.0)
        normal = np.where(pressure > 0.0, -self.gap, source[0] / k[0])
        return np.stack([normal, *(state + slip)])


def limit_traction(drive: np.ndarray, softness: np.ndarray, limit: np.ndarray) -> np.ndarray:
    r"""Find the tangential traction on a search direction, no larger than a limit.

    Notes
    -----
    With the least :math:`\sigma \ge 0` that satisfies the limit,

    .. math:: t_i = \frac{d_i}{\sigma + a_i}, \qquad |t| \le \ell.    \tag{1}

    If both components of :math:`a` are equal, :math:`t` and :math:`d` are parallel. Newton's method
    for :math:`1/|t| = 1/\ell`, which is nearly linear in :math:`\sigma`, increases monotonically
    [1]_.

    References
    ----------
    .. [1] J. J. Moré, D. C. Sorensen, SIAM J. Sci. Stat. Comput. 4 (1983) 553-572,
       doi:10.1137/0904038.
    """
    sigma = np.zeros(limit.shape)
    for _ in range(MAX_ITERATIONS):
        traction = drive / np.maximum(sigma + softness, LEAST_DIVISOR)  # (1)
        size = np.sqrt(np.sum(traction**2, axis=0))
        slides = (size > limit) & (limit > NEGLIGIBLE_LIMIT * size)
        along = traction / np.maximum(size, LEAST_DIVISOR)
        slope = np.sum(along**2 / np.maximum(sigma + softness, LEAST_DIVISOR), axis=0)
        rise = np.where(slides, size / np.where(slides, limit, 1.0) - 1.0, 0.0)
        step = rise / np.where(slides, slope, 1.0)
        if not np.any(step > RELATIVE_CHANGE * sigma):
            break
        sigma = sigma + step
    return np.asarray(along * np.minimum(size, limit))
