"""Map of the initial gap of an interface: waviness that is too long for cells."""

from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError

__all__ = ["GapMap"]

NEAR, FINE = 3.0, 0.1
"""Distance from a defined point of a map, in its spacings and relative to the size of an interface,
up to which it covers a place."""

PLAUSIBLE = 0.02
"""Largest range of a gap relative to the size of the interface; more is another unit."""


@dataclass(frozen=True, eq=False)
class GapMap:
    """Initial gap at points of an interface, linear between them.

    Parameters
    ----------
    position : ndarray, shape (n, 2)
        Points of the map, m, along the two axes of the structure in the plane of the interface: x
        and y where its normal is z.
    gap : ndarray, shape (n,), gap, m, NaN where it is undefined, such as in holes
    name : str, in messages

    Raises
    ------
    CaseError
        If it has fewer than three defined points.
    """

    position: np.ndarray
    gap: np.ndarray
    name: str = "the map of the gap"

    def __post_init__(self) -> None:
        if not np.count_nonzero(np.isfinite(self.gap)) >= 3:
            raise CaseError(
                f"{self.name} has {np.count_nonzero(np.isfinite(self.gap))} defined points, and a "
                f"gap over an interface needs three or more"
            )

    def at(self, place: np.ndarray) -> np.ndarray:
        """Return the gap at points of the interface, m.

        Parameters
        ----------
        place : ndarray, shape (points, 3), m, in a plane across x, y or z

        Raises
        ------
        CaseError
            If the map does not cover the interface, by its extents or by undefined points, or its
            gap is too large for the interface, as in another unit.
        """
        from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
        from scipy.spatial import cKDTree

        axes = np.sort(np.argsort(np.ptp(place, axis=0))[1:])
        x, defined = place[:, axes], np.isfinite(self.gap)
        known = self.position[defined]
        spacing = np.median(cKDTree(self.position).query(self.position, 2)[0][:, 1])
        size = float(np.ptp(x, axis=0).max())
        covered = cKDTree(known).query(x)[0] <= min(NEAR * spacing, FINE * size)
        if not covered.all():
            raise CaseError(
                f"{self.name} covers {covered.mean():.3g} of the interface: its defined points lie "
                f"{_say(known)}, and the interface {_say(x)}; give a map of the whole interface in "
                f"the coordinates of the structure, and its unit"
            )
        values = self.gap[defined]
        gap = LinearNDInterpolator(known, values)(x)
        gap = np.where(np.isnan(gap), NearestNDInterpolator(known, values)(x), gap)
        if np.ptp(gap) > PLAUSIBLE * size:
            raise CaseError(
                f"{self.name} varies by {np.ptp(gap):.3g} m over an interface of {size:.3g} m, "
                f"more than {PLAUSIBLE:g} of it; give the unit of the gaps"
            )
        return np.asarray(gap)


def _say(x: np.ndarray) -> str:
    """Extents of points in a plane."""
    low, high = x.min(axis=0), x.max(axis=0)
    return " by ".join(f"from {a:.4g} to {b:.4g} m" for a, b in zip(low, high, strict=True))
