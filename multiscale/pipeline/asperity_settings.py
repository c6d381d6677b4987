"""What a case may say of the asperities of an interface."""

from typing import Annotated, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from multiscale.laws import Asperities, AsperityLaw, class_densities, gaussian_asperities
from multiscale.pipeline.toml_model import (
    Factor,
    Number,
    Ratio,
    Settings,
    UncertainFactor,
    UncertainLength,
    UncertainPressure,
    must_rise,
    quantity,
    with_unit,
)

__all__ = ["StatedAsperities"]

PerArea = Annotated[float, quantity("1/m^2", uncertain=True), Field(gt=0.0), with_unit("1/m^2")]
Height = Annotated[float, quantity("m"), with_unit("m")]


class StatedAsperities(Settings):
    """Statistics of the asperities between two alike bodies, from published surfaces.

    Single values may have a half-width of 95 %, such as `"1.4 mm +- 10 %"`.
    """

    density: PerArea = Field(description="Asperities per area, 1/m².")
    radius: UncertainLength = Field(description="Composite radius of both surfaces, m.")
    rms_height: UncertainLength | None = None
    """Root mean square of Gaussian heights about their mean plane, m."""
    heights: tuple[Height, ...] = ()
    """Rising heights of asperities above the plane from which the gap counts, m, in place of
    `rms_height`; contact begins at the highest."""
    weights: tuple[Factor, ...] = ()
    """Probability density at every one of `heights`, in any unit."""
    height_factor: UncertainFactor = 1.0
    """Factor of all heights, which may have the half-width of the roughness."""
    youngs_modulus: UncertainPressure = Field(description="Young's modulus of both bodies, Pa.")
    poissons_ratio: Ratio = Field(description="Poisson's ratio of both bodies.")
    yield_stress: UncertainPressure | None = None
    """Yield stress, Pa; the asperities are elastic if not given."""
    tangent_modulus: Annotated[Number, quantity("Pa"), Field(ge=0.0), with_unit("Pa")] = 0.0
    """Slope of the stress over the strain after yield, Pa."""

    _rise = field_validator("heights")(must_rise)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.rms_height is None) == (not self.heights):
            raise ValueError("asperities take either rms_height or heights with their weights")
        if len(self.heights) != len(self.weights):
            raise ValueError(
                f"asperities take one weight for each height, got {len(self.heights)} heights and "
                f"{len(self.weights)} weights"
            )
        return self

    def build(self, friction: float, stiffness_ratio: float | None, damage: float) -> AsperityLaw:
        """Make the law of an interface whose asperities damage has thinned out."""
        density = (1.0 - damage) * self.density
        height, own = (
            class_densities(np.array(self.heights), np.array(self.weights), density)
            if self.rms_height is None
            else gaussian_asperities(self.rms_height, density)
        )
        one = Asperities(
            self.height_factor * height,
            own,
            self.radius,
            self.youngs_modulus,
            self.poissons_ratio,
            self.yield_stress or np.inf,
            self.tangent_modulus,
        )
        return AsperityLaw(one, friction, stiffness_ratio)
