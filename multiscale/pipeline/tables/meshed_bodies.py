"""Tables of the bodies of a case: materials and meshes."""

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field

from multiscale import macro
from multiscale.errors import CaseError
from multiscale.fe.mesh_file import load_geometry
from multiscale.laws.bulk import AnisotropicElastic, Elastic
from multiscale.pipeline.tables import toml_model as toml
from multiscale.pipeline.tables.joint_settings import Damage
from multiscale.pipeline.tables.rve_settings import Direction

if TYPE_CHECKING:
    from skfem import Mesh


COARSER = 1.2  # ratio of the sizes of elements below which two meshes have no error to compare
SOLID_DENSITIES = (10.0, 23e3)  # densities of solids, from foams to osmium, kg/m3
QUICK_ELEMENT = 1.5  # element size of quick geometries over the size stated

RUN_QUICK_RVE = toml.Quick(lambda body, _: body.rve is not None)
FIRST = toml.Quick(lambda body, order: order if body.element else 1)
"""Keys of quick bodies: whether the case of a volume is run quick, and the order of the elements of
meshes from files, which cannot be coarsened."""

LARGE, SMALL = 10.0, 1e-3  # lengths of a body, m, beyond which the unit of its mesh must be given
ANY_MODULUS = 1e9  # Young's modulus of a body that is built only for its mesh and faces, Pa

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


def _read_unit(value: object) -> object:
    """Read ``"mm"`` as ``"1 mm"``."""
    return f"1 {value}" if isinstance(value, str) and value.isalpha() else value


Axes = Annotated[str, BeforeValidator(_read_axes)]
LengthUnit = Annotated[toml.Length, BeforeValidator(_read_unit)]
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
    unit: LengthUnit | None = None
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


def n_tetrahedra(mesh: "Mesh") -> int:
    """Count tetrahedra of about the size of the elements: six fill a hexahedron."""
    return int(mesh.nelements) * (1 if mesh.t.shape[0] == 4 else 6)


def _at_time(
    tractions: Mapping[int, np.ndarray], axis: int, position: np.ndarray, time: float
) -> np.ndarray:
    """One component of the traction of a load case, whose number is the time."""
    traction = tractions.get(int(time))
    return np.full(position.shape[1], 0.0 if traction is None else traction[axis])
