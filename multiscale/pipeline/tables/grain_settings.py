"""Tables of grains: their scenes, radii, contacts and motion."""

from abc import abstractmethod
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from multiscale.errors import CaseError
from multiscale.macro import granulate
from multiscale.pipeline.tables import toml_model as toml
from multiscale.pipeline.tables.structure_kind import StructureKind
from multiscale.schema import Dataset

if TYPE_CHECKING:
    from multiscale.pipeline.tables.settings import Case

QUICK_STEPS = 40  # of a motion
COARSEST = 2.5  # longest step of pressed grains, over the step that resolves how they rearrange

Speed = Annotated[float, toml.quantity("m/s"), Field(ge=0.0), toml.with_unit("m/s")]
SlidingSpeed = Annotated[float, toml.quantity("m/s"), Field(gt=0.0), toml.with_unit("m/s")]
StrainRate = Annotated[float, toml.quantity("s^-1"), Field(gt=0.0), toml.with_unit("s^-1")]


class GrainSettings(toml.Settings):
    """The grains and their contacts."""

    number: Annotated[toml.Positive, toml.at_most(60)] = Field(description="Number of grains.")
    radius: tuple[toml.Length, toml.Length]
    """Smallest and largest radius, m; the volume is uniformly distributed over the radius."""
    density: toml.Density = Field(2600.0, description="Density of the material, kg/m3.")
    friction: toml.Factor = Field(0.5, description="Friction coefficient between grains.")
    restitution: toml.Share = Field(0.0, description="Separation speed over closing speed.")
    compliance: toml.Factor = 0.0
    """Compliance of contacts; see `multiscale.macro.granulate.ContactLaw`."""
    tangential_compliance: toml.Factor = Field(
        0.0, description="Smallest compliance across the normal."
    )
    seed: toml.Natural = Field(0, description="Seed of radii and places.")

    def _faults(self) -> Iterator[str]:
        if self.radius[0] > self.radius[1]:
            yield "radius should be the smallest and then the largest"

    @property
    def law(self) -> "granulate.ContactLaw":
        """Contact law of two grains."""
        return granulate.ContactLaw(
            self.friction,
            self.restitution,
            self.compliance,
            tangential_compliance=self.tangential_compliance,
        )

    @property
    def options(self) -> dict[str, Any]:
        """Further options of an arrangement of grains."""
        return {"density": self.density, "seed": self.seed}

    @property
    def radii(self) -> np.ndarray:
        """Radius of every grain, m."""
        return granulate.draw_radii(self.number, *self.radius, seed=self.seed)


class ThirdBody(toml.Settings):
    """Cells of grains between two plates, pressed and sheared, as the law of an interface.

    Rigid grains have no time scale: at another speed than `speed` the law is valid at pressures
    proportional to the square of the speed, which is `speed` in `[interface]`.
    """

    size: tuple[toml.Length, toml.Length] = Field(description="Periods along x and y, m.")
    pressures: Annotated[
        toml.Rising[toml.Pressure], toml.Quick(lambda _, all_: all_[:: max(1, len(all_) // 3)])
    ] = Field(min_length=3, description="Pressures on the plates, Pa, rising.")
    speed: SlidingSpeed = Field(description="Speed of the upper plate, m/s.")
    realisations: Annotated[toml.Positive, toml.at_most(3)] = Field(description="Number of cells.")
    wider: Annotated[toml.Natural, toml.at_most(0)] = 0
    """Number of further cells of twice the periods, for the error of the size."""
    distance: Annotated[toml.Number, Field(ge=3.0), toml.Quick(lambda _, way: min(way, 10.0))] = (
        20.0
    )
    """Distance of the plate in mean diameters of grains; averages are over its second half."""
    wall_friction: toml.Factor | None = None
    """Friction coefficient of the plates, if not the value of the grains."""
    plate_mass: Annotated[toml.Number, Field(gt=0.0)] = Field(
        0.1, description="Mass of the upper plate over the mass of the grains."
    )
    tolerance: toml.Tolerance = Field(1e-2, description="Error of contacts over their velocities.")
    max_iterations: toml.Positive = Field(300, description="Largest number of sweeps in a step.")

    def cell(self, grains: GrainSettings, k: int) -> tuple[np.ndarray, dict[str, Any]]:
        """Return the radii of a realisation, m, and the options of its shear."""
        seed, (a, b) = grains.seed + k, grains.radius
        radii = granulate.draw_radii(grains.number, a, b, seed=seed)
        mean_cube = 2.0 * (a * b) ** 2 / (a + b)  # of a volume that is uniform over the radius
        radii *= (grains.number * mean_cube / np.sum(radii**3)) ** (1.0 / 3.0)
        options = {
            "distance": self.distance,
            "wall_friction": self.wall_friction,
            "plate_mass": self.plate_mass,
            "solver": granulate.Solver(self.tolerance, self.max_iterations, 0),
            "density": grains.density,
            "seed": seed,
        }
        return radii, options

    def steps(self, grains: GrainSettings) -> list[int]:
        """Return the number of steps at each pressure; refuse too many, and short periods."""
        radii, _ = self.cell(grains, 0)
        some = granulate.Grains(np.zeros((grains.number, 3)), radii, grains.density)
        lengths, counts = zip(
            *(
                granulate.shear_steps(some, pressure, self.speed, self.distance)
                for pressure in self.pressures
            ),
            strict=True,
        )
        largest = max((self.cell(grains, k)[0] for k in range(self.realisations)), key=np.max)
        # two grains carried by the plate approach by twice its distance in a step
        least = granulate.least_period(largest, 2.0 * self.speed * max(lengths))
        if min(self.size) < least:
            raise CaseError(
                f"[third_body] size has a period of {min(self.size):.4g} m, and grains of a radius "
                f"of up to {largest.max():.4g} m need {least:.4g} m or more; give longer periods, "
                f"or smaller grains"
            )
        return list(counts)


def third_body_faults(case: "Case") -> Iterator[str]:
    """Report a third body without grains, or with cells of two surfaces or keys of their law."""
    if case.grains is None:
        yield "[third_body] needs [grains]; give this table"
    stray = [name for name in ("cell", "micro", "slide", "seal", "measured") if getattr(case, name)]
    if stray:
        yield f"[third_body] and [{stray[0]}] both give the law of an interface; leave out one"
    fit, standard = case.law, type(case.law)()
    of_surfaces = [
        name for name in ("terms", "apart") if getattr(fit, name) != getattr(standard, name)
    ]
    if of_surfaces:
        yield (
            f"{' and '.join(of_surfaces)} in [law] fit cells of two surfaces, and the law of "
            f"[third_body] is a formula of two parameters; leave out {' and '.join(of_surfaces)}"
        )
    if case.structure is not None and (case.interface is None or case.interface.speed is None):
        yield "the law of [third_body] depends on the speed of sliding; give speed in [interface]"
    if case.structure is not None and "grains" in case.structure.asks[0]:
        yield (
            f"a structure of kind {case.structure.kind!r} is made of [grains], and [third_body] "
            f"too; leave out one of them"
        )


class Motion(toml.TimeSteps):
    """Steps and solver of the motion; see :func:`multiscale.macro.granulate.simulate_grains`."""

    accuracy: toml.Tolerance | None = None
    """Approach in the step of an impact, over the smaller radius."""
    tolerance: toml.Tolerance = Field(1e-4, description="Error of contacts over their velocities.")
    max_iterations: toml.Positive = Field(1000, description="Largest number of sweeps in a step.")
    frames: toml.Count = Field(11, ge=2, description="Number of instants with stored data.")

    @property
    def solver(self) -> "granulate.Solver":
        """Solver of the contacts."""
        return granulate.Solver(self.tolerance, self.max_iterations)

    def smaller(self) -> Self:
        """Return few steps of the motion."""
        duration = min(self.duration, QUICK_STEPS * self.step)
        return self.model_copy(update={"duration": duration})


class Granulate(StructureKind):
    """Rigid grains in frictional contact."""

    stage: ClassVar[str] = "grains"
    asks: ClassVar[tuple[tuple[str, ...], ...]] = (("grains", "motion"),)
    strained: ClassVar[bool] = False
    """Whether the grains lie in a periodic cell that strains under a pressure."""
    question: ClassVar[str] = "How do the grains move, and which forces act at their contacts?"
    """Question of the case."""

    @property
    def roughest_wall(self) -> float:
        """Largest friction coefficient of a wall."""
        return 0.0

    @abstractmethod
    def build(self, grains: GrainSettings, motion: Motion) -> "granulate.Model":
        """Build grains and walls at the beginning of the motion."""

    def measured(self, result: Dataset) -> Dataset:
        """Return the result of the motion with the quantities that answer the question."""
        return result


class Deposit(Granulate):
    """Spheres that fall into an open box; see :func:`multiscale.macro.granulate.deposit`."""

    question: ClassVar[str] = (
        "Which walls carry the weight of the grains, and how many sweeps has a step?"
    )

    kind: Literal["deposit"]
    size: tuple[toml.Length, toml.Length] = Field(description="Edges of the box along x and y, m.")

    def build(self, grains: GrainSettings, motion: Motion) -> "granulate.Model":
        """Build the grains above the box, into which they fall."""
        return granulate.deposit(grains.radii, self.size, grains.law, **grains.options)

    def measured(self, result: Dataset) -> Dataset:
        """Add the shares of sides and floor in the weight."""
        return granulate.with_weight_shares(result, floor=4)


class Silo(Granulate):
    """Spheres that fall into a pipe; see :func:`multiscale.macro.granulate.silo`."""

    question: ClassVar[str] = "How much of the weight of the grains does the wall carry?"

    kind: Literal["silo"]
    diameter: toml.Length = Field(description="Inner diameter, m.")
    wall_friction: toml.Factor = Field(0.5, description="Friction coefficient of the wall.")
    sinking: Speed = Field(0.0, description="Speed of the bottom, m/s.")

    def build(self, grains: GrainSettings, motion: Motion) -> "granulate.Model":
        """Build the grains above the pipe, into which they fall."""
        walls: dict[str, Any] = {"wall_friction": self.wall_friction, "sinking": self.sinking}
        return granulate.silo(grains.radii, self.diameter, grains.law, **walls, **grains.options)

    def measured(self, result: Dataset) -> Dataset:
        """Add the shares of wall and bottom in the weight."""
        return granulate.with_weight_shares(result, floor=0)

    @property
    def roughest_wall(self) -> float:
        """Friction coefficient of the pipe."""
        return self.wall_friction


class ColumnCollapse(Granulate):
    """Discs that settle behind a gate, which is then removed."""

    question: ClassVar[str] = "How far do the grains spread beyond the gate?"

    kind: Literal["column_collapse"]
    width: toml.Length = Field(description="Width of the column, m.")
    settling: toml.Duration = Field(description="Time before the gate is removed, s.")

    def build(self, grains: GrainSettings, motion: Motion) -> "granulate.Model":
        """Settle the column, and remove the gate."""
        model = granulate.column(grains.radii, self.width, grains.law, **grains.options)
        still = granulate.simulate_grains(model, self.settling, motion.step, solver=motion.solver)
        return granulate.release(model, granulate.final_grains(model, still))

    def measured(self, result: Dataset) -> Dataset:
        """Add the distance of the farthest grain beyond the gate."""
        return granulate.with_run_out(result, self.width)

    def within(self, case: "Case") -> Self:
        """Return a column that settles for at most the duration of the motion."""
        return self.model_copy(update={"settling": min(self.settling, case.motion.duration)})


class ShearCell(Granulate):
    """Spheres sheared between rough plates; see :func:`multiscale.macro.granulate.shear_layer`."""

    question: ClassVar[str] = "Which shear stress does the layer of grains transmit?"

    kind: Literal["shear_cell"]
    size: tuple[toml.Length, toml.Length] = Field(description="Periods along x and y, m.")
    pressure: toml.Pressure = Field(description="Pressure on the plates, Pa.")
    speed: Speed = Field(description="Speed of the upper plate, m/s.")

    def build(self, grains: GrainSettings, motion: Motion) -> "granulate.Model":
        """Press the grains between the plates."""
        model, resolving = granulate.shear_layer(
            grains.radii, self.size, self.pressure, self.speed, grains.law, **grains.options
        )
        _refuse_long_steps(motion, resolving)
        return model

    def measured(self, result: Dataset) -> Dataset:
        """Add shear stress and pressure on the upper plate."""
        return granulate.with_plate_stress(result, 1, self.size[0] * self.size[1], self.speed)


class Biaxial(Granulate):
    """Grains in a periodic cell, compacted, then shortened along z under a lateral pressure."""

    strained: ClassVar[bool] = True
    question: ClassVar[str] = "Which stress ratio do the grains carry, and do they dilate?"

    kind: Literal["biaxial"]
    pressure: toml.Pressure = Field(
        description="Pressure of the compaction, and then on the sides, Pa."
    )
    strain_rate: StrainRate
    """Rate of the axial strain, 1/s; see `multiscale.macro.granulate.biaxial_cell`."""
    planar: bool = Field(False, description="Discs in place of spheres.")

    def build(self, grains: GrainSettings, motion: Motion) -> "granulate.Model":
        """Compact the grains in the cell."""
        model, resolving = granulate.biaxial_cell(
            grains.radii,
            self.pressure,
            self.strain_rate,
            grains.law,
            planar=self.planar,
            **grains.options,
        )
        _refuse_long_steps(motion, resolving)
        return model


def _refuse_long_steps(motion: Motion, resolving: float) -> None:
    if motion.step > COARSEST * resolving:
        raise CaseError(
            f"[motion] step {motion.step:.3g} s is too long for the pressure on these grains, "
            f"which rearrange within {5.0 * resolving:.2g} s; take about {resolving:.2g} s"
        )
