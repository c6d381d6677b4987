"""Observations against the law that was fitted to them: one check for all branches of a law."""

from dataclasses import dataclass

import numpy as np

from multiscale.units import readable

__all__ = ["ALLOWED", "TWO_SIDED", "Misfit", "list_pressures"]

ALLOWED = 0.1
"""Distance of a law from an observation over its scale, beside the scatter, up to which it fits."""

TWO_SIDED = 1.96  # standard deviations to 95 %


@dataclass(frozen=True, eq=False)
class Misfit:
    """Distances of a law from what it was fitted to.

    Attributes
    ----------
    what : str, name of the law and of what was observed, such as "the bed misses the shear"
    pressure : ndarray, shape (points,), of the observations, Pa
    distance : ndarray, shape (points,)
        Law less observation, over the scale of the observation; dimensionless.
    scatter : ndarray, shape (points,), optional
        Standard deviation of the mean observation over its scale; none if it is not known.
    """

    what: str
    pressure: np.ndarray
    distance: np.ndarray
    scatter: np.ndarray | float = 0.0

    @property
    def missed(self) -> np.ndarray:
        """Which observations lie farther from the law than :data:`ALLOWED` and 95 % of chance."""
        allowed = ALLOWED + TWO_SIDED * np.nan_to_num(self.scatter)
        return np.asarray(~(np.abs(self.distance) <= allowed))

    def judge(self, advice: str) -> list[str]:
        """Return a caution that names the pressures which the law misses; none if it fits."""
        if not self.missed.any():
            return []
        largest = 100.0 * float(np.max(np.abs(self.distance[self.missed])))
        at = list_pressures(self.pressure[self.missed])
        return [f"{self.what} by up to {largest:.3g} % at {at}; {advice}"]


def list_pressures(pressure: np.ndarray) -> str:
    """Write pressures, Pa, in rising order: all of up to five, else how many between which."""
    told = [readable(f"{one:.4g} Pa") for one in np.unique(pressure)]
    if len(told) > 5:
        return f"{len(told)} pressures from {told[0]} to {told[-1]}"
    return f"{', '.join(told[:-1])} and {told[-1]}" if len(told) > 1 else told[0]
