"""Normal law that is a convex decreasing spline, zero beyond the highest summit."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from multiscale.errors import CaseError, ConvergenceError
from multiscale.laws.interface_law import NormalLaw, newton_from_the_left

__all__ = ["ConvexDecreasing"]


@dataclass(frozen=True)
class ConvexDecreasing(NormalLaw):
    r"""Frictionless law whose pressure is a convex, decreasing cubic spline of the gap.

    Parameters
    ----------
    knot : ndarray, shape (terms,), gaps :math:`s_1 < \dots < s_n` at which the terms vanish, m
    coefficient : ndarray, shape (terms,)
        :math:`c_k`, Pa m\ :sup:`-3`. Single coefficients may be negative, see (2).
    gap, pressure_range, pressure_limit
        As of :class:`NormalLaw`.

    Raises
    ------
    CaseError
        If the knots do not increase, or the law is not convex.

    Notes
    -----
    With the local gap :math:`g = [\![u_N]\!] + g_0`,

    .. math:: t_N = -\sum_k c_k\, \langle s_k - g\rangle_+^3, \qquad t_T = 0.    \tag{1}

    The curvature of (1) is linear between the knots and zero beyond the last knot. The law is
    therefore convex, and since it vanishes beyond :math:`s_n` also decreasing and positive, if and
    only if

    .. math::
        \sum_{k>j} c_k\, (s_k - s_j) \ge 0 \quad (j = 1 \dots n-1), \qquad
        \sum_k c_k \ge 0,    \tag{2}

    where the last condition applies to gaps below the first knot. Coefficients :math:`c_k \ge 0`
    satisfy (2) but represent only laws with convex :math:`p^{1/3}`: no power law :math:`(s - g)^m`
    with :math:`m < 3`, no Greenwood-Williamson law at small gap, and not the first contact of a
    wave.

    Between two knots (1) is expanded about the right knot,

    .. math::
        p = \sum_{i=0}^3 a_{ij} (s_j - g)^i, \qquad
        a_{ij} = \binom{3}{i} \sum_{k \ge j} c_k (s_k - s_j)^{3-i},    \tag{3}

    with no more cancellation than in (1).

    Examples
    --------
    >>> law = ConvexDecreasing(knot=np.array([1.0e-6]), coefficient=np.array([1.0e27]))
    >>> jump = np.array([[0.0, 0.5e-6, 2.0e-6], [0.0, 0.0, 0.0]])  # shape (d, points), m
    >>> law.respond(jump, state=np.empty((0, 3))).traction[0]
    array([-1.00e+09, -1.25e+08, -0.00e+00])
    """

    knot: np.ndarray
    coefficient: np.ndarray
    gap: float = 0.0
    pressure_range: tuple[float, float] = (0.0, np.inf)
    pressure_limit: float = np.inf

    def __post_init__(self) -> None:
        s, c = np.asarray(self.knot, dtype=float), np.asarray(self.coefficient, dtype=float)
        if s.ndim != 1 or s.shape != c.shape or s.size == 0:
            raise CaseError(
                f"knot and coefficient must be lists of one length, got shapes {s.shape} "
                f"and {c.shape}"
            )
        if not (np.all(np.isfinite(s)) and np.all(np.isfinite(c))):
            raise CaseError("knot (m) and coefficient (Pa m^-3) must be finite")
        if not np.all(np.diff(s) > 0.0):
            raise CaseError("the knots of a convex decreasing law must increase (m)")
        ramp = np.maximum(0.0, s - s[:, None])  # (2), one row per j
        curvature = np.append(ramp @ c, np.sum(c))
        size = np.append(ramp @ np.abs(c), np.sum(np.abs(c)))
        if not np.all(curvature >= -1e-9 * size):  # relative to the terms that cancel
            j = int(np.argmin(np.where(size > 0.0, curvature / np.where(size > 0.0, size, 1), 0)))
            where = f"at the gap {s[j]:.3g} m" if j < s.size else "below the first knot"
            raise CaseError(
                f"the law is not convex {where}: its curvature is negative there; "
                f"it is convex if all coefficients are positive (Pa m^-3)"
            )
        if not c[-1] > 0.0:
            raise CaseError(
                f"the coefficient of the last knot must be positive (Pa m^-3), got {c[-1]:g}; "
                f"remove terms that are zero"
            )
        object.__setattr__(self, "knot", s)
        object.__setattr__(self, "coefficient", c)

    def pressure(self, gap: np.ndarray) -> np.ndarray:
        """Evaluate (1); the unit is Pa."""
        d, (a0, a1, a2, a3) = self._piece(gap)
        return np.asarray(a0 + d * (a1 + d * (a2 + d * a3)))  # (3)

    def stiffness(self, gap: np.ndarray) -> np.ndarray:
        """Return minus the derivative of (1), Pa/m."""
        d, (_, a1, a2, a3) = self._piece(gap)
        return np.asarray(a1 + d * (2.0 * a2 + d * 3.0 * a3))

    def gap_at(self, pressure: np.ndarray) -> np.ndarray:
        """Return the local gap, m, at a pressure, Pa; the last knot at zero pressure.

        Newton's method is monotone for a convex function from any start left of the root: it starts
        at the next knot left of the root. In the last interval (1) has one term and is inverted
        directly.
        """
        target = np.asarray(pressure, dtype=float)
        if not np.all((target >= 0.0) & np.isfinite(target)):
            raise ValueError("a pressure must be finite and not negative (Pa)")
        s, c = self.knot, self.coefficient
        at_knot = self._at_knots
        last = target <= (at_knot[-2] if s.size > 1 else np.inf)
        left = np.searchsorted(-at_knot, -target, side="right") - 1
        gap = np.where(last, s[-1] - np.cbrt(target / c[-1]), s[np.maximum(left, 0)])
        for _ in range(200):
            error = self.pressure(gap) - target
            step = np.where(last, 0.0, error / np.where(last, 1.0, self.stiffness(gap)))
            small = np.abs(step) <= 1e-14 * (np.abs(gap) + s[-1] - s[0])
            passed = (error <= 0.0) & (error >= -1e-9 * target)  # only round-off passes the root
            finished = last | small | passed
            if np.all(finished):
                return np.asarray(gap)
            gap = np.where(finished, gap, gap + step)
        raise ConvergenceError(
            f"the convex decreasing law was not inverted at {float(np.max(target)):.3g} Pa; "
            f"it was fitted up to {self.pressure_range[1]:.3g} Pa"
        )

    def resolvent(
        self, source: np.ndarray, stiffness: float | np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Find the jump on the law and on a search direction; see :class:`InterfaceLaw`.

        Newton's method starts from the last knot left of the root; beyond all knots the start is
        the root.
        """
        stiffness = np.broadcast_to(stiffness, source.shape)
        k, b = stiffness[0], source[0]
        knot, left = self.knot - self.gap, np.full(b.shape, -1)
        for jump, pressure in zip(knot, self._at_knots, strict=True):
            left += k * jump - pressure <= b
        if np.any(left < 0):
            return super().resolvent(source, stiffness, state)
        start = np.where(left < knot.size - 1, knot[left], b / k)
        return newton_from_the_left(self, source, stiffness, state, start)

    @cached_property
    def _at_knots(self) -> np.ndarray:
        """Pressure at the knots, Pa."""
        return self.pressure(self.knot)

    @cached_property
    def _expansions(self) -> np.ndarray:
        """:math:`a_{ij}` of (3) in row i, and zeros beyond the last knot, shape (4, terms + 1)."""
        s, c = self.knot, self.coefficient
        beyond = np.maximum(0.0, s - s[:, None])  # one row per j
        own = s >= s[:, None]
        terms = [beyond**3, 3.0 * beyond**2, 3.0 * beyond, own]
        return np.stack([np.append(term @ c, 0.0) for term in terms])

    def _piece(self, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the distance to the next knot on the right and the coefficients of (3) there."""
        j = np.searchsorted(self.knot, gap, side="right")
        right = self.knot[np.minimum(j, self.knot.size - 1)]
        return np.maximum(0.0, right - gap), self._expansions[:, j]
