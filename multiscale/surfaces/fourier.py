"""Fourier modes (1) of a surface: mean squares of height and slope, density, mean spectrum."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from multiscale.errors import CaseError
from multiscale.surfaces.surface import Surface

NEGLECTED_SHARE = 0.01  # share of the mean squares beyond the longest and the shortest wavelength


def rms_height(surface: Surface) -> float:
    r"""Root mean square height about the mean, :math:`\langle (h - \bar h)^2 \rangle^{1/2}`, m."""
    return float(surface.heights.std())


def rms_slope(surface: Surface) -> float:
    r"""Root mean square slope of a periodic surface, dimensionless.

    It is :math:`\langle |\nabla h|^2 \rangle^{1/2} = (\sum_q q^2 |\hat h_q|^2)^{1/2}`, by the
    Fourier series; for a measured map, which is not periodic, see :func:`describe_surface`.
    """
    q, power = wave_power(surface)
    return float(np.sqrt(np.sum(q**2 * power)))


def nayak_parameter(surface: Surface) -> float:
    """Nayak's breadth (3) of an isotropic surface: at least 1.5 if it is Gaussian."""
    return breadth(*wave_power(surface))


def breadth(q: np.ndarray, power: np.ndarray) -> float:
    """Nayak's parameter (3) of modes: wavenumbers, rad/m, and shares of the mean square, m^2."""
    height_square, slope_square, curvature_square = (
        float(np.sum(weight)) for weight in (power, q**2 * power, (q**2) ** 2 * power)
    )
    if slope_square == 0.0:
        raise CaseError("a flat surface has no Nayak parameter; give a rough surface")
    m0, m2, m4 = height_square, slope_square / 2.0, 3.0 / 8.0 * curvature_square
    # P. R. Nayak, J. Lubr. Technol. 93 (1971) 398-407, doi:10.1115/1.3451608:
    # alpha = m_0 m_4 / m_2², m_0 = <h²>, m_2 = <|grad h|²> / 2, m_4 = 3/8 <(laplace h)²> (3)
    return float(m0 * m4 / m2**2)  # (3)


def ring_density(
    surface: Surface, q: np.ndarray, power: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Wavenumber, rad/m, density (4), m^4, and number of modes of the rings of wavenumbers."""
    rings = np.rint(q / (2.0 * np.pi / min(surface.size))).astype(int).ravel()
    weights = _weights(surface).ravel()
    number = np.bincount(rings, weights)
    used = number > 0.0
    number = number[used]
    wavenumber = np.bincount(rings, weights * q.ravel())[used] / number
    # T. D. B. Jacobs, T. Junge, L. Pastewka, Surf. Topogr.: Metrol. Prop. 5 (2017) 013001,
    # doi:10.1088/2051-672X/aa51f8, with an exact sum over rings of width 2π / min(L), incomplete
    # rings in the corners included:
    #     C_q = L_x L_y |h_q|²,   <(h - mean)²> = 1/(L_x L_y) sum N C ~ 1/2π ∫ q C dq  (4)
    area = surface.size[0] * surface.size[1]
    return wavenumber, area * np.bincount(rings, power.ravel())[used] / number, number  # (4)


def wavenumbers(surface: Surface) -> np.ndarray:
    """Wavenumber of each entry of the real transform, rad/m, shape (nx, ny // 2 + 1)."""
    (nx, ny), (dx, dy) = surface.heights.shape, surface.spacing
    wavenumber: np.ndarray = (
        2.0 * np.pi * np.hypot(scipy.fft.fftfreq(nx, dx)[:, None], scipy.fft.rfftfreq(ny, dy))
    )
    return wavenumber


def wave_power(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """Return wavenumbers, rad/m, and shares of the mean square height, m^2: (nx, ny // 2 + 1)."""
    modulus = np.abs(scipy.fft.rfft2(surface.heights, norm="forward"))
    return wavenumbers(surface), _weights(surface) * modulus**2


def _weights(surface: Surface) -> np.ndarray:
    """Count the modes q and -q of each entry of the real transform; 0 for the mean."""
    nx, ny = surface.heights.shape
    weights = np.full((nx, ny // 2 + 1), 2.0)
    weights[:, 0] = 1.0
    if ny % 2 == 0:
        weights[:, -1] = 1.0
    weights[0, 0] = 0.0
    return weights


@dataclass(frozen=True)
class Roughness:
    """Roughness of a surface or a mean spectrum.

    Attributes
    ----------
    rms_height, rms_slope : float, root mean square height, m, and slope, dimensionless
    longest_wave, shortest_wave : float
        Wavelengths, m: longer wavelengths have a hundredth of the mean square height, and shorter
        wavelengths a hundredth of the mean square slope.
    """

    rms_height: float
    rms_slope: float
    longest_wave: float
    shortest_wave: float


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Modes of surfaces on the same grid, in rising order."""

    wavenumber: np.ndarray  # (modes,), rad/m
    power: np.ndarray  # share of a mode in the mean square height, averaged, m²
    measured: tuple[float, float] = (1.0, 1.0)  # mean squares, of measured over all points

    def roughness(self) -> Roughness:
        """Return the statistics of the measured points."""
        height, slope = (
            float(np.sqrt(share * self._sums[order][-1]))
            for share, order in zip(self.measured, (0, 2), strict=True)
        )
        return Roughness(
            height,
            slope,
            self.length_holding(np.sqrt(1.0 - NEGLECTED_SHARE)),
            self.cutoff_holding(np.sqrt(1.0 - NEGLECTED_SHARE), order=2),
        )

    def cutoff_holding(self, share: float, *, order: int) -> float:
        """Longest cut-off that leaves a share of the rms height (order 0) or slope (2), m."""
        return self._reach(self.wavenumber, self._sums[order], share)

    def share(self, long: float, short: float, *, order: int) -> float:
        """Share of the rms height (order 0) or slope (2) in wavelengths from long to short, m."""
        ends = np.searchsorted(self.wavenumber, (2.0 * np.pi / long, 2.0 * np.pi / short))
        below = self._sums[order]  # mean square of the modes up to each
        first, last = (below[end - 1] if end else 0.0 for end in ends)
        return float(np.sqrt(max(last - first, 0.0) / below[-1]))

    @cached_property
    def _sums(self) -> dict[int, np.ndarray]:
        return {order: np.cumsum(self.wavenumber**order * self.power) for order in (0, 2)}

    def length_holding(self, share: float) -> float:
        """Shortest length below which wavelengths have a share of the rms height, m."""
        return self._reach(self.wavenumber[::-1], np.cumsum(self.power[::-1]), share)

    @staticmethod
    def _reach(q: np.ndarray, total: np.ndarray, share: float) -> float:
        """Wavelength, m, of the mode with which a running sum reaches the square of a share."""
        last = np.searchsorted(total, share**2 * total[-1] * (1.0 - 1e-12))
        return float(2.0 * np.pi / q[min(last, q.size - 1)])


def spectrum(surfaces: Sequence[Surface], *, periodic: bool = True) -> Spectrum:
    r"""Average the spectra of surfaces with the same grid and size.

    Parameters
    ----------
    periodic : bool
        Whether the surfaces are periodic. Otherwise the modes are
        :math:`\cos(\pi i x / L_x) \cos(\pi j y / L_y)` of the mirror image, which is continuous
        across its edges, and filled points lie at the mean height of the measured points.
    """
    measured = (1.0, 1.0)
    if periodic:
        spectra = [wave_power(surface) for surface in surfaces]
        q, power = spectra[0][0], np.mean([power for _, power in spectra], axis=0)
    else:
        first = surfaces[0]
        i, j = (
            np.arange(n) * np.pi / edge
            for n, edge in zip(first.heights.shape, first.size, strict=True)
        )
        q = np.hypot(i[:, None], j)
        level = []  # heights about the mean of the measured points, m; zero at filled points
        for surface in surfaces:
            measured_points = np.s_[:] if surface.filled is None else ~surface.filled
            heights = surface.heights[measured_points]
            level.append(np.zeros(surface.heights.shape))
            level[-1][measured_points] = heights - heights.mean()
        modes = [scipy.fft.dctn(heights, norm="ortho") for heights in level]
        power = np.mean(np.square(modes), axis=0) / first.heights.size
        if any(surface.filled is not None for surface in surfaces):
            squares = [_mean_squares(*pair) for pair in zip(surfaces, level, strict=True)]
            height, slope, height_of_all, slope_of_all = np.sum(squares, axis=0)
            measured = (height / height_of_all, slope / slope_of_all)
    order = np.argsort(q, axis=None)[1:]  # the first is the mean
    return Spectrum(q.ravel()[order], power.ravel()[order], measured)


def _mean_squares(surface: Surface, level: np.ndarray) -> tuple[float, float, float, float]:
    """Mean squares of height, m², and slope, over measured points, then over all points."""
    measured = np.ones(level.shape, dtype=bool) if surface.filled is None else ~surface.filled
    slopes = [0.0, 0.0]
    for axis, step in enumerate(surface.spacing):
        if level.shape[axis] == 1:  # a profile
            continue
        square = (np.diff(level, axis=axis) / step) ** 2
        both = np.logical_and(*(np.delete(measured, end, axis=axis) for end in (0, -1)))
        slopes[0] += float(np.mean(square[both])) if both.any() else 0.0
        slopes[1] += float(np.mean(square))
    return float(np.mean(level[measured] ** 2)), slopes[0], float(np.mean(level**2)), slopes[1]
