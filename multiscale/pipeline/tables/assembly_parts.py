"""Tables of bodies in a case: meshes, interfaces, stated laws, bolts and named loads."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field

from multiscale import macro
from multiscale.errors import CaseError
from multiscale.fe.mesh_file import load_geometry
from multiscale.io.csv_tables import read_table
from multiscale.laws import Exponential, Tabulated
from multiscale.laws.bulk import AnisotropicElastic, Elastic
from multiscale.pipeline.tables import toml_model as toml
from multiscale.pipeline.tables.grain_settings import SlidingSpeed
from multiscale.pipeline.tables.joint_settings import (
    RUN_QUICK,
    Damage,
    JointLaw,
    LawError,
    StatedAsperities,
)
from multiscale.pipeline.tables.rve_settings import Direction
from multiscale.pipeline.tables.structure_kind import Face
from multiscale.units import to_si

if TYPE_CHECKING:
    from skfem import Mesh


COARSER = 1.2  # ratio of the sizes of elements below which two meshes have no error to compare
SOLID_DENSITIES = (10.0, 23e3)  # densities of solids, from foams to osmium, kg/m3
GROUNDED = "ground"  # first side of an interface with the rigid ground
QUICK_ELEMENT = 1.5  # element size of quick geometries over the size stated

RUN_QUICK_RVE = toml.Quick(lambda body, _: body.rve is not None)
FIRST = toml.Quick(lambda body, order: order if body.element else 1)
"""Keys of quick bodies: whether the case of a volume is run quick, and the order of the elements of
meshes from files, which cannot be coarsened."""

LARGE, SMALL = 10.0, 1e-3  # lengths of a body, m, beyond which the unit of its mesh must be given
ANY_MODULUS = 1e9  # Young's modulus of a body that is built only for its mesh and faces, Pa
PLANE = 1e-6  # spread of the unit normals of a plane face

CLAMPED = "xyz"


def _read_axes(value: object) -> object:
    if value == "clamped":
        return CLAMPED
    if not (isinstance(value, str) and value and set(value) <= set(CLAMPED)):
        raise ValueError(
            f'should be "clamped", or the axes along which nothing moves, such as "z" or "xy", '
            f"got {value!r}"
        )
    return value


def _read_component(value: object, *, unit: str) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool) and value == 0:
        return 0.0
    try:
        return to_si(value, unit)
    except CaseError as error:
        raise ValueError(str(error)) from error


def _read_unit(value: object) -> object:
    """Read ``"mm"`` as ``"1 mm"``."""
    return f"1 {value}" if isinstance(value, str) and value.isalpha() else value


Axes = Annotated[str, BeforeValidator(_read_axes)]
Stress = Annotated[
    float, BeforeValidator(partial(_read_component, unit="Pa")), toml.with_unit("Pa")
]
Newton = Annotated[float, BeforeValidator(partial(_read_component, unit="N")), toml.with_unit("N")]
Size = Annotated[float, toml.quantity("N", uncertain=True), Field(gt=0.0), toml.with_unit("N")]
Stiffness = Annotated[float, toml.quantity("N/m"), Field(gt=0.0), toml.with_unit("N/m")]
UncertainStiffness = Annotated[
    float, toml.quantity("Pa/m", uncertain=True), Field(gt=0.0), toml.with_unit("Pa/m")
]
Unit = Annotated[toml.Length, BeforeValidator(_read_unit)]
Name = Annotated[str, Field(pattern=r"^[^.\s]+$")]


def doubt_density(name: str, density: float | None) -> list[str]:
    """Return a caution if no solid has a density, kg/m3."""
    low, high = SOLID_DENSITIES
    if density is None or low <= density <= high:
        return []
    return [
        f"{name} has a density of {density:.4g} kg/m^3, and solids have {low:g} to {high:g} "
        f"kg/m^3; check its unit, as in 7.85 g/cm^3 or 7850 kg/m^3"
    ]


class Material(toml.Settings):
    """Material of an elastic body: moduli or a representative volume."""

    youngs_modulus: toml.Pressure | None = None
    """Young's modulus, Pa; the stiffness of a representative volume if not given."""
    poissons_ratio: toml.Ratio | None = None
    """Poisson's ratio; together with the modulus."""
    density: toml.Density | None = Field(None, description="Density, kg/m3; [vibration] needs it.")
    rve: Path | None = None
    """Representative volume: a dataset `rve`, the folder of a run, or a case, which is run in a
    separate folder; the `[rve]` of this case if neither `rve` nor moduli are given."""
    rve_axes: tuple[Direction, Direction] | None = None
    """Directions of the x and y axes of the volume in the body; the axes of the body if not
    given."""

    def _faults(self) -> Iterator[str]:
        if (self.youngs_modulus is None) != (self.poissons_ratio is None):
            yield "youngs_modulus and poissons_ratio belong together; give both or neither"
        if not self.porous and self.rve is not None:
            yield "takes either its moduli or rve, a volume with the moduli of its solid"
        if self.rve_axes is not None:
            first, second = np.array(self.rve_axes, dtype=float)
            norms = np.linalg.norm(first) * np.linalg.norm(second)
            if not (norms > 0.0 and abs(first @ second) < 1e-3 * norms):
                directions = " and ".join(f"{list(direction)}" for direction in self.rve_axes)
                yield f"rve_axes are two directions at right angles, got {directions}"

    @property
    def moduli(self) -> tuple[float, float]:
        """Young's modulus, Pa, and Poisson's ratio of a body that is not porous."""
        assert self.youngs_modulus is not None
        assert self.poissons_ratio is not None
        return self.youngs_modulus, self.poissons_ratio

    @property
    def porous(self) -> bool:
        """Whether the stiffness comes from a representative volume."""
        return self.youngs_modulus is None

    @property
    def axes(self) -> np.ndarray:
        """Axes of the representative volume in the body, as columns, shape (3, 3)."""
        if self.rve_axes is None:
            return np.eye(3)
        first, second = np.array(self.rve_axes, dtype=float)
        first = first / np.linalg.norm(first)
        second = second - (second @ first) * first
        second = second / np.linalg.norm(second)
        return np.stack([first, second, np.cross(first, second)], axis=1)


class MeshedBody(Material):
    """An elastic body with a mesh."""

    name: Name = Field(description="Name of the body, without dots.")
    mesh: Path
    """Mesh of tetrahedra or hexahedra with named faces: a file of gmsh, of Salome (`.med`), of
    Abaqus or CalculiX (`.inp`), or of another program that meshio or gmsh reads; or a geometry of
    gmsh with physical surfaces, a file `.geo`, which is meshed. Groups and surfaces name faces, and
    a set of nodes names the outer faces with all corners in the set. Nodes between the corners are
    removed; `order` adds nodes on straight edges."""
    element: Annotated[toml.Length | None, toml.Quick(lambda _, h: h and QUICK_ELEMENT * h)] = None
    """Largest edge of the elements of a geometry, m; the error of the mesh comes from elements
    twice as large."""
    coarser: Path | None = None
    """Mesh of the same body with about twice the element size, for the error of the mesh, which is
    unknown without it."""
    volume: str = ""
    """Named volume of the mesh that is the body; or `"tetra"` or `"hexahedron"` in a mesh with
    both; or a named face of the body in a mesh of several volumes. The whole mesh if not given."""
    unit: Unit | None = None
    """Length of the unit of the mesh, such as `"mm"`; m if not given."""
    order: Annotated[Literal[1, 2] | None, FIRST] = None
    """Order of the elements: 2 adds nodes between the corners of the mesh, without which tetrahedra
    are too stiff in bending. If not given, 2 for tetrahedra and 1 for hexahedra, which have
    incompatible modes for bending."""
    youngs_modulus: toml.UncertainPressure | None = None
    """Young's modulus, Pa; the stiffness of a representative volume if not given."""
    damage: Damage = Field(0.0, description="Damage D of the body, with stiffness times 1 - D.")
    quick: Annotated[bool, RUN_QUICK_RVE] = False
    """Whether a case that `rve` names is run `--quick`."""
    supports: dict[str, Axes] = Field({})
    """Faces that are fixed: `"clamped"`, or the axes along which they do not move, such as `"z"` or
    `"xy"`."""

    def _faults(self) -> Iterator[str]:
        yield from super()._faults()
        if (self.element is not None) != (self.mesh.suffix == ".geo"):
            yield (
                "a geometry, in a file that ends in .geo, needs the size of its elements by element"
                if self.element is None
                else "element is the size of the elements of a geometry, and mesh has its elements"
            )
        if self.element is not None and self.coarser is not None:
            yield "coarser belongs to a mesh; a geometry is meshed twice anyway"

    @property
    def worst_damage(self) -> float:
        """Damage in the fields of its elements."""
        return self.damage

    def elasticity(self) -> Elastic | AnisotropicElastic:
        """Return the law of the body; an arbitrary law as long as its volume is missing."""
        E = (1.0 - self.damage) * (self.youngs_modulus or ANY_MODULUS)
        return Elastic(E, self.poissons_ratio or 0.0)

    def coarsened(self) -> "Self | None":
        """Return the same body with larger elements, if it has a coarser mesh or a geometry."""
        if self.element is not None:
            return self.model_copy(update={"element": 2.0 * self.element})
        if self.coarser is None:
            return None
        return self.model_copy(update={"mesh": self.coarser, "coarser": None})

    def check_coarser(self) -> None:
        """Refuse a coarser mesh with elements that are not clearly larger."""
        coarse = None if self.coarser is None else self.coarsened()
        if coarse is None:
            return
        meshes = [body.load() for body in (self, coarse)]
        fine, few = (mesh.nelements for mesh in meshes)
        tetrahedra, fewer = map(n_tetrahedra, meshes)
        most = few * tetrahedra / fewer / COARSER**3
        if tetrahedra < COARSER**3 * fewer:
            raise CaseError(
                f"{self.coarser}: coarser of {self.name} has {few} elements and its mesh {fine}, "
                f"and the error of the mesh needs at most {most:.0f}; give a mesh of "
                f"elements about twice as large"
            )

    def load(self) -> "Mesh":
        """Read the mesh."""
        if self.element is None:
            mesh = macro.load_mesh(self.mesh, scale=self.unit or 1.0, volume=self.volume)
        else:
            scale = self.unit or 1.0
            mesh = load_geometry(self.mesh, self.element, scale=scale, volume=self.volume)
        if mesh.dim() != 3:
            raise CaseError(
                f"{self.mesh}: the mesh of {self.name} is plane, and a body takes tetrahedra or "
                f"hexahedra; mesh it in three dimensions"
            )
        if not mesh.boundaries:
            raise CaseError(
                f"{self.mesh}: the mesh of {self.name} names no faces, which supports, interfaces "
                f"and loads need; name them: in gmsh as physical surfaces (and save all elements "
                f"in format 4 only), in Salome as groups of faces, in Abaqus and CalculiX by "
                f"*SURFACE or *NSET"
            )
        extent = np.ptp(mesh.p, axis=1)
        if self.unit is None and not SMALL < extent.max() < LARGE:
            box = " x ".join(f"{length:.4g}" for length in extent)
            raise CaseError(
                f"{self.mesh}: {self.name} would measure {box} m, as the mesh has no unit; give "
                f'unit = "mm" if its coordinates are millimetres, or unit = "m" if it is so large'
            )
        return mesh

    def build(
        self, mesh: "Mesh", tractions: Mapping[str, Mapping[int, np.ndarray]]
    ) -> "macro.Body":
        """Build the body on a mesh, with tractions on faces, Pa, for each load case."""
        from multiscale.fe.elasticity import element_of_order

        supports = {
            boundary: tuple(0.0 if axis in axes else None for axis in CLAMPED)
            for boundary, axes in self.supports.items()
        }
        pulled = {
            boundary: tuple(partial(_at_time, parts, axis) for axis in range(3))
            for boundary, parts in tractions.items()
        }
        return macro.Body(
            mesh,
            self.elasticity(),
            supports,
            pulled,
            element_of_order(mesh, self.order_on(mesh)),
            name=self.name,
            bends=True,
        )

    def count_nodes(self, mesh: "Mesh") -> int:
        """Count the nodes of the body."""
        between = [mesh.edges] if mesh.t.shape[0] == 4 else [mesh.edges, mesh.facets, mesh.t]
        return sum(
            indices.shape[1] for indices in (mesh.p, *between[: 3 * (self.order_on(mesh) - 1)])
        )

    def count_face_nodes(self, mesh: "Mesh", boundary: str) -> int:
        """Count the nodes of the body on a boundary."""
        facets = mesh.boundaries[boundary]
        corners = np.unique(mesh.facets[:, facets]).size
        if self.order_on(mesh) == 1:
            return corners
        middles = facets.size * (mesh.t.shape[0] == 8)  # of quadrilaterals
        return int(corners + np.unique(mesh.f2e[:, facets]).size + middles)

    def order_on(self, mesh: "Mesh") -> int:
        """Order of the elements on its mesh."""
        return self.order or (2 if mesh.t.shape[0] == 4 else 1)


class StatedLaw(toml.Settings):
    """A normal law without cells: the pressure p_c exp(-g/u_0) at the gap g."""

    pressure_scale: toml.UncertainPressure = Field(description="Pressure p_c at zero gap, Pa.")
    decay_length: toml.UncertainLength = Field(description="Decay length u_0 of the pressure, m.")
    pressures: Annotated[tuple[toml.Pressure, toml.Pressure], toml.RISE]
    """Pressures between which the law is valid, Pa, rising."""

    def build(self) -> Exponential:
        """Return the law."""
        return Exponential(self.pressure_scale, self.decay_length, pressure_range=self.pressures)


class LinearLaw(toml.Settings):
    """A normal law without cells: the pressure K a at the overclosure a, and no tension."""

    stiffness: UncertainStiffness = Field(description="Stiffness K of the interface, Pa/m.")
    pressures: ClassVar[tuple[float, float]] = (1.0, 1e9)
    """Pressures of the bed of sliders, Pa; its stiffness is the same at all pressures."""

    def build(self) -> Tabulated:
        """Return the law."""
        return Tabulated(np.array([0.0, self.stiffness]), np.array([0.0, -1.0]))


class StatedGap(toml.Settings):
    """The initial gap of an interface, added to the gap of its law."""

    form: Literal["map"] = Field(description="Origin of the gap.")
    file: Path
    """Table with the columns `x`, `y` and `gap`: points in the plane of the interface, along the
    axes of the structure, and gaps, `nan` in holes."""
    unit: Unit = Field(description='Length of one unit of the table, such as `"mm"`.')

    def build(self) -> "macro.GapMap":
        """Read the map."""
        table = read_table(self.file, lambda name: float)  # holes are nan
        if missing := sorted({"x", "y", "gap"} - set(table)):
            raise CaseError(
                f"{self.file}: no column {missing[0]!r}; a map of a gap has x, y and gap"
            )
        x, y, gap = (self.unit * np.array(table[name], dtype=float) for name in ("x", "y", "gap"))
        return macro.GapMap(np.column_stack([x, y]), gap, str(self.file))


class BodyInterface(toml.Settings):
    """An interface between two named faces; their meshes need not match."""

    sides: tuple[str, str]
    """Both faces, as `"BODY.FACE"`; the first may be `"ground"`."""
    law: Path | None = None
    """Law of this interface: a dataset, the folder of a run, or a case, which is run in a separate
    folder; or a table of `pressure` and `overclosure` in a `.csv` file; if not given, the law of
    the cells or of `[interface]`."""
    law_error: LawError | None = None
    """Relative half-width of the 95 % interval of overclosure and stiffness of a table, such as
    `"10 %"`; the error is unknown if not given."""
    exponential: StatedLaw | None = None
    """Stated normal law, in place of `law`; needs `friction`."""
    linear: LinearLaw | None = None
    """Stated normal law of constant stiffness, as `exponential`."""
    asperities: StatedAsperities | None = None
    """Statistics of asperities, in place of `law`; they need `friction`. Asperities yield and slip
    in the order of their heights."""
    gap: StatedGap | None = None
    """Initial gap over the interface; uniform if not given."""
    quick: Annotated[bool, RUN_QUICK] = False
    """Whether a case that `law` names is run `--quick`."""
    speed: SlidingSpeed | None = None
    """Speed of sliding of a law of grains, m/s, if not the value of `[interface]`."""
    friction: toml.UncertainFactor | None = None
    """Coefficient of friction, if not the value of `[interface]` or the law."""
    stiffness_ratio: Annotated[toml.UncertainNumber, Field(gt=0.0)] | None = None
    """Tangential over normal stiffness, if not the value of `[interface]` or the law."""
    damage: Damage = Field(0.0, description="Damage D of the interface, with its law times 1 - D.")
    surface_damage: bool = False
    """Whether the damage D(n) of sections of the representative volumes of its bodies, normal to
    the interface, counts too: each gives the law a factor 1 - D(n)."""

    def _faults(self) -> Iterator[str]:
        stated = self.exponential, self.linear, self.asperities
        if sum(law is not None for law in (self.law, *stated)) > 1:
            yield "an interface takes one of law, exponential, linear and asperities"
        if self.law_error is not None and self.law is None:
            yield "law_error belongs to a table in law, and the interface has no law"

    @property
    def is_stated(self) -> bool:
        """Whether the case itself states the normal law."""
        return any((self.exponential, self.linear, self.asperities))

    @property
    def faces(self) -> tuple[str, ...]:
        """Faces of bodies, without the ground."""
        return self.sides[self.sides[0] == GROUNDED :]

    @property
    def name(self) -> str:
        """Both faces in words."""
        return " on ".join(reversed(self.sides))

    def over(self, shared: JointLaw | None) -> JointLaw:
        """Return the keys of ``[interface]``, if given, replaced by the keys of this interface."""
        names = ("law", "law_error", "speed", "friction", "stiffness_ratio")
        keys = {name: getattr(self, name) for name in names}
        given = {name: value for name, value in keys.items() if value is not None}
        if self.law is not None:  # of this law, whatever [interface] states
            of_law = {"law_error": self.law_error, "quick": self.quick, "speed": self.speed}
            given |= of_law
        return (shared or JointLaw()).model_copy(update=given)


class BodyBolt(toml.Settings):
    """A bolt between two opposite faces along x, y or z.

    Its washers are rigid and tilt, and it carries no shear. A meshed bolt is part of both bodies,
    and bends and shears with them.
    """

    sides: tuple[str, str]
    """Faces under head and nut, as `"BODY.FACE"`, of the size of the washers; or both faces of a
    cut across a meshed shank."""
    meshed: bool = False
    """Whether the meshes of the bodies contain the bolt, with a cut across its shank. Both faces of
    the cut have equal displacements across the axis; along the axis acts the constant preload."""
    preload: Size = Field(description="Force of the bolt at the factor 1 of `preload`, N.")
    diameter: toml.Length | None = Field(None, description="Diameter of the shank, m.")
    length: toml.Length | None = None
    """Length of the shank, m; the distance of its washers if not given."""
    youngs_modulus: toml.Pressure = Field(210e9, description="Young's modulus of the shank, Pa.")
    stiffness: Stiffness | None = None
    """Axial stiffness of the shank, N/m, in place of its diameter."""

    def _faults(self) -> Iterator[str]:
        if self.meshed and (self.diameter or self.stiffness or self.length):
            yield "a meshed bolt must not have a diameter, length or stiffness"
        if not self.meshed and (self.diameter is None) == (self.stiffness is None):
            yield "a bolt takes either the diameter of its shank or its stiffness"
        if len({side.partition(".")[0] for side in self.sides}) == 1:
            yield (
                f"a bolt between two faces of one body clamps nothing, got {self.sides[0]!r} and "
                f"{self.sides[1]!r}; name a face of another body in sides"
            )

    def build(
        self, sides: tuple[int, int], boundaries: tuple[str, str], bodies: "Sequence[macro.Body]"
    ) -> "tuple[macro.Bolt, str]":
        """Build the bolt between faces of bodies; return it and a sentence on faces and shank."""
        bolt = macro.Bolt(sides, boundaries, self.stiffness or 1.0, self.preload)
        description = " to ".join(self.sides)
        head, nut = bolt.washers(bodies)
        if self.diameter is None:
            return bolt, description
        assert head.point is not None
        assert nut.point is not None
        length = self.length or abs(nut.point[head.axis] - head.point[head.axis])
        between = "" if self.length else " between its washers"
        description += (
            f", shank of {1e3 * length:.4g} mm{between} and {1e-9 * self.youngs_modulus:.4g} GPa"
        )
        k = macro.shank_stiffness(self.diameter, length, self.youngs_modulus)
        return replace(bolt, stiffness=k), description


class NamedLoad(toml.Settings):
    """A load on a face, with a name for the path: a traction, a force or a pressure."""

    name: Name = Field(description="Name of the load.")
    face: str = Field(description='Loaded face, as `"BODY.FACE"`.')
    traction: tuple[Stress, Stress, Stress] | None = None
    """Force per area along x, y and z at the factor 1, Pa."""
    force: tuple[Newton, Newton, Newton] | None = None
    """Resultant along x, y and z, uniformly distributed, at the factor 1, N."""
    pressure: Stress | None = None
    """Pressure on a plane face at the factor 1, Pa."""

    def _faults(self) -> Iterator[str]:
        given = [value for value in (self.traction, self.force, self.pressure) if value is not None]
        if len(given) != 1:
            yield "a load is either a traction, a force or a pressure"
        if not np.any(given[0]):
            yield "the load is zero"

    def traction_on(self, mesh: "Mesh", boundary: str) -> tuple[np.ndarray, float]:
        """Return the traction at the factor 1, Pa, and the area of the face, m²."""
        face = Face.at(mesh, boundary)
        if self.force is not None:
            return np.array(self.force) / face.area, face.area
        if self.traction is not None:
            return np.array(self.traction), face.area
        if np.linalg.norm(face.normal) < 1.0 - PLANE:
            raise CaseError(
                f"the load {self.name} is a pressure on {self.face}, which is not plane; give its "
                f"traction or force"
            )
        return -float(self.pressure or 0.0) * face.normal, face.area


def n_tetrahedra(mesh: "Mesh") -> int:
    """Count tetrahedra of about the size of the elements: six fill a hexahedron."""
    return int(mesh.nelements) * (1 if mesh.t.shape[0] == 4 else 6)


def _at_time(
    tractions: Mapping[int, np.ndarray], axis: int, position: np.ndarray, time: float
) -> np.ndarray:
    """One component of the traction of a load case, whose number is the time."""
    traction = tractions.get(int(time))
    return np.full(position.shape[1], 0.0 if traction is None else traction[axis])
