"""Steps of a result as VTU files, and the collection that ParaView opens as a series."""

from collections.abc import Iterable
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.io.files import replacing, write_bytes

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["timesteps", "write_series"]


def write_series(
    folder: Path, name: str, times: np.ndarray, steps: Iterable[dict[str, Any]]
) -> Path:
    """Write one VTU file for each step and part.

    Parameters
    ----------
    folder : Path
        Folder for ``NAME.pvd``, ``NAME-0000.vtu`` and so on; ``NAME-PART-0000.vtu`` for a named
        part.
    name : str
    times : ndarray, shape (steps,)
        Times, load factors or numbers of the steps.
    steps : iterable of dict
        A meshio mesh for each part of a step, by the name of the part; the main part is ``""``.

    Returns
    -------
    Path
        File of the collection.

    Raises
    ------
    MultiscaleError
        If a file cannot be written.
    """
    entries = []
    for k, (at, meshes) in enumerate(zip(times, steps, strict=True)):
        for number, (part, mesh) in enumerate(meshes.items()):
            file = f"{name}-{part}-{k:04d}.vtu" if part else f"{name}-{k:04d}.vtu"
            with replacing(folder / file) as whole:
                mesh.write(whole, file_format="vtu")
            entries.append(
                f'    <DataSet timestep="{float(at)!r}" part="{number}" file="{escape(file)}"/>\n'
            )
    collection = folder / f"{name}.pvd"  # written last: it names only existing files
    text = (
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>\n'
        + "".join(entries)
        + "  </Collection>\n</VTKFile>\n"
    )
    write_bytes(collection, text.encode())
    return collection


def timesteps(result: "xr.Dataset") -> np.ndarray:
    """Return rising times, s, or load factors of the steps of a result, else their numbers."""
    for name in ("time", "load_factor"):
        if name in result.coords and np.all(np.diff(result[name].values) > 0.0):
            return np.asarray(result[name].values)
    return np.arange(result.sizes["step"])
