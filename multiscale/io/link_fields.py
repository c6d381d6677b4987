"""A structure of links and nodes, step by step, as VTU files for ParaView."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

import numpy as np

from multiscale.errors import SchemaError
from multiscale.io.files import write_bytes
from multiscale.schema import MACRO_RESULT

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["collection_text", "write_link_fields"]

ON_LINKS = ("tension", "slack", "impulse")
ON_NODES = ("displacement", "velocity", "rotation")


def write_link_fields(result: "xr.Dataset", folder: Path, *, name: str = "links") -> Path:
    """Write one VTU file per step, and the collection that ParaView opens as a series.

    The links are lines between the nodes of the unloaded structure, with tension and slack;
    the filter *Warp By Vector* with the displacement of the nodes moves them.

    Parameters
    ----------
    result : Dataset
        Follows ``MACRO_RESULT``, with the position of the nodes and the ends of the links.
    folder : Path
        Gets ``NAME.pvd``, ``NAME-0000.vtu`` and so on.
    name : str
        Of the series.

    Returns
    -------
    Path
        The collection. Its steps are at their times, or at their load factors where these rise,
        else at their numbers.

    Raises
    ------
    SchemaError
        If the dataset does not follow the schema or says nothing of the structure.
    MultiscaleError
        If a file cannot be written.
    """
    import meshio

    MACRO_RESULT.check(result)
    missing = [needed for needed in ("position", "ends", "tension") if needed not in result]
    if missing:
        raise SchemaError(f"the result has no {', '.join(missing)}: not one of nodes and links")
    points, lines = result["position"].values, [("line", result["ends"].values)]
    entries = []
    with TemporaryDirectory() as scratch:
        for k, at in enumerate(_timesteps(result)):
            nodes = {key: result[key].values[k] for key in ON_NODES if key in result}
            links = {key: [result[key].values[k]] for key in ON_LINKS if key in result}
            part = Path(scratch) / "part.vtu"
            meshio.Mesh(points, lines, point_data=nodes, cell_data=links).write(part)
            file = f"{name}-{k:04d}.vtu"
            write_bytes(folder / file, part.read_bytes())
            entries.append(f'    <DataSet timestep="{float(at)!r}" file={quoteattr(file)}/>\n')
    collection = folder / f"{name}.pvd"  # last: it names only files that are there
    write_bytes(collection, collection_text(entries).encode())
    return collection


def _timesteps(result: "xr.Dataset") -> np.ndarray:
    """Where the steps stand in the series."""
    for name in ("time", "load_factor"):
        if name in result.coords and np.all(np.diff(result[name].values) > 0.0):
            return np.asarray(result[name].values)
    return np.arange(result.sizes["step"])


def collection_text(entries: list[str]) -> str:
    """Text of a ``.pvd`` file."""
    return (
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>\n'
        + "".join(entries)
        + "  </Collection>\n</VTKFile>\n"
    )
