r"""Elastic layer under a pressure wave, compared with the half-space.

A frictionless pressure :math:`\hat p\cos(qx)` moves the surface of a half-space by
:math:`2\hat p/(E^* q)`, and the surface of a layer of thickness :math:`T` by the ratio below times
as much.
"""

import numpy as np

__all__ = ["ratio_bonded"]


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
