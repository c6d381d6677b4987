"""A rough surface as heights on a regular grid, and its reading from an instrument file."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from multiscale.errors import CaseError

__all__ = ["Surface", "read_surface", "remove_trend"]

_TRENDS = ("mean", "plane", "curvature")


@dataclass(frozen=True, eq=False)
class Surface:
    """Heights of a surface on a regular grid of one rectangular cell.

    Parameters
    ----------
    heights : ndarray, shape (nx, ny)
        Height at the nodes ``x_i = i dx``, ``y_j = j dy``, m; positive out of the body. The array
        is copied.
    size : tuple of float
        Edge lengths (Lx, Ly) of the cell, m, with ``dx = Lx / nx``: the grid is that of a periodic
        surface, whose node ``nx`` is node 0 again. ``nx != ny`` and ``dx != dy`` are normal. One
        point across means a profile, whose cell is in plane strain; its width is arbitrary.
    filled : ndarray of bool, shape (nx, ny), optional
        Which points of a map were filled and not measured; none if not given. Detrended and
        cropped maps keep it.

    Raises
    ------
    CaseError
        If the heights are not a map of finite numbers with at least 2 points along one direction,
        a length is not positive, or the filled points are those of another map.

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
                f"filled must say of each of {heights.shape[0]} x {heights.shape[1]} heights "
                f"whether it was filled, got an array of shape {self.filled.shape}"
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


def remove_trend(heights: np.ndarray, order: int) -> np.ndarray:
    r"""Subtract the least-squares polynomial of a total degree.

    Parameters
    ----------
    heights : ndarray, shape (nx, ny)
        Heights, m. Points that are NaN take no part in the fit and stay NaN.
    order : {0, 1, 2}
        Degree: 0 removes the mean, 1 a plane, 2 a plane and the curvature.

    Returns
    -------
    ndarray, shape (nx, ny)
        :math:`h - \sum_{i+j \le n} c_{ij}\, x^i y^j`, m.

    Raises
    ------
    CaseError
        If the order is none of the three.
    """
    if order not in (0, 1, 2):
        raise CaseError(
            f"the detrending order must be 0 (mean), 1 (plane) or 2 (curvature), got {order!r}"
        )
    x, y = np.meshgrid(*(np.linspace(-1.0, 1.0, n) for n in heights.shape), indexing="ij")
    powers = [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]
    basis = np.stack([x**i * y**j for i, j in powers], axis=-1)
    defined = np.isfinite(heights)
    heights = heights - np.mean(heights[defined])  # a large offset would cost the fit its digits
    coefficients = np.linalg.lstsq(basis[defined], heights[defined], rcond=None)[0]
    detrended: np.ndarray = heights - basis @ coefficients
    return detrended


def read_surface(
    path: str | PathLike[str],
    *,
    detrend_order: int = 1,
    fill_undefined: bool = False,
    channel: int | str | None = None,
) -> Surface:
    """Read a measured topography from an instrument file.

    Parameters
    ----------
    path : path
        File of any format that SurfaceTopography reads; the format is found from the content.
    detrend_order : {0, 1, 2}
        Degree of the polynomial that is removed: 0 the mean, 1 a plane (a tilted sample), 2 also
        the curvature (a ball or a cylinder). The fit uses the defined points only.
    fill_undefined : bool
        Fill undefined points, after detrending, by the solution of Laplace's equation with their
        defined neighbours as boundary values. Filled regions are too smooth, so they lower the
        root mean square slope; the result says which points they are. Undefined points are
        refused otherwise.
    channel : int or str, optional
        Number, counted from 0, or name of the channel. The format's default height channel if not
        given.

    Returns
    -------
    Surface
        Heights and size in m, mean height 0 unless points were filled: ``filled`` says which,
        ``filled_share`` how many. A measured map is not
        periodic: see :func:`multiscale.micro.topography.mirror` and
        :func:`~multiscale.micro.topography.window`.

    Raises
    ------
    CaseError
        If there is no such file, it cannot be read as a height map, it gives no unit or no lateral
        size, it has undefined points, it is flat, or SurfaceTopography is not installed.

    Notes
    -----
    Formats without length or checksum, such as plain text cut between two rows, do not tell that
    the file is incomplete.
    """
    path = Path(path)
    _check_file(path)
    with _reading(path) as (library, reader):
        entry = _pick_channel(path, reader, channel)
        _check_channel(path, entry)
        topography = entry.topography().to_unit("m")
        size = tuple(float(length) for length in topography.physical_sizes)
        heights: np.ndarray = np.ma.filled(np.ma.array(topography.heights(), dtype=float), np.nan)
        undefined = ~np.isfinite(heights)
        heights[undefined] = np.nan
        _check_undefined(path, undefined, fill_undefined)
        scale = np.nanmax(np.abs(heights))
        heights = remove_trend(heights, detrend_order)
        if np.nanstd(heights) <= 1e-13 * scale:  # round-off of the fit
            raise CaseError(
                f"{path}: all heights are equal once the {_TRENDS[detrend_order]} is removed; "
                f"choose a file, or a channel, that holds a rough surface"
            )
        if undefined.any():
            masked = np.ma.array(heights, mask=undefined)
            filled = library.Topography(masked, size).interpolate_undefined_data()
            heights = np.ma.getdata(filled.heights())
        try:
            return Surface(heights, size, undefined if undefined.any() else None)  # type: ignore[arg-type]
        except CaseError as error:
            raise CaseError(f"{path}: {error}") from error


def _check_file(path: Path) -> None:
    """Refuse what is not a file with content."""
    if path.is_dir():
        raise CaseError(f"{path}: is a directory; give one topography file in it")
    if not path.exists():
        try:
            names = [entry.name for entry in path.parent.iterdir()]
        except OSError:
            names = []
        close = get_close_matches(path.name, names, n=1)
        hint = f"did you mean {close[0]!r}?" if close else "check the name and the folder"
        raise CaseError(f"{path}: no such file; {hint}")
    if not path.is_file():
        raise CaseError(f"{path}: is a device or a pipe; give a topography file")
    if path.stat().st_size == 0:
        raise CaseError(f"{path}: the file is empty; copy it again from the instrument")


@contextmanager
def _reading(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open a file with SurfaceTopography and turn whatever it raises into one sentence."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            import SurfaceTopography
            from SurfaceTopography.Exceptions import CannotDetectFileFormat
        except ImportError as error:
            raise CaseError(
                f"{path}: reading topography files needs SurfaceTopography; install it with "
                f'pip install "multiscale[surfaces]"'
            ) from error
        warnings.simplefilter("error", RuntimeWarning)  # arithmetic on a damaged header
        try:
            stream = path.open("rb")  # ours, as not every reader closes a file it fails to read
        except OSError as error:
            raise CaseError(
                f"{path}: cannot be opened ({error.strerror}); check the permissions"
            ) from error
        try:
            with stream, SurfaceTopography.open_topography(stream) as reader:
                yield SurfaceTopography, reader
        except CaseError:
            raise
        except CannotDetectFileFormat as error:
            raise CaseError(
                f"{path}: no known topography format; the file is damaged, cut off, or of another "
                f"kind, so copy it again or export it from the instrument in another format"
            ) from error
        except Exception as error:  # damaged files raise any kind
            lines = str(error).strip().splitlines() or [type(error).__name__]
            raise CaseError(
                f"{path}: cannot be read as a topography, probably because it is damaged or cut "
                f"off ({lines[0][:200].rstrip('.')}); copy it again or export it in another format"
            ) from error


def _pick_channel(path: Path, reader: Any, channel: int | str | None) -> Any:
    """Find the channel asked for among those that hold heights."""
    from SurfaceTopography.IO.Reader import DataKind

    known = {entry.index: entry for entry in reader.channels if entry.data_kind == DataKind.HEIGHT}
    if channel is None and known:
        default = reader.default_channel.index
        return known.get(default, next(iter(known.values())))
    for entry in known.values():
        if channel in (entry.index, entry.name):
            return entry
    listed = ", ".join(f"{index} ({entry.name!r})" for index, entry in known.items())
    raise CaseError(
        f"{path}: no channel {channel!r} with heights; height channels: {listed or 'none'}"
    )


def _check_channel(path: Path, entry: Any) -> None:
    """Refuse line scans and maps without scale."""
    if entry.dim == 1 or entry.is_uniform is False:
        raise CaseError(
            f"{path}: holds a line scan or scattered points; give a map on a regular grid"
        )
    found = {"unit of length": entry.unit, "lateral size": entry.physical_sizes}
    missing = [name for name, value in found.items() if value is None]
    if missing:
        raise CaseError(
            f"{path}: the file gives no {' and no '.join(missing)}; export it in a format that "
            f"does (in a text file the header lines '# Width: 10 um', '# Height: 10 um', "
            f"'# Value units: um'), or build Surface(heights, size) in Python"
        )


def _check_undefined(path: Path, undefined: np.ndarray, fill: bool) -> None:
    """Refuse undefined points unless they may be filled, and can be."""
    number = np.count_nonzero(undefined)
    if number == undefined.size:
        raise CaseError(f"{path}: no point has a defined height; choose another channel or file")
    if number and not fill:
        raise CaseError(
            f"{path}: {number} of {undefined.size} points ({number / undefined.size:.2%}) are "
            f"undefined; set fill_undefined to true or crop the map in the instrument's "
            f"software"
        )
