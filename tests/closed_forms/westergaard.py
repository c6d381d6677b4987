r"""Frictionless contact of an elastic half-space with a wave in one direction.

The undeformed gap is :math:`\Delta (1 - \cos(2\pi x/\lambda))` and :math:`p` the nominal pressure.
"""

import numpy as np
from numpy import pi
from scipy.special import xlogy

__all__ = [
    "contact_fraction",
    "full_contact_pressure",
    "largest_pressure",
    "mean_gap",
    "pressure_profile",
]


def full_contact_pressure(amplitude: float, wavelength: float, contact_modulus: float) -> float:
    r"""Nominal pressure that closes the gap.

    Parameters
    ----------
    amplitude, wavelength : float, :math:`\Delta` and :math:`\lambda`, m
    contact_modulus : float, :math:`E^*`, Pa

    Returns
    -------
    float, :math:`p^* = \pi E^* \Delta / \lambda`, Pa

    References
    ----------
    .. [1] H. M. Westergaard, J. Appl. Mech. 6 (1939) A49-A53.
    """
    return pi * contact_modulus * amplitude / wavelength


def contact_fraction(relative_pressure: np.ndarray) -> np.ndarray:
    r"""Real over nominal contact area.

    Parameters
    ----------
    relative_pressure : ndarray, :math:`s = p/p^* \ge 0`, dimensionless

    Returns
    -------
    ndarray, :math:`A/A_0 = (2/\pi) \arcsin\sqrt{s}`, and 1 from :math:`s = 1`

    Examples
    --------
    >>> contact_fraction(np.array([0.25, 0.5, 0.75])).round(4)
    array([0.3333, 0.5   , 0.6667])
    """
    return np.asarray(2.0 / pi * np.arcsin(np.sqrt(np.clip(relative_pressure, 0.0, 1.0))))


def largest_pressure(relative_pressure: np.ndarray) -> np.ndarray:
    r"""Pressure on the crest over the nominal pressure.

    Parameters
    ----------
    relative_pressure : ndarray, :math:`s = p/p^* > 0`, dimensionless

    Returns
    -------
    ndarray, :math:`2/\sqrt{s}` in partial contact and :math:`1 + 1/s` in full contact
    """
    s = np.asarray(relative_pressure, dtype=float)
    return np.where(s < 1.0, 2.0 / np.sqrt(s), 1.0 + 1.0 / s)


def mean_gap(relative_pressure: np.ndarray) -> np.ndarray:
    r"""Area mean of the gap over the amplitude.

    Parameters
    ----------
    relative_pressure : ndarray, :math:`s = p/p^* \ge 0`, dimensionless

    Returns
    -------
    ndarray, :math:`\bar g/\Delta = 1 - s + s \ln s`, and 0 from :math:`s = 1`
    """
    s = np.clip(relative_pressure, 0.0, 1.0)
    return np.asarray(1.0 - s + xlogy(s, s))


def pressure_profile(position: np.ndarray, relative_pressure: float) -> np.ndarray:
    r"""Local pressure over the nominal pressure, in partial contact.

    Parameters
    ----------
    position : ndarray, :math:`x/\lambda` from a crest, dimensionless
    relative_pressure : float, :math:`0 < s = p/p^* \le 1`, dimensionless

    Returns
    -------
    ndarray
        :math:`(2/s) \cos(\pi x/\lambda) \sqrt{s - \sin^2(\pi x/\lambda)}` in absolute value,
        and 0 outside the contact.
    """
    inside = np.maximum(0.0, relative_pressure - np.sin(pi * position) ** 2)
    return 2.0 / relative_pressure * np.abs(np.cos(pi * position)) * np.sqrt(inside)
