"""Elastic layers on a frictionless base, and held laterally."""

import numpy as np

__all__ = ["oedometer_compliance", "ratio_frictionless"]


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
