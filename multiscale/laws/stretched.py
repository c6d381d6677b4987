"""Normal law with stretched gaps, for the propagation of errors of a law."""

from dataclasses import dataclass

import numpy as np

from multiscale.laws.interface_law import NormalLaw
from multiscale.laws.parameters import check_parameter

__all__ = ["StretchedLaw"]


@dataclass(frozen=True)
class StretchedLaw(NormalLaw):
    r"""Law :math:`p(g) = p_0(g_c + (g - g_c - d) / f)` from the pressure :math:`p_0` of a law.

    Parameters
    ----------
    law : NormalLaw, law of the pressure :math:`p_0`
    factor : float, factor :math:`f > 0` of the distance of all gaps to the centre, dimensionless
    gap : float, default 0.0
        Initial gap between the mean planes, m; the gap of the other law is not used.
    centre : float, default 0.0, gap :math:`g_c` that is not stretched, m
    shift : float, default 0.0, increase :math:`d` of all gaps, m

    Raises
    ------
    CaseError
        If the factor is not positive.

    Examples
    --------
    >>> from multiscale.laws import Exponential
    >>> law = StretchedLaw(Exponential(1.0e9, 1.0e-6), 1.1)
    >>> float(law.gap_at(np.array(1.0e9 / np.e)))  # m
    1.1e-06
    """

    law: NormalLaw
    factor: float
    gap: float = 0.0
    centre: float = 0.0
    shift: float = 0.0

    def __post_init__(self) -> None:
        check_parameter(self, "factor")

    @property
    def pressure_range(self) -> tuple[float, float]:  # type: ignore[override]
        """Pressures of the data of the other law, Pa."""
        return self.law.pressure_range

    @property
    def pressure_limit(self) -> float:  # type: ignore[override]
        """Pressure above which data contradict the other law, Pa."""
        return self.law.pressure_limit

    def pressure(self, gap: np.ndarray) -> np.ndarray:
        """Return the pressure, Pa, at a local gap, m."""
        return self.law.pressure(self._unstretched(gap))

    def stiffness(self, gap: np.ndarray) -> np.ndarray:
        """Return minus the derivative of the pressure, Pa/m, at a local gap, m."""
        return self.law.stiffness(self._unstretched(gap)) / self.factor

    def gap_at(self, pressure: np.ndarray) -> np.ndarray:
        """Return the local gap, m, at a pressure, Pa."""
        own = self.law.gap_at(pressure)
        return np.asarray(self.centre + self.shift + self.factor * (own - self.centre))

    def _unstretched(self, gap: np.ndarray) -> np.ndarray:
        """Return the gap of the other law at the same pressure, m."""
        return np.asarray(self.centre + (np.asarray(gap) - self.centre - self.shift) / self.factor)
