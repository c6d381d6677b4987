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

ELEMENT_NAMES = {4: "tetra", 8: "hexahedron"}  # elements in meshio by their number of corners
ELEMENT_VARIABLES = ("equivalent_stress", "energy_density")  # variables of elements at every step
CONSTANT_VARIABLES = ("element_body", "element_damage")  # variables of elements without steps
POINT_VARIABLES = ("gap", "contact_state")  # variables of the points of joints at every step


def write_body_fields(result: "xr.Dataset", folder: Path, *, name: str = "bodies") -> Path:
    """Write the elements of every step, and the points of joints beside them as a second part.

    The filter *Warp By Vector* with the displacement of the nodes moves the bodies. Points have
    gap, m, pressure and magnitude of the shear traction, Pa, ``contact_state`` (0 open, 1 sticks,
    2 slips), damage and number of their joint. Elements have von Mises stress, Pa, density of the
    strain energy, J/m³, damage and number of their body.

    Parameters
    ----------
    result : Dataset
        Follows ``MACRO_RESULT``, with the fields that
        :func:`multiscale.macro.substructures.add_body_fields` adds.
    folder, name
        As of :func:`~.series.write_series`; the part of the joints is named ``joints``.

    Returns
    -------
    Path
        File of the collection; for its steps see :func:`write_link_fields`.

    Raises
    ------
    SchemaError
        If the dataset does not follow the schema or has no elements.
    MultiscaleError
        If a file cannot be written.
    """
    MACRO_RESULT.check(result)
    missing = [needed for needed in ("position", "displacement", "corners") if needed not in result]
    if missing:
        raise SchemaError(
            f"the result has no {', '.join(missing)}: it is no result of elastic bodies"
        )
    steps = (
        {"": _bodies(result, k)} | ({"joints": _joints(result, k)} if "traction" in result else {})
        for k in range(result.sizes["step"])
    )
    return write_series(folder, name, timesteps(result), steps)


def _bodies(result: "xr.Dataset", step: int) -> Any:
    """Elements with their values at a step."""
    import meshio

    corners = result["corners"].values
    values = {key: [result[key].values[step]] for key in ELEMENT_VARIABLES if key in result}
    constant = {key: [result[key].values] for key in CONSTANT_VARIABLES if key in result}
    return meshio.Mesh(
        result["position"].values,
        [(ELEMENT_NAMES[corners.shape[1]], corners)],
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
        **{key: result[key].values[step] for key in POINT_VARIABLES if key in result},
        **{key: result[f"point_{key}"].values for key in ("joint", "damage")},
    }
    points = result["point_position"].values
    return meshio.Mesh(points, [("vertex", np.arange(len(points))[:, None])], point_data=values)
