"""Normal laws made from another one: of a damaged interface, and with stretched gaps."""

from dataclasses import dataclass, field

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.interface_law import NormalLaw, check_parameter

__all__ = ["Damaged", "StretchedLaw"]


@dataclass(frozen=True)
class Damaged(NormalLaw):
    r"""Normal law of an interface of which a share carries no load.

    Parameters
    ----------
    law : NormalLaw, law of the sound interface, with its gap
    damage : float, damage :math:`D`, from 0 to below 1, dimensionless

    Notes
    -----
    .. math:: t_N = -(1 - D)\, p(g), \qquad t_T = 0.    \tag{1}

    Examples
    --------
    >>> from multiscale.laws import Exponential
    >>> law = Damaged(Exponential(pressure_scale=1.0e9, decay_length=0.5e-6), damage=0.25)
    >>> law.pressure(np.array([0.0]))
    array([7.5e+08])
    """

    law: NormalLaw
    damage: float = field()

    def __post_init__(self) -> None:
        if not 0.0 <= self.damage < 1.0:
            raise CaseError(
                f"the damage of an interface must lie from 0 to below 1, got {self.damage:g}; "
                f"remove an interface that is fully damaged"
            )

    @property
    def gap(self) -> float:  # type: ignore[override]
        """Initial gap of the sound law, m."""
        return self.law.gap

    @property
    def pressure_range(self) -> tuple[float, float]:  # type: ignore[override]
        """Pressures of the data of the sound law, times 1 - D, Pa."""
        low, high = self.law.pressure_range
        return (1.0 - self.damage) * low, (1.0 - self.damage) * high

    @property
    def pressure_limit(self) -> float:  # type: ignore[override]
        """Pressure above which data contradict the sound law, times 1 - D, Pa."""
        return (1.0 - self.damage) * self.law.pressure_limit

    def pressure(self, gap: np.ndarray) -> np.ndarray:
        """Evaluate (1), Pa."""
        return np.asarray((1.0 - self.damage) * self.law.pressure(gap))

    def stiffness(self, gap: np.ndarray) -> np.ndarray:
        """Return minus the derivative of (1), Pa/m."""
        return np.asarray((1.0 - self.damage) * self.law.stiffness(gap))

    def gap_at(self, pressure: np.ndarray) -> np.ndarray:
        """Return the local gap, m, at a pressure, Pa."""
        return self.law.gap_at(np.asarray(pressure) / (1.0 - self.damage))


@dataclass(frozen=True)
class StretchedLaw(NormalLaw):
    r"""Law with stretched gaps, for errors of a law: :math:`p(g) = p_0(g_c + (g - g_c - d) / f)`.

    Parameters
    ----------
    law : NormalLaw, law of the pressure :math:`p_0`; its initial gap is not used
    factor : float, factor :math:`f > 0` of the distance of all gaps to the centre, dimensionless
    gap : float, default 0.0, initial gap between the mean planes, m
    centre : float, default 0.0, gap :math:`g_c` that is not stretched, m
    shift : float, default 0.0, increase :math:`d` of all gaps, m

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
        distance = self.law.gap_at(pressure) - self.centre
        return np.asarray(self.centre + self.shift + self.factor * distance)

    def _unstretched(self, gap: np.ndarray) -> np.ndarray:
        """Return the gap of the other law at the same pressure, m."""
        return np.asarray(self.centre + (np.asarray(gap) - self.centre - self.shift) / self.factor)
