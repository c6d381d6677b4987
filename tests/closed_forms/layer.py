"""Elastic layers on a frictionless and on a rigid base, and laterally fixed."""

import numpy as np


def ratio_frictionless(phase: np.ndarray) -> np.ndarray:
    r"""Compliance of a layer on a frictionless base over the half-space, :math:`x = q T > 0`.

    .. math:: \sinh^2 x / (\sinh x \cosh x + x)
    """
    x = np.asarray(phase, dtype=float)
    # numerator and denominator times 4 exp(-2 x)
    return np.expm1(-2.0 * x) ** 2 / (-np.expm1(-4.0 * x) + 4.0 * x * np.exp(-2.0 * x))


def oedometer_compliance(thickness: float, youngs_modulus: float, poissons_ratio: float) -> float:
    r"""Shortening of a laterally fixed layer by a unit pressure, m/Pa.

    .. math:: T (1+\nu)(1-2\nu) / (E(1-\nu))
    """
    nu = poissons_ratio
    return thickness * (1.0 + nu) * (1.0 - 2.0 * nu) / (youngs_modulus * (1.0 - nu))


def ratio_bonded(phase: np.ndarray, poissons_ratio: float) -> np.ndarray:
    r"""Compliance of a layer bonded to a rigid base over the half-space, :math:`x = q T > 0`.

    .. math::
        \frac{(3-4\nu)\sinh 2x - 2x}{(3-4\nu)\cosh 2x + 2x^2 + 5 - 12\nu + 8\nu^2}.
    """
    x, nu = np.asarray(phase, dtype=float), poissons_ratio
    kappa, decay = 3.0 - 4.0 * nu, np.exp(-2.0 * x)
    sinh, cosh = -0.5 * np.expm1(-4.0 * x), 0.5 * (1.0 + decay**2)  # times exp(-2 x)
    denominator = kappa * cosh + (2.0 * x**2 + 5.0 - 12.0 * nu + 8.0 * nu**2) * decay
    return (kappa * sinh - 2.0 * x * decay) / denominator
