"""Tables of a case: cells, ensemble, law, joint, sliding and accuracy."""

import re
from itertools import pairwise
from typing import Annotated, Any, Literal, Self

from pydantic import Field, Strict, field_validator, model_validator

from multiscale.pipeline.toml_model import (
    Count,
    Length,
    Number,
    Pressure,
    Settings,
    must_rise,
)

__all__ = [
    "AccuracySettings",
    "CellSettings",
    "JointSettings",
    "LawSettings",
    "MicroSettings",
    "Points",
    "SlideSettings",
]

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
    extrapolate : bool
        Whether answers stand where more than 5 % of a load lies beyond a factor of 2 outside the
        pressures of the cells; they are unknown otherwise.
    """

    terms: Annotated[Count, Field(ge=6)] = 20
    samples: Annotated[Count, Field(ge=0)] = 200
    extrapolate: bool = False


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

    def quick(self, cell: CellSettings, micro: MicroSettings) -> Self:
        """Return a quarter of a length of the cell, under one pressure."""
        pressures = self.pressures or micro.pressures
        return self.model_copy(
            update={
                "distance": min(self.distance, 0.25 * cell.size[0]),
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
