"""What a scene of grains may say: where they fall, what they are like, how they are followed."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from multiscale.pipeline.toml_model import (
    Count,
    Duration,
    Length,
    Number,
    Settings,
    TimeSteps,
    quantity,
    with_unit,
)

__all__ = [
    "GRANULATES",
    "Biaxial",
    "ColumnCollapse",
    "Deposit",
    "GrainScene",
    "GrainSettings",
    "Motion",
    "ShearCell",
    "Silo",
]

QUICK_GRAINS, QUICK_STEPS = 60, 40

Density = Annotated[float, quantity("kg/m^3"), Field(gt=0.0), with_unit("kg/m^3")]
Speed = Annotated[float, quantity("m/s"), Field(ge=0.0), with_unit("m/s")]
Stress = Annotated[float, quantity("Pa"), Field(gt=0.0), with_unit("Pa")]
StrainRate = Annotated[float, quantity("s^-1"), Field(gt=0.0), with_unit("s^-1")]
Friction = Annotated[Number, Field(ge=0.0)]
Positive = Annotated[Count, Field(ge=1)]


class Deposit(Settings):
    """Spheres that fall into an open box; see :func:`multiscale.macro.granulate.deposit`.

    Parameters
    ----------
    size : two quantities
        Edges of the box along x and y, m.
    """

    kind: Literal["deposit"]
    size: tuple[Length, Length]


class Silo(Settings):
    """Spheres that fall into a pipe; see :func:`multiscale.macro.granulate.silo`.

    Parameters
    ----------
    diameter : quantity
        Inner diameter, m.
    wall_friction : number
        Friction coefficient of the wall.
    sinking : quantity
        Speed of the bottom, m/s.
    """

    kind: Literal["silo"]
    diameter: Length
    wall_friction: Friction = 0.5
    sinking: Speed = 0.0


class ColumnCollapse(Settings):
    """Discs that settle behind a gate, which is then taken away.

    Parameters
    ----------
    width : quantity
        Of the column, m.
    settling : quantity
        Time before the gate is taken away, s.
    """

    kind: Literal["column_collapse"]
    width: Length
    settling: Duration


class ShearCell(Settings):
    """Spheres sheared between rough plates; see :func:`multiscale.macro.granulate.shear_layer`.

    Parameters
    ----------
    size : two quantities
        Periods along x and y, m.
    pressure : quantity
        On the plates, Pa.
    speed : quantity
        Of the upper plate, m/s.
    """

    kind: Literal["shear_cell"]
    size: tuple[Length, Length]
    pressure: Stress
    speed: Speed


class Biaxial(Settings):
    """Grains in a periodic cell, compacted, then shortened along z under a lateral pressure.

    Parameters
    ----------
    pressure : quantity
        Of the compaction, and then on the sides of the cell, Pa.
    strain_rate : quantity
        Of the axial strain, 1/s; see :func:`multiscale.macro.granulate.biaxial_cell`.
    planar : bool
        Discs in place of spheres.
    """

    kind: Literal["biaxial"]
    pressure: Stress
    strain_rate: StrainRate
    planar: bool = False


GRANULATES = ("deposit", "silo", "column_collapse", "shear_cell", "biaxial")
"""Kinds of structures that are grains."""


class GrainSettings(Settings):
    """The grains and how they touch.

    Parameters
    ----------
    number : int
        Number of grains.
    radius : two quantities
        Smallest and largest radius, m; every interval has its share of the volume.
    density : quantity
        Of the material, kg/m3.
    friction : number
        Friction coefficient between grains.
    restitution : number
        Share of the closing speed that a contact gives back.
    compliance : number
        How far contacts give way, relative to rigid ones (0); see
        :class:`multiscale.macro.granulate.ContactLaw`.
    seed : int
        Of radii and places.
    """

    number: Positive
    radius: tuple[Length, Length]
    density: Density = 2600.0
    friction: Friction = 0.5
    restitution: Annotated[Number, Field(ge=0.0, le=1.0)] = 0.0
    compliance: Annotated[Number, Field(ge=0.0)] = 0.0
    seed: Annotated[Count, Field(ge=0)] = 0

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.radius[0] > self.radius[1]:
            raise ValueError("radius should be the smallest and then the largest")
        return self


class Motion(TimeSteps):
    """How the grains are followed; see :func:`multiscale.macro.granulate.simulate_grains`.

    Parameters
    ----------
    step : quantity
        Time step, s; shortened so that a whole number of them fills the duration, or the longest if
        an accuracy is given.
    duration : quantity
        How long the motion is followed, s.
    accuracy : number, optional
        Of impacts, relative to the smaller radius, by which the length of the steps is chosen.
    tolerance : number
        Error of the contacts at which a step is solved, relative to their velocities.
    max_iterations : int
        Largest number of sweeps in a step.
    threads : int
        Threads of the sweeps.
    frames : int
        Instants whose grains and forces are kept.
    """

    accuracy: Annotated[Number, Field(gt=0.0, lt=1.0)] | None = None
    tolerance: Annotated[Number, Field(gt=0.0, lt=1.0)] = 1e-4
    max_iterations: Positive = 1000
    threads: Positive = 1
    frames: Annotated[Count, Field(ge=2)] = 11


class GrainScene(Settings):
    """One question to rigid grains in frictional contact.

    Parameters
    ----------
    title : str
        Stands in tables and datasets.
    structure : table
        Its ``kind`` is ``"deposit"``, ``"silo"``, ``"column_collapse"``, ``"shear_cell"`` or
        ``"biaxial"``.
    grains, motion : table
    """

    title: str
    structure: Annotated[
        Deposit | Silo | ColumnCollapse | ShearCell | Biaxial, Field(discriminator="kind")
    ]
    grains: GrainSettings
    motion: Motion

    @property
    def joint(self) -> None:
        """Grains have no joint that a law could be of."""
        return

    @property
    def substructures(self) -> None:
        """Grains are not cut into substructures."""
        return

    def quick(self) -> Self:
        """Return the same scene with few grains and steps."""
        grains = self.grains.model_copy(update={"number": min(QUICK_GRAINS, self.grains.number)})
        duration = min(self.motion.duration, QUICK_STEPS * self.motion.step)
        motion = self.motion.model_copy(update={"duration": duration})
        small = {"title": f"{self.title} (quick)", "grains": grains, "motion": motion}
        if isinstance(self.structure, ColumnCollapse):
            settling = min(self.structure.settling, duration)
            small["structure"] = self.structure.model_copy(update={"settling": settling})
        return self.model_copy(update=small)
