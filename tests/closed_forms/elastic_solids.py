"""Stiffness of an isotropic solid."""

import numpy as np

from multiscale.laws.bulk.bulk_law import lame_parameters


def isotropic_stiffness(youngs_modulus, poissons_ratio):
    """Stiffness of an isotropic material from Young's modulus, Pa, and Poisson's ratio."""
    lame, shear = lame_parameters(youngs_modulus, poissons_ratio)
    stiffness = np.diag([2.0 * shear] * 3 + [shear] * 3)
    stiffness[:3, :3] += lame
    return stiffness
