"""Stiffness of an isotropic solid, and upper bounds of a stiffness with voids."""

import numpy as np

from multiscale.laws.bulk.bulk_law import lame_parameters


def isotropic_stiffness(youngs_modulus, poissons_ratio):
    """Stiffness of an isotropic material from Young's modulus, Pa, and Poisson's ratio."""
    lame, shear = lame_parameters(youngs_modulus, poissons_ratio)
    stiffness = np.diag([2.0 * shear] * 3 + [shear] * 3)
    stiffness[:3, :3] += lame
    return stiffness


def voigt_bound(solid, porosity):
    """Upper bound of a stiffness, Pa, with a volume fraction of voids, in the sense of energy."""
    return (1.0 - porosity) * solid


def hashin_shtrikman_bound(youngs_modulus, poissons_ratio, phi):
    """Upper bounds of bulk and shear modulus, Pa, with a volume fraction of voids.

    Z. Hashin and S. Shtrikman, J. Mech. Phys. Solids 11 (1963) 127-140,
    doi:10.1016/0022-5096(63)90060-7.
    """
    K = youngs_modulus / (3.0 * (1.0 - 2.0 * poissons_ratio))
    G = youngs_modulus / (2.0 * (1.0 + poissons_ratio))
    bulk = 4.0 * (1.0 - phi) * K * G / (4.0 * G + 3.0 * phi * K)
    shear = G * (1.0 - phi) * (9.0 * K + 8.0 * G) / (9.0 * K + 8.0 * G + 6.0 * phi * (K + 2.0 * G))
    return bulk, shear
