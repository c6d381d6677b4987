"""Rough surfaces from the files of instruments."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.errors import CaseError

if TYPE_CHECKING:
    from multiscale.surfaces import Surface

__all__ = ["read_surface"]

_TRENDS = ("mean", "plane", "curvature")


def read_surface(
    path: str | PathLike[str],
    *,
    detrend_order: int = 1,
    fill_undefined: bool = False,
    channel: int | str | None = None,
) -> "Surface":
    """Read a measured topography from an instrument file.

    Parameters
    ----------
    path : path
        File of any format that SurfaceTopography reads; its content determines the format.
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

    Returns
    -------
    Surface
        Heights and size in m. The mean height is 0 unless points were filled; ``filled`` marks
        them, and ``filled_share`` is their share. A measured map is not periodic: see
        :func:`multiscale.surfaces.mirror` and :func:`~multiscale.surfaces.window`.

    Raises
    ------
    CaseError
        If the file is missing, cannot be read as a height map, has no unit or no lateral size, has
        undefined points, is flat, or SurfaceTopography is not installed.

    Notes
    -----
    An incomplete file is not detected in formats without length or checksum, such as plain text
    cut between two rows.
    """
    from multiscale.surfaces.surface import Surface, remove_trend

    path = Path(path)
    _check_file(path)
    with _reading(path) as (library, reader):
        entry = _pick_channel(path, reader, channel)
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
        topography = entry.topography().to_unit("m")
        size = tuple(float(length) for length in topography.physical_sizes)
        heights: np.ndarray = np.ma.filled(np.ma.array(topography.heights(), dtype=float), np.nan)
        undefined = ~np.isfinite(heights)
        heights[undefined] = np.nan
        n_undefined = np.count_nonzero(undefined)
        if n_undefined == undefined.size:
            raise CaseError(
                f"{path}: no point has a defined height; choose another channel or file"
            )
        if n_undefined and not fill_undefined:
            raise CaseError(
                f"{path}: {n_undefined} of {undefined.size} points "
                f"({n_undefined / undefined.size:.2%}) are undefined; set fill_undefined to true "
                f"or crop the map in the instrument's software"
            )
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
    """Refuse a path that is not a file with content."""
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
    """Open a file with SurfaceTopography and report its errors in one sentence."""
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
            stream = path.open("rb")  # not every reader closes a file that it fails to read
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
        except Exception as error:  # damaged files raise exceptions of any kind
            lines = str(error).strip().splitlines() or [type(error).__name__]
            raise CaseError(
                f"{path}: cannot be read as a topography, probably because it is damaged or cut "
                f"off ({lines[0][:200].rstrip('.')}); copy it again or export it in another format"
            ) from error


def _pick_channel(path: Path, reader: Any, channel: int | str | None) -> Any:
    """Find a channel by number or name among the channels of heights."""
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
