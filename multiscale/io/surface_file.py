"""Rough surfaces from the files of instruments."""

import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from io import BytesIO
from math import prod
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.io.files import check_file, first_line
from multiscale.io.mended_topographies import mend, place_on_grid
from multiscale.units import readable

if TYPE_CHECKING:
    from multiscale.surfaces import Surface

_TRENDS = ("mean", "plane", "curvature")

NPY = b"\x93NUMPY"
MOST_SPIKES = 0.01  # largest share of points that are spikes
MOST_POINTS = 2**28  # of a map, which takes about ten times the memory of its heights
LARGEST_FILE = 16 * MOST_POINTS  # bytes

BOM = b"\xef\xbb\xbf"

OLDER_SDF = {b"aBCR-1.0": b"aISO-1.0", b"bBCR-1.0": b"bISO-1.0"}
"""First bytes of SDF files before and in ISO 25178-71."""


@dataclass(frozen=True, eq=False)
class Topography:
    """A channel of a topography file, as it was measured."""

    path: Path
    format: str  # of the file, in words
    channels: tuple[str, ...]  # number, name, kind, points, size and unit of each, as text
    channel: str  # number and name of the channel that was read
    heights: np.ndarray  # (nx, ny), m, NaN where undefined; a line scan has ny = 1
    size: tuple[float, float]  # edge lengths, m; the width of a line scan is its length
    resolution: float | None = None  # shortest wavelength of the instrument by its file, m
    interpolated: bool = False  # whether points of a line scan were uneven
    spikes: int = 0  # points that were taken for spikes, and are undefined now

    @property
    def is_profile(self) -> bool:
        """Whether this is a line scan."""
        return bool(self.heights.shape[1] == 1)

    def without_spikes(self) -> "Topography":
        """Return the scan with spikes, by :func:`multiscale.surfaces.find_spikes`, undefined."""
        from multiscale.surfaces.preparation import find_spikes

        spikes = find_spikes(self.heights)
        number = int(np.count_nonzero(spikes))
        if number > MOST_SPIKES * spikes.size:
            raise CaseError(
                f"{self.path}: {number} of {spikes.size} points ({number / spikes.size:.2%}) are "
                f"far from their neighbours, too many for spikes; leave out spikes, or remove them "
                f"in the instrument's software"
            )
        return replace(self, heights=np.where(spikes, np.nan, self.heights), spikes=number)

    def say_spikes(self) -> list[str]:
        """Report how many spikes were removed, if any."""
        if not self.spikes:
            return []
        share = f"{100.0 * self.spikes / self.heights.size:.2g} %"
        return [
            f"{self.spikes} of {self.heights.size} points ({share}) were spikes, far from "
            f"their neighbours, and are filled"
        ]

    def to_surface(self, *, detrend_order: int = 1, fill_undefined: bool = False) -> "Surface":
        """Remove the trend and fill undefined points; see :func:`read_surface`."""
        from multiscale.surfaces.surface import Surface, remove_trend

        path, undefined = self.path, ~np.isfinite(self.heights)
        n_undefined = np.count_nonzero(undefined)
        if n_undefined == undefined.size:
            raise CaseError(
                f"{path}: no point has a defined height; choose another channel or file"
            )
        in_file = n_undefined - self.spikes
        if in_file and not fill_undefined:
            raise CaseError(
                f"{path}: {in_file} of {undefined.size} points "
                f"({in_file / undefined.size:.2%}) are undefined; set fill_undefined to true "
                f"or crop the map in the instrument's software"
            )
        scale = np.nanmax(np.abs(self.heights))
        heights = remove_trend(self.heights, detrend_order)
        if np.nanstd(heights) <= 1e-13 * scale:  # round-off of the fit
            raise CaseError(
                f"{path}: all heights are equal without the {_TRENDS[detrend_order]}; "
                f"choose a file or channel with a rough surface"
            )
        if n_undefined:
            heights = _fill(heights, undefined, self.size)
        try:
            return Surface(heights, self.size, undefined if n_undefined else None)
        except CaseError as error:
            raise CaseError(f"{path}: {error}") from error


def read_surface(
    path: str | PathLike[str],
    *,
    detrend_order: int = 1,
    fill_undefined: bool = False,
    channel: int | str | None = None,
    size: Sequence[float] | None = None,
    unit: float | None = None,
) -> "Surface":
    """Read a measured map from an instrument file.

    Parameters
    ----------
    path : path
        File of any format that SurfaceTopography reads, a NumPy array, or text with a matrix or
        with points ``x y z``; its content determines the format.
    detrend_order : {0, 1, 2}
        Degree of the polynomial that is removed: 0 the mean, 1 a plane (a tilted sample), 2 also
        the curvature (a ball or a cylinder). The fit uses the defined points only.
    fill_undefined : bool
        Fill undefined points, after detrending, by the solution of Laplace's equation with their
        defined neighbours as boundary values. Filled regions are too smooth, so they lower the
        root mean square slope; the result marks their points. Without it undefined points are
        refused.
    channel : int or str, optional
        Number, counted from 0, or name of the channel. The format's default height channel if not
        given.
    size : sequence of float, optional, edge lengths along x and y, m, by default from the file
    unit : float, optional
        Length of a unit of heights (and positions), m, for a file without units.

    Returns
    -------
    Surface
        Heights and size in m. The mean height is 0 unless points were filled; ``filled`` marks
        them, and ``filled_share`` is their share. A measured map is not periodic: see
        :func:`multiscale.surfaces.mirror` and :func:`~multiscale.surfaces.window`.

    Raises
    ------
    CaseError
        If the file is missing, cannot be read as a height map, holds a line scan, has no unit or
        no lateral size, has undefined points, is flat, or SurfaceTopography is not installed.

    Notes
    -----
    An incomplete file is not detected in formats without length or checksum, such as plain text
    cut between two rows. Text may have a byte order mark, semicolons or tabs, and decimal commas.
    """
    topography = open_topography(path, channel=channel, size=size, unit=unit)
    if topography.is_profile:
        raise CaseError(
            f"{path}: contains a line scan of {topography.heights.size} points; give a map, or set "
            f"profile in the surface table of a case to make a map of the scan"
        )
    return topography.to_surface(detrend_order=detrend_order, fill_undefined=fill_undefined)


def open_topography(
    path: str | PathLike[str],
    *,
    channel: int | str | None = None,
    size: Sequence[float] | None = None,
    unit: float | None = None,
) -> Topography:
    """Read a channel of a topography file as it was measured, map or line scan."""
    path = Path(path)
    check_file(path, "topography file")
    if path.stat().st_size == 0:
        raise CaseError(f"{path}: the file is empty; copy it again from the instrument")
    with _reading(path) as reader:
        # topography in m, or in the unit of the caller for a file without units
        entry = _pick_channel(path, reader, channel)
        if prod(entry.nb_grid_pts) > MOST_POINTS:
            points = " x ".join(map(str, entry.nb_grid_pts))
            raise CaseError(
                f"{path}: {points} points are more than {MOST_POINTS:,} in all; export fewer "
                f"points, or a part of the map"
            )
        _check_metadata(path, entry, size, unit)
        given: dict[str, Any] = {} if entry.unit is not None else {"unit": "m"}
        if entry.physical_sizes is None:
            given["physical_sizes"] = tuple(1.0 for _ in entry.nb_grid_pts)
        topography = entry.topography(**given)
        if entry.unit is not None:
            topography = topography.to_unit("m")
        # heights and edges, m
        factor = 1.0 if unit is None else unit
        resolution = None
        with suppress(Exception):  # a tip radius that makes no sense
            resolution = topography.short_reliability_cutoff()
        uneven = topography.dim == 1 and not topography.is_uniform
        heights, edges = _even(topography) if uneven else _as_array(topography)
        if entry.physical_sizes is None or size is not None:
            assert size is not None  # or the file would have been refused
            edges, factor_of_size = tuple(size), 1.0
        else:
            factor_of_size = factor
        edges = (*edges, *edges)[:2] if heights.shape[1] == 1 else edges
        return Topography(
            path,
            reader.name(),
            tuple(map(_describe_channel, reader.channels)),
            f"{entry.index} ({entry.name!r})",
            factor * heights,
            (factor_of_size * float(edges[0]), factor_of_size * float(edges[1])),
            None if resolution is None else factor * float(resolution),
            uneven,
        )


def _check_metadata(
    path: Path, entry: Any, size: Sequence[float] | None, unit: float | None
) -> None:
    """Refuse a file without size or unit, or with a unit that is also given by the caller."""
    if entry.dim not in (1, 2) or (entry.dim == 2 and entry.is_uniform is False):
        raise CaseError(f"{path}: contains scattered points; give a map on a regular grid")
    if entry.unit is not None and unit is not None:
        raise CaseError(f"{path}: the file gives its unit, {entry.unit}; leave out unit")
    missing = {
        "lateral size": entry.physical_sizes is None and size is None,
        "unit of length": entry.unit is None and unit is None,
    }
    absent = [name for name, is_missing in missing.items() if is_missing]
    if absent:
        keys = [name.split()[-1 if name.endswith("size") else 0] for name in absent]
        raise CaseError(
            f"{path}: the file, a {'map' if entry.dim == 2 else 'line scan'}, gives no "
            f"{' and no '.join(absent)}; give {' and '.join(keys)}, or "
            f"export it in a format that has them (in a text file the header lines "
            f"'# Width: 10 um', '# Height: 10 um', '# Value units: um')"
        )
    if not all(length > 0.0 for length in (*(size or ()), 1.0 if unit is None else unit)):
        raise CaseError(f"{path}: size and unit must be positive lengths")
    if size is not None and len(size) < entry.dim:
        raise CaseError(f"{path}: size of a map is two lengths, got {len(size)}; give both")


def _as_array(topography: Any) -> tuple[np.ndarray, tuple[float, ...]]:
    """Heights, NaN where undefined, shape (nx, ny), and size, in the unit of a topography."""
    heights: np.ndarray = np.ma.filled(np.ma.array(topography.heights(), dtype=float), np.nan)
    heights[~np.isfinite(heights)] = np.nan
    return np.atleast_2d(heights.T).T, tuple(topography.physical_sizes)


def _even(topography: Any) -> tuple[np.ndarray, tuple[float, ...]]:
    """Interpolate an uneven line scan at as many even points: heights, shape (n, 1), and size."""
    x, heights = topography.positions_and_heights()
    even = np.linspace(x[0], x[-1], x.size)
    length = (x[-1] - x[0]) * x.size / (x.size - 1)
    return np.interp(even, x, heights)[:, None], (length,)


def _fill(heights: np.ndarray, undefined: np.ndarray, size: tuple[float, float]) -> np.ndarray:
    """Fill undefined points by the solution of Laplace's equation; of line scans linearly."""
    if heights.shape[1] == 1:
        known, places = ~undefined[:, 0], np.arange(heights.size)
        between: np.ndarray = np.interp(places, places[known], heights[known, 0])
        return between[:, None]
    from SurfaceTopography import Topography as Map

    masked = np.ma.array(heights, mask=undefined)
    filled: np.ndarray = np.ma.getdata(Map(masked, size).interpolate_undefined_data().heights())
    return filled


@contextmanager
def _reading(path: Path) -> Iterator[Any]:
    """Open a file with SurfaceTopography and report its errors as a ``CaseError``."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            import SurfaceTopography
            from SurfaceTopography.Exceptions import CannotDetectFileFormat
        except ImportError as error:
            raise CaseError(
                f"{path}: reading topography files needs SurfaceTopography; install it with "
                f'pip install "multiscale-contact[surfaces]"'
            ) from error
        warnings.simplefilter("error", RuntimeWarning)  # arithmetic on a damaged header
        try:
            stream: Any = path.open("rb")  # not every reader closes a file that it fails to read
        except OSError as error:
            raise CaseError(
                f"{path}: cannot be opened ({error.strerror}); check the permissions"
            ) from error
        try:
            with stream:
                if (length := path.stat().st_size) > LARGEST_FILE:  # readers may load it whole
                    raise CaseError(
                        f"{path}: {1e-9 * length:.3g} GB are more than {1e-9 * LARGEST_FILE:.3g} "
                        f"GB; export fewer points, or a part of the map"
                    )
                begin = stream.read(len(NPY))
                if begin == NPY:
                    _check_array(path)
                stream.seek(0)
                source: Any = str(path) if begin == NPY else _as_text(_with_newer_head(stream))
                try:
                    opened = SurfaceTopography.open_topography(source)
                except CannotDetectFileFormat:
                    if begin == NPY:
                        raise
                    opened = _open_otherwise(path, source)
                if (on_grid := _points_on_grid(path, opened)) is not None:
                    opened.close()
                    opened = SurfaceTopography.open_topography(on_grid)
                with opened as reader:
                    yield reader
        except CaseError:
            raise
        except CannotDetectFileFormat as error:
            raise CaseError(
                f"{path}: no known topography format; the file is damaged, cut off, or of another "
                f"kind, so copy it again or export it from the instrument in another format"
            ) from error
        except Exception as error:  # damaged files raise exceptions of any kind
            raise CaseError(
                f"{path}: cannot be read as a topography, probably because it is damaged or cut "
                f"off ({first_line(error)}); copy it again or export it in another format"
            ) from error


def _with_newer_head(stream: Any) -> Any:
    """Replace the older first line of an SDF file by the line that SurfaceTopography reads."""
    head = OLDER_SDF.get(stream.read(8))
    if head is None:
        stream.seek(0)
        return stream
    return BytesIO(head + stream.read())


def _open_otherwise(path: Path, source: Any) -> Any:
    """Open a file of an unknown format: mended, with other separators, or by its extension."""
    from SurfaceTopography import open_topography
    from SurfaceTopography.Exceptions import CannotDetectFileFormat
    from SurfaceTopography.IO import readers

    source.seek(0)
    content = source.read()
    attempts: list[Callable[[], BytesIO | None]] = [lambda: mend(content)]
    if b"\0" not in content[:4096]:
        attempts.append(lambda: _with_blanks(BytesIO(content)))
    for attempt in attempts:
        with suppress(Exception):  # of damaged files; the reader below gives a better reason
            if (mended := attempt()) is not None:
                return open_topography(mended)
    for reader in readers:
        if path.suffix[1:].lower() in reader.file_extensions():
            try:
                return open_topography(BytesIO(content), format=reader.format())
            except UnicodeDecodeError:  # the file is not text
                continue
            except Exception as error:  # damaged files raise exceptions of any kind
                raise CaseError(
                    f"{path}: no known topography format, and the reader of {reader.name()} "
                    f"refuses it ({first_line(error)}); copy it again or export it from the "
                    f"instrument in another format"
                ) from error
    raise CannotDetectFileFormat


def _points_on_grid(path: Path, reader: Any) -> BytesIO | None:
    """Write points x, y, z with missing places, which look like a matrix, on their grid."""
    first = reader.channels[0]
    if reader.format() != "asc" or first.physical_sizes or first.nb_grid_pts[0] != 3:
        return None
    points = reader.topography(physical_sizes=(1.0, 1.0)).heights()
    on_grid = place_on_grid(np.ma.filled(points, np.nan).T)
    if on_grid is None:
        raise CaseError(
            f"{path}: has three columns, which are scattered points or not a map; give a map "
            f"on a regular grid"
        )
    return on_grid


def _check_array(path: Path) -> None:
    """Refuse NumPy arrays that are neither a map nor a line scan of real numbers."""
    array = np.load(path, mmap_mode="r", allow_pickle=False)
    if array.ndim not in (1, 2) or array.dtype.kind not in "fiu":
        raise CaseError(
            f"{path}: contains an array of shape {array.shape} and type {array.dtype}; a map is a "
            f"matrix of real numbers (nx, ny)"
        )


_NUMBERS = re.compile(rb"^[-+\d.,;\s]*\d(?:[-+\d.,;\seE]|nan|inf)*$", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(rb"\d,\d")
_SEPARATOR = re.compile(rb"[;\t ]")
SEEN_LINES = 200


def _as_text(stream: Any) -> Any:
    """Leave out a byte order mark, and write decimal commas as points where blanks separate."""
    start = len(BOM) if stream.read(len(BOM)) == BOM else 0
    stream.seek(start)
    lines = [line for line in stream.readlines(1 << 16)[:SEEN_LINES] if _NUMBERS.match(line)]
    commas = bool(lines) and all(
        _SEPARATOR.search(line.strip()) and b"." not in line and b", " not in line for line in lines
    )
    commas = commas and any(_DECIMAL_COMMA.search(line) for line in lines)
    stream.seek(start)
    if commas:
        return _with_blanks(stream, comma=b".")
    return BytesIO(stream.read()) if start else stream


def _with_blanks(stream: Any, comma: bytes = b" ") -> BytesIO:
    """Separate numbers by blanks in all lines of nothing but numbers."""
    table = bytes.maketrans(b",;\t", comma + b"  ")
    return BytesIO(
        b"".join(line.translate(table) if _NUMBERS.match(line) else line for line in stream)
    )


def _height_channels(reader: Any) -> dict[int, Any]:
    from SurfaceTopography.IO.Reader import DataKind

    return {
        entry.index: entry
        for entry in reader.channels
        if entry.data_kind == DataKind.HEIGHT and not isinstance(entry.unit, tuple)
    }


def _describe_channel(entry: Any) -> str:
    points = " x ".join(map(str, entry.nb_grid_pts))
    unit = entry.unit[0] if isinstance(entry.unit, tuple) else entry.unit
    kind = entry.data_kind.value if not isinstance(entry.unit, tuple) else "other"
    unit = unit or "(no unit)"
    edges = [f"{float(edge):.6g} {unit}" for edge in entry.physical_sizes or ()]
    size = " x ".join(map(readable, edges)) or f"no size {unit}"
    return f"{entry.index} ({entry.name!r}): {kind}, {points} points, {size}"


def _pick_channel(path: Path, reader: Any, channel: int | str | None) -> Any:
    """Return a channel of heights by number or name, the default channel if neither is given."""
    known = _height_channels(reader)
    if channel is None and known:
        default = reader.default_channel.index
        return known.get(default, next(iter(known.values())))
    for entry in known.values():
        if str(channel) in (str(entry.index), entry.name):
            return entry
    listed = ", ".join(f"{index} ({entry.name!r})" for index, entry in known.items())
    raise CaseError(
        f"{path}: no channel {channel!r} with heights; height channels: {listed or 'none'}"
    )
