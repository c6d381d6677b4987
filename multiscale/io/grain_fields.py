"""A granulate, frame by frame, as VTU files for ParaView."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.io.series import write_series
from multiscale.schema import GRANULATE

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["write_grain_fields"]


def write_grain_fields(result: "xr.Dataset", folder: Path, *, name: str = "grains") -> Path:
    """Write one VTU file per frame, and the collection that ParaView opens as a series.

    A grain is a point with its radius, m, velocity, m/s, and, if grains turn, spin, rad/s. The
    filter *Glyph* shows it as a sphere scaled by twice the radius. A contact is a line with its
    force, N.

    Parameters
    ----------
    result : Dataset
        Follows ``GRANULATE``.
    folder, name
        As of :func:`~.series.write_series`.

    Returns
    -------
    Path
        File of the collection, with the frames at their times, s.

    Raises
    ------
    SchemaError
        If the dataset does not follow the schema.
    MultiscaleError
        If a file cannot be written.
    """
    GRANULATE.check(result)
    time = np.append(0.0, result["time"].values)[result["frame_step"].values + 1]
    frames = ({"": _frame(result, k)} for k in range(result.sizes["frame"]))
    return write_series(folder, name, time, frames)


def _frame(result: "xr.Dataset", k: int) -> Any:
    """Points of the grains and lines of their contacts in a frame."""
    import meshio

    n, frame = result.sizes["grain"], result.isel(frame=k)
    here = result["contact_frame"].values == k
    first = frame["position"].values[result["contact_ends"].values[here, 0]]
    second = first - result["branch"].values[here]  # a contact across a period stays short
    force = np.linalg.norm(result["contact_force"].values[here], axis=1)
    m = len(force)
    grains = {
        "radius": result["radius"].values,
        **{name: frame[name].values for name in ("velocity", "spin") if name in frame},
    }
    return meshio.Mesh(
        np.concatenate([frame["position"].values, first, second]),
        [("vertex", np.arange(n)[:, None]), ("line", n + np.arange(2 * m).reshape(2, m).T)],
        point_data={
            key: np.concatenate([value, np.zeros((2 * m, *value.shape[1:]))])
            for key, value in grains.items()
        },
        cell_data={"force": [np.zeros(n), force]},
    )
