"""Radii and loose packings of grains, and the boxes and pipes into which they fall."""

import numpy as np

from multiscale.errors import CaseError, require
from multiscale.macro.granulate.bodies import CylinderWall, Grains, PlaneWall, box
from multiscale.macro.granulate.model import ContactLaw, Model


def draw_radii(n: int, smallest: float, largest: float, *, seed: int = 0) -> np.ndarray:
    r"""Draw radii with a volume that is distributed uniformly over the radius.

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
        If the bounds are not positive and in order, or n is no integer from 1 on.

    Notes
    -----
    The volume of spheres is distributed uniformly over the radius, so that the density of their
    number is proportional to :math:`R^{-3}`, and
    :math:`R = (a^{-2} - q\,(a^{-2} - b^{-2}))^{-1/2}` for :math:`q` uniform in [0, 1] and radii
    from a to b.
    """
    if not 0.0 < smallest <= largest < np.inf:
        raise CaseError(
            f"radii must be positive and rise from the smallest to the largest (m), got "
            f"{smallest:g} and {largest:g}"
        )
    require("the number of grains", n, "[1, inf)", integer=True)
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
            f"{float((high - low)[:2].min()):g} m wide; use smaller grains"
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


def deposit(
    radii: np.ndarray,
    size: tuple[float, float],
    law: ContactLaw,
    *,
    density: float = 2600.0,
    seed: int = 0,
) -> Model:
    """Spheres that fall into an open box.

    Parameters
    ----------
    radii : ndarray, shape (grains,), radii of the grains, m
    size : tuple of float, edges of the box along x and y, m
    law : ContactLaw
    density : float, density of the grains, kg/m3
    seed : int

    Returns
    -------
    Model, grains above the floor of the box, at rest
    """
    low, high = np.zeros(3), np.array([*size, np.inf])
    grains = place_loosely(radii, low, high, density=density, seed=seed)
    return Model(grains, box(low, high), law)


def silo(
    radii: np.ndarray,
    diameter: float,
    law: ContactLaw,
    *,
    wall_friction: float = 0.5,
    sinking: float = 0.0,
    density: float = 2600.0,
    seed: int = 0,
) -> Model:
    """Spheres that fall into a round pipe with a flat bottom.

    Parameters
    ----------
    radii, law, density, seed
        As for :func:`deposit`.
    diameter : float, diameter of the pipe about the z axis, m
    wall_friction : float
        Friction coefficient of the pipe, dimensionless; the bottom has the coefficient of ``law``.
    sinking : float, downward speed of the bottom, m/s; it mobilises the full friction of the pipe

    Returns
    -------
    Model, grains above the bottom of the pipe, at rest

    Raises
    ------
    CaseError
        If the largest grain does not fit.
    """
    largest, bore = float(np.max(radii)), 0.5 * diameter
    across = int(diameter / (2.2 * largest))
    for count in (across, 1):  # on a square lattice, or in a single file
        ticks = (np.arange(count) - 0.5 * (count - 1)) * 2.2 * largest
        x, y = (axis.ravel() for axis in np.meshgrid(ticks, ticks))
        inside = np.hypot(x, y) + 1.08 * largest < bore
        if inside.any():
            break
    else:
        raise CaseError(
            f"a grain of radius {largest:g} m does not fit into a pipe of {diameter:g} m; use "
            f"smaller grains"
        )
    n, floor = len(radii), int(inside.sum())
    layers = lattice(n, np.array([1, 1]), np.zeros(3), np.zeros(3), largest, seed)
    k = np.arange(n)
    layers[:, 0] += x[inside][k % floor]
    layers[:, 1] += y[inside][k % floor]
    layers[:, 2] += (k // floor - k) * 2.3 * largest
    walls = (
        PlaneWall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), velocity=(0.0, 0.0, -sinking)),
        CylinderWall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), friction=wall_friction, radius=bore),
    )
    return Model(Grains(layers, radii, density), walls, law)


def column(
    radii: np.ndarray, width: float, law: ContactLaw, *, density: float = 2600.0, seed: int = 0
) -> Model:
    """Discs in the plane y = 0 that fall between a wall at x = 0 and a gate at x = width.

    Parameters
    ----------
    radii : ndarray, shape (grains,), radii of the discs, m
    width : float, distance of wall and gate, m
    law, density, seed
        As for :func:`deposit`; the discs are 1 m thick.

    Returns
    -------
    Model, the gate is the last wall; :func:`release` removes it
    """
    low, high = np.array([0.0, 0.0, 0.0]), np.array([width, 1.0, np.inf])
    grains = place_loosely(radii, low, high, density=density, thickness=1.0, seed=seed)
    wall, gate, floor = box((0.0, -np.inf, 0.0), (width, np.inf, np.inf))
    return Model(grains, (wall, floor, gate), law)


def release(model: Model, grains: Grains) -> Model:
    """Return the model of a :func:`column` without its gate, with the settled grains at rest."""
    still = np.zeros_like(grains.position)
    resting = grains.moved(grains.position, still, still)
    return Model(resting, model.walls[:-1], model.law, model.gravity, model.period)
