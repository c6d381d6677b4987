"""Power normal law of a rough interface."""

from dataclasses import dataclass

import numpy as np

from multiscale.laws.interface_law import NormalLaw
from multiscale.laws.parameters import check_parameter

__all__ = ["PowerLaw"]


@dataclass(frozen=True)
class PowerLaw(NormalLaw):
    r"""Frictionless law whose pressure is a power of the approach.

    Parameters
    ----------
    pressure_scale : float, pressure :math:`p_c > 0` at zero gap, Pa
    support : float, gap :math:`s > 0` at which contact begins, m
    exponent : float, exponent :math:`m \ge 1`, dimensionless
    gap, pressure_range
        As of :class:`NormalLaw`.

    Raises
    ------
    CaseError
        If a parameter is outside its range.

    Notes
    -----
    .. math:: p(g) = p_c\, \langle 1 - g/s \rangle_+^m.    \tag{1}

    With the approach :math:`a = s - g` this is :math:`c_n a^m` with :math:`c_n = p_c s^{-m}`; the
    units of the parameters of (1) do not depend on the exponent.

    References
    ----------
    .. [1] J. T. Oden and J. A. C. Martins, Comput. Methods Appl. Mech. Eng. 52 (1985) 527-634,
       doi:10.1016/0045-7825(85)90009-X.

    Examples
    --------
    >>> law = PowerLaw(pressure_scale=1.0e9, support=1.0e-6, exponent=2.0)
    >>> law.pressure(np.array([0.0, 0.9e-6, 2.0e-6]))  # Pa
    array([1.e+09, 1.e+07, 0.e+00])
    """

    pressure_scale: float
    support: float
    exponent: float
    gap: float = 0.0
    pressure_range: tuple[float, float] = (0.0, np.inf)

    def __post_init__(self) -> None:
        check_parameter(self, "pressure_scale", "Pa")
        check_parameter(self, "support", "m")
        check_parameter(self, "exponent", lowest=1.0)  # a convex law

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
