"""Statistics of a measured map or line scan: density, self-affine fit, lay, bearing curve."""

from dataclasses import astuple, dataclass

import numpy as np
import scipy

from multiscale.errors import CaseError
from multiscale.schema import SURFACE_STATISTICS, Dataset
from multiscale.surfaces.fourier import Spectrum, breadth, ring_density, spectrum, wave_power
from multiscale.surfaces.preparation import window
from multiscale.surfaces.surface import Surface

PIXELS_PER_WAVELENGTH = 4  # at the shortest reliable wavelength
BINS_PER_DECADE = 12  # of the fitted density
FEWEST_BINS = 6  # of a fit
EDGE = 1.25  # margin of the fitted wavelengths, as the window spreads the edges of the spectrum
DRAWN_POINTS = 512  # along an edge of the picture
SHARES = np.linspace(0.0, 1.0, 101)
FITTED = ("hurst_exponent", "roll_off", "fit_level", "fit_deviation")  # the fields of a fit


@dataclass(frozen=True)
class SelfAffineFit:
    r"""Self-affine spectrum, :math:`C \propto \max(q, 2\pi/\lambda_r)^{-d-2H}`, and its range."""

    hurst_exponent: float  # between 0 and 1
    roll_off: float  # wavelength above which the density is flat, m
    level: float  # density of the flat range, m^4 of a map, m^3 of a profile
    deviation: float  # root mean square deviation of the density from the fit, decades
    dimensions: int = 2  # 2 for a map, 1 for a profile

    def density(self, wavenumber: np.ndarray) -> np.ndarray:
        """Evaluate the fit, m^4 or m^3, at wavenumbers, rad/m."""
        q = np.maximum(wavenumber * self.roll_off / (2.0 * np.pi), 1.0)
        return np.asarray(self.level * q ** (-self.dimensions - 2.0 * self.hurst_exponent))

    def rms_height(self, long_cutoff: float, short_cutoff: float) -> float:
        """Root mean square height of an isotropic surface with wavelengths of a band only, m."""
        q = 2.0 * np.pi * np.geomspace(1.0 / long_cutoff, 1.0 / short_cutoff, 2001)
        weight = self.density(q) * (q / (2.0 * np.pi) if self.dimensions == 2 else 1.0 / np.pi)
        return float(np.sqrt(np.trapezoid(weight, q)))


def fit_self_affine(
    wavenumber: np.ndarray, density: np.ndarray, *, dimensions: int
) -> SelfAffineFit | None:
    """Fit a self-affine spectrum with a roll-off to a density, by least squares of logarithms.

    Parameters
    ----------
    wavenumber, density : ndarray, shape (bins,)
        Wavenumbers, rad/m, rising, and the positive density of a map, m^4, or of a profile, m^3.
    dimensions : {2, 1}, whether the density belongs to a map or to a profile

    Returns
    -------
    SelfAffineFit or None
        None if fewer than six intervals of a twelfth of a decade have modes.
    """
    q, C = _logarithmic_bins(wavenumber, density)
    if q.size < FEWEST_BINS:
        return None
    x, y, fits = np.log(q), np.log(C), []
    for first in range(q.size - FEWEST_BINS + 1):  # the bin at which the flat range ends
        bent = np.maximum(x, x[first])
        slope, level = np.polyfit(bent, y, 1)
        hurst = float(np.clip(0.5 * (-slope - dimensions), 0.0, 1.0))
        shape = -(dimensions + 2.0 * hurst) * (bent - x[first])
        level = float(np.mean(y - shape))
        error = float(np.sqrt(np.mean((y - shape - level) ** 2)))
        roll_off = float(2.0 * np.pi / q[first])
        decades = error / np.log(10.0)
        fits.append(SelfAffineFit(hurst, roll_off, float(np.exp(level)), decades, dimensions))
    return min(fits, key=lambda fit: fit.deviation)


def describe_surface(
    surface: Surface, *, resolution: float | None = None, waves: Spectrum | None = None
) -> Dataset:
    r"""Describe a measured map, or a line scan: heights, slopes, spectrum, lay and bearing curve.

    Parameters
    ----------
    surface : Surface
        Detrended map, or line scan with ``ny = 1``. Statistics of heights and slopes
        leave out filled points; the density counts them.
    resolution : float, optional, shortest wavelength that the instrument resolves, m
    waves : Spectrum, optional, spectrum of the surface if already computed, not periodic

    Returns
    -------
    Dataset
        Follows ``SURFACE_STATISTICS``; unknown values are NaN. A flat surface is refused.

    Notes
    -----
    The density is the density of the map under Hann's window, divided by the factor 9/64 (3/8 for
    a line scan) by which the window reduces the mean square. Wavelengths are reliable from half of
    the shorter edge down to the longest of three: four pixels, the resolution of the instrument,
    and the wavelength below which the density falls more slowly than with a Hurst exponent of
    zero, as noise does.
    """
    waves = waves or spectrum([surface], periodic=False)
    # heights of the measured points
    roughness = waves.roughness()
    if not roughness.rms_height > 0.0:
        raise CaseError("all heights are equal; give a rough surface")
    measured = surface.heights if surface.filled is None else surface.heights[~surface.filled]
    level = (measured - measured.mean()) / roughness.rms_height
    square, profile = level**2, surface.heights.shape[1] == 1
    # density under Hann's window, and the range of reliable wavelengths
    faded = window(surface, taper=0.5)
    wavenumber, power = wave_power(faded)
    q, C = _density(faded, wavenumber, power)
    longest = 0.5 * (surface.size[0] if profile else min(surface.size))
    pixel = surface.spacing[0] if profile else max(surface.spacing)
    shortest = max(PIXELS_PER_WAVELENGTH * pixel, resolution or 0.0)
    shortest = max(shortest, _noise_from(q, C, shortest, 1 if profile else 2))
    # self-affine fit
    fitted_to = max(shortest, EDGE * roughness.shortest_wave)
    fitted_from = min(longest, roughness.longest_wave / EDGE)
    band = (q >= 2.0 * np.pi / fitted_from) & (q <= 2.0 * np.pi / fitted_to) & (C > 0.0)
    fit = fit_self_affine(q[band], C[band], dimensions=1 if profile else 2)
    fitted = [np.nan] * 4 if fit is None else list(astuple(fit))[:4]
    # breadth and lay of the reliable modes
    last = 2.0 * np.pi / shortest * (1.0 + 1e-9)  # a mode exactly on the limit is reliable
    reliable = np.where(wavenumber <= last, power, 0.0)
    broad = breadth(wavenumber, reliable) if reliable.any() else np.nan
    lay = None if profile else _lay_of(surface, wavenumber, power, shortest)
    step = max(1, -(-max(surface.heights.shape) // DRAWN_POINTS))
    values = {
        "height": surface.heights[::step, ::step].T,
        "wavenumber": q,
        ("profile_density" if profile else "power_spectral_density"): C,
        "bearing_share": SHARES,
        "bearing_height": np.quantile(measured, 1.0 - SHARES) - measured.mean(),
        "dimensions": 1 if profile else 2,
        "size": [*surface.size],
        "rms_height": roughness.rms_height,
        "rms_slope": roughness.rms_slope,
        "longest_wave": roughness.longest_wave,
        "shortest_wave": roughness.shortest_wave,
        "longest_reliable": longest,
        "shortest_reliable": shortest,
        "skewness": np.mean(level * square),
        "kurtosis": np.mean(square**2),
        "peak_to_valley": np.ptp(measured),
        "nayak_parameter": broad / 1.5 if profile else broad,  # (3) without the factors 1/2, 3/8
        "filled_share": surface.filled_share,
        "fitted_to": fitted_to,
        **dict(zip(FITTED, fitted, strict=True)),
        "lay_angle": np.nan if lay is None else lay.angle,
        "lay_ratio": np.nan if lay is None else lay.ratio,
    }
    return SURFACE_STATISTICS.build(values)


def fit_of_statistics(statistics: Dataset) -> SelfAffineFit | None:
    """Return the self-affine fit in a dataset of :func:`describe_surface`, if there is a fit."""
    hurst, roll_off, level, deviation = (float(statistics[name]) for name in FITTED)
    if not np.isfinite(level):
        return None
    return SelfAffineFit(hurst, roll_off, level, deviation, int(statistics["dimensions"]))


def _density(
    faded: Surface, wavenumber: np.ndarray, power: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Wavenumbers, rad/m, and density under Hann's window, m^4 of a map and m^3 of a profile."""
    if faded.heights.shape[1] > 1:
        q, C, _ = ring_density(faded, wavenumber, power)
        return q, C / (3.0 / 8.0) ** 2
    length = faded.size[0]
    square = Surface(faded.heights, (length, length))  # each ring has a single mode
    q, C, _ = ring_density(square, wavenumber, power)
    return q, C / length / (3.0 / 8.0)


def _logarithmic_bins(q: np.ndarray, C: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Average wavenumber and density over the logarithmic bins that have modes."""
    number = np.floor(BINS_PER_DECADE * np.log10(q)).astype(int)
    bins = [number == k for k in np.unique(number)]
    return np.array([q[in_bin].mean() for in_bin in bins]), np.array(
        [C[in_bin].mean() for in_bin in bins]
    )


def _noise_from(q: np.ndarray, C: np.ndarray, shortest: float, dimensions: int) -> float:
    """Longest wavelength below which the density is as flat as noise, m; 0 without noise."""
    resolved = (q <= 2.0 * np.pi / shortest) & (C > 0.0) & (q > 0.0)
    if np.count_nonzero(resolved) < FEWEST_BINS:
        return 0.0
    x, y = map(np.log, _logarithmic_bins(q[resolved], C[resolved]))
    # last window of a third of a decade in which the density falls
    width, start = BINS_PER_DECADE // 3, 0
    for first in range(x.size - width - 1, -1, -1):
        bins = slice(first, first + width + 1)
        if np.polyfit(x[bins], y[bins], 1)[0] < -dimensions:
            start = first + width
            break
    return 0.0 if start >= x.size - 1 or start == 0 else float(2.0 * np.pi / np.exp(x[start]))


@dataclass(frozen=True)
class Lay:
    """Direction of ridges and grooves."""

    angle: float  # to the x axis, rad, from 0 to pi
    ratio: float  # root mean square slope across the lay over along it, at least 1
    oblique: float  # share of the lay missing in a mirror image


def find_lay(surface: Surface, short_cutoff: float) -> Lay:
    r"""Compute the direction of the lay of a map, and the share of it lost in a mirror image.

    The map is detrended, Hann's window makes it periodic, and wavelengths below ``short_cutoff``,
    m, are left out. The eigenvalues of :math:`T = \sum_q q\, q^T |\hat h_q|^2 = \langle \nabla h\,
    \nabla h^T \rangle` are the mean square slopes across and along the lay. A mirror image, which
    has the modes :math:`(\pm q_x, \pm q_y)` for a mode :math:`(q_x, q_y)`, loses the share
    :math:`2 |T_{xy}| / (T_{xx} + T_{yy})`: ridges become a herringbone.
    """
    return _lay_of(surface, *wave_power(window(surface, taper=0.5)), short_cutoff)


def _lay_of(surface: Surface, q: np.ndarray, power: np.ndarray, short_cutoff: float) -> Lay:
    """Lay of a map with given modes under a window; see :func:`find_lay`."""
    power = np.where(q <= 2.0 * np.pi / short_cutoff, power, 0.0)
    (nx, ny), (dx, dy) = surface.heights.shape, surface.spacing
    qx = 2.0 * np.pi * scipy.fft.fftfreq(nx, dx)[:, None]
    qy = 2.0 * np.pi * scipy.fft.rfftfreq(ny, dy)
    xx, yy, xy = (float(np.sum(product * power)) for product in (qx**2, qy**2, qx * qy))
    along, across = np.linalg.eigvalsh([[xx, xy], [xy, yy]])
    angle = float((0.5 * np.arctan2(2.0 * xy, xx - yy) + 0.5 * np.pi) % np.pi)
    ratio = float(np.sqrt(across / max(along, 1e-12 * across))) if across > 0.0 else 1.0
    return Lay(angle, ratio, 2.0 * abs(xy) / max(xx + yy, 1e-300))
