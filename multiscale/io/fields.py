"""Fields on the contact surface as VTU files for ParaView."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.io.files import replacing

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["write_surface_fields"]


def write_surface_fields(fields: "xr.Dataset", size: tuple[float, float], folder: Path) -> None:
    """Write one VTU file per step: the surface as quadrilaterals with pressure, Pa, and gap, m.

    Parameters
    ----------
    fields : Dataset
        Follows ``FIELDS``.
    size : tuple of float
        Edge lengths of the cell, m.
    folder : Path
        For ``contact-0000.vtu`` and so on.

    Raises
    ------
    MultiscaleError
        If a file cannot be written.
    """
    import meshio

    ny, nx = fields["height"].shape
    x, y = (np.arange(n) * length / n for n, length in zip((nx, ny), size, strict=True))
    points = np.column_stack(
        [*(axis.ravel() for axis in np.meshgrid(x, y)), fields["height"].values.ravel()]
    )
    first = (np.arange(ny - 1)[:, None] * nx + np.arange(nx - 1)).ravel()
    quads = np.column_stack([first, first + 1, first + nx + 1, first + nx])
    for k in range(fields.sizes["step"]):
        data = {name: fields[name].values[k].ravel() for name in ("pressure", "gap")}
        mesh = meshio.Mesh(points, [("quad", quads)], point_data=data)
        with replacing(folder / f"contact-{k:04d}.vtu") as whole:
            mesh.write(whole, file_format="vtu")
