"""The solid around cavities and cracks, and its reduced modulus."""

import numpy as np

from multiscale.micro.damage import Cavities, spheres, youngs_modulus_along
from multiscale.micro.damage.cavities import Ellipsoids

E, NU = 200e9, 0.3
CUBE = (1.0, 1.0, 1.0)
MIDDLE = [[0.5, 0.5, 0.5]]
AXES = np.eye(3)


def ratio(solution, normals=AXES):
    """Young's modulus along directions over the modulus of the solid."""
    return youngs_modulus_along(solution.unwrap(), normals) / E


LATTICES = {
    "simple cubic": [[0.5, 0.5, 0.5]],
    "body-centred cubic": [[0.25, 0.25, 0.25], [0.75, 0.75, 0.75]],
    "face-centred cubic": [
        [0.25, 0.25, 0.25],
        [0.25, 0.75, 0.75],
        [0.75, 0.25, 0.75],
        [0.75, 0.75, 0.25],
    ],
}
"""Places of the spheres in the cubic cell, relative to its edge."""


def lattice(name, radius, *, edge):
    """Spheres on a cubic lattice, in one cell of it."""
    return Cavities((edge,) * 3, [spheres(edge * np.array(LATTICES[name]), radius)])


def ellipsoids(centre, semi_axes, rotation=None):
    """Ellipsoids with semi-axes along the columns of a rotation, or along x, y and z."""
    turn = np.eye(3) if rotation is None else rotation
    return Ellipsoids(np.array(centre, dtype=float), turn * np.array([[semi_axes]], dtype=float))


def channels(centre, radius, size=CUBE):
    """Box with round channels along z: ellipsoids a million times as long."""
    long = [ellipsoids([c], [r, r, 1e6 * max(size)]) for c, r in zip(centre, radius, strict=True)]
    return Cavities(size, long, periodic=False)
