r"""Moduli of isotropic elasticity: ranges, Lamé's parameters and contact modulus."""

import numpy as np

from multiscale.errors import CaseError

__all__ = ["check_moduli", "contact_modulus", "lame_parameters"]


def check_moduli(
    youngs_modulus: float | np.ndarray, poissons_ratio: float | np.ndarray, least: float = -1.0
) -> None:
    """Refuse a Young's modulus or a Poisson's ratio outside its range.

    Parameters
    ----------
    youngs_modulus : float or ndarray, Young's modulus, Pa; must be positive and finite
    poissons_ratio : float or ndarray, Poisson's ratio, dimensionless; must lie between -1 and 1/2
    least : float, least Poisson's ratio that is taken: zero where auxetic bodies are not solved

    Raises
    ------
    CaseError
        If a value is outside its range; the message contains the first such value.
    """
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
    r"""Return the contact modulus :math:`1/E^* = \sum (1-\nu_i^2)/E_i`, Pa.

    Parameters
    ----------
    *bodies : tuple of float, Young's modulus, Pa, and Poisson's ratio of each body

    Examples
    --------
    >>> round(contact_modulus((210e9, 0.3), (210e9, 0.3)) / 1e9, 3)
    115.385
    """
    return 1.0 / sum((1.0 - nu**2) / modulus for modulus, nu in bodies)


def lame_parameters(
    youngs_modulus: float | np.ndarray, poissons_ratio: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    r"""Return Lamé's parameters :math:`\lambda` and :math:`\mu`, Pa.

    Parameters
    ----------
    youngs_modulus : float or ndarray, Young's modulus, Pa
    poissons_ratio : float or ndarray, Poisson's ratio, dimensionless
    """
    E, nu = np.asarray(youngs_modulus), np.asarray(poissons_ratio)
    return E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), E / (2.0 * (1.0 + nu))
