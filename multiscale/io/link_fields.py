"""A structure of links and nodes, step by step, as VTU files for ParaView."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from multiscale.errors import SchemaError
from multiscale.io.series import timesteps, write_series
from multiscale.schema import MACRO_RESULT

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["write_link_fields"]

LINK_VARIABLES = ("tension", "slack", "impulse")  # variables of links at every step
NODE_VARIABLES = ("displacement", "velocity", "rotation")  # variables of nodes at every step


def write_link_fields(result: "xr.Dataset", folder: Path, *, name: str = "links") -> Path:
    """Write one VTU file per step, and the collection that ParaView opens as a series.

    The links are lines between the nodes of the unloaded structure, with tension and slack;
    the filter *Warp By Vector* with the displacement of the nodes moves them.

    Parameters
    ----------
    result : Dataset
        Follows ``MACRO_RESULT``, with the position of the nodes and the ends of the links.
    folder, name
        As of :func:`~.series.write_series`.

    Returns
    -------
    Path
        File of the collection. Its steps are at their times, s, or at rising load factors, else at
        their numbers.

    Raises
    ------
    SchemaError
        If the dataset does not follow the schema or has no nodes and links.
    MultiscaleError
        If a file cannot be written.
    """
    import meshio

    MACRO_RESULT.check(result)
    missing = [needed for needed in ("position", "ends", "tension") if needed not in result]
    if missing:
        raise SchemaError(
            f"the result has no {', '.join(missing)}: it is no result of nodes and links"
        )
    position, lines = result["position"].values, [("line", result["ends"].values)]

    def links(step: int) -> Any:
        nodes = {key: result[key].values[step] for key in NODE_VARIABLES if key in result}
        values = {key: [result[key].values[step]] for key in LINK_VARIABLES if key in result}
        return meshio.Mesh(position, lines, point_data=nodes, cell_data=values)

    steps = ({"": links(k)} for k in range(result.sizes["step"]))
    return write_series(folder, name, timesteps(result), steps)
