"""Contact area and stiffness of an interface as functions of its pressure."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.interface_law import check_parameters


@dataclass(frozen=True)
class AreaLaw:
    r"""Contact fraction interpolated between given pressures, monotone, from 0 to at most 1.

    Parameters
    ----------
    knot_pressure : ndarray, shape (terms,)
        Nominal pressures :math:`0 < p_1 < \dots < p_n`, Pa; at least two.
    knot_fraction : ndarray, shape (terms,)
        Contact fractions :math:`A_i` at these pressures, from 0 to 1, never falling.

    Notes
    -----
    Between the knots, :math:`\ln A` over :math:`\ln p` is the monotone cubic interpolation of
    Fritsch and Butland [1]_, in which light contact is a straight line; outside the knots

    .. math::
        A(p) = A_1\, \frac{\langle p - p_0 \rangle}{p_1 - p_0} \quad (p < p_1), \qquad
        A(p) = 1 - (1 - A_n)\, \exp\Big(-\frac{A'_n\,(p - p_n)}{1 - A_n}\Big)
        \quad (p > p_n),    \tag{1}

    where :math:`p_1` is the first knot with contact, :math:`p_0` the last knot without, or zero,
    and :math:`A'_n` the slope at the last knot.

    References
    ----------
    .. [1] F. N. Fritsch and J. Butland, SIAM J. Sci. Stat. Comput. 5 (1984) 300-304,
       doi:10.1137/0905021.

    Examples
    --------
    >>> law = AreaLaw(np.array([1.0e6, 2.0e6]), np.array([0.1, 0.2]))
    >>> law.contact_fraction(np.array([0.0, 0.5e6, 1.5e6]))
    array([0.  , 0.05, 0.15])
    """

    knot_pressure: np.ndarray
    knot_fraction: np.ndarray

    def __post_init__(self) -> None:
        p = np.asarray(self.knot_pressure, dtype=float)
        a = np.asarray(self.knot_fraction, dtype=float)
        if p.ndim != 1 or p.shape != a.shape or p.size < 2:
            raise CaseError(
                f"an area law needs at least two pressures and as many contact fractions, "
                f"got shapes {p.shape} and {a.shape}"
            )
        if not (p[0] > 0.0 and np.all(np.diff(p) > 0.0) and np.isfinite(p[-1])):
            raise CaseError("the pressures of an area law must be positive and increase (Pa)")
        if not (a[0] >= 0.0 and a[-1] <= 1.0 and np.all(np.diff(a) >= 0.0)):
            raise CaseError(
                f"contact fractions must lie between 0 and 1 and never decrease with pressure, "
                f"got {np.array2string(a, precision=4)}"
            )
        object.__setattr__(self, "knot_pressure", p)
        object.__setattr__(self, "knot_fraction", a)

    def contact_fraction(self, pressure: np.ndarray) -> np.ndarray:
        """Return the contact fraction, dimensionless, at a nominal pressure, Pa; any shape."""
        pressure = np.asarray(pressure, dtype=float)
        if not np.all(pressure >= 0.0):
            raise ValueError("a pressure must not be negative (Pa)")
        touching = np.flatnonzero(self.knot_fraction > 0.0)
        if not touching.size:
            return np.zeros(pressure.shape)
        first = int(touching[0])
        origin = self.knot_pressure[first - 1] if first else 0.0
        p, a = self.knot_pressure[first:], self.knot_fraction[first:]
        ramp = np.maximum(0.0, pressure - origin) / (p[0] - origin)
        fraction, slope = a[0] * np.minimum(ramp, 1.0), a[0] / (p[0] - origin)
        if p.size > 1:
            from scipy.interpolate import PchipInterpolator

            x = np.log(p / p[0])
            inner = PchipInterpolator(x, np.log(a))
            inside = np.exp(inner(np.log(np.clip(pressure, p[0], p[-1]) / p[0])))
            slope = max(0.0, float(inner(x[-1], 1))) * a[-1] / p[-1]
            inside = np.where(pressure < p[-1], inside, a[-1])
            fraction = np.where(pressure < p[0], fraction, inside)
        if a[-1] < 1.0:
            beyond = np.maximum(0.0, pressure - p[-1]) * slope / (1.0 - a[-1])
            fraction = np.where(pressure > p[-1], 1.0 - (1.0 - a[-1]) * np.exp(-beyond), fraction)
        return np.asarray(np.clip(fraction, 0.0, 1.0))


@dataclass(frozen=True)
class ErrorFunctionArea:
    r"""Contact fraction of the diffusion theory of contact, with a single parameter.

    Parameters
    ----------
    pressure_scale : float, pressure :math:`p_A > 0` of (1), Pa

    Notes
    -----
    .. math:: A(p) = \operatorname{erf}(p / p_A),    \tag{1}

    In the theory :math:`p_A = E^* g / \sqrt 2` with the contact modulus :math:`E^*` and the root
    mean square slope :math:`g`; computed areas of light contact are larger, so that it is fitted.

    References
    ----------
    .. [1] B. N. J. Persson, J. Chem. Phys. 115 (2001) 3840-3861, doi:10.1063/1.1388626.
    """

    pressure_scale: float

    def __post_init__(self) -> None:
        check_parameters(self, pressure_scale="Pa")

    def contact_fraction(self, pressure: np.ndarray) -> np.ndarray:
        """Evaluate (1) at a nominal pressure, Pa; any shape."""
        from scipy.special import erf

        return np.asarray(erf(np.asarray(pressure) / self.pressure_scale))


class StiffnessLaw(ABC):
    """Stiffness of an interface that is not negative and does not decrease with the pressure."""

    @abstractmethod
    def stiffness_at(self, pressure: np.ndarray) -> np.ndarray:
        """Return the stiffness, Pa/m, at a nominal pressure, Pa; any shape."""


@dataclass(frozen=True)
class PowerStiffness(StiffnessLaw):
    r"""Stiffness that is a power of the pressure.

    Parameters
    ----------
    stiffness_scale : float, stiffness :math:`K_0 > 0` at the reference pressure, Pa/m
    exponent : float
        Exponent :math:`m \ge 0`, dimensionless; 1 if the stiffness is proportional to the pressure.
    reference_pressure : float, pressure :math:`p_0 > 0`, Pa

    Notes
    -----
    .. math:: K(p) = K_0\, (p / p_0)^m.    \tag{1}

    For self-affine surfaces the normal stiffness is proportional to the pressure at intermediate
    load, and the tangential stiffness is proportional to the normal stiffness, with the ratio
    :math:`2(1-\nu)/(2-\nu)` of a smooth contact before slip.

    References
    ----------
    .. [1] R. D. Mindlin, J. Appl. Mech. 16 (1949) 259-268, doi:10.1115/1.4009973.
    """

    stiffness_scale: float
    exponent: float
    reference_pressure: float

    def __post_init__(self) -> None:
        check_parameters(self, stiffness_scale="Pa/m", reference_pressure="Pa")
        check_parameters(self, lowest=0.0, exponent="1")

    def stiffness_at(self, pressure: np.ndarray) -> np.ndarray:
        """Evaluate (1), Pa/m."""
        share = np.asarray(pressure, dtype=float) / self.reference_pressure
        return np.asarray(self.stiffness_scale * share**self.exponent)
