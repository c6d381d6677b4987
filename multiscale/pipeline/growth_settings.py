"""The table ``[growth]`` of a case: cracks of the representative volume that grow under tension."""

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, model_validator

from multiscale.errors import CaseError
from multiscale.micro.damage import Cavities, Microcracks
from multiscale.pipeline.rve_settings import RveSettings
from multiscale.pipeline.toml_model import Factor, Length, Settings, quantity, with_unit

if TYPE_CHECKING:
    from typing import Self

__all__ = ["GrowthSettings"]

UNIT = "Pa*m^0.5"
Toughness = Annotated[float, quantity(UNIT), Field(gt=0.0), with_unit(UNIT)]


class GrowthSettings(Settings):
    """Penny-shaped cracks of [rve] that grow where K_I reaches K_Ic, under tension along an axis.

    A structure of one body cracks by their softening law.
    """

    toughness: Toughness
    """Toughness K_Ic where a crack begins to grow, such as `"0.5 MPa*m^0.5"`."""
    rise: Factor = 0.0
    """Share by which the toughness rises as grains bridge the faces of a crack."""
    bridging: Length | None = None
    """Growth of a crack over which it rises, m; together with `rise`."""
    pull: Literal["x", "y", "z"] = Field("z", description="Axis of the tension.")
    through: bool = False
    """Whether a crack that reaches another crack grows on as if it were alone; otherwise its volume
    has no softening law."""

    @model_validator(mode="after")
    def _check(self) -> "Self":
        if bool(self.rise) != (self.bridging is not None):
            raise ValueError("rise and bridging belong together; give both or none")
        return self

    def volumes(self, rve: RveSettings) -> list[tuple[float, Microcracks]]:
        """Make the cracks of all periodic volumes, with their edges over the whole one."""
        solid = {name: getattr(rve, name) for name in ("youngs_modulus", "poissons_ratio")}
        solid |= {"toughness": self.toughness, "rise": self.rise}
        solid |= {"bridging": self.bridging} if self.bridging else {}
        found = []
        for share, volume in rve.jobs():
            if not isinstance(volume, Cavities):
                raise CaseError("[growth] takes the cracks of [rve], and an image has none")
            if volume.periodic:  # parts of a listed volume have cut cracks
                try:
                    found.append((share, Microcracks.of(volume, **solid)))
                except CaseError as error:
                    raise CaseError(f"[growth] {error}") from error
        return found
