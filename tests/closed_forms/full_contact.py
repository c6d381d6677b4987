r"""Rough half-space pressed flat: full frictionless contact.

The heights are :math:`h = \sum_q h_q\, e^{i q \cdot x}` with all wave vectors, both signs.
"""

import numpy as np


def elastic_energy(wavenumber: np.ndarray, amplitude: np.ndarray, contact_modulus: float) -> float:
    r"""Elastic energy per area of a flat surface, :math:`(E^*/4) \sum_q |q|\, |h_q|^2`, J m⁻²."""
    return float(0.25 * contact_modulus * np.sum(wavenumber * np.abs(amplitude) ** 2))


def rms_pressure(rms_slope: float, contact_modulus: float) -> float:
    """Root mean square of the pressure about its mean, :math:`E^* h'_{rms} / 2`, Pa."""
    return 0.5 * contact_modulus * rms_slope
