"""Steps of a result as VTU files, and the collection that ParaView opens as a series."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import quoteattr

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
        Gets ``NAME.pvd``, ``NAME-0000.vtu`` and so on; ``NAME-PART-0000.vtu`` of a named part.
    name : str
        Of the series.
    times : ndarray, shape (steps,)
        Where the steps stand in it.
    steps : iterable of dict
        A meshio mesh for each part of a step, by the name of the part; ``""`` of the only or the
        main one.

    Returns
    -------
    Path
        The collection.

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
                f'    <DataSet timestep="{float(at)!r}" part="{number}" file={quoteattr(file)}/>\n'
            )
    collection = folder / f"{name}.pvd"  # last: it names only files that are there
    write_bytes(collection, _collection(entries).encode())
    return collection


def timesteps(result: "xr.Dataset") -> np.ndarray:
    """Where the steps of a result stand: at times or load factors if these rise, else numbered."""
    for name in ("time", "load_factor"):
        if name in result.coords and np.all(np.diff(result[name].values) > 0.0):
            return np.asarray(result[name].values)
    return np.arange(result.sizes["step"])


def _collection(entries: list[str]) -> str:
    """Text of a ``.pvd`` file."""
    return (
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>\n'
        + "".join(entries)
        + "  </Collection>\n</VTKFile>\n"
    )
