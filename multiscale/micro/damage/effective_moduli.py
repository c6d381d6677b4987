r"""Moduli along directions, soft modes, rotations and bounds of a 6 x 6 stiffness.

Strains and stresses are ordered xx, yy, zz, yz, xz, xy with shear angles. Stiffnesses have the
shape (6, 6) and the unit Pa.
"""

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.bulk.moduli import lame_parameters

__all__ = [
    "drop_soft_modes",
    "hashin_shtrikman_bound",
    "isotropic_stiffness",
    "voigt_bound",
    "youngs_modulus_along",
]

MANDEL = np.array([1.0, 1.0, 1.0, 2.0**0.5, 2.0**0.5, 2.0**0.5])
"""Factors between the components and an orthonormal basis of symmetric tensors."""

COMPONENTS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
"""Indices of the components xx, yy, zz, yz, xz, xy."""


def isotropic_stiffness(youngs_modulus: float, poissons_ratio: float) -> np.ndarray:
    """Stiffness of an isotropic material from Young's modulus, Pa, and Poisson's ratio."""
    lame, shear = lame_parameters(youngs_modulus, poissons_ratio)
    stiffness = np.diag([2.0 * shear] * 3 + [shear] * 3)
    stiffness[:3, :3] += lame
    return stiffness


def youngs_modulus_along(stiffness: np.ndarray, normals: np.ndarray) -> np.ndarray:
    r"""Young's modulus for tension along directions.

    Parameters
    ----------
    stiffness : ndarray, shape (6, 6)
    normals : ndarray, shape (..., 3)
        Unit vectors n.

    Returns
    -------
    ndarray, shape (...)
        :math:`1 / (n \otimes n : C^{-1} : n \otimes n)`, Pa; zero where the stiffness
        against the tension is zero.
    """
    n = np.asarray(normals, dtype=float)
    tension = MANDEL * np.stack([n[..., i] * n[..., j] for i, j in COMPONENTS], axis=-1)
    values, modes = np.linalg.eigh(MANDEL[:, None] * stiffness * MANDEL)
    share = (tension @ modes) ** 2
    lost = values <= 1e-9 * max(values.max(), 0.0)
    compliance = share[..., ~lost] @ (1.0 / values[~lost])
    resisted = share[..., lost].sum(axis=-1) < 1e-9
    return np.asarray(np.where(resisted, 1.0 / np.where(resisted, compliance, 1.0), 0.0))


def drop_soft_modes(stiffness: np.ndarray, limit: float) -> np.ndarray:
    """Remove the modes of strain that are softer than a limit, Pa; without any, change nothing."""
    values, modes = np.linalg.eigh(MANDEL[:, None] * stiffness * MANDEL)
    if not np.any(values < limit):
        return stiffness
    kept = (modes * np.where(values < limit, 0.0, values)) @ modes.T
    return np.asarray(kept / MANDEL / MANDEL[:, None])


def voigt_bound(solid: np.ndarray, porosity: float) -> np.ndarray:
    """Upper bound of a stiffness, Pa, with a volume fraction of voids, in the sense of energy."""
    return (1.0 - _porosity(porosity)) * solid


def hashin_shtrikman_bound(
    youngs_modulus: float, poissons_ratio: float, porosity: float
) -> tuple[float, float]:
    r"""Upper bounds of bulk and shear modulus of an isotropic solid with voids.

    Parameters
    ----------
    youngs_modulus, poissons_ratio : float
        Moduli of the solid, Pa and dimensionless.
    porosity : float
        Volume fraction :math:`\phi` of the voids.

    Returns
    -------
    bulk, shear : float
        Upper bounds, Pa; the lower bounds are zero.

    Notes
    -----
    .. math::
        K^+ = \frac{4 (1-\phi) K G}{4 G + 3 \phi K}, \qquad
        G^+ = G\,\frac{(1-\phi)(9K + 8G)}{9K + 8G + 6\phi (K + 2G)}.    \tag{1}

    References
    ----------
    .. [1] Z. Hashin and S. Shtrikman, J. Mech. Phys. Solids 11 (1963) 127-140,
       doi:10.1016/0022-5096(63)90060-7.
    """
    phi = _porosity(porosity)
    K = youngs_modulus / (3.0 * (1.0 - 2.0 * poissons_ratio))
    G = youngs_modulus / (2.0 * (1.0 + poissons_ratio))
    bulk = 4.0 * (1.0 - phi) * K * G / (4.0 * G + 3.0 * phi * K)
    shear = G * (1.0 - phi) * (9.0 * K + 8.0 * G) / (9.0 * K + 8.0 * G + 6.0 * phi * (K + 2.0 * G))
    return bulk, shear


def _porosity(value: float) -> float:
    if not 0.0 <= value <= 1.0:
        raise CaseError(f"the porosity must lie from 0 to 1, got {value:g}")
    return value
