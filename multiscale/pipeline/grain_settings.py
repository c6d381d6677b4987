"""What a case may say of grains: where they fall, what they are like, how they are followed."""

from abc import abstractmethod
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from multiscale.macro import granulate
from multiscale.macro.granulate import ContactLaw, Model, Solver
from multiscale.pipeline.structure_kind import StructureKind
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

if TYPE_CHECKING:
    from multiscale.pipeline.structure_settings import StructureCase

__all__ = [
    "Biaxial",
    "ColumnCollapse",
    "Deposit",
    "GrainSettings",
    "Granulate",
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

    @property
    def law(self) -> ContactLaw:
        """How two grains touch."""
        return ContactLaw(self.friction, self.restitution, self.compliance)

    @property
    def options(self) -> dict[str, Any]:
        """What else an arrangement of grains takes."""
        return {"density": self.density, "seed": self.seed}

    @property
    def radii(self) -> np.ndarray:
        """Radius of every grain, m."""
        return granulate.draw_radii(self.number, *self.radius, seed=self.seed)

    def quick(self) -> Self:
        """Return few such grains."""
        return self.model_copy(update={"number": min(QUICK_GRAINS, self.number)})


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

    @property
    def solver(self) -> Solver:
        """How the contacts are solved."""
        return Solver(self.tolerance, self.max_iterations, self.threads)

    def quick(self) -> Self:
        """Return few steps of the motion."""
        duration = min(self.duration, QUICK_STEPS * self.step)
        return self.model_copy(update={"duration": duration})


class Granulate(StructureKind):
    """Rigid grains in frictional contact."""

    stage: ClassVar[str] = "grains"
    asks: ClassVar[tuple[tuple[str, ...], ...]] = (("grains", "motion"),)
    strained: ClassVar[bool] = False
    """Whether they lie in a periodic cell that strains under a pressure."""

    @property
    def roughest_wall(self) -> float:
        """Largest friction coefficient of a wall that has one of its own."""
        return 0.0

    @abstractmethod
    def build(self, grains: GrainSettings, motion: Motion) -> Model:
        """Build grains and walls at the beginning of the motion that is asked for.

        Raises
        ------
        CaseError
            If the grains do not fit.
        ConvergenceError
            If grains that are pressed do not come to rest.
        """


class Deposit(Granulate):
    """Spheres that fall into an open box; see :func:`multiscale.macro.granulate.deposit`.

    Parameters
    ----------
    size : two quantities
        Edges of the box along x and y, m.
    """

    kind: Literal["deposit"]
    size: tuple[Length, Length]

    def build(self, grains: GrainSettings, motion: Motion) -> Model:
        """Let the grains fall into the box."""
        return granulate.deposit(grains.radii, self.size, grains.law, **grains.options)


class Silo(Granulate):
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

    def build(self, grains: GrainSettings, motion: Motion) -> Model:
        """Let the grains fall into the pipe."""
        walls: dict[str, Any] = {"wall_friction": self.wall_friction, "sinking": self.sinking}
        return granulate.silo(grains.radii, self.diameter, grains.law, **walls, **grains.options)

    @property
    def roughest_wall(self) -> float:
        """That of the pipe."""
        return self.wall_friction


class ColumnCollapse(Granulate):
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

    def build(self, grains: GrainSettings, motion: Motion) -> Model:
        """Let the column settle, and take the gate away."""
        model = granulate.column(grains.radii, self.width, grains.law, **grains.options)
        still = granulate.simulate_grains(model, self.settling, motion.step, solver=motion.solver)
        return granulate.release(model, granulate.final_grains(model, still))

    def quick(self, case: "StructureCase") -> Self:
        """Return a column that settles no longer than the motion is followed."""
        assert case.motion is not None  # the case has been validated
        return self.model_copy(update={"settling": min(self.settling, case.motion.duration)})


class ShearCell(Granulate):
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

    def build(self, grains: GrainSettings, motion: Motion) -> Model:
        """Press the grains between the plates."""
        return granulate.shear_layer(
            grains.radii, self.size, self.pressure, self.speed, grains.law, **grains.options
        )[0]


class Biaxial(Granulate):
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

    strained: ClassVar[bool] = True

    kind: Literal["biaxial"]
    pressure: Stress
    strain_rate: StrainRate
    planar: bool = False

    def build(self, grains: GrainSettings, motion: Motion) -> Model:
        """Compact the grains in the cell."""
        return granulate.biaxial_cell(
            grains.radii,
            self.pressure,
            self.strain_rate,
            grains.law,
            planar=self.planar,
            **grains.options,
        )[0]
