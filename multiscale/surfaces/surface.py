"""A rough surface, heights on a regular grid, and synthesis of self-affine surfaces."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from multiscale.errors import CaseError, require
from multiscale.units import html_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class Surface:
    """Heights of a surface on a regular grid of a rectangular cell.

    Parameters
    ----------
    heights : ndarray, shape (nx, ny)
        Height at the nodes ``x_i = i dx``, ``y_j = j dy``, m; positive out of the body. The array
        is copied.
    size : tuple of float
        Edge lengths (Lx, Ly) of the cell, m, with ``dx = Lx / nx``: in a periodic surface node
        ``nx`` is node 0 again. ``nx`` and ``ny``, ``dx`` and ``dy`` may differ. A profile has
        ``ny = 1``: its cell is in plane strain, and its width is arbitrary.
    filled : ndarray of bool, shape (nx, ny), optional
        Whether a point of a map was filled instead of measured; no point if not given. Detrended
        and cropped maps keep it.

    Examples
    --------
    >>> surface = Surface(np.zeros((4, 2)), size=(8.0e-6, 2.0e-6))
    >>> surface.spacing
    (2e-06, 1e-06)
    """

    heights: np.ndarray
    size: tuple[float, float]
    filled: np.ndarray | None = None

    def __post_init__(self) -> None:
        heights: np.ndarray = np.ma.filled(
            np.ma.array(self.heights, dtype=float, copy=True), np.nan
        )
        size = tuple(float(length) for length in self.size)
        if heights.ndim != 2 or min(heights.shape) < 1 or heights.size < 2:
            raise CaseError(
                f"heights must be a map (nx, ny) of at least 2 x 1 points, got an array of shape "
                f"{heights.shape}"
            )
        undefined = np.count_nonzero(~np.isfinite(heights))
        if undefined:
            raise CaseError(
                f"{undefined} of {heights.size} heights are undefined (NaN or infinite); fill them "
                f"or crop the map"
            )
        if len(size) != 2 or not all(0.0 < length < np.inf for length in size):
            raise CaseError(f"size must be two positive lengths (m), got {size}")
        if self.filled is not None and self.filled.shape != heights.shape:
            raise CaseError(
                f"filled must mark each of {heights.shape[0]} x {heights.shape[1]} heights, got an "
                f"array of shape {self.filled.shape}"
            )
        object.__setattr__(self, "heights", heights)
        object.__setattr__(self, "size", size)

    @property
    def spacing(self) -> tuple[float, float]:
        """Distances (dx, dy) of neighbouring nodes, m."""
        return self.size[0] / self.heights.shape[0], self.size[1] / self.heights.shape[1]

    @property
    def filled_share(self) -> float:
        """Filled points over all points, dimensionless."""
        return 0.0 if self.filled is None else float(np.mean(self.filled))

    def plot(self, *, ax: "Axes | None" = None) -> "Axes":
        """Plot the heights in colours, in the current axes if none are given."""
        import matplotlib.pyplot as plt

        ax = ax or plt.gca()
        extent = (0.0, 1e6 * self.size[0], 0.0, 1e6 * self.size[1])
        image = ax.imshow(1e6 * self.heights.T, origin="lower", extent=extent, cmap="RdBu_r")
        ax.figure.colorbar(image, ax=ax, label="height (µm)")
        ax.set(xlabel="x (µm)", ylabel="y (µm)")
        return ax

    def _repr_html_(self) -> str:
        nx, ny = self.heights.shape
        rows = {
            "points": f"{nx} x {ny}",
            "length": f"{self.size[0]} m",
            "width": f"{self.size[1]} m",
            "rms height": f"{float(np.std(self.heights))} m",
            "filled": f"{100.0 * self.filled_share:.3g} %",
        }
        return html_table("Surface", rows)


def remove_trend(heights: np.ndarray, order: int) -> np.ndarray:
    r"""Subtract the least-squares polynomial of a total degree."""
    if order not in (0, 1, 2):
        raise CaseError(
            f"the detrending order must be 0 (mean), 1 (plane) or 2 (curvature), got {order!r}"
        )
    powers = [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]
    x, y = (np.vander(np.linspace(-1.0, 1.0, n), 2 * order + 1, True) for n in heights.shape)
    defined = np.isfinite(heights)
    heights = heights - np.mean(heights[defined])  # a large offset would cost digits of the fit
    moments = x.T @ (defined.astype(float) @ y)  # sums of x^i y^j over the defined points
    matrix = np.array([[moments[i + k, j + m] for k, m in powers] for i, j in powers])
    for _ in range(2):  # the second pass removes the round-off of the first
        weighted = x.T @ np.where(defined, heights, 0.0) @ y
        sums = np.array([weighted[power] for power in powers])
        fitted = np.zeros((order + 1, order + 1))
        fitted[tuple(zip(*powers, strict=True))] = np.linalg.lstsq(matrix, sums, rcond=1e-12)[0]
        # contiguous arrays: six times faster
        along_y = np.ascontiguousarray(fitted @ y[:, : order + 1].T)
        heights = heights - np.ascontiguousarray(x[:, : order + 1]) @ along_y
    detrended: np.ndarray = heights
    return detrended


_ROUND_OFF = 1e-9  # relative: a mode exactly on a cut-off belongs to the band


@dataclass(frozen=True)
class Anisotropy:
    """Lay of a rough surface with longer wavelengths along one direction.

    Attributes
    ----------
    ratio : float
        Wavelength along the lay over the wavelength across it, at least 1; also the root mean
        square slope across the lay over the slope along it.
    direction : float, angle of the lay, the direction of ridges and grooves, to the x axis, rad
    """

    ratio: float
    direction: float = 0.0

    def __post_init__(self) -> None:
        require("the ratio of an anisotropy", self.ratio, "[1, inf)")


def self_affine(
    points: tuple[int, int],
    size: tuple[float, float],
    seed: int,
    *,
    hurst_exponent: float,
    long_cutoff: float,
    short_cutoff: float,
    roll_off: float | None = None,
    rms_height: float | None = None,
    rms_slope: float | None = None,
    anisotropy: Anisotropy | None = None,
) -> Surface:
    r"""Generate a periodic, self-affine surface with a band-limited spectrum.

    Parameters
    ----------
    points, size : tuple, grid points (nx, ny) and edge lengths (Lx, Ly) of the cell, m
    hurst_exponent : float, :math:`0 \le H \le 1`, dimensionless
    long_cutoff, short_cutoff : float
        Longest and shortest wavelength :math:`\lambda_l \ge \lambda_s`, m.
    roll_off : float, optional
        Wavelength :math:`\lambda_r`, m, above which the spectrum is flat, else ``long_cutoff``.
    rms_height, rms_slope : float, optional
        Root mean square height, m, or slope :math:`\langle |\nabla h|^2 \rangle^{1/2}`,
        dimensionless; exactly one is given.
    anisotropy : Anisotropy, optional
        Lay of the surface; cut-offs and roll-off then apply across it. Isotropic if not given.

    Notes
    -----
    With independent phases :math:`\varphi_q`, uniform in :math:`[0, 2\pi)`,

    .. math::
        \hat h_q \propto \max(q, 2\pi/\lambda_r)^{-1-H}\, e^{i \varphi_q}
        \quad\text{for}\quad 2\pi/\lambda_l \le q \le 2\pi/\lambda_s,    \tag{2}

    and 0 elsewhere, so the power spectral density falls as :math:`q^{-2-2H}`. With an anisotropy of
    ratio r the wavenumber q is replaced by :math:`(q_\perp^2 + r^2 q_\parallel^2)^{1/2}` of the
    components across and along the lay.

    Only the phases are random: every realisation has exactly the given root mean square height or
    slope, and the same spectrum. The scatter of an ensemble with Gaussian moduli is missing: with
    few modes in the band, statistics over realisations are too narrow.

    The surface depends on the seed, the cell and the band, not on the grid, which must have more
    than two points per wavelength; to resolve contact, use at least 8 per shortest wavelength.
    Phases are drawn in the order of rising :math:`q`, so a lower ``short_cutoff`` leaves longer
    modes as they are.

    Examples
    --------
    >>> surface = self_affine(
    ...     (64, 32), (1e-4, 1e-4), seed=1,
    ...     hurst_exponent=0.8, long_cutoff=1e-4, short_cutoff=1e-5, rms_slope=0.1,
    ... )
    >>> surface.heights.shape
    (64, 32)
    """
    roll_off = long_cutoff if roll_off is None else roll_off
    for name, count in (("points[0]", points[0]), ("points[1]", points[1]), ("seed", seed)):
        require(name, count, "[0, inf)", integer=True)
    _check_band(points, size, long_cutoff, short_cutoff, roll_off)
    require("hurst_exponent", hurst_exponent, "[0, 1]")
    if (rms_height is None) == (rms_slope is None):
        raise CaseError("give exactly one of rms_height (m) and rms_slope")
    for name, value in (("rms_height", rms_height), ("rms_slope", rms_slope)):
        if value is not None:
            require(name, value, "(0, inf)")

    # modes of the band, with random phases
    i, j, q = _modes(size, short_cutoff)
    phase = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, size=q.size)
    across = q  # wavenumbers with the component along the lay stretched by its ratio, rad/m
    if anisotropy is not None:
        qx, qy = 2.0 * np.pi * i / size[0], 2.0 * np.pi * j / size[1]
        c, s = np.cos(anisotropy.direction), np.sin(anisotropy.direction)
        across = np.hypot(c * qy - s * qx, anisotropy.ratio * (c * qx + s * qy))
    band = across >= 2.0 * np.pi / long_cutoff * (1.0 - _ROUND_OFF)
    band &= across <= 2.0 * np.pi / short_cutoff * (1.0 + _ROUND_OFF)
    if not band.any():
        raise CaseError(
            f"no mode of the {size[0]:g} m x {size[1]:g} m cell lies between short_cutoff "
            f"{short_cutoff:g} m and long_cutoff {long_cutoff:g} m; widen the band"
        )
    i, j, q, across, phase = i[band], j[band], q[band], across[band], phase[band]
    # moduli of the spectrum
    q_roll_off = 2.0 * np.pi / roll_off
    modulus = (np.maximum(across, q_roll_off) / q_roll_off) ** (-1.0 - hurst_exponent)  # (2)
    if rms_height is not None:
        modulus *= rms_height / np.sqrt(2.0 * np.sum(modulus**2))  # 2: the modes -q
    else:
        modulus *= rms_slope / np.sqrt(2.0 * np.sum((q * modulus) ** 2))

    # inverse transform
    nx, ny = points
    spectrum = np.zeros((nx, ny // 2 + 1), dtype=complex)
    spectrum[i % nx, j] = modulus * np.exp(1j * phase)
    axis = j == 0  # here the transform needs q and -q
    spectrum[-i[axis] % nx, 0] = spectrum[i[axis] % nx, 0].conj()
    return Surface(scipy.fft.irfft2(spectrum, s=(nx, ny), norm="forward"), size)


def _modes(
    size: tuple[float, float], short_cutoff: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """List a mode of each pair q, -q, in rising order: i, j and wavenumber, rad/m."""
    length, width = size
    i_max, j_max = (int(edge / short_cutoff * (1.0 + _ROUND_OFF)) for edge in size)
    i, j = np.meshgrid(np.arange(-i_max, i_max + 1), np.arange(j_max + 1), indexing="ij")
    square = i**2 + (j * (length / width)) ** 2  # (q Lx / 2 pi)^2, free of the unit of length
    half = (j > 0) | ((j == 0) & (i > 0))
    half &= square <= (length / short_cutoff * (1.0 + _ROUND_OFF)) ** 2
    i, j, square = i[half], j[half], square[half]
    order = np.lexsort((i, j, np.round(square, 9)))
    return i[order], j[order], 2.0 * np.pi / length * np.sqrt(square[order])


def _check_band(
    points: tuple[int, int],
    size: tuple[float, float],
    long_cutoff: float,
    short_cutoff: float,
    roll_off: float,
) -> None:
    lengths = {
        "size[0]": size[0],
        "size[1]": size[1],
        "long_cutoff": long_cutoff,
        "roll_off": roll_off,
        "short_cutoff": short_cutoff,
    }
    for name, value in lengths.items():
        require(name, value, "(0, inf)", "m")
    if not short_cutoff <= roll_off <= long_cutoff:
        raise CaseError(
            f"the wavelengths must be in the order short_cutoff <= roll_off <= long_cutoff, got "
            f"{short_cutoff:g}, {roll_off:g} and {long_cutoff:g} m"
        )
    if long_cutoff > max(size) * (1.0 + _ROUND_OFF):
        raise CaseError(
            f"long_cutoff {long_cutoff:g} m is longer than the cell of {size[0]:g} m x "
            f"{size[1]:g} m; enlarge the cell or shorten long_cutoff"
        )
    least = tuple(2 * int(edge / short_cutoff * (1.0 + _ROUND_OFF)) + 1 for edge in size)
    if points[0] < least[0] or points[1] < least[1]:
        good = tuple(int(np.ceil(8.0 * edge / short_cutoff - _ROUND_OFF)) for edge in size)
        raise CaseError(
            f"{points[0]} x {points[1]} points cannot carry short_cutoff {short_cutoff:g} m on a "
            f"cell of {size[0]:g} m x {size[1]:g} m: it takes at least {least[0]} x {least[1]} "
            f"points, and {good[0]} x {good[1]} (8 per wavelength) to resolve contact"
        )
