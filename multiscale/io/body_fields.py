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
    import meshio

    MACRO_RESULT.check(result)
    missing = [needed for needed in ("position", "displacement", "corners") if needed not in result]
    if missing:
        raise SchemaError(
            f"the result has no {', '.join(missing)}: it is no result of elastic bodies"
        )
    corners = result["corners"].values
    elements = [(ELEMENT_NAMES[corners.shape[1]], corners)]

    def parts(step: int) -> dict[str, Any]:
        values = {key: [result[key].values[step]] for key in ELEMENT_VARIABLES if key in result}
        values |= {key: [result[key].values] for key in CONSTANT_VARIABLES if key in result}
        moved = {"displacement": result["displacement"].values[step]}
        bodies = meshio.Mesh(result["position"].values, elements, moved, values)
        if "traction" not in result:
            return {"": bodies}
        traction, points = result["traction"].values[step], result["point_position"].values
        joints = {
            "pressure": -traction[:, 0],
            "shear": np.hypot(traction[:, 1], traction[:, 2]),
            **{key: result[key].values[step] for key in POINT_VARIABLES if key in result},
            **{key: result[f"point_{key}"].values for key in ("joint", "damage")},
        }
        vertices = [("vertex", np.arange(len(points))[:, None])]
        return {"": bodies, "joints": meshio.Mesh(points, vertices, joints)}

    return write_series(folder, name, timesteps(result), map(parts, range(result.sizes["step"])))
