"""The table ``[fatigue]`` of a case: the two-scale model of the bodies of a structure."""

from typing import TYPE_CHECKING, Annotated

from pydantic import Field, model_validator

from multiscale.micro.damage.fatigue_material import FatigueMaterial
from multiscale.pipeline.toml_model import (
    Factor,
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

__all__ = ["FatigueSettings"]

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
    """Whether the damage of an inclusion changes its own stress."""
    scatter: Deviation = 0.0
    """Standard deviation of the logarithm of the fatigue limit among the inclusions of an element;
    with 0 an element has one inclusion."""
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
                f"strength must be the larger one"
            )
        return self

    def material(self, youngs_modulus: float, poissons_ratio: float) -> FatigueMaterial:
        """Make the two-scale material of a body of such moduli, Pa and dimensionless."""
        names = ("fatigue_limit", "damage_strength", "damage_exponent", "hardening", "threshold")
        names += ("critical_damage", "closure", "feedback")  # type: ignore[assignment]
        own = {name: getattr(self, name) for name in names}
        return FatigueMaterial(youngs_modulus, poissons_ratio, **own)
