"""What a case may say of elastic bodies: blocks, plate, stacked blocks, lap joint."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import fields
from math import ceil, sqrt
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal, Self

from pydantic import Field, model_validator

from multiscale.fe.boxes import box_mesh
from multiscale.fe.lap_mesh import lap_meshes
from multiscale.io import open_dataset
from multiscale.laws import NormalLaw, Sliders
from multiscale.laws.bulk import AnisotropicElastic, Elastic
from multiscale.macro import Body
from multiscale.macro.bodies import (
    Assembly,
    LapShape,
    lap_joint,
    shank_stiffness,
    stacked_blocks,
)
from multiscale.macro.data_range import FAR_FACTOR
from multiscale.macro.substructures import CutProblem, cut_assembly
from multiscale.pipeline.joint_settings import (
    FEW_SLABS,
    SLABS,
    Cycles,
    Damage,
    LawSource,
    Preloads,
    RisingPreloads,
    RoughInterface,
)
from multiscale.pipeline.link_settings import Statics
from multiscale.pipeline.structure_kind import StructureKind
from multiscale.pipeline.toml_model import (
    Count,
    Length,
    Positive,
    Pressure,
    Ratio,
    Settings,
)
from multiscale.schema import DAMAGE_SECTIONS, RVE
from multiscale.upscaling import law_from_dataset, with_damage

if TYPE_CHECKING:
    import xarray as xr

    from multiscale.pipeline.settings import Case
    from multiscale.pipeline.stage import Datasets

__all__ = [
    "COARSER",
    "Blocks",
    "LapJoint",
    "Plate",
    "RoughBodies",
    "StackedBlocks",
    "elasticity",
]

PLAN_SHARE, NEAR_HOLE = 1.15, 100
"""Nodes of the plan of a lap joint over those of a grid, and those that hole and washer add; as
counted at four sizes of elements."""

COARSER = 1.2
"""Ratio of the sizes of elements below which two meshes tell no error."""

QUICK_ELEMENTS = 4
"""Elements along an edge, at most."""

Edges = tuple[Length, Length, Length]
Elements = tuple[Positive, Positive, Positive]


class Blocks(StructureKind):
    """Two blocks pressed together, evenly, of the materials of both bodies."""

    stage: ClassVar[str] = "joint"
    asks: ClassVar[tuple[tuple[str, ...], ...]] = (("statics",), ("interface", "statics"))
    models: ClassVar[Mapping[str, type[Settings]]] = {
        "interface": LawSource,
        "statics": RisingPreloads,
    }
    of_bodies: ClassVar[bool] = True

    kind: Literal["blocks"]
    height: Length = Field(description="Height of each block, m.")
    width: Length = Field(description="Edge of their square section, m.")

    @property
    def interface_width(self) -> float:
        """Edge of the interface, m."""
        return self.width

    def check(self, case: "Case") -> None:
        """Refuse a joint that the cells will tell nothing of."""
        if not case.has_cells:
            return
        p, given = case.micro.pressures, case.statics.preloads
        low, high = p[0] / FAR_FACTOR, p[-1] * FAR_FACTOR
        far = [preload for preload in given if not low <= preload <= high]
        target = case.accuracy is not None and case.accuracy.quantity == "joint_stiffness"
        if far and (target or (len(far) == len(given) and not case.extrapolate)):
            raise ValueError(
                f"preloads in [statics] of {', '.join(f'{1e-6 * one:g}' for one in far)} MPa lie "
                f"more than a factor of {FAR_FACTOR:g} outside the pressures in [micro], "
                f"{1e-6 * p[0]:g} to {1e-6 * p[-1]:g} MPa: "
                f"the joint would be unknown there; press the cells at such pressures"
                + ("" if target else ", or set extrapolate = true in [law]")
            )


def elasticity(
    youngs_modulus: float, poissons_ratio: float, stiffness: Path | None, damage: float
) -> Elastic | AnisotropicElastic:
    """Make the elasticity of a body of moduli or of a file, 1 - D as stiff."""
    if stiffness is None:
        return Elastic((1.0 - damage) * youngs_modulus, poissons_ratio)
    sound = open_dataset(stiffness, RVE)["stiffness"].values
    return AnisotropicElastic((1.0 - damage) * sound)


class RoughBodies(StructureKind):
    """Elastic bodies with rough joints."""

    stage: ClassVar[str] = "rough_joints"
    asks: ClassVar[tuple[tuple[str, ...], ...]] = (
        ("interface", "statics"),
        ("interface", "statics", "cycles"),
    )
    models: ClassVar[Mapping[str, type[Settings]]] = {
        "interface": RoughInterface,
        "statics": Preloads,
        "cycles": Cycles,
    }
    may_be_cut: ClassVar[bool] = True
    mesher: ClassVar[tuple[str, ...]] = ()
    """Library that meshes the bodies."""

    youngs_modulus: Pressure = Field(description="Young's modulus, Pa.")
    poissons_ratio: Ratio = Field(description="Poisson's ratio.")
    damage: tuple[Damage, ...] = Field(
        (), description="Damage of bodies from below: each is 1 - D as stiff; sound if not given."
    )
    stiffness: Path | None = Field(
        None,
        description="Dataset `rve` whose tensor replaces the moduli of sound bodies.",
    )

    @property
    @abstractmethod
    def joints(self) -> int:
        """Number of joints."""

    @property
    @abstractmethod
    def nodes(self) -> tuple[int, int]:
        """Nodes of a body and of its face, about."""

    @abstractmethod
    def coarser(self) -> Mapping[float, Self]:
        """Return the same structure on larger elements, if any, by the ratio of their sizes."""

    @abstractmethod
    def build(self, laws: Sequence[Sliders]) -> Assembly:
        """Build bodies and joints, whose laws are given from below.

        Raises
        ------
        MultiscaleError
            If dimensions are refused, or a file that is named cannot be read.
        """

    def assemble(
        self,
        case: "Case",
        law: "xr.Dataset",
        *,
        normal: NormalLaw | None = None,
        sample: int | None = None,
    ) -> Assembly:
        """Build bodies and joints of a case, with the law of :meth:`Case.interface_law`.

        Parameters
        ----------
        case : Case
        law : Dataset
        normal : NormalLaw, optional
            Instead of the normal law of the dataset.
        sample : int, optional
            Which bootstrap sample of the law; the mean if not given.
        """
        return self.build(self.sliders(case, law, normal=normal, sample=sample))

    def sliders(
        self,
        case: "Case",
        law: "xr.Dataset",
        *,
        normal: NormalLaw | None = None,
        sample: int | None = None,
    ) -> list[Sliders]:
        """Make the laws of the joints, from below; parameters are those of :meth:`assemble`."""
        sound = law_from_dataset(law, sample) if normal is None else normal
        pressures, slabs = case.statics.joint_pressures, self.slabs(case)
        made: list[Sliders] = case.interface.build(
            law, sound, self.joints, pressures, slabs, sample
        )
        return made

    def complete_law(self, law: "xr.Dataset", case: "Case") -> "xr.Dataset":
        """Return the law of the joints with friction, and with the damage near the surface."""
        interface: RoughInterface = case.interface
        pressure = case.statics.preloads[-1]
        law = interface.complete(law, self.poissons_ratio, pressure, case.strict)
        if interface.damage_file is None:
            return law
        return with_damage(law, open_dataset(interface.damage_file, DAMAGE_SECTIONS))

    def slabs(self, case: "Case") -> int:
        """Slabs of the law of the joints: the loss of a cycle is a small difference."""
        return SLABS if case.cycles else FEW_SLABS

    def cut(self, case: "Case", found: "Datasets") -> CutProblem:
        """Cut every body into boxes."""
        return cut_assembly(self.assemble(case, case.interface_law(found)), case.cut.parts)

    @model_validator(mode="after")
    def _check_damage(self) -> Self:
        if self.damage and len(self.damage) != self.joints + 1:
            raise ValueError(
                f"damage should have one entry for each body ({self.joints + 1}), got "
                f"{len(self.damage)}"
            )
        return self

    @property
    def damages(self) -> tuple[float, ...]:
        """Damage of every body."""
        return self.damage or (0.0,) * (self.joints + 1)

    @property
    def materials(self) -> list[Elastic | AnisotropicElastic]:
        """Elasticity of every body, less its damage."""
        return [
            elasticity(self.youngs_modulus, self.poissons_ratio, self.stiffness, D)
            for D in self.damages
        ]

    def check(self, case: "Case") -> None:
        """Refuse damages that are not one for each joint, and friction that nothing tells."""
        if case.has_cells:
            slid = case.slide is not None and case.slide.distance >= case.cell.size[0]
            known = {"friction"} if slid else set()
            if case.micro.shear is not None:
                known = {"friction", "stiffness_ratio"}
            if missing := case.interface.tell_missing(known, case.strict):
                raise ValueError(missing)
        damage = case.interface.damage
        if damage and case.interface.damage_file is not None:
            raise ValueError(
                "[interface] has damage and damage_file, which both tell the damage of the "
                "interfaces; leave out one of them"
            )
        if damage and len(damage) != self.joints:
            raise ValueError(
                f"[interface] damage should have one entry for each joint ({self.joints}), got "
                f"{len(damage)}"
            )


class Plate(StructureKind):
    """An elastic plate, clamped on its left and right edges, under an even pressure on its top."""

    stage: ClassVar[str] = "plate"
    asks: ClassVar[tuple[tuple[str, ...], ...]] = (("statics",),)
    models: ClassVar[Mapping[str, type[Settings]]] = {"statics": Statics}
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

    def cut(self, case: "Case", found: "Datasets") -> CutProblem:
        """Cut the plate into boxes."""
        return cut_assembly(self.build(), case.cut.parts)

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        x, y, z = self.elements
        return (x + 1) * (y + 1) * (z + 1)

    def check(self, case: "Case") -> None:
        """Refuse large displacements."""
        case.statics.refuse_large()

    def quick(self, case: "Case") -> Self:
        """Return the same plate with four elements along an edge."""
        return self.model_copy(update={"elements": _fewer(self.elements)})


class StackedBlocks(RoughBodies):
    """Equal blocks with rough joints; see :func:`multiscale.macro.bodies.stacked_blocks`."""

    kind: Literal["stacked_blocks"]
    size: Edges = Field(description="Lengths of a block along x, y and z, m.")
    elements: Elements = Field(description="Hexahedra of a block along x, y and z.")
    blocks: Count = Field(2, ge=2, description="Number of blocks, one on the other.")

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.blocks - 1

    def coarser(self) -> Mapping[float, Self]:
        """Return the same blocks on elements of twice the size; none if their number is odd."""
        if any(number % 2 for number in self.elements):
            return {}
        x, y, z = (number // 2 for number in self.elements)
        return {2.0: self.model_copy(update={"elements": (x, y, z)})}

    def build(self, laws: Sequence[Sliders]) -> Assembly:
        """Build the blocks and their joints."""
        return stacked_blocks(self.size, self.elements, self.materials, laws)

    @property
    def nodes(self) -> tuple[int, int]:
        """Nodes of a block and of its face."""
        x, y, z = self.elements
        return (x + 1) * (y + 1) * (z + 1), (x + 1) * (y + 1)

    def quick(self, case: "Case") -> Self:
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
    bolt: Length | None = Field(
        None,
        description="Diameter of the shank of a bolt of the modulus of the plates, m: its force "
        "changes with the load; the force is constant if not given.",
    )
    element: Length = Field(description="Edge of an element in plan, m.")
    layers: Positive = Field(2, description="Elements through each thickness.")

    @property
    def joints(self) -> int:
        """Number of joints."""
        return 1

    @property
    def shape(self) -> LapShape:
        """Dimensions and mesh."""
        return LapShape(**self.model_dump(include={field.name for field in fields(LapShape)}))

    def coarser(self) -> Mapping[float, Self]:
        """Return the same joint on larger elements in plan, as far as its hole lets them grow."""
        larger = self.model_copy(update={"element": 2.0 * self.element})
        own, coarse = (lap_meshes(one.shape)[0].nelements for one in (self, larger))
        ratio = sqrt(own / coarse)
        return {ratio: larger} if ratio >= COARSER else {}

    @model_validator(mode="after")
    def _check_bolt(self) -> Self:
        if self.bolt is not None and self.bolt > self.hole:
            raise ValueError(
                f"bolt of {1e3 * self.bolt:g} mm does not go through a hole of "
                f"{1e3 * self.hole:g} mm; give the diameter of its shank"
            )
        return self

    def build(self, laws: Sequence[Sliders]) -> Assembly:
        """Build the plates and their joint."""
        shank = (
            None
            if self.bolt is None
            else shank_stiffness(self.bolt, 2.0 * self.thickness, self.youngs_modulus)
        )
        return lap_joint(self.shape, self.materials, laws[0], shank)

    @property
    def nodes(self) -> tuple[int, int]:
        """Nodes of a plate and of the overlap, about."""
        plan, overlap = (
            PLAN_SHARE * (side / self.element + 1.0) * (self.width / self.element + 1.0) + NEAR_HOLE
            for side in (self.length, self.overlap)
        )
        return ceil(plan) * (self.layers + 1), ceil(overlap)

    def quick(self, case: "Case") -> Self:
        """Return the same joint with elements no finer than a quarter of the overlap."""
        return self.model_copy(update={"element": max(self.element, self.overlap / QUICK_ELEMENTS)})


def _fewer(elements: Elements) -> Elements:
    x, y, z = (min(QUICK_ELEMENTS, number) for number in elements)
    return x, y, z
