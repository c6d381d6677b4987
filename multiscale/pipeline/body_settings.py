"""What a scene of elastic bodies may say: plate, stacked blocks, lap joint, law and loading."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from multiscale.pipeline.toml_model import Count, Length, Number, Pressure, Settings

__all__ = [
    "BODIES",
    "JointLawSettings",
    "LapJoint",
    "Loading",
    "Plate",
    "StackedBlocks",
    "Substructures",
]

QUICK = 4
"""Elements along an edge, at most."""

FEW = 2
"""Load steps to the amplitude, at most."""

LEAST, MOST = 0.1, 3.0
"""Pressures of a joint that count, relative to the least and the largest preload."""

SLABS, FEW_SLABS = 48, 8
"""Slabs of the law of a joint under cycles, whose loss is a small difference, and of one that is
only pressed: their shear errs by up to .5 and 8 % of the friction limit; see :class:`Sliders`."""

Positive = Annotated[Count, Field(ge=1)]
Edges = tuple[Length, Length, Length]
Elements = tuple[Positive, Positive, Positive]
Ratio = Annotated[Number, Field(ge=0.0, le=0.4999)]
Damage = Annotated[Number, Field(ge=0.0, lt=1.0)]


class Substructures(Settings):
    """The cut, and the solver of the parts; see :func:`multiscale.macro.solve_latin`.

    Parameters
    ----------
    parts : two whole numbers
        Substructures along x and y, of every body if there are several.
    coarse : bool
        Whether a coarse problem balances the resultants of the interfaces.
    tolerance : number
        Relative residual at which a step is solved.
    max_iterations : int
        Largest number of iterations of a step.
    homogenise : bool
        Whether to write the stiffness of every substructure against the resultants of its
        interfaces, before and after slackening, into ``NAME-homogenised.nc``; see
        :func:`multiscale.macro.homogenise`.
    """

    parts: tuple[Positive, Positive] = (1, 1)
    coarse: bool = True
    tolerance: Annotated[Number, Field(gt=0.0, lt=1.0)] = 1e-8
    max_iterations: Positive = 400
    homogenise: bool = False


class Plate(Settings):
    """An elastic plate, clamped on its left and right edges, under an even pressure on its top.

    Parameters
    ----------
    size : three quantities
        Lengths along x, y and z, m.
    elements : three whole numbers
        Hexahedra along x, y and z.
    youngs_modulus : quantity
        Young's modulus, Pa.
    poissons_ratio : number
        Poisson's ratio.
    pressure : quantity
        Downwards on its top at load factor one, Pa.
    """

    kind: Literal["plate"]
    size: Edges
    elements: Elements
    youngs_modulus: Pressure
    poissons_ratio: Ratio
    pressure: Pressure

    def quick(self) -> Self:
        """Return the same plate with four elements along an edge."""
        return self.model_copy(update={"elements": _fewer(self.elements)})


class StackedBlocks(Settings):
    """Equal blocks with rough joints; see :func:`multiscale.macro.substructures.stacked_blocks`.

    Parameters
    ----------
    size : three quantities
        Lengths of a block along x, y and z, m.
    elements : three whole numbers
        Hexahedra of a block along x, y and z.
    blocks : int
        Number of blocks, one on the other.
    youngs_modulus : quantity
        Young's modulus, Pa.
    poissons_ratio : number
        Poisson's ratio.
    damage : list of numbers
        Of every block, from below: its stiffness is that of the sound one times 1 - D. All are
        sound if not given.
    stiffness : path
        An ``rve_stiffness`` dataset, relative to the scene file: sound blocks have its whole
        tensor in place of both moduli.
    """

    kind: Literal["stacked_blocks"]
    size: Edges
    elements: Elements
    blocks: Annotated[Count, Field(ge=2)] = 2
    youngs_modulus: Pressure
    poissons_ratio: Ratio
    damage: tuple[Damage, ...] = ()
    stiffness: Path | None = None

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.blocks - 1

    def coarser(self) -> Self | None:
        """Return the same blocks on elements of twice the size; nothing if their number is odd."""
        if any(number % 2 for number in self.elements):
            return None
        x, y, z = (number // 2 for number in self.elements)
        return self.model_copy(update={"elements": (x, y, z)})

    @model_validator(mode="after")
    def _check(self) -> Self:
        _check_damage(self.damage, self.blocks, "block")
        return self

    def quick(self) -> Self:
        """Return the same blocks with four elements along an edge."""
        return self.model_copy(update={"elements": _fewer(self.elements)})


class LapJoint(Settings):
    """Two bolted plates; see :func:`multiscale.macro.substructures.lap_joint`.

    Parameters
    ----------
    length : quantity
        Length of each plate along x, m.
    width : quantity
        Width of each plate, m.
    thickness : quantity
        Thickness of each plate, m.
    overlap : quantity
        Length over which they lie on each other, m.
    hole : quantity
        Diameter of the hole, m.
    washer : quantity
        Diameter of the washer, m.
    element : quantity
        Edge of an element in plan, m.
    layers : int
        Elements through each thickness.
    youngs_modulus : quantity
        Young's modulus, Pa.
    poissons_ratio : number
        Poisson's ratio.
    damage : list of numbers
        Of the lower and the upper plate, as for stacked blocks.
    stiffness : path
        Of both plates, as for stacked blocks.
    """

    kind: Literal["lap_joint"]
    length: Length
    width: Length
    thickness: Length
    overlap: Length
    hole: Length
    washer: Length
    element: Length
    layers: Positive = 2
    youngs_modulus: Pressure
    poissons_ratio: Ratio
    damage: tuple[Damage, ...] = ()
    stiffness: Path | None = None

    @property
    def joints(self) -> int:
        """Number of joints."""
        return 1

    def coarser(self) -> Self | None:
        """Return the same joint on elements of twice the size in plan; nothing if too large."""
        if 2.0 * self.element > 0.5 * self.overlap:
            return None
        return self.model_copy(update={"element": 2.0 * self.element})

    @model_validator(mode="after")
    def _check(self) -> Self:
        _check_damage(self.damage, 2, "plate")
        return self

    def quick(self) -> Self:
        """Return the same joint with elements no finer than a quarter of the overlap."""
        return self.model_copy(update={"element": max(self.element, self.overlap / QUICK)})


BODIES = (Plate, StackedBlocks, LapJoint)
"""Structures that consist of elastic bodies."""


class JointLawSettings(Settings):
    """The law of the joints: a fitted normal law with friction.

    Parameters
    ----------
    law : path
        What ``multiscale run`` or ``multiscale fit`` has written; relative to the scene file. Not
        needed if the command names one.
    friction : number
        Coefficient of Coulomb's law.
    stiffness_ratio : number
        Tangential over normal stiffness, of springs that slip one after the other.
    damage : list of numbers
        Of every joint, from below: it carries 1 - D times what the law says. All are sound if not
        given.
    extrapolate : bool
        Whether answers stand where more than 5 % of the load of a joint lies beyond a factor of 2
        outside the pressures of the law; they are unknown otherwise.
    """

    law: Path | None = None
    friction: Annotated[Number, Field(ge=0.0)]
    stiffness_ratio: Annotated[Number, Field(gt=0.0)] = 0.8
    damage: tuple[Damage, ...] = ()
    extrapolate: bool = False


class Loading(Settings):
    """Preloads, then cycles; see :class:`multiscale.macro.substructures.JointLoading`.

    Parameters
    ----------
    preloads : list of quantities
        Pressures on the pressed face, Pa; the last stays during the cycles.
    shear : quantity
        Amplitude of the tangential traction on the sheared face, Pa.
    cycles : int
        Closed cycles after the first loading.
    steps : int
        Load steps from zero to the amplitude.
    """

    preloads: Annotated[tuple[Pressure, ...], Field(min_length=1)]
    shear: Pressure | None = None
    cycles: Annotated[Count, Field(ge=0)] = 0
    steps: Positive = 10

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.shear is None) != (self.cycles == 0):
            raise ValueError("give both shear and cycles, or neither")
        return self

    @property
    def joint_pressures(self) -> tuple[float, float]:
        """Pressures for which the law of the joints is fine, Pa."""
        return LEAST * min(self.preloads), MOST * max(self.preloads)

    @property
    def slabs(self) -> int:
        """Slabs of the law of the joints: the loss of a cycle is a small difference."""
        return SLABS if self.cycles else FEW_SLABS

    def quick(self) -> Self:
        """Return one cycle of few steps."""
        return self.model_copy(
            update={"cycles": min(1, self.cycles), "steps": min(FEW, self.steps)}
        )


def _fewer(elements: Elements) -> Elements:
    x, y, z = (min(QUICK, number) for number in elements)
    return x, y, z


def _check_damage(damage: tuple[float, ...], count: int, what: str) -> None:
    """Refuse damages that are not one for each."""
    if damage and len(damage) != count:
        raise ValueError(
            f"damage should have one entry for each {what} ({count}), got {len(damage)}"
        )
