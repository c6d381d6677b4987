"""Cells on scikit-fem meshes: any element, any geometry below a named contact face."""

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from multiscale.errors import CaseError, listed
from multiscale.laws.bulk import J2
from multiscale.laws.bulk.moduli import check_moduli
from multiscale.micro.cell_needs import AVERAGES, CellPart, cell_choices
from multiscale.micro.layer import Linear, PeriodicLayer, statistics_of
from multiscale.micro.path import Path
from multiscale.needs import Needs
from multiscale.surfaces.surface import Surface

if TYPE_CHECKING:
    from skfem import Element, Mesh

    from multiscale.micro.step_loop import CellModel

__all__ = ["CellSides", "MeshCell"]

MOST_FACTORED = 20_000
"""Unknowns above which factors of a stiffness in three dimensions fill up, and multigrid is used.

A rough obstacle, sides of uniform traction, metals and friction have factors always.
"""

MESH = 4e-5  # s of one core for a load step and an unknown, measured


class CellSides(StrEnum):
    """Condition on the sides of a cell on a mesh.

    Periodic sides move alike, sliding ones stay in their planes. Sides of uniform displacement move
    down in proportion to z and not across; the force on their highest node is the resultant of all
    of them. Sides of uniform traction are bent freely at no mean strain in the plane. At a given
    approach the energies of the last two bound the energy of periodic sides from above and below.
    """

    PERIODIC = "periodic"
    SLIDING = "sliding"
    DISPLACEMENT = "displacement"
    TRACTION = "traction"


@dataclass(frozen=True, eq=False)
class MeshCell:
    """A body on any scikit-fem mesh, pressed by a rigid obstacle: the general path.

    Parameters
    ----------
    mesh : Mesh
        Three-dimensional, between planes x = const and y = const, with boundaries named ``"base"``
        (clamped) and ``"top"`` (contact). The top may overhang.
    element : Element
        Scalar element for each displacement component, for instance ``ElementTetP2()``.
    law : Elastic, GradedElastic or J2, graded moduli have the shape (elements,)
    sides : CellSides
        Periodic sides, with nodes that match; sides that slide in their planes; or uniform
        displacement and uniform traction, with answers that enclose the one of periodic sides.
    obstacle : Surface, optional
        Underside of the rigid obstacle; a flat if not given.
    layer : PeriodicLayer, optional
        The layer that the mesh discretises, if its contact nodes are the points of a surface.
    points : tuple of int, optional
        Points along x and y of the fields that are kept of a mesh without such a layer.
    friction_coefficient : float, coefficient of the local Coulomb law

    Raises
    ------
    CaseError
        If a boundary is missing or the moduli do not fit the mesh.
    """

    mesh: "Mesh"
    element: "Element"
    law: Linear | J2
    sides: CellSides = CellSides.PERIODIC
    obstacle: Surface | None = None
    layer: PeriodicLayer | None = None
    points: tuple[int, int] | None = None
    friction_coefficient: float = 0.0
    small_slopes: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if not isinstance(self.law, Linear | J2):
            raise CaseError(
                f"a cell on a general mesh takes Elastic, GradedElastic or J2 as its law, got "
                f"{type(self.law).__name__}"
            )
        mu = self.friction_coefficient
        if not 0.0 <= mu < np.inf:
            raise CaseError(f"the friction coefficient must not be negative, got {mu:g}")
        fits = {CellSides.PERIODIC} if mu > 0.0 else {CellSides.PERIODIC, CellSides.SLIDING}
        if self.remembers and (self.sides not in fits or self.obstacle is not None):
            raise CaseError(
                f"a mesh with {'friction' if mu > 0.0 else 'a metal that flows'} takes "
                f"{' or '.join(sorted(fits))} sides and a flat obstacle, got {self.sides} sides"
                f"{'' if self.obstacle is None else ' and a rough obstacle'}; change them, or put "
                f"the roughness on the mesh"
            )
        check_moduli(self.law.youngs_modulus, self.law.poissons_ratio, least=0.0)
        boundaries = self.mesh.boundaries or {}
        missing = sorted({"base", "top"} - set(boundaries))
        if missing:
            raise CaseError(
                f"the mesh has no boundary named {' and '.join(missing)}, which a cell needs; its "
                f"boundaries are {listed(boundaries)}"
            )
        for name, value in (
            ("Young's modulus", self.law.youngs_modulus),
            ("Poisson's ratio", self.law.poissons_ratio),
        ):
            if np.shape(value) not in ((), (self.mesh.nelements,)):
                raise CaseError(
                    f"give one {name} or one per element ({self.mesh.nelements}), got "
                    f"{np.shape(value)}"
                )
        if self.obstacle is not None and self.sides in (CellSides.DISPLACEMENT, CellSides.TRACTION):
            raise CaseError(
                f"sides of uniform {self.sides.value} go with a flat obstacle; choose periodic or "
                f"sliding sides, or put the roughness on the mesh"
            )

    @property
    def unknowns(self) -> int:
        """Number of displacements of all nodes."""
        from skfem.assembly import Dofs

        return 3 * int(Dofs(self.mesh, self.element).N)

    @property
    def multigrid(self) -> bool:
        """Whether multigrid solves contact, in place of factors of the stiffness."""
        flat = self.obstacle is None and self.sides is not CellSides.TRACTION
        return flat and not self.remembers and self.unknowns > MOST_FACTORED

    @property
    def recovers_stress(self) -> bool:
        """Whether all contact forces come from stresses: sides that move as one have others."""
        return self.sides is not CellSides.DISPLACEMENT and not self.remembers

    @property
    def remembers(self) -> bool:
        """Whether the answer depends on the path: the body flows, or there is friction."""
        return self.law.flows or self.friction_coefficient > 0.0

    @property
    def field_shape(self) -> tuple[int, int] | None:
        """Points along x and y of the fields that can be kept, if any."""
        return self.points if self.layer is None else self.layer.field_shape

    @property
    def grid_spacing(self) -> tuple[float, float] | None:
        """Distance of points along x and y of the gap, m; none without a surface."""
        return None if self.layer is None else self.layer.grid_spacing

    def cautions(self) -> list[str]:
        """Return what a user should know before trusting the results, one sentence each."""
        cautions = [] if self.layer is None else self.layer.cautions()
        if self.law.flows and self.element.maxdeg == 1:
            cautions.append(
                "tetrahedra of first order lock where a metal flows at constant volume, and are "
                "too stiff; take the element tet10 or hex8"
            )
        return cautions

    def surface_record(self, *, heights: bool) -> dict[str, np.ndarray]:
        """Return statistics of the surface that a response keeps, and its heights, m."""
        if self.field_shape is None:
            return {}
        if self.layer is not None:
            return statistics_of(self.layer.surface, heights=heights)
        from multiscale.micro.mesh.elastic_mesh import uppermost_facets

        height, _ = uppermost_facets(self)
        size = np.ptp(self.mesh.p, axis=1)
        seen = Surface(height - height.mean(), (float(size[0]), float(size[1])))
        return statistics_of(seen, heights=heights)

    def needs(self) -> Needs:
        """Parts, memory and time that a step takes."""
        large, mu = self.law.finite_strain, self.friction_coefficient
        unknowns, multigrid = self.unknowns, self.multigrid
        # measured with hexahedra of 37,000 to 553,000 unknowns: assembly, stiffness, coarse spaces
        entries = {4: 45, 8: 81, 10: 85, 27: 110}[len(self.element.doflocs)]  # in a row
        factors = 0.0 if multigrid else 12 * unknowns**1.33
        matrices = 2 if self.remembers else 1  # the stiffness, and Newton's matrix
        return Needs(
            unknowns_per_contact=3 if mu > 0.0 else 1,
            kinematics=f"{'large' if large else 'small'} strain on a finite-element mesh, rigid "
            f"{'flat' if self.obstacle is None else 'rough'} obstacle",
            choices=cell_choices(
                {
                    CellPart.STIFFNESS: True,
                    CellPart.TANGENT: large,
                    CellPart.FRICTION: mu > 0.0,
                    CellPart.MEAN_DILATATION: self.law.flows and self.element.maxdeg <= 3,
                    CellPart.FACTORS: not multigrid,
                    CellPart.MULTIGRID: multigrid,
                    CellPart.OBSTACLE_NORMALS: self.obstacle is not None,
                    CellPart.ELEMENT_MODULI: np.ndim(self.law.youngs_modulus) > 0,
                },
                {
                    CellPart.STIFFNESS: "of the elements, as a matrix",
                    CellPart.FACTORS: "of Newton's matrix, computed in every iteration"
                    if self.remembers
                    else CellPart.FACTORS.why,
                    CellPart.TANGENT: "of the elements as they are strained, as a matrix",
                    CellPart.MEAN_DILATATION: AVERAGES.format("in the energy"),
                },
                {
                    CellPart.LAYER_FACTORS: "a matrix is at hand, and has another way to speed up "
                    "the iteration",
                    CellPart.MEAN_DILATATION: "the element is the user's choice",
                },
            ),
            state_variables=self.law.history,
            libraries=("numba", *(["pyamg"] if multigrid else []), "scikit-fem"),
            memory=int(matrices * (140 * unknowns * entries + factors)),
            seconds=MESH * unknowns,
        )

    def model(self, path: Path, *, recover_stress: bool = False) -> "CellModel[Any]":
        """Set up the contact of the cell for a path."""
        if self.remembers:
            from multiscale.micro.mesh.mesh_history import assemble_mesh_history

            return assemble_mesh_history(self, path)
        from multiscale.micro.mesh.elastic_mesh import assemble_elastic_mesh

        path.check_still()
        return assemble_elastic_mesh(self, recover_stress=recover_stress).problem
