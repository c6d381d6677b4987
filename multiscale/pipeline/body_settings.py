"""What a case may say of elastic bodies: plate, stacked blocks, lap joint, law and loading."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import fields
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from multiscale.errors import CaseError
from multiscale.fe.boxes import box_mesh
from multiscale.io import open_dataset, open_law
from multiscale.laws import Damaged, NormalLaw, Sliders
from multiscale.laws.bulk import AnisotropicElastic, Elastic
from multiscale.macro import Body, LatinMethod
from multiscale.macro.bodies import Assembly, LapShape, lap_joint, stacked_blocks
from multiscale.macro.substructures import CutProblem, JointLoading, cut_assembly
from multiscale.pipeline.structure_kind import StructureKind
from multiscale.pipeline.toml_model import (
    Count,
    Factor,
    Length,
    Natural,
    Number,
    Positive,
    Pressure,
    Ratio,
    Settings,
    Tolerance,
)
from multiscale.schema import RVE_STIFFNESS
from multiscale.upscaling import law_from_dataset

if TYPE_CHECKING:
    import xarray as xr

    from multiscale.macro.substructures import ProcessGroup
    from multiscale.pipeline.structure_settings import StructureCase

__all__ = [
    "JointLawSettings",
    "LapJoint",
    "Loading",
    "Plate",
    "RoughBodies",
    "StackedBlocks",
    "Substructures",
]

QUICK_ELEMENTS = 4
"""Elements along an edge, at most."""

QUICK_STEPS = 2
"""Load steps to the amplitude, at most."""

LEAST, MOST = 0.1, 3.0
"""Pressures of a joint that count, relative to the least and the largest preload."""

SLABS, FEW_SLABS = 48, 8
"""Slabs of the law of a joint under cycles, whose loss is a small difference, and of one that is
only pressed: their shear errs by up to .5 and 8 % of the friction limit; see :class:`Sliders`."""

Edges = tuple[Length, Length, Length]
Elements = tuple[Positive, Positive, Positive]
Damage = Annotated[Number, Field(ge=0.0, lt=1.0)]


class Substructures(Settings):
    """The cut, and the solver of the parts; see :func:`multiscale.macro.solve_latin`."""

    parts: tuple[Positive, Positive] = Field(
        (1, 1), description="Substructures along x and y, of every body."
    )
    coarse: bool = Field(
        True, description="Whether a coarse problem balances interface resultants."
    )
    tolerance: Tolerance = Field(1e-8, description="Relative residual of a solved step.")
    max_iterations: Positive = Field(400, description="Largest number of iterations of a step.")
    homogenise: bool = Field(
        False,
        description="Writes the stiffness of substructures against their interface resultants, "
        "before and after slackening, to `NAME-homogenised.nc`; see `multiscale.macro.homogenise`.",
    )

    @property
    def count(self) -> int:
        """Substructures of a body, or of a grid."""
        return self.parts[0] * self.parts[1]

    def stop(self, team: "ProcessGroup | None") -> dict[str, Any]:
        """When the solver stops, and who shares its work."""
        return {"tolerance": self.tolerance, "max_iterations": self.max_iterations, "team": team}

    def method(self, team: "ProcessGroup | None") -> LatinMethod:
        """How elastic bodies are solved."""
        return LatinMethod(self.parts, self.coarse, **self.stop(team))

    def quick(self) -> Self:
        """Return a cut into two parts each way, at most."""
        return self.model_copy(update={"parts": tuple(min(2, number) for number in self.parts)})


class JointLawSettings(Settings):
    """The law of the joints: a fitted normal law with friction."""

    law: Path | None = Field(
        None, description="Dataset of a law from a run or fit; needless if the command names one."
    )
    friction: Factor = Field(description="Coefficient of Coulomb's law.")
    stiffness_ratio: Number = Field(
        0.8, gt=0.0, description="Tangential over normal stiffness, of springs slipping in turn."
    )
    damage: tuple[Damage, ...] = Field(
        (),
        description="Damage of joints from below: each carries 1 - D of the law; 0 if not given.",
    )
    extrapolate: bool = Field(
        False,
        description="Whether answers stand where more than 5 % of the load of a joint lies beyond "
        "a factor of 2 outside the pressures of the law; they are unknown otherwise.",
    )

    def open(self) -> "xr.Dataset":
        """Open the normal law.

        Raises
        ------
        MultiscaleError
            If there is none, or it is refused.
        """
        if self.law is None:
            raise CaseError(
                "the structure has joints but no law: name a file by [joint] law or by --law, such "
                "as the interface_law.nc of a run"
            )
        return open_law(self.law)

    def build(self, sound: NormalLaw, joints: int, loading: "Loading") -> list[Sliders]:
        """Make the law of every joint: the sound one, less its damage, with friction."""
        return [
            Sliders(
                Damaged(sound, D) if D else sound,
                self.friction,
                self.stiffness_ratio,
                pressures=loading.joint_pressures,
                slabs=loading.slabs,
            )
            for D in self.damage or (0.0,) * joints
        ]


class Loading(Settings):
    """Preloads, then cycles; see :class:`multiscale.macro.substructures.JointLoading`."""

    preloads: tuple[Pressure, ...] = Field(
        min_length=1, description="Pressures on the pressed face, Pa; the last one stays."
    )
    shear: Pressure | None = Field(
        None, description="Amplitude of the shear on the sheared face, Pa."
    )
    cycles: Natural = Field(0, description="Closed cycles after the first loading.")
    steps: Positive = Field(10, description="Load steps from zero to the amplitude.")

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

    def build(self) -> JointLoading:
        """Make the loading."""
        return JointLoading(self.preloads, self.shear or 0.0, self.cycles, self.steps)

    def quick(self) -> Self:
        """Return one cycle of few steps."""
        return self.model_copy(
            update={"cycles": min(1, self.cycles), "steps": min(QUICK_STEPS, self.steps)}
        )


class RoughBodies(StructureKind):
    """Elastic bodies with rough joints."""

    stage: ClassVar[str] = "rough_joints"
    asks: ClassVar[tuple[tuple[str, ...], ...]] = (("joint", "loading"),)
    may_be_cut: ClassVar[bool] = True
    mesher: ClassVar[tuple[str, ...]] = ()
    """Library that meshes the bodies."""

    if TYPE_CHECKING:
        youngs_modulus: float
        poissons_ratio: float
        damage: tuple[float, ...]
        stiffness: Path | None

    @property
    @abstractmethod
    def joints(self) -> int:
        """Number of joints."""

    @property
    @abstractmethod
    def nodes(self) -> tuple[int, int]:
        """Nodes of a body and of its face, about."""

    @abstractmethod
    def coarser(self) -> Self | None:
        """Return the same structure on elements of twice the size; nothing if it has none."""

    @abstractmethod
    def build(self, laws: Sequence[Sliders]) -> Assembly:
        """Build bodies and joints, whose laws are given from below.

        Raises
        ------
        MultiscaleError
            If dimensions are refused, or a file that is named cannot be read.
        """

    def assemble(self, case: "StructureCase", normal: NormalLaw) -> Assembly:
        """Build bodies and joints of a case, whose sound joints have a normal law."""
        assert case.joint is not None  # the case has been validated
        assert case.loading is not None
        return self.build(case.joint.build(normal, self.joints, case.loading))

    def cut(self, case: "StructureCase") -> CutProblem:
        """Cut every body into boxes."""
        assert case.joint is not None  # the case has been validated
        normal = law_from_dataset(case.joint.open())
        return cut_assembly(self.assemble(case, normal), case.cut.parts)

    @property
    def damages(self) -> tuple[float, ...]:
        """Damage of every body."""
        return self.damage or (0.0,) * (self.joints + 1)

    @property
    def materials(self) -> list[Elastic | AnisotropicElastic]:
        """Elasticity of every body, less its damage."""
        if self.stiffness is None:
            return [
                Elastic((1.0 - D) * self.youngs_modulus, self.poissons_ratio) for D in self.damages
            ]
        sound = open_dataset(self.stiffness, RVE_STIFFNESS)["stiffness"].values
        return [AnisotropicElastic((1.0 - D) * sound) for D in self.damages]

    def check(self, case: "StructureCase") -> None:
        """Refuse damages that are not one for each joint."""
        damage = case.joint.damage if case.joint else ()
        if damage and len(damage) != self.joints:
            raise ValueError(
                f"[joint] damage should have one entry for each joint ({self.joints}), got "
                f"{len(damage)}"
            )


class Plate(StructureKind):
    """An elastic plate, clamped on its left and right edges, under an even pressure on its top."""

    stage: ClassVar[str] = "plate"
    asks: ClassVar[tuple[tuple[str, ...], ...]] = (("statics",),)
    may_be_cut: ClassVar[bool] = True

    kind: Literal["plate"]
    size: Edges = Field(description="Lengths along x, y and z, m.")
    elements: Elements = Field(description="Hexahedra along x, y and z.")
    youngs_modulus: Pressure = Field(description="Young's modulus, Pa.")
    poissons_ratio: Ratio = Field(description="Poisson's ratio.")
    pressure: Pressure = Field(description="Pressure on the top at load factor one, Pa.")

    def build(self) -> Assembly:
        """Clamp the plate and load it."""
        clamped = (0.0, 0.0, 0.0)
        plate = Body(
            box_mesh(self.size, self.elements),
            Elastic(self.youngs_modulus, self.poissons_ratio),
            supports={"left": clamped, "right": clamped},
            tractions={"top": (0.0, 0.0, -self.pressure)},
        )
        return Assembly((plate,))

    def cut(self, case: "StructureCase") -> CutProblem:
        """Cut the plate into boxes."""
        return cut_assembly(self.build(), case.cut.parts)

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        x, y, z = self.elements
        return (x + 1) * (y + 1) * (z + 1)

    def check(self, case: "StructureCase") -> None:
        """Refuse large displacements."""
        if case.statics:
            case.statics.refuse_large()

    def quick(self, case: "StructureCase") -> Self:
        """Return the same plate with four elements along an edge."""
        return self.model_copy(update={"elements": _fewer(self.elements)})


class StackedBlocks(RoughBodies):
    """Equal blocks with rough joints; see :func:`multiscale.macro.bodies.stacked_blocks`."""

    kind: Literal["stacked_blocks"]
    size: Edges = Field(description="Lengths of a block along x, y and z, m.")
    elements: Elements = Field(description="Hexahedra of a block along x, y and z.")
    blocks: Count = Field(2, ge=2, description="Number of blocks, one on the other.")
    youngs_modulus: Pressure = Field(description="Young's modulus, Pa.")
    poissons_ratio: Ratio = Field(description="Poisson's ratio.")
    damage: tuple[Damage, ...] = Field(
        (), description="Damage of blocks from below: each is 1 - D as stiff; sound if not given."
    )
    stiffness: Path | None = Field(
        None,
        description="Dataset `rve_stiffness` whose tensor replaces the moduli of sound blocks.",
    )

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

    def build(self, laws: Sequence[Sliders]) -> Assembly:
        """Build the blocks and their joints."""
        return stacked_blocks(self.size, self.elements, self.materials, laws)

    @property
    def nodes(self) -> tuple[int, int]:
        """Nodes of a block and of its face."""
        x, y, z = self.elements
        return (x + 1) * (y + 1) * (z + 1), (x + 1) * (y + 1)

    def quick(self, case: "StructureCase") -> Self:
        """Return the same blocks with four elements along an edge."""
        return self.model_copy(update={"elements": _fewer(self.elements)})


class LapJoint(RoughBodies):
    """Two bolted plates; see :func:`multiscale.macro.bodies.lap_joint`."""

    mesher: ClassVar[tuple[str, ...]] = ("gmsh",)

    kind: Literal["lap_joint"]
    length: Length = Field(description="Length of each plate along x, m.")
    width: Length = Field(description="Width of each plate, m.")
    thickness: Length = Field(description="Thickness of each plate, m.")
    overlap: Length = Field(description="Length over which the plates lie on each other, m.")
    hole: Length = Field(description="Diameter of the hole, m.")
    washer: Length = Field(description="Diameter of the washer, m.")
    element: Length = Field(description="Edge of an element in plan, m.")
    layers: Positive = Field(2, description="Elements through each thickness.")
    youngs_modulus: Pressure = Field(description="Young's modulus, Pa.")
    poissons_ratio: Ratio = Field(description="Poisson's ratio.")
    damage: tuple[Damage, ...] = Field(
        (), description="Damage of the lower and the upper plate, as of blocks."
    )
    stiffness: Path | None = Field(
        None, description="Stiffness of both plates, as for stacked blocks."
    )

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

    def build(self, laws: Sequence[Sliders]) -> Assembly:
        """Build the plates and their joint."""
        shape = LapShape(**self.model_dump(include={field.name for field in fields(LapShape)}))
        return lap_joint(shape, self.materials, laws[0])

    @property
    def nodes(self) -> tuple[int, int]:
        """Nodes of a plate and of the overlap, about."""
        plan, overlap = (
            side * self.width / self.element**2 for side in (self.length, self.overlap)
        )
        return ceil(plan * (self.layers + 1)), ceil(overlap)

    def quick(self, case: "StructureCase") -> Self:
        """Return the same joint with elements no finer than a quarter of the overlap."""
        return self.model_copy(update={"element": max(self.element, self.overlap / QUICK_ELEMENTS)})


def _fewer(elements: Elements) -> Elements:
    x, y, z = (min(QUICK_ELEMENTS, number) for number in elements)
    return x, y, z


def _check_damage(damage: tuple[float, ...], count: int, what: str) -> None:
    """Refuse damages that are not one for each."""
    if damage and len(damage) != count:
        raise ValueError(
            f"damage should have one entry for each {what} ({count}), got {len(damage)}"
        )
