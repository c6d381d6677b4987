"""Random radii of grains, and loose packings from which grains fall."""

import numpy as np

from multiscale.errors import CaseError
from multiscale.macro.granulate.grain_bodies import Grains

__all__ = ["draw_radii", "place_loosely"]


def draw_radii(n: int, smallest: float, largest: float, *, seed: int = 0) -> np.ndarray:
    r"""Draw radii whose volume is distributed evenly over the radius.

    Parameters
    ----------
    n : int, number of grains
    smallest, largest : float, bounds of the radii, m
    seed : int

    Returns
    -------
    ndarray, shape (n,), radii in random order, m

    Raises
    ------
    CaseError
        If the bounds are not positive and in order, or n is below one.

    Notes
    -----
    The volume of spheres is distributed evenly over the radius, so the density of their number is
    proportional to :math:`R^{-3}`, and :math:`R = (a^{-2} - q\,(a^{-2} - b^{-2}))^{-1/2}` for
    :math:`q` uniform in [0, 1] and radii from a to b.
    """
    if not 0.0 < smallest <= largest < np.inf:
        raise CaseError(
            f"radii must be positive and rise from the smallest to the largest (m), got "
            f"{smallest:g} and {largest:g}"
        )
    if n < 1:
        raise CaseError(f"there must be at least one grain, got {n}")
    share = np.random.default_rng(seed).uniform(size=n)
    inverse = smallest**-2 - share * (smallest**-2 - largest**-2)
    return np.asarray(np.clip(inverse**-0.5, smallest, largest))


def place_loosely(
    radii: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    *,
    density: float = 2600.0,
    thickness: float | None = None,
    seed: int = 0,
) -> Grains:
    """Place grains on a jittered lattice, layer upon layer, inside a box."""
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    largest = float(np.max(radii))
    spacing = 2.2 * largest
    cells = np.floor((high[:2] - low[:2]) / spacing + 1e-9).astype(int)
    if thickness is not None:
        cells[1] = 1
    if cells.min() < 1:
        raise CaseError(
            f"a grain of radius {largest:g} m needs {spacing:g} m, the box is "
            f"{float((high - low)[:2].min()):g} m wide; take smaller grains"
        )
    flat = thickness is not None
    centre = lattice(len(radii), cells, low, high, largest, seed, flat=flat)
    return Grains(centre, radii, density, thickness=thickness)


def lattice(
    n: int,
    cells: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    radius: float,
    seed: int,
    *,
    flat: bool = False,
) -> np.ndarray:
    """Return centres on a jittered lattice that fills a box from below, shape (n, 3), m."""
    k = np.arange(n)
    layer, rest = np.divmod(k, int(cells[0] * cells[1]))
    row, column = np.divmod(rest, int(cells[1]))
    width = (high[:2] - low[:2]) / cells
    centre = np.column_stack(
        [
            low[0] + (row + 0.5) * width[0],
            low[1] + (column + 0.5) * width[1],
            low[2] + 1.2 * radius + layer * 2.3 * radius,
        ]
    )
    centre += np.random.default_rng(seed).uniform(-0.05, 0.05, centre.shape) * radius
    if flat:
        centre[:, 1] = 0.0
    return centre
