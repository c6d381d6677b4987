r"""Frictionless contact of an elastic half-space with a wave in one direction.

The undeformed gap is :math:`\Delta (1 - \cos(2\pi x/\lambda))`, :math:`p` the nominal pressure and
:math:`s = p/p^*`. H. M. Westergaard, J. Appl. Mech. 6 (1939) A49-A53.
"""

import numpy as np
from numpy import pi
from scipy.special import xlogy


def full_contact_pressure(amplitude: float, wavelength: float, contact_modulus: float) -> float:
    r"""Nominal pressure that closes the gap, :math:`p^* = \pi E^* \Delta / \lambda`, Pa."""
    return pi * contact_modulus * amplitude / wavelength


def contact_fraction(relative_pressure: np.ndarray) -> np.ndarray:
    r"""Contact fraction :math:`(2/\pi) \arcsin\sqrt{s}`, and 1 from :math:`s = 1`."""
    return np.asarray(2.0 / pi * np.arcsin(np.sqrt(np.clip(relative_pressure, 0.0, 1.0))))


def largest_pressure(relative_pressure: np.ndarray) -> np.ndarray:
    r"""Crest pressure over p: :math:`2/\sqrt{s}` below, :math:`1 + 1/s` in full contact."""
    s = np.asarray(relative_pressure, dtype=float)
    return np.where(s < 1.0, 2.0 / np.sqrt(s), 1.0 + 1.0 / s)


def mean_gap(relative_pressure: np.ndarray) -> np.ndarray:
    r"""Mean gap over the amplitude, :math:`1 - s + s \ln s`, and 0 from :math:`s = 1`."""
    s = np.clip(relative_pressure, 0.0, 1.0)
    return np.asarray(1.0 - s + xlogy(s, s))


def pressure_profile(position: np.ndarray, relative_pressure: float) -> np.ndarray:
    r"""Local pressure over p at :math:`x/\lambda` from a crest, in partial contact.

    .. math:: (2/s)\, |\cos(\pi x/\lambda)| \sqrt{s - \sin^2(\pi x/\lambda)}
    """
    inside = np.maximum(0.0, relative_pressure - np.sin(pi * position) ** 2)
    return 2.0 / relative_pressure * np.abs(np.cos(pi * position)) * np.sqrt(inside)
