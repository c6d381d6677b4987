r"""Moduli of elasticity: ranges, Lamé's parameters, contact modulus, moduli along directions.

Tensors of the shape (6, 6), Pa, are ordered xx, yy, zz, yz, xz, xy with shear angles.
"""

import numpy as np

from multiscale.errors import CaseError

MANDEL = np.array([1.0, 1.0, 1.0, 2.0**0.5, 2.0**0.5, 2.0**0.5])
"""Factors between the components and an orthonormal basis of symmetric tensors."""

VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
"""Indices of the components xx, yy, zz, yz, xz, xy."""


def check_moduli(
    youngs_modulus: float | np.ndarray, poissons_ratio: float | np.ndarray, least: float = -1.0
) -> None:
    """Refuse a Young's modulus or a Poisson's ratio outside its range."""
    E, nu = np.ravel(youngs_modulus), np.ravel(poissons_ratio)
    wrong = E[~((E > 0.0) & np.isfinite(E))]
    if wrong.size:
        raise CaseError(f"youngs_modulus must be positive (Pa), got {wrong[0]:g}")
    wrong = nu[~((nu > -1.0) & (nu >= least) & (nu < 0.5))]
    if wrong.size:
        raise CaseError(
            f"poissons_ratio must lie between {least:g} and 0.5, got {wrong[0]:g}; use 0.499 for "
            f"an incompressible material"
        )


def contact_modulus(*bodies: tuple[float, float]) -> float:
    r"""Return the contact modulus, Pa, of bodies (E, nu): :math:`1/E^* = \sum (1-\nu_i^2)/E_i`.

    Examples
    --------
    >>> round(contact_modulus((210e9, 0.3), (210e9, 0.3)) / 1e9, 3)
    115.385
    """
    return 1.0 / sum((1.0 - nu**2) / modulus for modulus, nu in bodies)


def lame_parameters(
    youngs_modulus: float | np.ndarray, poissons_ratio: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    r"""Return Lamé's parameters :math:`\lambda` and :math:`\mu`, Pa."""
    E, nu = np.asarray(youngs_modulus), np.asarray(poissons_ratio)
    return E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), E / (2.0 * (1.0 + nu))


def mindlin_ratio(poissons_ratio: float) -> float:
    """Tangential over normal stiffness of contacts between alike bodies, by Mindlin."""
    return 2.0 * (1.0 - poissons_ratio) / (2.0 - poissons_ratio)


def youngs_modulus_along(stiffness: np.ndarray, normals: np.ndarray) -> np.ndarray:
    r"""Young's modulus, Pa, for tension along unit vectors n, shape (..., 3).

    :math:`1 / (n \otimes n : C^{-1} : n \otimes n)`; zero where nothing resists the tension.
    """
    n = np.asarray(normals, dtype=float)
    tension = MANDEL * np.stack([n[..., i] * n[..., j] for i, j in VOIGT], axis=-1)
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
    stiff = (modes * np.where(values < limit, 0.0, values)) @ modes.T
    return np.asarray(stiff / MANDEL / MANDEL[:, None])
