"""Statistics of a rough surface: heights, slopes, spectrum."""

import numpy as np
import scipy

from multiscale.errors import CaseError
from multiscale.surfaces.surface import Surface

__all__ = ["nayak_parameter", "rms_height", "rms_slope", "wavenumbers"]


def rms_height(surface: Surface) -> float:
    r"""Root mean square height about the mean, :math:`\langle (h - \bar h)^2 \rangle^{1/2}`, m."""
    return float(surface.heights.std())


def rms_slope(surface: Surface) -> float:
    r"""Root mean square slope of a periodic surface, dimensionless.

    Returns
    -------
    float
        :math:`\langle |\nabla h|^2 \rangle^{1/2} = (\sum_q q^2 |\hat h_q|^2)^{1/2}`, by the Fourier
        series. The slope of a measured map, which is not periodic, is told by
        :func:`~.map_statistics.describe_surface`.
    """
    q, power = wave_power(surface)
    return float(np.sqrt(np.sum(q**2 * power)))


def nayak_parameter(surface: Surface) -> float:
    r"""Nayak's breadth of the spectrum of a periodic, isotropic surface, dimensionless.

    Returns
    -------
    float
        :math:`\alpha` of (3), at least 1.5 for a Gaussian surface.

    Raises
    ------
    CaseError
        If the surface is flat.

    Notes
    -----
    .. math::
        \alpha = \frac{m_0 m_4}{m_2^2}, \qquad
        m_0 = \langle h^2 \rangle, \quad
        m_2 = \tfrac12 \langle |\nabla h|^2 \rangle, \quad
        m_4 = \tfrac38 \langle (\nabla^2 h)^2 \rangle,    \tag{3}

    where the factors turn the means over the plane into the moments of a profile, if the surface
    is isotropic. The means are sums over the waves (1). The shortest waves dominate the fourth
    moment: use :func:`low_pass` on a measured surface first.

    References
    ----------
    .. [1] P. R. Nayak, J. Lubr. Technol. 93 (1971) 398-407, doi:10.1115/1.3451608.
    """
    return breadth(*wave_power(surface))


def breadth(q: np.ndarray, power: np.ndarray) -> float:
    """Nayak's parameter (3) of waves: wavenumbers, rad/m, and shares of the mean square, m^2."""
    height_square, slope_square, curvature_square = (
        float(np.sum(weight)) for weight in (power, q**2 * power, (q**2) ** 2 * power)
    )
    if slope_square == 0.0:
        raise CaseError("a flat surface has no Nayak parameter; give a rough one")
    m0, m2, m4 = height_square, slope_square / 2.0, 3.0 / 8.0 * curvature_square
    return float(m0 * m4 / m2**2)  # (3)


def ring_density(
    surface: Surface, q: np.ndarray, power: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r"""Wavenumber, rad/m, density (4), m^4, and number of waves of each ring of :func:`wave_power`.

    Notes
    -----
    Convention of [1]_ for the two-dimensional density, averaged over rings of width
    :math:`2\pi / \min(L_x, L_y)`:

    .. math::
        C_q = L_x L_y\, |\hat h_q|^2, \qquad
        \langle (h - \bar h)^2 \rangle = \frac{1}{L_x L_y} \sum_\text{rings} N\, C
        \approx \frac{1}{2\pi} \int_0^\infty q\, C(q)\, dq.    \tag{4}

    The sum is exact: waves in the corners are kept, in incomplete rings.

    References
    ----------
    .. [1] T. D. B. Jacobs, T. Junge and L. Pastewka, Surf. Topogr.: Metrol. Prop. 5 (2017)
       013001, doi:10.1088/2051-672X/aa51f8.
    """
    rings = np.rint(q / (2.0 * np.pi / min(surface.size))).astype(int).ravel()
    weights = _weights(surface).ravel()
    number = np.bincount(rings, weights)
    used = number > 0.0
    number = number[used]
    wavenumber = np.bincount(rings, weights * q.ravel())[used] / number
    area = surface.size[0] * surface.size[1]
    return wavenumber, area * np.bincount(rings, power.ravel())[used] / number, number  # (4)


def wavenumbers(surface: Surface) -> np.ndarray:
    """Wavenumber of each entry of the real transform, rad/m, shape (nx, ny // 2 + 1)."""
    (nx, ny), (dx, dy) = surface.heights.shape, surface.spacing
    wavenumber: np.ndarray = (
        2.0 * np.pi * np.hypot(scipy.fft.fftfreq(nx, dx)[:, None], scipy.fft.rfftfreq(ny, dy))
    )
    return wavenumber


def _weights(surface: Surface) -> np.ndarray:
    """Count the waves q and -q of each entry of the real transform; 0 for the mean."""
    nx, ny = surface.heights.shape
    weights = np.full((nx, ny // 2 + 1), 2.0)
    weights[:, 0] = 1.0
    if ny % 2 == 0:
        weights[:, -1] = 1.0
    weights[0, 0] = 0.0
    return weights


def wave_power(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """Return wavenumbers, rad/m, and shares of the mean square height, m^2: (nx, ny // 2 + 1)."""
    modulus = np.abs(scipy.fft.rfft2(surface.heights, norm="forward"))
    return wavenumbers(surface), _weights(surface) * modulus**2
