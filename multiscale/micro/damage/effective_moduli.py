r"""Moduli along directions and soft modes of a 6 x 6 stiffness.

Strains and stresses are ordered xx, yy, zz, yz, xz, xy with shear angles. Stiffnesses have the
shape (6, 6) and the unit Pa.
"""

import numpy as np

__all__ = ["drop_soft_modes", "youngs_modulus_along"]

MANDEL = np.array([1.0, 1.0, 1.0, 2.0**0.5, 2.0**0.5, 2.0**0.5])
"""Factors between the components and an orthonormal basis of symmetric tensors."""

COMPONENTS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
"""Indices of the components xx, yy, zz, yz, xz, xy."""


def youngs_modulus_along(stiffness: np.ndarray, normals: np.ndarray) -> np.ndarray:
    r"""Young's modulus for tension along directions.

    Parameters
    ----------
    stiffness : ndarray, shape (6, 6)
    normals : ndarray, shape (..., 3), unit vectors n

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
