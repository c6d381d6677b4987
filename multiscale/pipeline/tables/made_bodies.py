"""Bodies defined by dimensions: blocks, plate, stacked blocks and lap joint."""

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace
from math import ceil, pi, sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from multiscale import macro
from multiscale.errors import CaseError
from multiscale.fe.mesh_file import box_mesh
from multiscale.laws import InterfaceLaw
from multiscale.laws.bulk import AnisotropicElastic, Elastic
from multiscale.macro import substructures
from multiscale.macro.data_range import FAR_FACTOR
from multiscale.pipeline.tables import assembly_parts, joint_settings, meshed_bodies
from multiscale.pipeline.tables import toml_model as toml
from multiscale.pipeline.tables.porous_body import PorousBody
from multiscale.pipeline.tables.solved_bodies import SolvedBodies, StructureParts, body_faults
from multiscale.pipeline.tables.structure_kind import (
    Pressed,
    StructureKind,
    far_cells,
)
from multiscale.schema import Dataset

if TYPE_CHECKING:
    from skfem import Mesh

    from multiscale.pipeline.stage import Datasets
    from multiscale.pipeline.tables.settings import Case

LEAST, MOST = 0.1, 3.0  # relevant pressures of joints, over the smallest and the largest preload
QUICK_ELEMENTS = 4  # elements along an edge, at most

Edges = tuple[toml.Length, toml.Length, toml.Length]
Elements = Annotated[
    tuple[toml.Positive, toml.Positive, toml.Positive],
    toml.Quick(lambda _, elements: tuple(min(QUICK_ELEMENTS, number) for number in elements)),
]


class Blocks(StructureKind):
    """Two uniformly pressed blocks of the materials of both bodies."""

    stage: ClassVar[str] = "joint"
    asks: ClassVar[tuple[tuple[str, ...], ...]] = (("statics",), ("interface", "statics"))
    models: ClassVar[Mapping[str, type[toml.Settings]]] = {
        "interface": joint_settings.LawSource,
        "statics": joint_settings.RisingPreloads,
    }
    of_bodies: ClassVar[bool] = True

    kind: Literal["blocks"]
    height: toml.Length = Field(description="Height of each block, m.")
    width: toml.Length = Field(description="Edge of their square section, m.")

    @property
    def interface_width(self) -> float:
        """Edge of the interface, m."""
        return self.width

    def faults_with(self, case: "Case") -> Iterator[str]:
        """Report preloads far outside the pressures of the cells."""
        yield from far_cells(self, case)
        if case.accuracy is None or case.accuracy.answer not in ("", "joint_stiffness"):
            return
        p = case.micro.pressures
        low, high = p[0] / FAR_FACTOR, p[-1] * FAR_FACTOR
        if far := [preload for preload in case.statics.preloads if not low <= preload <= high]:
            listed = ", ".join(f"{1e-6 * preload:g}" for preload in far)
            yield (
                f"preloads in [statics] of {listed} MPa lie more than a factor of {FAR_FACTOR:g} "
                f"outside the pressures in [micro], {1e-6 * p[0]:g} to {1e-6 * p[-1]:g} MPa: the "
                "answer would be unknown; press the cells at such pressures"
            )

    def pressed(self, case: "Case") -> list[Pressed]:
        """Return the preloads, which press the interface uniformly."""
        return [Pressed("preloads in [statics] press the joint", case.statics.even)]

    def point_pressures(self, result: Dataset) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the preloads, which press a single point."""
        return result["preload"].to_numpy()[:, None], np.ones(1), np.zeros(1, int)

    def with_wide_cells(self, case: "Case") -> "Case":
        """Return the case with cells as wide as the blocks, of at most the same spacing."""
        if not case.has_cells or case.cell.geometry != "flat" or case.from_maps:
            raise CaseError(
                'way = "direct" in [interface] resolves the roughness of the blocks by cells as '
                "wide as the blocks, which needs flat cells of synthetic surfaces; give "
                '[cell] with geometry = "flat", or take "adaptive" or "concurrent"'
            )
        edges = zip(case.cell.points, case.cell.size, strict=True)
        # even numbers, as coarser cells have half of the points
        points = tuple(2 * ceil(0.5 * n * self.width / edge - 1e-9) for n, edge in edges)
        size = {"size": (self.width, self.width), "points": points}
        return case.model_copy(update={"cell": case.cell.model_copy(update=size)})


PLAN_SHARE, NEAR_HOLE = 1.15, 100
"""Nodes of the plan of a lap joint over the nodes of a grid, and nodes added by hole and washer,
counted for four element sizes."""

Elasticity = Elastic | AnisotropicElastic


class MadeBodies(StructureKind, meshed_bodies.Material):
    """Elastic bodies of the same material with rough joints between neighbours, if several."""

    stage: ClassVar[str] = "loaded_bodies"
    asks: ClassVar[tuple[tuple[str, ...], ...]] = (
        ("interface", "statics"),
        ("interface", "statics", "cycles"),
        ("interface", "statics", "vibration"),
    )
    models: ClassVar[Mapping[str, type[toml.Settings]]] = {
        "interface": joint_settings.RoughInterface,
        "statics": joint_settings.JointPreloads,
        "cycles": joint_settings.Cycles,
    }
    may_be_cut: ClassVar[bool] = True
    may_tire: ClassVar[bool] = True
    mesher: ClassVar[tuple[str, ...]] = ()
    """Library for meshing."""

    damage: tuple[joint_settings.Damage, ...] = ()
    """Damage D of bodies, from the lowest; each stiffness has the factor 1 - D. 0 if not given."""
    quick_rve: Annotated[bool, meshed_bodies.RUN_QUICK_RVE] = False
    """Whether a case that `rve` names is run `--quick`."""

    @property
    @abstractmethod
    def joints(self) -> int:
        """Number of joints."""

    @property
    @abstractmethod
    def nodes(self) -> tuple[int, int]:
        """Approximate number of nodes of a body and of its face."""

    @abstractmethod
    def meshes(self) -> "Sequence[Mesh]":
        """Mesh every body, the lowest first."""

    @abstractmethod
    def coarser(self) -> Mapping[float, Self]:
        """Return the same structure on larger elements, if any, by the ratio of their sizes."""

    def path(self, case: "Case", areas: Sequence[float]) -> "substructures.LoadPath":
        """Return the path over preload and shear, on faces of these areas, m²."""
        preloads = case.statics.preloads
        path = case.cycles.path(preloads) if case.cycles else substructures.joint_path(preloads)
        return replace(path, forces=tuple(areas))

    def refinement(self) -> float:
        """Return the ratio of the sizes of the elements of the coarser structure; 1 without any."""
        return max(self.coarser(), default=1.0)

    @abstractmethod
    def build(
        self, materials: Sequence[Elasticity], laws: Sequence[InterfaceLaw]
    ) -> "macro.Assembly":
        """Build bodies and joints from materials and laws, the lowest first."""

    @property
    def bodies(self) -> tuple[meshed_bodies.MeshedBody, ...]:
        """All bodies, the lowest first."""
        material = self.model_dump(include=set(meshed_bodies.Material.model_fields)) | {
            "quick": self.quick_rve
        }
        damages = self.damage or (0.0,) * (self.joints + 1)
        return tuple(
            BuiltBody.model_construct(name=f"body {k}", damage=D, source=self, number=k, **material)
            for k, D in enumerate(damages)
        )

    def for_solver(self, case: "Case") -> "JointedBodies":
        """Return bodies and interfaces of a case."""
        damages = (case.interface and case.interface.damage) or (0.0,) * self.joints
        interfaces = tuple(
            assembly_parts.BodyInterface(sides=(f"body {k}.top", f"body {k + 1}.bottom"), damage=D)
            for k, D in enumerate(damages)
        )
        return JointedBodies.model_construct(
            kind="bodies", bodies=self.bodies, interfaces=interfaces, source=self
        )

    def taken_volumes(self) -> set[tuple[Path, bool]]:
        """Return the file of its representative volume, if any, and whether a case is run quick."""
        return set() if self.rve is None else {(self.rve, self.quick_rve)}

    def _faults(self) -> Iterator[str]:
        yield from super()._faults()
        if self.damage and len(self.damage) != self.joints + 1:
            yield (
                f"damage should have one entry for each body ({self.joints + 1}), got "
                f"{len(self.damage)}"
            )

    def faults_with(self, case: "Case") -> Iterator[str]:
        """Report a wrong number of damages, and joints without friction."""
        yield from body_faults(self.bodies, case)
        if case.interface is None:
            return
        yield from far_cells(self, case)
        if case.has_cells:
            yield from case.interface.missing(case.known_shear, case.strict)
        damage = case.interface.damage
        if damage and len(damage) != self.joints:
            yield (
                f"[interface] damage should have one entry for each joint ({self.joints}), got "
                f"{len(damage)}"
            )


class BuiltBody(meshed_bodies.MeshedBody):
    """A body with a generated mesh; no case has such a table."""

    source: Any
    number: int  # from below

    def load(self) -> "Mesh":
        """Build the mesh."""
        mesh: Mesh = self.source.meshes()[self.number]
        return mesh


class JointedBodies(SolvedBodies):
    """Generated bodies, such as a lap joint; no case has such a table."""

    no_coarser: ClassVar[str] = (
        "the error of the mesh is unknown, and in no interval: no structure was solved with "
        "elements of twice the size; give smaller elements, or an even number of them, in "
        "[structure]"
    )

    source: Any

    @property
    def mesher(self) -> tuple[str, ...]:
        """Library for meshing, if any."""
        mesher: tuple[str, ...] = self.source.mesher
        return mesher

    def read_laws(
        self, case: "Case", datasets: "Datasets", open_law: joint_settings.OpenLaw
    ) -> list[Dataset | None]:
        """Read the law of all joints, with friction."""
        if not self.interfaces:
            return []
        interface: joint_settings.RoughInterface = case.interface
        ratio, pressure = self.poissons_ratio(self.interfaces[0]), case.statics.preloads[-1]
        law = interface.complete(
            case.interface_law(datasets, open_law), ratio, pressure, case.strict
        )
        return [law] * len(self.interfaces)

    def joint_size(self, case: "Case") -> "substructures.JointSize":
        """Estimate the numbers of unknowns, points of joints and load steps."""
        (nodes, face), joints, bodies = self.source.nodes, len(self.interfaces), len(self.bodies)
        steps = self.path(case, (1.0, 1.0)).count
        return substructures.JointSize(3 * nodes * bodies, face * joints, bodies, steps)

    def path(self, case: "Case", forces: Sequence[float]) -> "substructures.LoadPath":
        """Return the path over the loads, on faces of these areas, m²."""
        path: substructures.LoadPath = self.source.path(case, forces)
        return path

    def slabs(self, case: "Case") -> int:
        """Slabs of the law of the joints: the loss of a cycle is a small difference."""
        return case.cycles.slabs if case.cycles else joint_settings.FEW_SLABS

    def beds(self, case: "Case") -> dict[str, Any]:
        """Pressures that the beds of the joints resolve, Pa, and number of their slabs."""
        if not self.interfaces:
            return super().beds(case)
        preloads = case.statics.preloads
        ends = (LEAST * min(preloads), MOST * max(preloads))
        return {"pressures": ends, "slabs": self.slabs(case)}

    def build(self, case: "Case", laws: Sequence[InterfaceLaw]) -> StructureParts:
        """Build bodies and joints, and the path over preload and shear."""
        assembly = self.source.build([body.elasticity() for body in self.bodies], laws)
        return StructureParts(assembly, self.path(case, assembly.areas))

    def coarser(self) -> dict[float, Self]:
        """Return the same structure on larger elements, if any, by the ratio of their sizes."""
        coarse = {}
        for ratio, larger in self.source.coarser().items():
            bodies = tuple(
                PorousBody.of(new, old.volume_data) if isinstance(old, PorousBody) else new
                for new, old in zip(larger.bodies, self.bodies, strict=True)
            )
            coarse[ratio] = self.model_copy(update={"source": larger, "bodies": bodies})
        return coarse


class Boxes(MadeBodies):
    """Equal boxes of hexahedra."""

    size: Edges = Field(description="Lengths of a box along x, y and z, m.")
    elements: Elements = Field(description="Hexahedra of a box along x, y and z.")

    def coarser(self) -> Mapping[float, Self]:
        """Return the same boxes on elements of twice the size; none if their number is odd."""
        if any(number % 2 for number in self.elements):
            return {}
        x, y, z = (number // 2 for number in self.elements)
        return {2.0: self.model_copy(update={"elements": (x, y, z)})}

    def meshes(self) -> "Sequence[Mesh]":
        """Mesh every box in the position of the lowest."""
        return [box_mesh(self.size, self.elements)] * (self.joints + 1)

    @property
    def nodes(self) -> tuple[int, int]:
        """Nodes of a box and of its face."""
        x, y, z = self.elements
        return (x + 1) * (y + 1) * (z + 1), (x + 1) * (y + 1)


class Plate(Boxes):
    """An elastic plate, clamped on its left and right edges, under a pressure on its top."""

    asks: ClassVar[tuple[tuple[str, ...], ...]] = (("statics",), ("statics", "vibration"))
    models: ClassVar[Mapping[str, type[toml.Settings]]] = {"statics": joint_settings.LoadFactors}
    may_tire: ClassVar[bool] = False

    kind: Literal["plate"]
    pressure: toml.Pressure = Field(description="Pressure on the top at load factor 1, Pa.")

    @property
    def joints(self) -> int:
        """Number of joints."""
        return 0

    def path(self, case: "Case", areas: Sequence[float]) -> "substructures.LoadPath":
        """Return the path over the pressure."""
        forces = tuple(self.pressure * area for area in areas)
        steps = tuple((factor,) for factor in case.statics.load_factors)
        return substructures.LoadPath(("pressure",), forces, steps)

    def build(
        self, materials: Sequence[Elasticity], laws: Sequence[InterfaceLaw]
    ) -> "macro.Assembly":
        """Clamp the plate and load it."""
        clamped = (0.0, 0.0, 0.0)
        plate = macro.Body(
            box_mesh(self.size, self.elements),
            materials[0],
            supports={"left": clamped, "right": clamped},
            tractions={"top": (0.0, 0.0, -self.pressure)},
            bends=True,
        )
        return macro.Assembly((plate,), areas=(self.size[0] * self.size[1],))


class StackedBlocks(Boxes):
    """Equal blocks with rough joints; see :func:`multiscale.macro.bodies.stacked_blocks`."""

    kind: Literal["stacked_blocks"]
    blocks: toml.Count = Field(2, ge=2, description="Number of blocks, stacked along z.")

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.blocks - 1

    def pressed(self, case: "Case") -> list[Pressed]:
        """Return the preloads, which press the joints uniformly."""
        return [Pressed("preloads in [statics] press the joints", case.statics.even)]

    def build(
        self, materials: Sequence[Elasticity], laws: Sequence[InterfaceLaw]
    ) -> "macro.Assembly":
        """Build the blocks and their joints."""
        return macro.bodies.stacked_blocks(self.size, self.elements, materials, laws)


class LapJoint(MadeBodies):
    """Two bolted plates; see :func:`multiscale.macro.bodies.lap_joint`."""

    mesher: ClassVar[tuple[str, ...]] = ("gmsh",)

    kind: Literal["lap_joint"]
    length: toml.Length = Field(description="Length of each plate along x, m.")
    width: toml.Length = Field(description="Width of each plate, m.")
    thickness: toml.Length = Field(description="Thickness of each plate, m.")
    overlap: toml.Length = Field(description="Length of the overlap of the plates, m.")
    hole: toml.Length = Field(description="Diameter of the hole, m.")
    washer: toml.Length = Field(description="Diameter of the washer, m.")
    bolt: toml.Length | None = None
    """Diameter of the shank of a bolt with the modulus of the plates, m, whose force changes with
    the load; a constant force if not given."""
    element: Annotated[
        toml.Length, toml.Quick(lambda joint, h: max(h, joint.overlap / QUICK_ELEMENTS))
    ]
    """Edge of an element in plan, m."""
    layers: toml.Positive = Field(2, description="Elements through each thickness.")

    @property
    def joints(self) -> int:
        """Number of joints."""
        return 1

    @property
    def shape(self) -> "macro.bodies.LapShape":
        """Dimensions and mesh."""
        return macro.bodies.LapShape(
            **self.model_dump(include={field.name for field in fields(macro.bodies.LapShape)})
        )

    def coarser(self) -> Mapping[float, Self]:
        """Return the same joint on larger elements in plan, as far as its hole allows."""
        larger = self.model_copy(update={"element": 2.0 * self.element})
        fine, coarse = (
            macro.bodies.lap_meshes(joint.shape)[0].nelements for joint in (self, larger)
        )
        ratio = sqrt(fine / coarse)
        return {ratio: larger} if ratio >= meshed_bodies.COARSER else {}

    def _faults(self) -> Iterator[str]:
        yield from super()._faults()
        if self.bolt is not None and self.bolt > self.hole:
            yield (
                f"bolt of {1e3 * self.bolt:g} mm does not go through a hole of "
                f"{1e3 * self.hole:g} mm; give the diameter of its shank"
            )
        if self.bolt is not None and self.porous:
            yield (
                "bolt takes the modulus of the plates, and a representative volume has none; "
                "leave it out, and the force of the bolt is constant"
            )

    def pressed(self, case: "Case") -> list[Pressed]:
        """Estimate pressures of the joint: uniform over the overlap, and under the washers."""
        ring, hole = self.shape.ring, pi / 4.0 * self.hole**2
        share = ring / (self.overlap * self.width - hole)
        # at the edge of the hole, solved joints have .75 to 1.2 of the pressure under the washers
        steps = [(share * preload, preload) for preload in case.statics.preloads]
        return [Pressed("preloads in [statics], under the washers, press the joint", steps)]

    def meshes(self) -> "Sequence[Mesh]":
        """Mesh both plates."""
        return macro.bodies.lap_meshes(self.shape)

    def build(
        self, materials: Sequence[Elasticity], laws: Sequence[InterfaceLaw]
    ) -> "macro.Assembly":
        """Build the plates and their joint."""
        shank = None
        if self.bolt is not None:
            shank = macro.shank_stiffness(self.bolt, 2.0 * self.thickness, self.moduli[0])
        return macro.bodies.lap_joint(self.shape, materials, laws[0], shank)

    @property
    def nodes(self) -> tuple[int, int]:
        """Approximate number of nodes of a plate and of the overlap."""
        plan, overlap = (
            PLAN_SHARE * (side / self.element + 1.0) * (self.width / self.element + 1.0) + NEAR_HOLE
            for side in (self.length, self.overlap)
        )
        return ceil(plan) * (self.layers + 1), ceil(overlap)
