r"""Two elastic blocks in series with an interface, under uniaxial stress."""

import numpy as np


def series(*stiffness: np.ndarray | float) -> np.ndarray:
    r"""Stiffness of springs in series, :math:`1 / \sum_i k_i^{-1}`, in any unit."""
    return np.asarray(1.0 / sum(1.0 / np.asarray(k, dtype=float) for k in stiffness))


def joint_stiffness(pressure: np.ndarray, decay_length: float, *compliance: float) -> np.ndarray:
    r"""Stiffness :math:`1/(u_0/p + \sum_i h_i/E_i)`, Pa/m, of blocks joined by an exponential law.

    The pressure of the law decays over :math:`u_0`; compliances are :math:`h_i/E_i`.
    """
    return series(np.asarray(pressure) / decay_length, *(1.0 / c for c in compliance))


def stiffness_ratio(
    pressure: np.ndarray, decay_length: float, youngs_modulus: float, height: float
) -> np.ndarray:
    """Stiffness of two equal joined blocks over the solid stiffness, :math:`1/(1 + E u_0/(2 h p))`.

    >>> stiffness_ratio(np.array([1e6, 1e7, 5e7]), 0.45 * 0.4e-6, 210e9, 0.02).round(4)
    array([0.5141, 0.9137, 0.9815])
    """
    return 1.0 / (1.0 + youngs_modulus * decay_length / (2.0 * height * np.asarray(pressure)))


def eccentric_stiffness(
    stiffness: float, eccentricity: tuple[float, float], section: tuple[float, float]
) -> float:
    """Stiffness at the point of an eccentric force on a *linear* closed joint, Pa/m.

    Compression and bending superpose, sections stay plane: with the stiffness k under a centred
    force :math:`k / (1 + 12 e_x^2/L_x^2 + 12 e_y^2/L_y^2)`.
    """
    arms = (arm / length for arm, length in zip(eccentricity, section, strict=True))
    return stiffness / (1.0 + 12.0 * sum(ratio**2 for ratio in arms))
