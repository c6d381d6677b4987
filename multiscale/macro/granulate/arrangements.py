"""Common arrangements of grains and walls."""

import numpy as np

from multiscale.errors import CaseError
from multiscale.macro.granulate.grain_bodies import CylinderWall, Grains, PlaneWall, box
from multiscale.macro.granulate.loose_packing import lattice, place_loosely
from multiscale.macro.granulate.model import ContactLaw, Model

__all__ = ["column", "deposit", "release", "silo"]


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
    ticks = (np.arange(across) - 0.5 * (across - 1)) * 2.2 * largest
    x, y = (axis.ravel() for axis in np.meshgrid(ticks, ticks))
    inside = np.hypot(x, y) + 1.08 * largest < bore
    if not inside.any():
        raise CaseError(
            f"a grain of radius {largest:g} m does not fit into a pipe of {diameter:g} m; take "
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
    """Return the model of a :func:`column` without its gate, the settled grains at rest."""
    still = np.zeros_like(grains.position)
    resting = grains.moved(grains.position, still, still)
    return Model(resting, model.walls[:-1], model.law, model.gravity, model.period)
