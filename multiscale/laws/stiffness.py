"""Contact stiffness of an interface as a function of its pressure."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from multiscale.laws.parameters import check_parameter

__all__ = ["PowerStiffness", "StiffnessLaw"]


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

    Raises
    ------
    CaseError
        If a parameter is outside its range.

    Notes
    -----
    .. math:: K(p) = K_0\, (p / p_0)^m.    \tag{1}

    For self-affine surfaces the normal stiffness is proportional to the pressure at intermediate
    load, and the tangential stiffness is proportional to the normal stiffness, with the ratio
    :math:`2(1-\nu)/(2-\nu)` of a smooth contact before slip.

    References
    ----------
    .. [1] R. D. Mindlin, J. Appl. Mech. 16 (1949) 259-268, doi:10.1115/1.4009973.

    Examples
    --------
    >>> law = PowerStiffness(stiffness_scale=2.0e13, exponent=0.5, reference_pressure=1.0e7)
    >>> law.stiffness_at(np.array([1.0e7, 4.0e7]))  # Pa/m
    array([2.e+13, 4.e+13])
    """

    stiffness_scale: float
    exponent: float
    reference_pressure: float

    def __post_init__(self) -> None:
        check_parameter(self, "stiffness_scale", "Pa/m")
        check_parameter(self, "reference_pressure", "Pa")
        check_parameter(self, "exponent", lowest=0.0)

    def stiffness_at(self, pressure: np.ndarray) -> np.ndarray:
        """Evaluate (1), Pa/m."""
        share = np.asarray(pressure, dtype=float) / self.reference_pressure
        return np.asarray(self.stiffness_scale * share**self.exponent)
