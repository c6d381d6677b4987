r"""Frictionless contact of an elastic half-space with a wave in two directions.

The surface is :math:`\Delta \cos(2\pi x/\lambda)\cos(2\pi y/\lambda)`. Only the limits of low and
high pressure have a closed form. K. L. Johnson, J. A. Greenwood and J. G. Higginson, Int. J. Mech.
Sci. 27 (1985) 383-396.
"""

import numpy as np
from numpy import pi, sqrt


def full_contact_pressure(amplitude: float, wavelength: float, contact_modulus: float) -> float:
    r"""Pressure that closes the gap, :math:`p^* = \sqrt 2\, \pi E^* \Delta / \lambda`, Pa."""
    return float(sqrt(2.0) * pi * contact_modulus * amplitude / wavelength)


def contact_fraction_low(relative_pressure: np.ndarray) -> np.ndarray:
    r"""Fraction for :math:`r = p/p^* \ll 1`, Hertz contacts: :math:`\pi\, (3 r / (8\pi))^{2/3}`."""
    return pi * (3.0 * np.asarray(relative_pressure) / (8.0 * pi)) ** (2.0 / 3.0)


def contact_fraction_high(relative_pressure: np.ndarray) -> np.ndarray:
    r"""Fraction for :math:`r = p/p^* \to 1`, :math:`1 - 3(1 - r)/(2\pi)`."""
    return 1.0 - 1.5 / pi * (1.0 - np.asarray(relative_pressure))
