"""Elastic layers on a frictionless and on a rigid base, and held laterally."""

import numpy as np

__all__ = ["oedometer_compliance", "ratio_bonded", "ratio_frictionless"]


def ratio_frictionless(phase: np.ndarray) -> np.ndarray:
    r"""Compliance of a layer on a rigid frictionless base over that of the half-space.

    Parameters
    ----------
    phase : ndarray, :math:`x = q T > 0`, dimensionless

    Returns
    -------
    ndarray, :math:`\sinh^2 x / (\sinh x \cosh x + x)`, dimensionless
    """
    x = np.asarray(phase, dtype=float)
    # numerator and denominator times 4 exp(-2 x)
    return np.expm1(-2.0 * x) ** 2 / (-np.expm1(-4.0 * x) + 4.0 * x * np.exp(-2.0 * x))


def oedometer_compliance(thickness: float, youngs_modulus: float, poissons_ratio: float) -> float:
    r"""Shortening of a laterally held layer under a unit uniform pressure.

    Parameters
    ----------
    thickness : float, :math:`T`, m
    youngs_modulus : float, :math:`E`, Pa
    poissons_ratio : float, :math:`\nu`, dimensionless

    Returns
    -------
    float, :math:`T (1+\nu)(1-2\nu) / (E(1-\nu))`, m/Pa
    """
    nu = poissons_ratio
    return thickness * (1.0 + nu) * (1.0 - 2.0 * nu) / (youngs_modulus * (1.0 - nu))


def ratio_bonded(phase: np.ndarray, poissons_ratio: float) -> np.ndarray:
    r"""Compliance of a layer bonded to a rigid base over the compliance of the half-space.

    Parameters
    ----------
    phase : ndarray
        :math:`x = q T > 0`, dimensionless.
    poissons_ratio : float
        :math:`\nu`, dimensionless.

    Returns
    -------
    ndarray
        Dimensionless,

        .. math::
            \frac{(3-4\nu)\sinh 2x - 2x}{(3-4\nu)\cosh 2x + 2x^2 + 5 - 12\nu + 8\nu^2}.

    Examples
    --------
    >>> ratio_bonded(2.0 * np.pi * np.array([0.25, 0.5]), 0.3).round(4)
    array([0.632 , 0.9441])
    """
    x, nu = np.asarray(phase, dtype=float), poissons_ratio
    kappa, decay = 3.0 - 4.0 * nu, np.exp(-2.0 * x)
    sinh, cosh = -0.5 * np.expm1(-4.0 * x), 0.5 * (1.0 + decay**2)  # times exp(-2 x)
    denominator = kappa * cosh + (2.0 * x**2 + 5.0 - 12.0 * nu + 8.0 * nu**2) * decay
    return (kappa * sinh - 2.0 * x * decay) / denominator
