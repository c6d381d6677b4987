"""Preparation of measured maps for a cell: periodic, band-limited, on the grid of the cell."""

import numpy as np
import scipy

from multiscale.errors import CaseError, require
from multiscale.surfaces.fourier import wavenumbers
from multiscale.surfaces.surface import Surface, remove_trend

AROUND = 5  # points across the surroundings of a point that may be a spike

SPIKE, GAUSSIAN = 10.0, 1.4826
"""Height of a spike over the standard deviation; standard deviation over the median distance from
the mean in a Gaussian distribution."""

_ROUND_OFF = 1e-9  # relative: a mode exactly on a cut-off belongs to the band


def detrend(surface: Surface) -> Surface:
    """Subtract the least-squares plane of the heights.

    A cropped map has another mean and tilt: remove them after :func:`crop`. Size and filled points
    stay.
    """
    return Surface(remove_trend(surface.heights, 1), surface.size, surface.filled)


def find_spikes(heights: np.ndarray) -> np.ndarray:
    r"""Mark points that stand out of their surroundings: bool, with the shape of the heights.

    ``heights`` has the shape (nx, ny), m, and is NaN at undefined points, where the result is
    false; a line scan has ``ny = 1``. With the median :math:`m` of the 5 x 5 points about it, a
    point is a spike if

    .. math:: |h - m| > 10 \cdot 1.4826\, \mathrm{median}(|h - m| \ne 0),

    ten times the standard deviation of Gaussian differences. Clusters wider than three points
    dominate the median around them and are not marked.
    """
    undefined = ~np.isfinite(heights)
    if undefined.all():
        return np.zeros_like(undefined)
    # undefined points copy the nearest defined height
    nearest = scipy.ndimage.distance_transform_edt(
        undefined, return_distances=False, return_indices=True
    )
    whole = heights[tuple(nearest)]
    around = scipy.ndimage.median_filter(whole, np.minimum(heights.shape, AROUND), mode="nearest")
    away = np.where(undefined, 0.0, np.abs(whole - around))
    if not away.any():
        return np.zeros_like(undefined)
    spikes: np.ndarray = away > SPIKE * GAUSSIAN * np.median(away[away > 0.0])
    return spikes


def mirror(surface: Surface) -> Surface:
    """Reflect a map about its edges to a periodic map, twice as long in both directions.

    The heights are continuous across the seams and keep their distribution, but the slope normal
    to a seam jumps. The four quarters are copies: the cell is twice as long but contains no more
    statistics than the map, so that the scatter over realisations does not fall.

    Examples
    --------
    >>> mirror(Surface(np.array([[1.0, 2.0], [3.0, 4.0]]), (1.0, 1.0))).heights[0]
    array([1., 2., 2., 1.])
    """
    heights = np.concatenate([surface.heights, surface.heights[::-1]], axis=0)
    heights = np.concatenate([heights, heights[:, ::-1]], axis=1)
    return Surface(heights, (2.0 * surface.size[0], 2.0 * surface.size[1]))


def window(surface: Surface, *, taper: float = 0.1) -> Surface:
    r"""Fade a map to its mean height along the edges, so that it is periodic.

    Parameters
    ----------
    surface : Surface, detrended map
    taper : float
        Share of each edge length over which the heights fade, at either end; dimensionless,
        :math:`0 < \theta \le 1/2`. A taper of 1/2 is the Hann window.

    Returns
    -------
    Surface, heights :math:`\bar h + w(x)\, w(y)\, (h - \bar h)` with Tukey's window :math:`w`, m

    Notes
    -----
    The middle stays as measured. The window has a bias: for statistically homogeneous roughness
    the mean square height falls by the mean of :math:`w^2` in each direction, together by
    :math:`(1 - 5\theta/4)^2`, the margin is smoother than the middle, and contact spots gather in
    the middle.
    """
    require("taper", taper, "(0, 0.5]")
    mean, faded = surface.heights.mean(), surface.heights - surface.heights.mean()
    for axis, n in enumerate(surface.heights.shape):
        if n > 1:  # not across a line scan; the import of scipy.signal would take longer
            from_edge = np.minimum(np.arange(n), n - np.arange(n)) / (taper * n)
            fade = 0.5 - 0.5 * np.cos(np.pi * np.minimum(from_edge, 1.0))
            faded = faded * np.expand_dims(fade, 1 - axis)
    return Surface(mean + faded, surface.size)


def crop(surface: Surface, origin: tuple[int, int], points: tuple[int, int]) -> Surface:
    """Cut a rectangle out of a map from a node (i, j), with (nx, ny) points, at least 2 each."""
    shape = surface.heights.shape
    if any(
        first < 0 or n < 2 or first + n > total
        for first, n, total in zip(origin, points, shape, strict=True)
    ):
        raise CaseError(
            f"the piece of {points[0]} x {points[1]} points at node {origin} does not lie in the "
            f"map of {shape[0]} x {shape[1]} points, or has fewer than 2 x 2"
        )
    (i, j), (nx, ny) = origin, points
    dx, dy = surface.spacing
    piece = np.s_[i : i + nx, j : j + ny]
    filled = None if surface.filled is None else surface.filled[piece]
    return Surface(surface.heights[piece], (nx * dx, ny * dy), filled)


def rotate(surface: Surface, angle: float) -> Surface:
    """Turn a map, which need not be periodic, counter-clockwise by an angle, rad.

    Multiples of a right angle are exact. Otherwise heights are interpolated by cubic splines, which
    damps the shortest wavelengths, and the result is the largest rectangle in the turned map with
    sides in the ratio of the map or its inverse. The spacing stays; points with filled neighbours
    are filled.
    """
    from scipy.ndimage import map_coordinates

    # nearest multiple of a right angle, and the remaining turn
    quarters = round(angle / (0.5 * np.pi))
    heights = np.rot90(surface.heights, quarters)
    a, b = surface.size
    size = (a, b) if quarters % 2 == 0 else (b, a)
    filled = None if surface.filled is None else np.rot90(surface.filled, quarters)
    turn = angle - 0.5 * np.pi * quarters
    if abs(turn) < _ROUND_OFF:
        return Surface(heights, size, filled)
    # largest rectangle in the turned map
    dx, dy = size[0] / heights.shape[0], size[1] / heights.shape[1]
    lx, ly = (heights.shape[0] - 1) * dx, (heights.shape[1] - 1) * dy
    c, s = np.cos(turn), np.sin(turn)
    scale = min(lx / (lx * c + ly * abs(s)), ly / (lx * abs(s) + ly * c))
    nx, ny = (int(scale * edge / step + _ROUND_OFF) + 1 for edge, step in ((lx, dx), (ly, dy)))
    x, y = np.meshgrid(
        (np.arange(nx) - 0.5 * (nx - 1)) * dx, (np.arange(ny) - 0.5 * (ny - 1)) * dy, indexing="ij"
    )
    # interpolate at the turned nodes
    middle = 0.5 * np.array(heights.shape) - 0.5
    places = np.stack([(c * x + s * y) / dx + middle[0], (c * y - s * x) / dy + middle[1]])
    turned = map_coordinates(heights, places, order=3, mode="nearest")
    if filled is not None:
        filled = map_coordinates(filled.astype(float), places, order=1, mode="nearest") > 0.0
    return Surface(turned, (nx * dx, ny * dy), filled)


def resample(surface: Surface, points: tuple[int, int]) -> Surface:
    """Interpolate a periodic surface to another grid of the same cell by its Fourier series.

    A finer grid samples the same surface (1). For a coarser grid the modes that it cannot
    represent are removed first, in each direction, so that no mode is aliased. A map that is not
    periodic oscillates at its edges: :func:`mirror` or :func:`window` it first.

    ``points`` are the grid points (nx, ny) of the result, at least 2 each.
    """
    from scipy.signal import resample as resample_axis

    if min(points) < 2:
        raise CaseError(f"resampling needs at least 2 points in each direction, got {points}")
    heights = surface.heights
    for axis, n in enumerate(points):
        if n != heights.shape[axis]:
            heights = resample_axis(heights, n, axis=axis)
    return Surface(heights, surface.size)


def low_pass(surface: Surface, short_cutoff: float) -> Surface:
    """Remove the modes of a periodic surface that are shorter than a wavelength.

    This limits a measured surface to the wavelengths that a grid resolves. ``short_cutoff`` is the
    shortest wavelength that stays, m, positive.
    """
    require("short_cutoff", short_cutoff, "(0, inf)", "m")
    spectrum = scipy.fft.rfft2(surface.heights)
    spectrum[wavenumbers(surface) > 2.0 * np.pi / short_cutoff * (1.0 + _ROUND_OFF)] = 0.0
    return Surface(scipy.fft.irfft2(spectrum, s=surface.heights.shape), surface.size)


def composite(surface_1: Surface, surface_2: Surface) -> Surface:
    r"""Add two rough surfaces that face each other.

    Both have the same grid and size, and heights positive out of their bodies, at the same points
    of the joint, so that the gap at the mean-plane distance :math:`d` is :math:`d - h_1 - h_2`: the
    sum :math:`h_1 + h_2`, m, pressed against a plane, has the same gaps. A side 2 measured from
    outside must first be mirrored in x or in y.
    """
    if surface_1.heights.shape != surface_2.heights.shape:
        raise CaseError(
            f"the two surfaces must have the same points, got {surface_1.heights.shape} and "
            f"{surface_2.heights.shape}; resample a surface"
        )
    if not np.allclose(surface_1.size, surface_2.size, rtol=_ROUND_OFF, atol=0.0):
        raise CaseError(
            f"the two surfaces must have the same size, got {surface_1.size} and "
            f"{surface_2.size} m; crop the larger surface"
        )
    return Surface(surface_1.heights + surface_2.heights, surface_1.size)
