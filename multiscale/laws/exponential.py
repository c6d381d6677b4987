"""Exponential normal law of a rough interface."""

from dataclasses import dataclass

import numpy as np

from multiscale.laws.interface_law import NormalLaw
from multiscale.laws.parameters import check_parameter

__all__ = ["Exponential"]


@dataclass(frozen=True)
class Exponential(NormalLaw):
    r"""Frictionless law whose pressure decays exponentially with the gap.

    Parameters
    ----------
    pressure_scale : float, pressure :math:`p_c > 0` at zero gap, Pa
    decay_length : float, decay length :math:`u_0 > 0`, m
    gap, pressure_range
        As of :class:`NormalLaw`.

    Raises
    ------
    CaseError
        If a parameter is outside its range.

    Notes
    -----
    .. math:: p(g) = p_c\, e^{-g/u_0}.    \tag{1}

    The stiffness is proportional to the pressure, :math:`K = p / u_0`, as for self-affine surfaces
    at intermediate pressure.

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
        check_parameter(self, "pressure_scale", "Pa")
        check_parameter(self, "decay_length", "m")

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
