r"""Vertical stress in a silo with a wall that bears a share of the weight.

The stress on a slice follows from its balance, :math:`d\sigma/dz = \rho g - 4 \mu_w K \sigma / D`:
the wall pressure is :math:`K \sigma` and its friction is fully mobilised. H. A. Janssen,
Z. Ver. Dtsch. Ing. 39 (1895) 1045-1049.
"""

import numpy as np


def screening_length(diameter: float, wall_friction: float, stress_ratio: float) -> float:
    r"""Depth over which the stress saturates, :math:`\ell = D / (4 \mu_w K)`, m."""
    return diameter / (4.0 * wall_friction * stress_ratio)


def vertical_stress(
    depth: np.ndarray, density: float, length: float, *, gravity: float = 9.81
) -> np.ndarray:
    r"""Mean stress below the free surface, :math:`\rho g \ell \left(1 - e^{-z/\ell}\right)`, Pa.

    >>> length = screening_length(0.05, 0.5, 0.58)
    >>> vertical_stress(np.array([0.05, 0.1, 0.2, np.inf]), 1500.0, length).round(1)
    array([435.4, 571.9, 628.1, 634.3])
    """
    return np.asarray(-density * gravity * length * np.expm1(-np.asarray(depth) / length))
