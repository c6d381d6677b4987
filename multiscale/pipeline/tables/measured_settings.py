"""Tables of measured joints, by which the law of the cells is calibrated."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from multiscale.pipeline.tables.toml_model import Settings, Tolerance, quantity, with_unit
from multiscale.upscaling import MeasuredJoint, read_measured

Compliance = Annotated[float, quantity("m/Pa"), Field(ge=0.0), with_unit("m/Pa")]
Zero = Annotated[float, quantity("Pa"), Field(ge=0.0), with_unit("Pa")]
Area = Annotated[float, quantity("m^2"), Field(gt=0.0), with_unit("m^2")]


class MeasuredTable(Settings):
    """Measured values of a joint under an even pressure, by which the law is calibrated.

    Give `[[measured]]` for each table; see [measured joints](interfaces.md#measured-joints).
    """

    file: Path
    """Table with units in its head: `preload, stiffness`; `pressure, closure`; or
    `preload, displacement, shear` along loops."""
    kind: Literal["stiffness", "tangential_stiffness", "closure", "loop"]
    """Measured values: normal stiffness, tangential stiffness without slip, closure since the first
    row, or shear along loops."""
    error: Tolerance | None = None
    """Half-width of the 95 % interval of the values, over them, or in loops over the largest shear;
    needless where the table has a column `error`."""
    bodies: Compliance = Field(0.0, description="Compliance of the bodies between the sensors.")
    frame: Compliance | None = None
    """Half-width of the 95 % interval of a compliance of the frame that the values contain; a fifth
    of the least measured compliance if not given."""
    offset: Zero | None = None
    """Half-width of the 95 % interval of the zero of the load; a tenth of the least preload if not
    given."""
    area: Area | None = None
    """Nominal area of the joint, whose few cells scatter; many cells if not given."""

    def read(self) -> MeasuredJoint:
        """Read the table."""
        given = self.model_dump(include={"error", "bodies", "frame", "offset"})
        return read_measured(self.file, self.kind, **given)
