"""Normal laws: pressure as a convex decreasing function of the gap."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from multiscale.errors import CaseError, ConvergenceError
from multiscale.laws.interface_law import NormalLaw, check_parameters, forwarded

CONCAVE = 1e-9
"""Decrease of the stiffness from chord to chord that counts as round-off, relative to it."""


@dataclass(frozen=True)
class Exponential(NormalLaw):
    r"""Frictionless law with a pressure that decays exponentially with the gap.

    Parameters
    ----------
    pressure_scale : float, pressure :math:`p_c > 0` at zero gap, Pa
    decay_length : float, decay length :math:`u_0 > 0`, m
    gap, pressure_range : see :class:`NormalLaw`

    Notes
    -----
    .. math:: p(g) = p_c\, e^{-g/u_0}.    \tag{1}

    The stiffness :math:`K = p / u_0` agrees with self-affine surfaces at intermediate pressure.

    References
    ----------
    .. [1] S. Akarapu, T. Sharp and M. O. Robbins, Phys. Rev. Lett. 106 (2011) 204301,
       doi:10.1103/PhysRevLett.106.204301.

    Examples
    --------
    >>> law = Exponential(pressure_scale=1.0e9, decay_length=0.5e-6)
    >>> law.gap_at(np.array([1.0e8, 1.0e7]))  # m
    array([1.15129255e-06, 2.30258509e-06])
    """

    pressure_scale: float
    decay_length: float
    gap: float = 0.0
    pressure_range: tuple[float, float] = (0.0, np.inf)

    def __post_init__(self) -> None:
        check_parameters(self, pressure_scale="Pa", decay_length="m")

    def pressure(self, gap: np.ndarray) -> np.ndarray:
        """Evaluate (1); the unit is Pa."""
        with np.errstate(over="ignore"):  # infinite at very negative gaps
            return np.asarray(self.pressure_scale * np.exp(-gap / self.decay_length))

    def stiffness(self, gap: np.ndarray) -> np.ndarray:
        """Return minus the derivative of (1), Pa/m."""
        return self.pressure(gap) / self.decay_length

    def gap_at(self, pressure: np.ndarray) -> np.ndarray:
        """Return the local gap, m, at a pressure, Pa; infinite at zero pressure."""
        with np.errstate(divide="ignore"):
            return np.asarray(-self.decay_length * np.log(pressure / self.pressure_scale))


@dataclass(frozen=True)
class PowerLaw(NormalLaw):
    r"""Frictionless law with a pressure that is a power of the approach.

    Parameters
    ----------
    pressure_scale : float, pressure :math:`p_c > 0` at zero gap, Pa
    support : float, gap :math:`s > 0` at which contact begins, m
    exponent : float, exponent :math:`m \ge 1`, dimensionless
    gap, pressure_range : see :class:`NormalLaw`

    Notes
    -----
    .. math:: p(g) = p_c\, \langle 1 - g/s \rangle_+^m.    \tag{1}

    The units of the parameters do not depend on the exponent.

    References
    ----------
    .. [1] J. T. Oden and J. A. C. Martins, Comput. Methods Appl. Mech. Eng. 52 (1985) 527-634,
       doi:10.1016/0045-7825(85)90009-X.
    """

    pressure_scale: float
    support: float
    exponent: float
    gap: float = 0.0
    pressure_range: tuple[float, float] = (0.0, np.inf)

    def __post_init__(self) -> None:
        check_parameters(self, pressure_scale="Pa", support="m")
        check_parameters(self, lowest=1.0, exponent="1")  # a convex law

    def pressure(self, gap: np.ndarray) -> np.ndarray:
        """Evaluate (1); the unit is Pa."""
        approach = np.maximum(0.0, 1.0 - np.asarray(gap) / self.support)
        return np.asarray(self.pressure_scale * approach**self.exponent)

    def stiffness(self, gap: np.ndarray) -> np.ndarray:
        """Return minus the derivative of (1), Pa/m; zero at first contact."""
        approach = np.maximum(0.0, 1.0 - np.asarray(gap) / self.support)
        slope = self.pressure_scale * self.exponent / self.support
        return np.where(approach > 0.0, slope * approach ** (self.exponent - 1.0), 0.0)

    def gap_at(self, pressure: np.ndarray) -> np.ndarray:
        """Return the local gap, m, at a pressure, Pa; the support at zero pressure."""
        share = np.asarray(pressure) / self.pressure_scale
        return np.asarray(self.support * (1.0 - share ** (1.0 / self.exponent)))


@dataclass(frozen=True)
class Dilatant(NormalLaw):
    r"""Frictionless law of a sheared layer of rigid grains, which dilates as the pressure falls.

    Parameters
    ----------
    pressure_scale : float, pressure :math:`p_c > 0` at which the layer is twice as high, Pa
    solid_height : float, height :math:`h > 0` of the layer in slow shear, m
    least_dilation : float, dilation :math:`x_0 > 0` below which the law goes on with its tangent
    gap, pressure_range : see :class:`NormalLaw`

    Notes
    -----
    .. math:: p(g) = p_c\, x^{-2}, \qquad x = g/h - 1 \ge x_0,    \tag{1}

    at one speed: the solid fraction falls linearly with the inertial number [1]_, which is in
    proportion to :math:`1 / \sqrt p`.

    References
    ----------
    .. [1] F. da Cruz et al., Phys. Rev. E 72 (2005) 021309, doi:10.1103/PhysRevE.72.021309.
    """

    pressure_scale: float
    solid_height: float
    least_dilation: float = 1e-4
    gap: float = 0.0
    pressure_range: tuple[float, float] = (0.0, np.inf)

    def __post_init__(self) -> None:
        check_parameters(self, pressure_scale="Pa", solid_height="m", least_dilation="1")

    def pressure(self, gap: np.ndarray) -> np.ndarray:
        """Evaluate (1); the unit is Pa."""
        x, below = self._dilation(gap)
        return np.asarray(self.pressure_scale * (1.0 + 2.0 * below / x) / x**2)

    def stiffness(self, gap: np.ndarray) -> np.ndarray:
        """Return minus the derivative of (1), Pa/m."""
        x, _ = self._dilation(gap)
        return np.asarray(2.0 * self.pressure_scale / self.solid_height / x**3)

    def gap_at(self, pressure: np.ndarray) -> np.ndarray:
        """Return the local gap, m, at a pressure, Pa; infinite at zero pressure."""
        least = self.least_dilation
        with np.errstate(divide="ignore"):
            root = np.sqrt(self.pressure_scale / np.asarray(pressure, dtype=float))
        x = np.maximum(root, least)
        below = 0.5 * least * ((least / np.minimum(root, least)) ** 2 - 1.0)
        return np.asarray(self.solid_height * (1.0 + x - below))

    def _dilation(self, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return dilations limited to the least dilation, and their distances below it."""
        x = np.asarray(gap, dtype=float) / self.solid_height - 1.0
        return np.maximum(x, self.least_dilation), np.maximum(0.0, self.least_dilation - x)


@dataclass(frozen=True)
class Tabulated(NormalLaw):
    r"""Frictionless law that is linear between the points of a table.

    Parameters
    ----------
    table_pressure : ndarray, shape (points,), pressures :math:`p_0 = 0 < p_1 < \dots < p_n`, Pa
    table_gap : ndarray, shape (points,), gaps :math:`g_0 > g_1 > \dots > g_n` at these, m
    gap, pressure_range : see :class:`NormalLaw`

    Notes
    -----
    .. math:: p(g) = \sum_{i=0}^{n-1} (K_i - K_{i-1})\, \langle g_i - g\rangle_+, \qquad
        K_i = \frac{p_{i+1} - p_i}{g_i - g_{i+1}}, \quad K_{-1} = 0.    \tag{1}

    No chord may be softer than the chord before it, so that the law is convex; the last chord
    continues beyond the table, as in other finite-element codes.
    """

    table_pressure: np.ndarray
    table_gap: np.ndarray
    gap: float = 0.0
    pressure_range: tuple[float, float] = (0.0, np.inf)

    def __post_init__(self) -> None:
        p, g = np.asarray(self.table_pressure, float), np.asarray(self.table_gap, float)
        if p.ndim != 1 or p.shape != g.shape or p.size < 2:
            raise CaseError(
                f"a table has two points or more, each with a pressure and a gap, got shapes "
                f"{p.shape} and {g.shape}"
            )
        if not (np.all(np.isfinite(p)) and np.all(np.isfinite(g)) and p[0] == 0.0):
            raise CaseError(
                f"the pressures (Pa) and gaps (m) of a table must be finite and begin at the "
                f"pressure zero, got {p[0]:g} Pa at {g[0]:g} m"
            )
        wrong = np.flatnonzero((np.diff(p) <= 0.0) | (np.diff(g) >= 0.0))
        if wrong.size:
            k = int(wrong[0])
            raise CaseError(
                f"from point {k} to {k + 1} of a table the pressure must rise and the gap fall, "
                f"got {p[k]:g} to {p[k + 1]:g} Pa and {g[k]:g} to {g[k + 1]:g} m"
            )
        K = -np.diff(p) / np.diff(g)
        softer = np.flatnonzero(np.diff(K) < -CONCAVE * K[:-1])
        if softer.size:
            k = int(softer[0]) + 1
            raise CaseError(
                f"the law is not convex at point {k} of a table, {p[k]:g} Pa, behind which the "
                f"stiffness falls from {K[k - 1]:.4g} to {K[k]:.4g} Pa/m; smooth the table"
            )
        object.__setattr__(self, "table_pressure", p)
        object.__setattr__(self, "table_gap", g)

    @cached_property
    def _stiffness(self) -> np.ndarray:
        """Stiffness K_i of every chord, Pa/m."""
        K = -np.diff(self.table_pressure) / np.diff(self.table_gap)
        return np.maximum.accumulate(K)  # the round-off of equal chords is not softening

    def pressure(self, gap: np.ndarray) -> np.ndarray:
        """Evaluate (1) on the chord of each gap; the unit is Pa."""
        j, closed = self._chord(gap)
        rise = self._stiffness[j] * (self.table_gap[j] - gap)
        return np.where(closed, self.table_pressure[j] + rise, 0.0)

    def stiffness(self, gap: np.ndarray) -> np.ndarray:
        """Return the stiffness of the chord at a gap, Pa/m; at a point of the chord beyond it."""
        j, closed = self._chord(gap)
        return np.where(closed, self._stiffness[j], 0.0)

    def gap_at(self, pressure: np.ndarray) -> np.ndarray:
        """Return the local gap, m, at a pressure, Pa; the first gap at zero pressure."""
        p, last = np.asarray(pressure), self._stiffness.size - 1
        j = np.clip(np.searchsorted(self.table_pressure, p, side="right") - 1, 0, last)
        return np.asarray(self.table_gap[j] - (p - self.table_pressure[j]) / self._stiffness[j])

    def _chord(self, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the number of the chord at each gap, and whether the gap is closed."""
        j = np.searchsorted(-self.table_gap, -np.asarray(gap), side="right") - 1
        return np.clip(j, 0, self._stiffness.size - 1), j >= 0


@dataclass(frozen=True)
class ConvexDecreasing(NormalLaw):
    r"""Frictionless law with a convex, decreasing cubic spline of the gap as pressure.

    Parameters
    ----------
    knot : ndarray, shape (terms,), gaps :math:`s_1 < \dots < s_n` at which the terms vanish, m
    coefficient : ndarray, shape (terms,)
        :math:`c_k`, Pa m\ :sup:`-3`. Single coefficients may be negative, see (2).
    gap, pressure_range, pressure_limit : see :class:`NormalLaw`

    Notes
    -----
    .. math:: t_N = -\sum_k c_k\, \langle s_k - g\rangle_+^3, \qquad t_T = 0.    \tag{1}

    As its curvature is linear between the knots and zero beyond, the law is convex, and therefore
    decreasing and positive, if and only if

    .. math::
        \sum_{k>j} c_k\, (s_k - s_j) \ge 0 \quad (j = 1 \dots n-1), \qquad
        \sum_k c_k \ge 0,    \tag{2}

    the last condition below the first knot. Coefficients :math:`c_k \ge 0` satisfy (2) but
    represent only laws with convex :math:`p^{1/3}`: no power law with an exponent below 3, no
    Greenwood-Williamson law at small gap, no first contact of a sinusoidal profile. Between two
    knots (1) is expanded about the right knot,

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
                f"knot and coefficient must be lists of equal length, got shapes {s.shape} "
                f"and {c.shape}"
            )
        if not (np.all(np.isfinite(s)) and np.all(np.isfinite(c))):
            raise CaseError("knot (m) and coefficient (Pa m^-3) must be finite")
        if not np.all(np.diff(s) > 0.0):
            raise CaseError("the knots of a convex decreasing law must increase (m)")
        ramp = np.maximum(0.0, s - s[:, None])  # (2), a row per j
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

        Newton's method is monotone for a convex function from any start left of the root.
        """
        target = np.asarray(pressure, dtype=float)
        if not np.all((target >= 0.0) & np.isfinite(target)):
            raise ValueError("a pressure must be finite and not negative (Pa)")
        s, c = self.knot, self.coefficient
        at_knot = self._at_knots
        # in the last interval (1) has a single term; elsewhere start at the knot left of the root
        last = target <= (at_knot[-2] if s.size > 1 else np.inf)
        left = np.searchsorted(-at_knot, -target, side="right") - 1
        gap = np.where(last, s[-1] - np.cbrt(target / c[-1]), s[np.maximum(left, 0)])
        for _ in range(200):
            error, slope = self.pressure(gap) - target, np.where(last, 1.0, self.stiffness(gap))
            if not np.all(slope > 0.0):  # a pressure that the fitted law does not reach
                break
            step = np.where(last, 0.0, error / slope)
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

    def _left_of_root(self, b: np.ndarray, k: np.ndarray) -> np.ndarray:
        # last knot left of the root; beyond all knots b/k is the root
        knot, left = self.knot - self.gap, np.full(b.shape, -1)
        for jump, pressure in zip(knot, self._at_knots, strict=True):
            left += k * jump - pressure <= b
        if np.any(left < 0):
            return super()._left_of_root(b, k)
        return np.asarray(np.where(left < knot.size - 1, knot[left], b / k))

    @cached_property
    def _at_knots(self) -> np.ndarray:
        """Pressure at the knots, Pa."""
        return self.pressure(self.knot)

    @cached_property
    def _expansions(self) -> np.ndarray:
        """:math:`a_{ij}` of (3) in row i, and zeros beyond the last knot, shape (4, terms + 1)."""
        s, c = self.knot, self.coefficient
        beyond = np.maximum(0.0, s - s[:, None])  # a row per j
        terms = [beyond**3, 3.0 * beyond**2, 3.0 * beyond, s >= s[:, None]]
        return np.stack([np.append(term @ c, 0.0) for term in terms])

    def _piece(self, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the distance to the next knot on the right and the coefficients of (3) there."""
        j = np.searchsorted(self.knot, gap, side="right")
        right = self.knot[np.minimum(j, self.knot.size - 1)]
        return np.maximum(0.0, right - gap), self._expansions[:, j]


@dataclass(frozen=True)
class ModifiedLaw(NormalLaw):
    r"""Another law with damage, or with the gaps of an error of the law.

    Parameters
    ----------
    law : NormalLaw, law of the pressure :math:`p_0`, with its gap
    damage : float, share :math:`D` of the interface without load, from 0 to below 1, dimensionless
    factor : float, factor :math:`f > 0` of the distance of all gaps to the centre, dimensionless
    centre, shift : float, gap :math:`g_c` that is not stretched; increase :math:`d` of all gaps, m

    Notes
    -----
    .. math:: p(g) = (1 - D)\, p_0(g_c + (g - g_c - d) / f).    \tag{1}

    Examples
    --------
    >>> law = Exponential(pressure_scale=1.0e9, decay_length=1.0e-6)
    >>> ModifiedLaw(law, damage=0.25).pressure(np.array([0.0]))  # Pa
    array([7.5e+08])
    >>> float(ModifiedLaw(law, factor=1.1).gap_at(np.array(1.0e9 / np.e)))  # m
    1.1e-06
    """

    law: NormalLaw
    damage: float = 0.0
    factor: float = 1.0
    centre: float = 0.0
    shift: float = 0.0

    gap = forwarded("law", "gap")

    def __post_init__(self) -> None:
        check_parameters(self, factor="1")
        if not 0.0 <= self.damage < 1.0:
            raise CaseError(
                f"the damage of an interface must lie from 0 to below 1, got {self.damage:g}; "
                f"remove an interface that is fully damaged"
            )

    @property
    def pressure_range(self) -> tuple[float, float]:  # type: ignore[override]
        """Pressures of the data, Pa."""
        low, high = self.law.pressure_range
        return (1.0 - self.damage) * low, (1.0 - self.damage) * high

    @property
    def pressure_limit(self) -> float:  # type: ignore[override]
        """Pressure above which data contradict the law, Pa."""
        return (1.0 - self.damage) * self.law.pressure_limit

    def pressure(self, gap: np.ndarray) -> np.ndarray:
        """Evaluate (1), Pa."""
        return np.asarray((1.0 - self.damage) * self.law.pressure(self._gap_before(gap)))

    def stiffness(self, gap: np.ndarray) -> np.ndarray:
        """Return minus the derivative of (1), Pa/m."""
        sound = self.law.stiffness(self._gap_before(gap))
        return np.asarray((1.0 - self.damage) * sound / self.factor)

    def gap_at(self, pressure: np.ndarray) -> np.ndarray:
        """Return the local gap, m, at a pressure, Pa."""
        distance = self.law.gap_at(np.asarray(pressure) / (1.0 - self.damage)) - self.centre
        return np.asarray(self.centre + self.shift + self.factor * distance)

    def _gap_before(self, gap: np.ndarray) -> np.ndarray:
        """Return the gap of the other law at the same pressure, m."""
        return np.asarray(self.centre + (np.asarray(gap) - self.centre - self.shift) / self.factor)
