"""The solid around cavities and cracks, and what they leave of its modulus."""

import numpy as np

from multiscale.micro.damage import youngs_modulus_along

E, NU = 200e9, 0.3
CUBE = (1.0, 1.0, 1.0)
MIDDLE = [[0.5, 0.5, 0.5]]
AXES = np.eye(3)


def ratio(solution, normals=AXES):
    """Young's modulus along directions over that of the solid."""
    return youngs_modulus_along(solution.unwrap(), normals) / E
