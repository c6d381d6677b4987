"""Elastic bodies and their joints, step by step, as VTU files for ParaView."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.errors import SchemaError
from multiscale.io.series import timesteps, write_series
from multiscale.schema import MACRO_RESULT

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["write_body_fields"]

CELLS = {4: "tetra", 8: "hexahedron"}
"""Elements by their number of corners."""

ON_ELEMENTS = ("equivalent_stress", "energy_density")
CONSTANT = ("element_body", "element_damage")
AT_POINTS = ("gap", "contact_state")


def write_body_fields(result: "xr.Dataset", folder: Path, *, name: str = "bodies") -> Path:
    """Write the elements of every step, and the points of joints beside them as a second part.

    The filter *Warp By Vector* with the displacement of the nodes moves the bodies. Points carry
    gap, pressure, shear traction (its length), ``contact_state`` (0 open, 1 sticks, 2 slips),
    damage and number of their joint; elements von Mises stress, density of the strain energy,
    damage and number of their body.

    Parameters
    ----------
    result : Dataset
        Follows ``MACRO_RESULT``, with what :func:`multiscale.macro.substructures.add_body_fields`
        adds.
    folder : Path
        Gets ``NAME.pvd``, ``NAME-0000.vtu`` and, with joints, ``NAME-joints-0000.vtu`` and so on.
    name : str
        Of the series.

    Returns
    -------
    Path
        The collection; for its steps see :func:`write_link_fields`.

    Raises
    ------
    SchemaError
        If the dataset does not follow the schema or says nothing of the elements.
    MultiscaleError
        If a file cannot be written.
    """
    MACRO_RESULT.check(result)
    missing = [needed for needed in ("position", "displacement", "corners") if needed not in result]
    if missing:
        raise SchemaError(f"the result has no {', '.join(missing)}: not one of elastic bodies")
    steps = (
        {"": _bodies(result, k)} | ({"joints": _joints(result, k)} if "traction" in result else {})
        for k in range(result.sizes["step"])
    )
    return write_series(folder, name, timesteps(result), steps)


def _bodies(result: "xr.Dataset", step: int) -> Any:
    """Elements with their values at a step."""
    import meshio

    corners = result["corners"].values
    values = {key: [result[key].values[step]] for key in ON_ELEMENTS if key in result}
    constant = {key: [result[key].values] for key in CONSTANT if key in result}
    return meshio.Mesh(
        result["position"].values,
        [(CELLS[corners.shape[1]], corners)],
        point_data={"displacement": result["displacement"].values[step]},
        cell_data=values | constant,
    )


def _joints(result: "xr.Dataset", step: int) -> Any:
    """Points of the joints with their values at a step."""
    import meshio

    traction = result["traction"].values[step]
    values = {
        "pressure": -traction[:, 0],
        "shear": np.hypot(traction[:, 1], traction[:, 2]),
        **{key: result[key].values[step] for key in AT_POINTS if key in result},
        **{key: result[f"point_{key}"].values for key in ("joint", "damage")},
    }
    points = result["point_position"].values
    return meshio.Mesh(points, [("vertex", np.arange(len(points))[:, None])], point_data=values)
