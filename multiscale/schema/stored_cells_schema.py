"""The dataset of stored cells: what cells of known spectra say of others."""

from multiscale.schema.dataset_schema import Schema, Variable

__all__ = ["STORED_CELLS"]

_CELL = ("cell", "load")

STORED_CELLS = Schema(
    name="stored_cells",
    version=1,
    variables={
        "relative_pressure": Variable(
            ("load",), "1", "pressure over contact modulus and root mean square slope"
        ),
        "gap_over_height": Variable(_CELL, "1", "mean gap over root mean square height"),
        "contact_fraction": Variable(_CELL, "1", "real over nominal contact area"),
        "wall_time": Variable(_CELL, "s", "wall time of the load"),
        "waves": Variable(("cell",), "1", "longest wavelengths across the cell"),
        "points": Variable(("cell",), "1", "points of the grid across the shortest wavelength"),
        "hurst_exponent": Variable(("cell",), "1", "Hurst exponent"),
        "band": Variable(("cell",), "1", "longest over shortest wavelength"),
    },
)
