"""Normal law of a partly damaged interface."""

from dataclasses import dataclass, field

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.interface_law import NormalLaw

__all__ = ["Damaged"]


@dataclass(frozen=True)
class Damaged(NormalLaw):
    r"""Normal law of an interface of which a share carries no load.

    Parameters
    ----------
    law : NormalLaw, law of the sound interface, with its gap
    damage : float, damage :math:`D`, from 0 to below 1, dimensionless

    Raises
    ------
    CaseError
        If the damage is outside its range.

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
        """Evaluate (1); the unit is Pa."""
        return np.asarray((1.0 - self.damage) * self.law.pressure(gap))

    def stiffness(self, gap: np.ndarray) -> np.ndarray:
        """Return minus the derivative of (1), Pa/m."""
        return np.asarray((1.0 - self.damage) * self.law.stiffness(gap))

    def gap_at(self, pressure: np.ndarray) -> np.ndarray:
        """Return the local gap, m, at a pressure, Pa."""
        return self.law.gap_at(np.asarray(pressure) / (1.0 - self.damage))
