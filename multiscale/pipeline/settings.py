"""What a case may say: every key with its unit, range and default."""

import hashlib
import re
from itertools import pairwise
from typing import Annotated, Any, Literal, Self

from pydantic import Field, Strict, field_validator, model_validator

from multiscale.io import read_bytes
from multiscale.micro.cell import depth_caution
from multiscale.micro.slide import LONGEST
from multiscale.pipeline.rough_bodies import Body, InstrumentSurface, SyntheticSurface
from multiscale.pipeline.toml_model import (
    Count,
    Length,
    Number,
    Pressure,
    Settings,
    must_rise,
)

__all__ = [
    "POINTS_PER_WAVE",
    "TABOR",
    "AccuracySettings",
    "Body",
    "Case",
    "CellSettings",
    "InstrumentSurface",
    "JointSettings",
    "LawSettings",
    "MicroSettings",
    "SlideSettings",
    "SyntheticSurface",
]

FEWEST_REALISATIONS = 3  # for a band
TABOR = 2.8
"""Hardness over yield stress (D. Tabor, The Hardness of Metals, Oxford 1951)."""

STRONGEST = 0.1
"""Largest strain at which a metal may yield."""

POINTS_PER_WAVE = 8  # of the shortest wave of a measured surface, if the case names no cut-off

Points = Annotated[Count, Field(ge=4, le=8192, multiple_of=2)]


class CellSettings(Settings):
    """The representative surface element.

    Parameters
    ----------
    size : two quantities
        Edge lengths along x and y, m.
    points : two ints
        Grid points along x and y.
    depth : quantity, optional
        Depth of the elastic layer, m; the longer edge if not given.
    layers : int
        Layers of elements over the depth.
    geometry : {"conforming", "flat"}
        Whether the mesh follows the surface, or the surface is the gap of a flat layer: fast, for
        small slopes.
    """

    size: tuple[Length, Length]
    points: tuple[Points, Points]
    depth: Length | None = None
    layers: Annotated[Count, Field(ge=2, le=1000)] = 12
    geometry: Literal["conforming", "flat"] = "conforming"


class MicroSettings(Settings):
    """The ensemble of cells.

    Parameters
    ----------
    realisations : int
        Number of cells.
    pressures : list of quantities
        Mean pressures, Pa, rising.
    seed : int
        Random seed of the first realisation; the next ones count on.
    unload : bool or list of quantities
        Whether the cells are unloaded through the same pressures, or the falling pressures at
        which they are, Pa.
    """

    realisations: Annotated[Count, Field(ge=1)]
    pressures: Annotated[tuple[Pressure, ...], Field(min_length=3)]
    seed: Annotated[Count, Field(ge=0)] = 0
    unload: Annotated[bool, Strict()] | tuple[Pressure, ...] = False

    _rise = field_validator("pressures")(must_rise)

    @field_validator("unload", mode="before")
    @classmethod
    def _say_what(cls, value: Any) -> Any:
        if not isinstance(value, bool | list | tuple):
            raise ValueError(f"should be true, or a list of pressures that falls, got {value!r}")
        return value

    @model_validator(mode="after")
    def _check(self) -> Self:
        down = (self.pressures[-1], *self.unloading)
        if any(late >= early for early, late in pairwise(down)):
            raise ValueError(
                f"unload must fall from one pressure to the next, below the largest of pressures, "
                f"{1e-6 * down[0]:g} MPa"
            )
        return self

    @property
    def unloading(self) -> tuple[float, ...]:
        """Pressures on the way down, Pa."""
        if isinstance(self.unload, bool):
            return self.pressures[-2::-1] if self.unload else ()
        return self.unload

    @property
    def path(self) -> tuple[float, ...]:
        """All pressures in their order, Pa."""
        return self.pressures + self.unloading


class LawSettings(Settings):
    """The fit of the interface law.

    Parameters
    ----------
    terms : int
        Terms of the normal law.
    samples : int
        Bootstrap samples behind the bands.
    """

    terms: Annotated[Count, Field(ge=6)] = 20
    samples: Annotated[Count, Field(ge=0)] = 200


class JointSettings(Settings):
    """Two blocks pressed together through the law.

    Parameters
    ----------
    height : quantity
        Height of each block, m.
    width : quantity
        Edge of their square section, m.
    preloads : list of quantities
        Nominal pressures on the joint, Pa, rising; best within those of the cells.
    """

    height: Length
    width: Length
    preloads: Annotated[tuple[Pressure, ...], Field(min_length=1)]

    _rise = field_validator("preloads")(must_rise)


class SlideSettings(Settings):
    """Body 2 slides over body 1 along x: friction against pressure and distance.

    Both bodies are deformable, at large strain, with the surfaces of the first realisation; what
    they resist more than the friction of their points is ploughing.

    Parameters
    ----------
    distance : quantity
        How far, m; at most 20 lengths of the cell.
    friction_coefficient : float
        Of each point of contact.
    pressures : list of quantities
        Mean pressures, Pa, rising; those of the cells if not given.
    steps : int
        Steps of the result along the distance.
    """

    distance: Length
    friction_coefficient: Annotated[Number, Field(ge=0.0, le=10.0)] = 0.0
    pressures: tuple[Pressure, ...] = ()
    steps: Annotated[Count, Field(ge=1, le=10_000)] = 16

    _rise = field_validator("pressures")(must_rise)

    def quick(self, case: "Case") -> Self:
        """Return a quarter of a length of the cell, under one pressure."""
        pressures = self.pressures or case.micro.pressures
        return self.model_copy(
            update={
                "distance": min(self.distance, 0.25 * case.cell.size[0]),
                "pressures": pressures[len(pressures) // 2 :][:1],
                "steps": min(4, self.steps),
            }
        )


class AccuracySettings(Settings):
    """How sure the answer has to be; the rest of the case is then where a planner starts from.

    Parameters
    ----------
    target : quantity
        Largest total of the error budget, relative, such as ``"2 %"``.
    quantity : {"joint_stiffness", "mean_gap", "contact_fraction", "stiffness"}
        What the target is for, at every preload or, for the last three, at every pressure of the
        cells.
    """

    target: Annotated[Number, Field(gt=0.0, le=0.5)]
    quantity: Literal["joint_stiffness", "mean_gap", "contact_fraction", "stiffness"] = (
        "joint_stiffness"
    )

    @field_validator("target", mode="before")
    @classmethod
    def _say_percent(cls, value: Any) -> Any:
        if re.fullmatch(r"[1-9]\d*", str(value)):
            raise ValueError(f'{value!r} is no part of one; write it as "{value} %"')
        return value


class Case(Settings):
    """One question, such as how stiff the joint of two bodies is.

    Parameters
    ----------
    title : str
        Stands in report and tables.
    body_1, body_2 : Body
    cell : CellSettings
    micro : MicroSettings
    law : LawSettings
    joint : JointSettings
    slide : SlideSettings
        If given, the bodies also slide over each other.
    accuracy : AccuracySettings
        If given, a planner chooses cells, grid and realisations.
    """

    title: str
    body_1: Body
    body_2: Body
    cell: CellSettings
    micro: MicroSettings
    law: LawSettings = LawSettings()
    joint: JointSettings
    slide: SlideSettings | None = None
    accuracy: AccuracySettings | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.body_1.surface is None and self.body_2.surface is None:
            raise ValueError("both bodies are smooth; give one of them a [surface] table")
        self._check_metal()
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
            strain = (body.hardness or 0.0) / TABOR / body.youngs_modulus
            if not flat and strain > STRONGEST:
                raise ValueError(
                    f"hardness of body_{number} is {1e-9 * (body.hardness or 0.0):g} GPa, so that "
                    f"it would yield at a strain of {strain:.2g}, above {STRONGEST:g}; that of a "
                    f"metal is about a hundredth of its youngs_modulus"
                )
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

    @property
    def bodies(self) -> tuple[Body, Body]:
        """Both bodies."""
        return self.body_1, self.body_2

    @property
    def hardness(self) -> float | None:
        """Hardness of the softer body, Pa, if one is given."""
        return None if self.softer is None else self.softer.hardness

    @property
    def softer(self) -> Body | None:
        """The body of least hardness, if one is given."""
        given = [body for body in self.bodies if body.hardness is not None]
        return min(given, key=lambda body: body.hardness or 0.0, default=None)

    @property
    def yield_stress(self) -> float | None:
        r"""Yield stress of a conforming cell, Pa: :math:`\sigma_y = H/2.8` of the softer body."""
        if self.hardness is None or self.cell.geometry == "flat":
            return None
        return self.hardness / TABOR

    def quick(self) -> Self:
        """Return the same case on a coarser grid with fewer realisations, and without a target."""
        points = tuple(max(4, 2 * ((n + 2) // 4)) for n in self.cell.points)
        micro = self.micro.model_copy(update={"realisations": min(4, self.micro.realisations)})
        return self.model_copy(
            update={
                "title": f"{self.title} (quick)",
                "cell": self.cell.model_copy(update={"points": points}),
                "micro": micro,
                "law": self.law.model_copy(update={"samples": min(40, self.law.samples)}),
                "slide": self.slide and self.slide.quick(self),
                "accuracy": None,
            }
        )

    def cautions(self) -> list[str]:
        """Return what a user should know before trusting the results, one sentence each."""
        found = []
        spacing = max(
            length / n for length, n in zip(self.cell.size, self.cell.points, strict=True)
        )
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
        low, high = self.micro.pressures[0], self.micro.pressures[-1]
        outside = [p for p in self.joint.preloads if not low <= p <= high]
        if outside:
            values = ", ".join(f"{1e-6 * p:g}" for p in outside)
            found.append(
                f"the law extrapolates at the preloads {values} MPa: the cells were pressed at "
                f"{1e-6 * low:g} to {1e-6 * high:g} MPa"
            )
        if self.yield_stress is not None and self.hardness is not None:
            found.append(
                f"the hardness of {1e-9 * self.hardness:g} GPa of the softer body became a yield "
                f"stress of {1e-9 * self.yield_stress:.4g} GPa (H/{TABOR}) of the one body that "
                f"stands for both, which flows for both"
            )
        if self.micro.realisations < FEWEST_REALISATIONS:
            found.append(
                f"{self.micro.realisations} realisation(s) say too little about the scatter: there "
                f"are no bands below {FEWEST_REALISATIONS}"
            )
        for number, body in enumerate(self.bodies, start=1):
            if isinstance(body.surface, InstrumentSurface) and body.surface.periodic == "window":
                found.append(
                    f"the windows of body_{number} fade along their edges, which lowers their rms "
                    f"height by about an eighth"
                )
        return found

    def identity(self) -> str:
        """Checksum of everything that a realisation depends on, instrument files included."""
        content = self.model_dump_json(
            exclude={
                "title": True,
                "law": True,
                "joint": True,
                "slide": True,
                "accuracy": True,
                "micro": {"realisations"},
                "body_1": {"surface": {"file"}},
                "body_2": {"surface": {"file"}},
            }
        )
        checksum = hashlib.sha256(content.encode())
        for body in self.bodies:
            if isinstance(body.surface, InstrumentSurface):
                checksum.update(read_bytes(body.surface.file))
        return checksum.hexdigest()
