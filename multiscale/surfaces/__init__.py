r"""Rough surfaces: synthesis, preparation of measured maps, and statistics.

These functions use the discrete Fourier series of a periodic surface on its cell
:math:`L_x \times L_y`,

.. math::
    h(x) = \sum_q \hat h_q\, e^{i q \cdot x}, \qquad
    q = 2\pi \left(\frac{i}{L_x}, \frac{j}{L_y}\right),    \tag{1}

so that a mean over the cell is a sum over the waves,
:math:`\langle h^2 \rangle = \sum_q |\hat h_q|^2` (Parseval). For nodes, units
and the size of the cell see :class:`multiscale.surfaces.Surface`.
"""

from multiscale.surfaces.map_statistics import (
    SelfAffineFit,
    describe_surface,
    fit_of_statistics,
    fit_self_affine,
)
from multiscale.surfaces.preparation import (
    composite,
    crop,
    detrend,
    find_spikes,
    low_pass,
    mirror,
    resample,
    rotate,
    window,
)
from multiscale.surfaces.roughness import Lay, Roughness, Spectrum, find_lay, spectrum
from multiscale.surfaces.statistics import (
    nayak_parameter,
    rms_height,
    rms_slope,
)
from multiscale.surfaces.surface import Surface
from multiscale.surfaces.synthesis import Anisotropy, self_affine

__all__ = [
    "Anisotropy",
    "Lay",
    "Roughness",
    "SelfAffineFit",
    "Spectrum",
    "Surface",
    "composite",
    "crop",
    "describe_surface",
    "detrend",
    "find_lay",
    "find_spikes",
    "fit_of_statistics",
    "fit_self_affine",
    "low_pass",
    "mirror",
    "nayak_parameter",
    "resample",
    "rms_height",
    "rms_slope",
    "rotate",
    "self_affine",
    "spectrum",
    "window",
]

__dir__ = __all__.copy
