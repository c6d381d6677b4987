r"""Rough half-space pressed flat: full frictionless contact.

The heights are :math:`h = \sum_q h_q\, e^{i q \cdot x}` with all wave vectors, both signs.
"""

import numpy as np

__all__ = ["elastic_energy", "rms_pressure"]


def elastic_energy(wavenumber: np.ndarray, amplitude: np.ndarray, contact_modulus: float) -> float:
    r"""Elastic energy per nominal area that is stored when the surface is flat.

    Parameters
    ----------
    wavenumber : ndarray, :math:`|q|`, rad/m
    amplitude : ndarray, Fourier coefficients :math:`h_q`, m, of the same shape
    contact_modulus : float, :math:`E^*`, Pa

    Returns
    -------
    float, :math:`U = (E^*/4) \sum_q |q|\, |h_q|^2`, J m⁻²
    """
    return float(0.25 * contact_modulus * np.sum(wavenumber * np.abs(amplitude) ** 2))


def rms_pressure(rms_slope: float, contact_modulus: float) -> float:
    r"""Root mean square of the local pressure about its mean.

    Parameters
    ----------
    rms_slope : float, Root mean square slope :math:`h'_{rms}`, dimensionless
    contact_modulus : float, :math:`E^*`, Pa

    Returns
    -------
    float, :math:`E^* h'_{rms} / 2`, Pa
    """
    return 0.5 * contact_modulus * rms_slope
