"""What a case may say, and what its tables may say together."""

from typing import ClassVar, Self

from pydantic import Field, model_validator

from multiscale.macro.data_range import FAR_FACTOR
from multiscale.micro.cell import depth_caution
from multiscale.micro.slide import LONGEST
from multiscale.pipeline.case_tables import (
    AccuracySettings,
    CellSettings,
    JointSettings,
    LawSettings,
    MicroSettings,
    SlideSettings,
)
from multiscale.pipeline.rough_bodies import RoughBody
from multiscale.pipeline.toml_model import Settings
from multiscale.units import readable
from multiscale.upscaling.bootstrap import FEWEST_REALISATIONS

__all__ = ["POINTS_PER_WAVE", "Case"]


HARDEST = 0.1
"""Largest hardness over Young's modulus; that of diamond is about as large."""

POINTS_PER_WAVE = 8  # of the shortest wave of a measured surface, if the case names no cut-off


class Case(Settings):
    """One question, such as how stiff the joint of two bodies is."""

    title: str = Field(description="Title of report and tables.")
    elastic: bool = Field(False, description="Confirms real contact pressures that no metal bears.")
    body_1: RoughBody
    body_2: RoughBody
    cell: CellSettings
    micro: MicroSettings
    law: LawSettings = LawSettings()
    joint: JointSettings
    slide: SlideSettings | None = Field(None, description="Slide of the bodies over each other.")
    accuracy: AccuracySettings | None = Field(
        None, description="Target of a planner, which then chooses the cells."
    )

    describes: ClassVar[str] = "a joint of two rough bodies"

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.body_1.surface is None and self.body_2.surface is None:
            raise ValueError("both bodies are smooth; give one of them a [surface] table")
        self._check_metal()
        self._check_preloads()
        if self.slide is not None:
            self._check_slide(self.slide)
        return self

    def _check_slide(self, slide: SlideSettings) -> None:
        """Refuse what cells cannot slide, or not in reasonable time."""
        if self.cell.geometry == "flat":
            raise ValueError(
                'flat cells do not slide; set geometry = "conforming" in [cell], or leave [slide] '
                "out"
            )
        periods = slide.distance / self.cell.size[0]
        if periods > LONGEST:
            raise ValueError(
                f"distance in [slide] is {periods:.3g} lengths of the cell, which repeats itself "
                f"after one and is run in after a few where it flows: slide at most {LONGEST:g}"
            )

    def _check_metal(self) -> None:
        """Refuse metals and unloading that the cells do not know."""
        flat = self.cell.geometry == "flat"
        for number, body in enumerate(self.bodies, start=1):
            if flat and body.hardening_modulus is not None:
                raise ValueError(
                    f"hardening_modulus of body_{number} means nothing to flat cells, which cap "
                    f'the pressure; set geometry = "conforming" in [cell], or leave it out'
                )
            ratio = (body.hardness or 0.0) / body.youngs_modulus
            if ratio > HARDEST:
                raise ValueError(
                    f"hardness of body_{number} is {1e-9 * (body.hardness or 0.0):g} GPa, "
                    f"{ratio:.2g} of its youngs_modulus, and nothing is harder than {HARDEST:g}; "
                    f"that of a metal is about a hundredth, and a body that does not flow has none"
                )
        if self.elastic and self.hardness is not None:
            raise ValueError("elastic = true and a hardness exclude each other; leave one out")
        if self.micro.unload is not False and (flat or self.hardness is None):
            raise ValueError(
                "unload in [micro] needs conforming cells and the hardness of a body: without "
                "flow an interface unloads as it was loaded"
            )
        if self.micro.unload is not False and self.accuracy is not None:
            raise ValueError(
                "unload in [micro] and a target in [accuracy] exclude each other: a planner loads "
                "its cells alone"
            )

    def _check_preloads(self) -> None:
        """Refuse a joint that the cells will tell nothing of."""
        low, high = self.micro.pressures[0] / FAR_FACTOR, self.micro.pressures[-1] * FAR_FACTOR
        far = [p for p in self.joint.preloads if not low <= p <= high]
        target = self.accuracy is not None and self.accuracy.quantity == "joint_stiffness"
        if far and (target or (len(far) == len(self.joint.preloads) and not self.law.extrapolate)):
            raise ValueError(
                f"preloads in [joint] of {', '.join(f'{1e-6 * p:g}' for p in far)} MPa lie more "
                f"than a factor of {FAR_FACTOR:g} outside the pressures in [micro], "
                f"{1e-6 * self.micro.pressures[0]:g} to {1e-6 * self.micro.pressures[-1]:g} MPa: "
                f"the joint would be unknown there; press the cells at such pressures"
                + ("" if target else ", or set extrapolate = true in [law]")
            )

    @property
    def realisations(self) -> int:
        """Number of cells."""
        return self.micro.realisations

    @property
    def bodies(self) -> tuple[RoughBody, RoughBody]:
        """Both bodies."""
        return self.body_1, self.body_2

    @property
    def hardness(self) -> float | None:
        """Hardness of the softer body, Pa, if one is given."""
        return None if self.softer is None else self.softer.hardness

    @property
    def softer(self) -> RoughBody | None:
        """The body of least hardness, if one is given."""
        given = [body for body in self.bodies if body.hardness is not None]
        return min(given, key=lambda body: body.hardness or 0.0, default=None)

    @property
    def yield_stress(self) -> float | None:
        """Yield stress of a conforming cell, Pa: that of the softer body."""
        if self.softer is None or self.cell.geometry == "flat":
            return None
        return self.softer.yield_stress

    def quick(self) -> Self:
        """Return the same case on a coarser grid with fewer realisations, and without a target."""
        micro = self.micro.model_copy(update={"realisations": min(4, self.micro.realisations)})
        return self.model_copy(
            update={
                "title": f"{self.title} (quick)",
                "cell": self.cell.quick(),
                "micro": micro,
                "law": self.law.model_copy(update={"samples": min(40, self.law.samples)}),
                "slide": self.slide and self.slide.quick(self.cell, self.micro),
                "accuracy": None,
            }
        )

    def cautions(self) -> list[str]:
        """Return what a user should know before trusting the results, one sentence each."""
        found, spacing = [], self.cell.spacing
        for number, body in enumerate(self.bodies, start=1):
            cutoff = body.surface.short_cutoff if body.surface else None
            if cutoff is not None and cutoff < 0.99 * POINTS_PER_WAVE * spacing:
                found.append(
                    f"the shortest wave of body_{number} has {cutoff / spacing:.1f} points; "
                    f"gap and contact area need {POINTS_PER_WAVE} or more"
                )
        if self.cell.depth is not None and (
            shallow := depth_caution(self.cell.depth, max(self.cell.size))
        ):
            found.append(shallow)
        if self.cell.depth is not None and self.accuracy is not None:
            found.append(
                f"depth in [cell] stays {readable(f'{self.cell.depth:.4g} m')} under the cells of "
                f"all sizes that [accuracy] compares, and their errors mix with those of the "
                f"depth; leave it out, and it grows with the cells"
            )
        if self.micro.realisations < FEWEST_REALISATIONS:
            found.append(
                f"{self.micro.realisations} realisation(s) say too little about the scatter: there "
                f"are no bands below {FEWEST_REALISATIONS}"
            )
        return found

    @property
    def scope(self) -> str:
        """What belongs to one run folder, in a few words."""
        return self.cell.scope

    def identity(self) -> str:
        """Checksum of everything that a realisation depends on, instrument files included."""
        return self.checksum(
            exclude={
                **dict.fromkeys(("title", "elastic", "law", "joint", "slide", "accuracy"), True),
                "micro": {"realisations"},
            }
        )
