"""Normal law of a table of pressures and gaps, with chords between them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.interface_law import NormalLaw

__all__ = ["Tabulated"]

CONCAVE = 1e-9
"""Decrease of the stiffness from chord to chord that counts as round-off, relative to it."""


@dataclass(frozen=True)
class Tabulated(NormalLaw):
    r"""Frictionless law that is linear between the points of a table.

    Parameters
    ----------
    table_pressure : ndarray, shape (points,), pressures :math:`p_0 = 0 < p_1 < \dots < p_n`, Pa
    table_gap : ndarray, shape (points,), gaps :math:`g_0 > g_1 > \dots > g_n` at these, m
    gap, pressure_range
        As of :class:`NormalLaw`.

    Raises
    ------
    CaseError
        If the pressures do not rise from zero, the gaps do not fall, or a chord is softer than
        the chord before it, so that the law is not convex.

    Notes
    -----
    .. math:: p(g) = \sum_{i=0}^{n-1} (K_i - K_{i-1})\, \langle g_i - g\rangle_+, \qquad
        K_i = \frac{p_{i+1} - p_i}{g_i - g_{i+1}}, \quad K_{-1} = 0.    \tag{1}

    The last chord continues beyond the table, as in other finite-element codes.

    Examples
    --------
    >>> law = Tabulated(np.array([0.0, 1.0e6, 5.0e6]), np.array([0.0, -1.0e-7, -3.0e-7]))
    >>> law.pressure(np.array([1.0e-7, -0.5e-7, -2.0e-7])).round()  # Pa
    array([      0.,  500000., 3000000.])
    """

    table_pressure: np.ndarray
    table_gap: np.ndarray
    gap: float = 0.0
    pressure_range: tuple[float, float] = (0.0, np.inf)

    def __post_init__(self) -> None:
        p, g = (np.asarray(one, dtype=float) for one in (self.table_pressure, self.table_gap))
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
        return np.maximum.accumulate(K)  # round-off of equal chords is no softening

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
