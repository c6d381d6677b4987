"""The kinds of cells: geometry, material and obstacle of each."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from multiscale.errors import CaseError, listed
from multiscale.laws.bulk import J2, Elastic, GradedElastic, NeoHookean, Prony
from multiscale.laws.bulk.moduli import check_moduli, lame_parameters
from multiscale.micro.coating import (
    Coating,
    coating_faces,
    elements_of,
    follow_faces,
    moduli_by_layer,
)
from multiscale.micro.graph_mesh import graded_planes
from multiscale.micro.layered import layered_compliance
from multiscale.surfaces.preparation import composite
from multiscale.surfaces.statistics import nayak_parameter, rms_height, rms_slope
from multiscale.surfaces.surface import Surface

if TYPE_CHECKING:
    from skfem import Element, Mesh

__all__ = [
    "AnyCell",
    "CellSides",
    "FiniteCell",
    "FlatCell",
    "GraphCell",
    "GridCell",
    "MeshCell",
    "PeriodicLayer",
    "SecondBody",
    "depth_caution",
]

FEWEST_ELEMENTS = 3
"""Layers of elements from which a coating is resolved."""

STEEPEST = 0.5
"""Root mean square slope up to which a compliance is expanded in the slopes."""

Linear = Elastic | GradedElastic
LayerLaw = Linear | NeoHookean | J2 | Prony


def depth_caution(depth: float, period: float) -> str | None:
    """Return how a layer thinner than the period changes the answer, if it is."""
    if depth >= 0.99 * period:
        return None
    nu, planes = 0.3, np.array([0.0, depth])
    moduli = lame_parameters(np.ones(1), nu)
    waves = layered_compliance((2, 1), (period, period), planes, *moduli)
    share = float(waves[1, 0]) * np.pi / (period * (1.0 - nu**2))  # of a half-space's compliance
    return (
        f"a depth of {depth:.3g} m below a period of {period:.3g} m makes the longest wave "
        f"{100.0 * (1.0 - share):.2g} % too stiff"
    )


def _surface_record(surface: Surface, heights: bool) -> dict[str, np.ndarray]:
    statistics = (rms_height, rms_slope, nayak_parameter)
    kept = {one.__name__: np.array([one(surface)]) for one in statistics}
    return kept | ({"height": surface.heights.T[None]} if heights else {})


@dataclass(frozen=True, eq=False)
class PeriodicLayer:
    """A deformable periodic layer on a clamped base, whose top is a graph.

    Parameters
    ----------
    surface : Surface, heights of the top; for two rough bodies the heights of the composite surface
    depth : float, distance from the clamped base to the mean plane of the top, m
    layers : int, layers of elements, graded towards the top
    law : Elastic, GradedElastic, NeoHookean, J2 or Prony
        Graded moduli have the shape (layers,), from the base up, or (nx, layers, ny).
    coating : tuple of Coating
        Layers of other materials at the top, outermost first, on a body of one Elastic law. Node
        planes of a mesh move onto their lower faces.

    Raises
    ------
    CaseError
        If a parameter is outside its range.
    """

    surface: Surface
    depth: float
    layers: int
    law: LayerLaw
    coating: tuple[Coating, ...] = field(default=(), kw_only=True)
    small_slopes: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if not isinstance(self.law, LayerLaw):
            raise CaseError(
                f"a cell takes Elastic, GradedElastic, NeoHookean, J2 or Prony as its law, got "
                f"{type(self.law).__name__}"
            )
        check_moduli(self.law.youngs_modulus, self.law.poissons_ratio, least=0.0)
        nx, ny = self.surface.heights.shape
        for name in ("youngs_modulus", "poissons_ratio"):
            shape = np.shape(getattr(self.law, name))
            if shape not in ((), (self.layers,), (nx, self.layers, ny)):
                raise CaseError(
                    f"{name} must be one number, one of each layer ({self.layers},) or one of each "
                    f"element ({nx}, {self.layers}, {ny}), got shape {shape}"
                )
        if not self.depth > 0.0:
            raise CaseError(f"the depth of the cell must be positive (m), got {self.depth:g}")
        if self.layers < 2:
            raise CaseError(f"the cell needs at least 2 layers, got {self.layers}")
        one = np.ndim(self.law.youngs_modulus) == np.ndim(self.law.poissons_ratio) == 0
        if self.coating and (self.law.finite_strain or not one):
            raise CaseError(
                f"a coating lies on a body of one elastic material, and the law of the cell is "
                f"{type(self.law).__name__}; leave out the coating, or give Elastic"
            )
        coating_faces(self.coating, self.depth)  # checks itself

    @property
    def field_shape(self) -> tuple[int, int]:
        """Points along x and y of the fields that can be kept."""
        return self.surface.heights.shape[0], self.surface.heights.shape[1]

    @property
    def grid_spacing(self) -> tuple[float, float]:
        """Distance of points along x and y of the gap, m."""
        return self.surface.spacing

    @property
    def bodies(self) -> tuple["PeriodicLayer", ...]:
        """The deformable bodies."""
        return (self,)

    @property
    def heterogeneous(self) -> bool:
        """Whether moduli vary within a layer."""
        return max(np.ndim(self.law.youngs_modulus), np.ndim(self.law.poissons_ratio)) > 1

    @property
    def planes(self) -> np.ndarray:
        """Heights of the node planes from the base up, shape (layers + 1,), m."""
        planes = graded_planes(self.depth, self.layers, min(self.surface.spacing))
        if not self.coating:
            return planes
        return follow_faces(planes, coating_faces(self.coating, self.depth))

    @property
    def moduli(self) -> tuple[np.ndarray, np.ndarray]:
        """Lame's parameters (lambda, mu) of each layer or element, Pa."""
        if self.coating:
            return self.moduli_between(self.planes)

        def spread(value: float | np.ndarray) -> np.ndarray:
            array = np.asarray(value, dtype=float)
            if self.heterogeneous and array.ndim == 1:
                array = array[:, None]
            nx, ny = self.surface.heights.shape
            shape = (nx, self.layers, ny) if self.heterogeneous else (self.layers,)
            return np.broadcast_to(array, shape)

        return lame_parameters(spread(self.law.youngs_modulus), spread(self.law.poissons_ratio))

    def moduli_between(self, planes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lame's parameters (lambda, mu) of a coated body between planes on its faces, Pa."""
        below = float(self.law.youngs_modulus), float(self.law.poissons_ratio)
        return lame_parameters(*moduli_by_layer(self.coating, below, planes))

    @property
    def layer_moduli(self) -> tuple[np.ndarray, np.ndarray]:
        """Lame's parameters (lambda, mu) of each layer, Pa; the mean over its elements."""
        lame, shear = self.moduli
        return (lame.mean((0, 2)), shear.mean((0, 2))) if self.heterogeneous else (lame, shear)

    @property
    def nearly_incompressible(self) -> bool:
        """Whether the preconditioner is tilted, and elements take a mean change of volume."""
        ratios = [float(np.max(self.law.poissons_ratio))]
        return max(ratios + [one.poissons_ratio for one in self.coating]) >= 0.4

    @property
    def mean_dilatation(self) -> bool:
        """Whether an element takes its change of volume from the mean over its points."""
        return self.nearly_incompressible or self.law.flows

    def cautions(self) -> list[str]:
        """Return what a user should know before trusting the results, one sentence each."""
        period = max(self.surface.size)
        found = [depth_caution(body.depth, period) for body in self.bodies]
        return [caution for caution in found if caution] + self.element_cautions()

    def element_cautions(self) -> list[str]:
        """Say which coatings get too few elements."""
        return [
            f"a coating of {one.thickness:.3g} m gets {count} layer(s) of elements, and "
            f"{FEWEST_ELEMENTS} or more follow how it bends; raise layers and points"
            for body in self.bodies
            if body.coating
            for one, count in zip(body.coating, elements_of(body.coating, body.planes), strict=True)
            if count < FEWEST_ELEMENTS
        ]

    def surface_record(self, *, heights: bool) -> dict[str, np.ndarray]:
        """Return the statistics of the surface that a response keeps, and its heights, m."""
        return _surface_record(self.surface, heights)

    def _check_obstacle(self, obstacle: Surface | None) -> None:
        """Refuse a rigid obstacle on another grid."""
        own = self.surface
        if obstacle is not None and (
            obstacle.heights.shape != own.heights.shape or obstacle.size != own.size
        ):
            raise CaseError(
                f"the obstacle must have the grid of the surface, "
                f"{own.heights.shape} points on {own.size} m, got "
                f"{obstacle.heights.shape} on {obstacle.size} m; resample it"
            )


@dataclass(frozen=True, eq=False)
class FlatCell(PeriodicLayer):
    """A flat elastic layer, above which the surface only makes the gap.

    Fast, and right for small slopes: against the conforming cell it errs by the first order in the
    slope, or by the second where its compliance is expanded. Beside the parameters of
    :class:`PeriodicLayer`:

    Parameters
    ----------
    obstacle : Surface, optional
        Underside of the rigid obstacle on the same grid; a flat if not given.
    hardness : float, optional
        Largest local pressure, Pa: the cheap plastic limit.
    slope_order : int
        Order of the error in the slopes of both surfaces: 1, or 2 with
        :func:`~.slope_expansion.expanded_compliance`.
    second : SecondBody, optional
        Makes the obstacle deformable: the compliances of both bodies add up.

    A law that is not linear and moduli that vary within a layer are refused.
    """

    obstacle: Surface | None = None
    hardness: float | None = None
    slope_order: int = 1
    second: "SecondBody | None" = None
    small_slopes: ClassVar[bool] = True
    recovers_stress: ClassVar[bool] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if any(body.law.finite_strain for body in self.bodies):
            raise CaseError(
                "a flat cell has neither friction nor a law at large strain; use the conforming "
                "geometry"
            )
        if any(body.heterogeneous for body in self.bodies):
            raise CaseError(
                "a flat cell has one modulus in each layer, not in each element; use the "
                "conforming geometry"
            )
        if self.hardness is not None and not 0.0 < self.hardness < np.inf:
            raise CaseError(f"the hardness must be positive (Pa), got {self.hardness:g}")
        self._check_obstacle(self.obstacle)
        if self.slope_order not in (1, 2):
            raise CaseError(f"slope_order of a flat cell must be 1 or 2, got {self.slope_order}")
        if self.slope_order == 2:
            self._check_expansion()

    def _check_expansion(self) -> None:
        """Refuse what the expansion in the slopes is not derived for."""
        for body in self.bodies:
            if body.coating or np.any([np.ptp(value) for value in body.layer_moduli]):
                raise CaseError(
                    "slope_order = 2 is derived for bodies of one material, since faces between "
                    "materials are rough too; leave out coatings and moduli of layers, or set "
                    "slope_order to 1"
                )
            if body.depth < 0.5 * (period := max(self.surface.size)):
                raise CaseError(
                    f"slope_order = 2 is derived for half-spaces, and the depth of "
                    f"{body.depth:.3g} m is less than half of the period of {period:.3g} m; raise "
                    f"the depth"
                )
        slope = max(rms_slope(one) for one in self.surfaces)
        if slope > STEEPEST:
            raise CaseError(
                f"slope_order = 2 expands in slopes, and a surface has a root mean square slope "
                f"of {slope:.3g}, beyond {STEEPEST:g}; use the conforming geometry"
            )

    @property
    def surfaces(self) -> tuple[Surface, Surface]:
        """The surface and the underside of the obstacle, heights out of their own bodies."""
        under = 0.0 * self.surface.heights if self.obstacle is None else -self.obstacle.heights
        return self.surface, Surface(under, self.surface.size)

    @property
    def bodies(self) -> tuple[PeriodicLayer, ...]:
        """The deformable bodies; the second is as flat as the first."""
        return (self,) if self.second is None else (self, self.second.layer(self.surface))

    def surface_record(self, *, heights: bool) -> dict[str, np.ndarray]:
        """Return the statistics of both surfaces together, which make the gap, and heights, m."""
        return _surface_record(composite(*self.surfaces), heights)

    def element_cautions(self) -> list[str]:
        """Say nothing: there are no elements."""
        return []


@dataclass(frozen=True, eq=False)
class GraphCell(PeriodicLayer):
    """A linear elastic layer whose mesh follows its surface, pressed by a rigid obstacle.

    Contact acts along the normal of the obstacle, without friction. Beside the parameters of
    :class:`PeriodicLayer`:

    Parameters
    ----------
    obstacle : Surface, optional
        Underside of the rigid obstacle on the same grid; a flat if not given.

    A law that is not linear and an obstacle on another grid are refused.
    """

    obstacle: Surface | None = None
    recovers_stress: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.law.finite_strain:
            raise CaseError("a graph cell is linear elastic; use FiniteCell for large strain")
        self._check_obstacle(self.obstacle)


@dataclass(frozen=True, eq=False)
class SecondBody:
    """What makes the obstacle a deformable body: a layer behind its underside.

    Parameters
    ----------
    depth : float, distance from its clamped base to the mean plane of its underside, m
    layers : int, layers of elements, graded towards the underside
    law : Elastic, GradedElastic, NeoHookean, J2 or Prony
    coating : tuple of Coating, as of :class:`PeriodicLayer`
    """

    depth: float
    layers: int
    law: LayerLaw
    coating: tuple[Coating, ...] = ()

    def layer(self, surface: Surface) -> PeriodicLayer:
        """Return the body under a surface, in its own frame, whose z points out of it."""
        return PeriodicLayer(surface, self.depth, self.layers, self.law, coating=self.coating)


@dataclass(frozen=True, eq=False)
class FiniteCell(PeriodicLayer):
    """A layer at large strain, with friction or against a second deformable body.

    Contact is sought in the current configuration. Beside the parameters of
    :class:`PeriodicLayer`:

    Parameters
    ----------
    obstacle : Surface, optional
        Underside of the counterface; a flat if not given. It has the grid of the surface or, of
        a second body, another one on the same area.
    friction_coefficient : float, coefficient of the local Coulomb law
    second : SecondBody, optional
        Makes the obstacle deformable.
    """

    obstacle: Surface | None = None
    friction_coefficient: float = 0.0
    second: SecondBody | None = None
    recovers_stress: ClassVar[bool] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        mu = self.friction_coefficient
        if not 0.0 <= mu < np.inf:
            raise CaseError(f"the friction coefficient must not be negative, got {mu:g}")
        if self.second is None:
            self._check_obstacle(self.obstacle)
            return
        if self.obstacle is not None and self.obstacle.size != self.surface.size:
            raise CaseError(
                f"both bodies need the same area, the first has {self.surface.size} m, the "
                f"opposite {self.obstacle.size} m; crop or repeat one"
            )
        grid = self.surface.heights.shape
        if self.obstacle is not None and np.any(np.less(grid, self.obstacle.heights.shape)):
            raise CaseError(
                f"contact is decided at the nodes of the first body, which has {grid} points, "
                f"fewer than the opposite body with {self.obstacle.heights.shape}; exchange them "
                f"or resample one"
            )
        try:
            self.second_layer  # noqa: B018  checks itself
        except CaseError as error:
            raise CaseError(f"the opposite body: {error}") from error

    @property
    def second_layer(self) -> PeriodicLayer:
        """The second body in its own frame, whose z points out of its surface."""
        if self.second is None:
            raise ValueError("the obstacle of this cell is rigid")
        under = self.obstacle
        heights = np.zeros_like(self.surface.heights) if under is None else -under.heights
        return self.second.layer(Surface(heights, self.surface.size))

    @property
    def bodies(self) -> tuple[PeriodicLayer, ...]:
        """The deformable bodies."""
        return (self,) if self.second is None else (self, self.second_layer)

    @property
    def flows(self) -> bool:
        """Whether a body flows."""
        return any(body.law.flows for body in self.bodies)


class CellSides(StrEnum):
    """What the sides of a cell on a mesh do.

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
        Periodic sides, whose nodes must match; sides that slide in their planes; or uniform
        displacement and uniform traction, between whose answers that of periodic sides lies.
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
        found = self.mesh.boundaries or {}
        missing = sorted({"base", "top"} - set(found))
        if missing:
            raise CaseError(
                f"the mesh has no boundary named {' and '.join(missing)}, which a cell needs; its "
                f"boundaries are {listed(found)}"
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
        found = [] if self.layer is None else self.layer.cautions()
        if self.law.flows and self.element.maxdeg == 1:
            found.append(
                "tetrahedra of first order lock where a metal flows at constant volume, and are "
                "too stiff; take the element tet10 or hex8"
            )
        return found

    def surface_record(self, *, heights: bool) -> dict[str, np.ndarray]:
        """Return statistics of the surface that a response keeps, and its heights, m."""
        if self.field_shape is None:
            return {}
        from multiscale.micro.mesh.seen import seen_surface

        seen = seen_surface(self) if self.layer is None else self.layer.surface
        return _surface_record(seen, heights)


GridCell = FlatCell | GraphCell | FiniteCell
AnyCell = GridCell | MeshCell
