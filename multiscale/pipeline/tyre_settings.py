"""What a case of rubber that slides on a road may say."""

from itertools import pairwise
from typing import Annotated, ClassVar, Self

from pydantic import Field, field_validator, model_validator

from multiscale.laws import wlf_shift
from multiscale.micro.flat.viscoelastic import RelaxingSolid
from multiscale.pipeline.case_tables import POINTS_PER_WAVE, GridSettings
from multiscale.pipeline.rough_bodies import SyntheticSurface
from multiscale.pipeline.structure_kind import Pressed, tell_far
from multiscale.pipeline.toml_model import (
    Count,
    Duration,
    Length,
    Natural,
    Number,
    Positive,
    Pressure,
    Ratio,
    Settings,
    must_rise,
    quantity,
    with_unit,
)
from multiscale.upscaling.bootstrap import FEWEST_REALISATIONS

__all__ = ["RoadCell", "Rubber", "Slides", "Tread", "TyreCase"]

FASTEST = 100.0
"""Speed, m/s, beyond which rubber heats more than a steady, even temperature describes."""

Temperature = Annotated[float, quantity("K"), Field(gt=0.0), with_unit("K")]
Speed = Annotated[float, quantity("m/s"), Field(gt=0.0, le=FASTEST), with_unit("m/s")]


class Rubber(Settings):
    """A linear viscoelastic solid; see :class:`multiscale.micro.RelaxingSolid`."""

    relaxed_modulus: Pressure = Field(description="Young's modulus after a long time, Pa.")
    poissons_ratio: Ratio = Field(0.49, description="Poisson's ratio at all times.")
    moduli: tuple[Pressure, ...] = Field((), description="Young's moduli of the Prony series, Pa.")
    times: tuple[Duration, ...] = Field(
        (), description="Relaxation times, s; one for each modulus."
    )
    reference_temperature: Temperature = Field(
        description='Temperature of the times, K, as `"20 degC"`.'
    )
    wlf_c1: Number = Field(gt=0.0, description="First constant of Williams, Landel and Ferry.")
    wlf_c2: Temperature = Field(description="Second constant, K; see `multiscale.laws.wlf_shift`.")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.moduli:
            raise ValueError(
                "moduli names nothing that relaxes: rubber that slides without viscosity has no "
                "friction by hysteresis; give moduli and times"
            )
        if len(self.moduli) != len(self.times):
            raise ValueError(
                f"give one of times for each of moduli, got {len(self.times)} times and "
                f"{len(self.moduli)} moduli"
            )
        return self

    @property
    def solid(self) -> RelaxingSolid:
        """The solid at the reference temperature."""
        return RelaxingSolid(self.relaxed_modulus, self.poissons_ratio, self.moduli, self.times)

    def shift(self, temperature: float) -> float:
        """Factor of all relaxation times at a temperature, K."""
        return wlf_shift(temperature, self.reference_temperature, self.wlf_c1, self.wlf_c2)


class RoadCell(GridSettings):
    """The representative piece of road."""


class Slides(Settings):
    """The ensemble of cells: each slides at every pressure, speed and temperature."""

    realisations: Positive = Field(description="Number of cells.")
    pressures: tuple[Pressure, ...] = Field(min_length=3, description="Mean pressures, Pa, rising.")
    speeds: tuple[Speed, ...] = Field(min_length=4, description="Sliding speeds, m/s, rising.")
    temperatures: tuple[Temperature, ...] = Field(
        min_length=3, description='Temperatures, K, rising; such as `"20 degC"`.'
    )
    seed: Natural = Field(0, description="Seed of the first realisation; the next ones count on.")

    _rise = field_validator("pressures", "speeds", "temperatures")(must_rise)


class Tread(Settings):
    """The tread block; see :class:`multiscale.macro.joint.TreadBlock`."""

    length: Length = Field(description="Length along the motion, m.")
    width: Length = Field(description="Width across the motion, m.")
    height: Length = Field(description="Height from the road to the carcass, m.")
    pressure: Pressure = Field(description="Nominal pressure on the road, Pa.")
    elements: tuple[Annotated[Count, Field(ge=1, le=40)], ...] = Field(
        (8, 5, 2),
        min_length=3,
        max_length=3,
        description="Elements along the motion, across and upwards.",
    )


class LawSettings(Settings):
    """The fit of the friction law."""

    samples: Count = Field(200, ge=0, description="Bootstrap samples behind the bands.")
    extrapolate: bool = Field(
        False,
        description="Whether forces stand where more than 5 % of the load lies beyond a factor of "
        "2 outside the pressures of the cells; they are unknown otherwise.",
    )


class TyreCase(Settings):
    """One question: how hard a tread block brakes on a road, over speed and temperature."""

    title: str = Field(description="Title of report and tables.")
    rubber: Rubber
    road: SyntheticSurface
    cell: RoadCell
    sliding: Slides
    law: LawSettings = LawSettings()
    tread: Tread

    accuracy: ClassVar[None] = None
    """No planner: it chooses cells of joints alone."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        coldest = self.rubber.reference_temperature - self.rubber.wlf_c2
        if self.sliding.temperatures[0] <= coldest:
            raise ValueError(
                f"temperatures in [sliding] begin at {self.sliding.temperatures[0]:g} K, where the "
                f"shift of [rubber] has no meaning; stay above {coldest:g} K"
            )
        p, even = self.sliding.pressures, (self.tread.pressure, self.tread.pressure)
        remedy = "give such pressures in [sliding], or set extrapolate = true in [law]"
        said = tell_far(
            Pressed("pressure in [tread] presses the road", [even]),
            (p[0], p[-1]),
            "pressures in [sliding]",
            remedy,
        )
        if said and not self.law.extrapolate:
            raise ValueError(said)
        return self

    def quick(self) -> Self:
        """Return the same case on a coarser grid with fewer realisations."""
        fewer = {"realisations": min(4, self.sliding.realisations)}
        return self.model_copy(
            update={
                "title": f"{self.title} (quick)",
                "cell": self.cell.quick(),
                "sliding": self.sliding.model_copy(update=fewer),
                "law": self.law.model_copy(update={"samples": min(80, self.law.samples)}),
                "tread": self.tread.model_copy(update={"elements": (6, 4, 2)}),
            }
        )

    def cautions(self) -> list[str]:
        """Return what a user should know before trusting the results, one sentence each."""
        found, spacing = [], self.cell.spacing
        if self.road.short_cutoff < 0.99 * POINTS_PER_WAVE * spacing:
            found.append(
                f"the shortest wave of the road has {self.road.short_cutoff / spacing:.1f} points; "
                f"its contact needs {POINTS_PER_WAVE} or more"
            )
        if self.sliding.realisations < FEWEST_REALISATIONS:
            found.append(
                f"{self.sliding.realisations} realisation(s) say too little about the scatter: "
                f"there are no bands below {FEWEST_REALISATIONS}"
            )
        wide = [one for one, late in pairwise(self.sliding.speeds) if late > 31.0 * one]
        if wide:
            found.append(f"the speeds leave more than 1.5 decades open above {wide[0]:g} m/s")
        return found

    @property
    def scope(self) -> str:
        """What belongs to one run folder, in a few words."""
        return self.cell.scope

    def identity(self) -> str:
        """Checksum of everything that a realisation depends on."""
        return self.checksum(
            exclude={**dict.fromkeys(("title", "law", "tread"), True), "sliding": {"realisations"}}
        )
