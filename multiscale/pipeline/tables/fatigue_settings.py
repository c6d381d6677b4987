"""Tables of a case on the life of bodies: fatigue by cycles, and cracks that grow."""

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, model_validator

from multiscale.errors import CaseError
from multiscale.micro.damage import Cavities, Microcracks
from multiscale.micro.damage.fatigue import FatigueMaterial
from multiscale.pipeline.tables.rve_settings import RveSettings
from multiscale.pipeline.tables.toml_model import (
    Factor,
    Length,
    Number,
    Pressure,
    Settings,
    Share,
    Tolerance,
    quantity,
    with_unit,
)

if TYPE_CHECKING:
    from typing import Self

Modulus = Annotated[float, quantity("Pa"), Field(ge=0.0), with_unit("Pa")]
Deviation = Annotated[Number, Field(ge=0.0, lt=0.5)]


class FatigueSettings(Settings):
    """Life of a body under the cycles of its structure, by the two-scale model in every element.

    Inclusions of each element flow above the fatigue limit, are damaged and crack.
    """

    body: str | None = None
    """Name of the body that is followed; needed if there are several."""
    fatigue_limit: Pressure
    """Yield stress of the inclusions, the amplitude below which nothing cracks, Pa."""
    strength: Pressure
    """Static strength, Pa; a von Mises stress of an element above it is refused."""
    damage_strength: Pressure = Field(description="Strength S of the damage law, Pa.")
    damage_exponent: Annotated[Number, Field(gt=0.0)] = 1.0
    """Exponent s of the damage law."""
    hardening: Modulus = Field(0.0, description="Kinematic hardening C of the inclusions, Pa.")
    threshold: Factor = 0.0
    """Accumulated plastic strain p_D at which damage begins."""
    critical_damage: Annotated[Share, Field(gt=0.0)] = 0.3
    """Damage D_c at which an inclusion cracks."""
    closure: Share = Field(1.0, description="Share h of the damage that acts in compression.")
    feedback: bool = True
    """Whether the damage of an inclusion changes its stress."""
    scatter: Deviation = 0.0
    """Standard deviation of the logarithm of the fatigue limit among the inclusions of an element;
    with 0 an element has a single inclusion."""
    part_deviation: Deviation | None = None
    """Relative standard deviation of the fatigue limit from part to part, for the interval of the
    next part."""
    limit_error: Deviation | None = None
    """Relative standard error of the mean fatigue limit, for both intervals."""
    tolerance: Tolerance = 0.05
    """Bound on the relative error of the change of damage over a jump of cycles between two solves
    of the structure."""
    max_cycles: Annotated[Number, Field(ge=1.0, le=1e12)] = 1e9
    """Number of cycles up to which the life is followed."""

    @model_validator(mode="after")
    def _check(self) -> "Self":
        if self.strength <= self.fatigue_limit:
            raise ValueError(
                f"strength is {1e-6 * self.strength:g} MPa and fatigue_limit "
                f"{1e-6 * self.fatigue_limit:g} MPa; fatigue is damage between both, so that the "
                f"strength must be larger"
            )
        return self

    def material(self, youngs_modulus: float, poissons_ratio: float) -> FatigueMaterial:
        """Return the two-scale material of a body with these moduli, Pa and dimensionless."""
        names = ("fatigue_limit", "damage_strength", "damage_exponent", "hardening", "threshold")
        names += ("critical_damage", "closure", "feedback")  # type: ignore[assignment]
        parameters = {name: getattr(self, name) for name in names}
        return FatigueMaterial(youngs_modulus, poissons_ratio, **parameters)


UNIT = "Pa*m^0.5"
Toughness = Annotated[float, quantity(UNIT), Field(gt=0.0), with_unit(UNIT)]


class GrowthSettings(Settings):
    """Penny-shaped cracks of [rve] that grow where K_I reaches K_Ic, under tension along an axis.

    The body of a structure cracks by their softening law.
    """

    toughness: Toughness
    """Toughness K_Ic where a crack begins to grow, such as `"0.5 MPa*m^0.5"`."""
    rise: Factor = 0.0
    """Share by which the toughness rises as grains bridge the faces of a crack."""
    bridging: Length | None = None
    """Growth of a crack over which it rises, m; together with `rise`."""
    pull: Literal["x", "y", "z"] = Field("z", description="Axis of the tension.")
    through: bool = False
    """Whether a crack that reaches another crack grows on as an isolated crack; otherwise its
    volume has no softening law."""

    @model_validator(mode="after")
    def _check(self) -> "Self":
        if bool(self.rise) != (self.bridging is not None):
            raise ValueError("rise and bridging belong together; give both or none")
        return self

    def volumes(self, rve: RveSettings) -> list[tuple[float, Microcracks]]:
        """Return the size over the whole volume, and the cracks, of all periodic volumes."""
        solid = {name: getattr(rve, name) for name in ("youngs_modulus", "poissons_ratio")}
        solid |= {"toughness": self.toughness, "rise": self.rise}
        solid |= {"bridging": self.bridging} if self.bridging else {}
        volumes = []
        for share, volume in rve.jobs():
            if not isinstance(volume, Cavities):
                raise CaseError("[growth] takes the cracks of [rve], and an image has no cracks")
            if volume.periodic:  # smaller volumes of a listed volume have cut cracks
                try:
                    volumes.append((share, Microcracks.of(volume, **solid)))
                except CaseError as error:
                    raise CaseError(f"[growth] {error}") from error
        return volumes
