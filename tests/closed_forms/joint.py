r"""Two elastic blocks in series with an interface, under uniaxial stress."""

import numpy as np

__all__ = ["eccentric_stiffness", "joint_stiffness", "series", "stiffness_ratio"]


def series(*stiffness: np.ndarray | float) -> np.ndarray:
    r"""Stiffness of springs in series.

    Parameters
    ----------
    *stiffness : ndarray or float, :math:`k_i > 0`, all in one unit

    Returns
    -------
    ndarray, :math:`1 / \sum_i k_i^{-1}`, in the same unit

    Examples
    --------
    >>> float(series(2.0, 2.0))
    1.0
    """
    return np.asarray(1.0 / sum(1.0 / np.asarray(k, dtype=float) for k in stiffness))


def joint_stiffness(pressure: np.ndarray, decay_length: float, *compliance: float) -> np.ndarray:
    r"""Stiffness of blocks joined by an exponential law.

    Parameters
    ----------
    pressure : ndarray, Nominal pressure :math:`p`, Pa
    decay_length : float
        :math:`u_0` of the law :math:`p = p_c\, e^{-g/u_0}`, m; its stiffness is
        :math:`p/u_0`.
    *compliance : float, Height over Young's modulus of every block, m/Pa

    Returns
    -------
    ndarray, :math:`1/(u_0/p + \sum_i h_i/E_i)`, Pa/m
    """
    return series(np.asarray(pressure) / decay_length, *(1.0 / c for c in compliance))


def stiffness_ratio(
    pressure: np.ndarray, decay_length: float, youngs_modulus: float, height: float
) -> np.ndarray:
    r"""Stiffness of the joint of two equal blocks over that of the solid.

    Parameters
    ----------
    pressure : ndarray, Nominal pressure :math:`p`, Pa
    decay_length : float, :math:`u_0` of the exponential law, m
    youngs_modulus : float, :math:`E`, Pa
    height : float, :math:`h` of each block, m

    Returns
    -------
    ndarray, :math:`1/(1 + E u_0/(2 h p))`, dimensionless

    Examples
    --------
    >>> stiffness_ratio(np.array([1e6, 1e7, 5e7]), 0.45 * 0.4e-6, 210e9, 0.02).round(4)
    array([0.5141, 0.9137, 0.9815])
    """
    return 1.0 / (1.0 + youngs_modulus * decay_length / (2.0 * height * np.asarray(pressure)))


def eccentric_stiffness(
    stiffness: float, eccentricity: tuple[float, float], section: tuple[float, float]
) -> float:
    r"""Stiffness at the point of an eccentric force, for a *linear* closed joint.

    Compression and bending superpose: the stress is linear over the rectangular section and
    every section stays plane.

    Parameters
    ----------
    stiffness : float, :math:`k` of the same joint under a centred force, Pa/m
    eccentricity : tuple of float, :math:`e_x, e_y` from the centre, m
    section : tuple of float, Lengths :math:`L_x, L_y`, m

    Returns
    -------
    float, :math:`k / (1 + 12 e_x^2/L_x^2 + 12 e_y^2/L_y^2)`, Pa/m
    """
    arms = (arm / length for arm, length in zip(eccentricity, section, strict=True))
    return stiffness / (1.0 + 12.0 * sum(ratio**2 for ratio in arms))
