"""Longest and shortest waves of a map, and the direction of its lay."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from multiscale.surfaces.preparation import window
from multiscale.surfaces.statistics import wave_power
from multiscale.surfaces.surface import Surface

__all__ = ["Lay", "Roughness", "Spectrum", "find_lay", "spectrum"]

NEGLECTED_SHARE = 0.01  # share of the mean squares beyond the longest and the shortest wave


@dataclass(frozen=True)
class Roughness:
    """Statistics of one or several surfaces.

    Attributes
    ----------
    rms_height, rms_slope : float, root mean square height, m, and slope, dimensionless
    longest_wave : float, wavelength, m, beyond which a hundredth of the mean square height remains
    shortest_wave : float, wavelength, m, below which a hundredth of the mean square slope remains
    """

    rms_height: float
    rms_slope: float
    longest_wave: float
    shortest_wave: float


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Waves of surfaces of one grid, in rising order.

    Attributes
    ----------
    wavenumber : ndarray, shape (waves,), wavenumbers, rad/m
    power : ndarray, shape (waves,)
        Share of each wave in the mean square height, averaged over the surfaces, m^2.
    measured : tuple of float
        Ratios of the mean squares of height and slope of the measured points to the mean squares
        of all points, dimensionless.
    """

    wavenumber: np.ndarray
    power: np.ndarray
    measured: tuple[float, float] = (1.0, 1.0)

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
        """Find the longest cut-off that leaves a share of the rms height (order 0) or slope (2), m.

        By Parseval's identity this is exact for :func:`low_pass` of periodic surfaces.
        """
        return self._reach(self.wavenumber, self._sums[order], share)

    def share(self, long: float, short: float, *, order: int) -> float:
        """Share of the rms height (order 0) or slope (2) in the waves from long to short, m."""
        ends = np.searchsorted(self.wavenumber, (2.0 * np.pi / long, 2.0 * np.pi / short))
        below = self._sums[order]  # of the waves before each
        first, last = (below[end - 1] if end else 0.0 for end in ends)
        return float(np.sqrt(max(last - first, 0.0) / below[-1]))

    @cached_property
    def _sums(self) -> dict[int, np.ndarray]:
        """Running sums of mean square height and slope."""
        return {order: np.cumsum(self.wavenumber**order * self.power) for order in (0, 2)}

    def length_holding(self, share: float) -> float:
        """Find the shortest length whose waves up to it have a share of the rms height, m."""
        return self._reach(self.wavenumber[::-1], np.cumsum(self.power[::-1]), share)

    @staticmethod
    def _reach(q: np.ndarray, total: np.ndarray, share: float) -> float:
        """Wavelength, m, of the wave with which a running sum reaches the square of a share."""
        last = np.searchsorted(total, share**2 * total[-1] * (1.0 - 1e-12))
        return float(2.0 * np.pi / q[min(last, q.size - 1)])


def spectrum(surfaces: Sequence[Surface], *, periodic: bool = True) -> Spectrum:
    r"""Mean spectrum of surfaces of one grid and size.

    Parameters
    ----------
    surfaces : sequence of Surface
    periodic : bool
        Whether the surfaces are periodic. Otherwise the waves are
        :math:`\cos(\pi i x / L_x) \cos(\pi j y / L_y)` of the mirror image, which is continuous
        across its edges, and filled points lie at the mean height of the measured points.
    """
    if periodic:
        found = [wave_power(one) for one in surfaces]
        q, power, measured = found[0][0], np.mean([one for _, one in found], axis=0), (1.0, 1.0)
    else:
        first = surfaces[0]
        i, j = (
            np.arange(n) * np.pi / edge
            for n, edge in zip(first.heights.shape, first.size, strict=True)
        )
        q = np.hypot(i[:, None], j)
        level = []  # heights about the mean of the measured points, m; zero at filled points
        for one in surfaces:
            known = np.s_[:] if one.filled is None else ~one.filled
            level.append(np.zeros(one.heights.shape))
            level[-1][known] = one.heights[known] - one.heights[known].mean()
        waves = [scipy.fft.dctn(heights, norm="ortho") for heights in level]
        power = np.mean(np.square(waves), axis=0) / first.heights.size
        measured = (1.0, 1.0)
        if any(one.filled is not None for one in surfaces):
            parts = [_measured(*pair) for pair in zip(surfaces, level, strict=True)]
            height, slope, height_of_all, slope_of_all = np.sum(parts, axis=0)
            measured = (height / height_of_all, slope / slope_of_all)
    order = np.argsort(q, axis=None)[1:]  # the first is the mean
    return Spectrum(q.ravel()[order], power.ravel()[order], measured)


def _measured(surface: Surface, level: np.ndarray) -> tuple[float, float, float, float]:
    """Mean squares of heights, m², and slopes, first of measured points, then of all points."""
    known = np.ones(level.shape, dtype=bool) if surface.filled is None else ~surface.filled
    slopes = [0.0, 0.0]
    for axis, step in enumerate(surface.spacing):
        if level.shape[axis] == 1:  # a profile
            continue
        square = (np.diff(level, axis=axis) / step) ** 2
        both = np.logical_and(*(np.delete(known, end, axis=axis) for end in (0, -1)))
        slopes[0] += float(np.mean(square[both])) if both.any() else 0.0
        slopes[1] += float(np.mean(square))
    return float(np.mean(level[known] ** 2)), slopes[0], float(np.mean(level**2)), slopes[1]


@dataclass(frozen=True)
class Lay:
    r"""Direction of ridges and grooves.

    Attributes
    ----------
    angle : float, angle of the lay to the x axis, rad, from 0 to pi
    ratio : float, root mean square slope across the lay over the slope along it, at least 1
    oblique : float
        Share of the lay that a mirror image loses: 0 for an isotropic map and for a lay along an
        axis, :math:`|\sin 2\theta|` for parallel ridges.
    """

    angle: float
    ratio: float
    oblique: float


def find_lay(surface: Surface, short_cutoff: float) -> Lay:
    r"""Find the direction of the lay of a map, and how much of it a mirror image loses.

    Parameters
    ----------
    surface : Surface
        The map, detrended. Hann's window makes it periodic.
    short_cutoff : float, shortest wavelength that counts, m

    Notes
    -----
    Of :math:`T = \sum_q q\, q^T |\hat h_q|^2 = \langle \nabla h\, \nabla h^T \rangle` the
    eigenvalues are the mean square slopes across and along the lay, and
    :math:`2 |T_{xy}| / (T_{xx} + T_{yy})` is lost in a mirror image, which has four waves
    :math:`(\pm q_x, \pm q_y)` for a wave :math:`(q_x, q_y)`, so that :math:`T_{xy}` vanishes:
    ridges become a herringbone.
    """
    return lay_of(surface, *wave_power(window(surface, taper=0.5)), short_cutoff)


def lay_of(surface: Surface, q: np.ndarray, power: np.ndarray, short_cutoff: float) -> Lay:
    """Lay of a map whose waves under a window are known; see :func:`find_lay`."""
    power = np.where(q <= 2.0 * np.pi / short_cutoff, power, 0.0)
    (nx, ny), (dx, dy) = surface.heights.shape, surface.spacing
    qx = 2.0 * np.pi * scipy.fft.fftfreq(nx, dx)[:, None]
    qy = 2.0 * np.pi * scipy.fft.rfftfreq(ny, dy)
    xx, yy, xy = (float(np.sum(product * power)) for product in (qx**2, qy**2, qx * qy))
    along, across = np.linalg.eigvalsh([[xx, xy], [xy, yy]])
    angle = float((0.5 * np.arctan2(2.0 * xy, xx - yy) + 0.5 * np.pi) % np.pi)
    ratio = float(np.sqrt(across / max(along, 1e-12 * across))) if across > 0.0 else 1.0
    return Lay(angle, ratio, 2.0 * abs(xy) / max(xx + yy, 1e-300))
