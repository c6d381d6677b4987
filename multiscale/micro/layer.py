"""A deformable periodic layer below a height map: its surface, coatings, moduli and node planes."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from multiscale.errors import CaseError, require
from multiscale.laws.bulk import J2, Elastic, GradedElastic, NeoHookean, Prony
from multiscale.laws.bulk.bulk_law import check_moduli, lame_parameters
from multiscale.surfaces.fourier import nayak_parameter, rms_height, rms_slope
from multiscale.surfaces.surface import Surface

if TYPE_CHECKING:
    from skfem import MeshHex

FEWEST_ELEMENTS = 3  # fewest layers of elements that resolve a coating
_LANES = 32  # elements along y in a batch of the kernels
_KRYLOV = 15  # directions, each with its image
_VECTORS = 4  # displacement-sized arrays at the peak of a contact solve, with the last step

Linear = Elastic | GradedElastic
LayerLaw = Linear | NeoHookean | J2 | Prony


@dataclass(frozen=True)
class Coating:
    """An elastic layer of even thickness on a body, bonded to the material below.

    Parameters
    ----------
    thickness : float, m
    youngs_modulus, poissons_ratio : float, Pa and 1
    """

    thickness: float
    youngs_modulus: float
    poissons_ratio: float

    def __post_init__(self) -> None:
        require("the thickness of a coating", self.thickness, "(0, inf)", "m")
        check_moduli(self.youngs_modulus, self.poissons_ratio, least=0.0)


def coating_faces(coating: Sequence[Coating], depth: float) -> np.ndarray:
    """Heights of the lower faces of coatings, outermost first, above the base of a body, m."""
    faces = depth - np.cumsum([film.thickness for film in coating])
    if faces.size and not faces[-1] > 0.0:
        raise CaseError(
            f"the coatings are {depth - faces[-1]:.3g} m thick, and the depth of {depth:.3g} m "
            f"leaves no body below them; raise the depth"
        )
    return np.asarray(faces)


def elements_of(coating: Sequence[Coating], planes: np.ndarray) -> list[int]:
    """Count the layers of elements of each coating between planes that follow its faces."""
    faces = coating_faces(coating, float(planes[-1]))
    index = np.searchsorted(planes, np.concatenate([planes[-1:], faces]) * (1.0 - 1e-12))
    return [int(count) for count in -np.diff(index)]


def moduli_by_layer(
    coating: Sequence[Coating], below: tuple[float, float], planes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Young's moduli, Pa, and Poisson's ratios of the layers of coatings and the body below."""
    middle = 0.5 * (planes[1:] + planes[:-1])
    place = np.searchsorted(coating_faces(coating, float(planes[-1]))[::-1], middle)
    pairs = [below, *((film.youngs_modulus, film.poissons_ratio) for film in coating[::-1])]
    modulus, ratio = np.array(pairs)[place].T
    return modulus, ratio


@dataclass(frozen=True, eq=False)
class PeriodicLayer:
    """A deformable periodic layer on a clamped base, with a height map as its top.

    Parameters
    ----------
    surface : Surface, heights of the top; for two rough bodies the heights of the composite surface
    depth : float, distance from the clamped base to the mean plane of the top, m
    layers : int, layers of elements, graded towards the top
    law : Elastic, GradedElastic, NeoHookean, J2 or Prony
        Graded moduli have the shape (layers,), from the base up, or (nx, layers, ny).
    obstacle : Surface, optional, underside of the counterface on the same grid; flat if not given
    coating : tuple of Coating
        Layers of other materials at the top, outermost first, on a body with an Elastic law. Node
        planes of a mesh move onto their lower faces.
    """

    surface: Surface
    depth: float
    layers: int
    law: LayerLaw
    obstacle: Surface | None = None
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
                    f"{name} must be a number, or an array of the layers ({self.layers},) or of "
                    f"the elements ({nx}, {self.layers}, {ny}), got shape {shape}"
                )
        require("the depth of the cell", self.depth, "(0, inf]", "m")
        if self.layers < 2:
            raise CaseError(f"the cell needs at least 2 layers, got {self.layers}")
        uniform = np.ndim(self.law.youngs_modulus) == np.ndim(self.law.poissons_ratio) == 0
        if self.coating and (self.law.finite_strain or not uniform):
            raise CaseError(
                f"a coating needs a body with a single elastic material, and the law of the cell "
                f"is {type(self.law).__name__}; leave out the coating, or give Elastic"
            )
        coating_faces(self.coating, self.depth)  # raises if the coatings are too thick
        self._check_obstacle()

    def _check_obstacle(self) -> None:
        surface, obstacle = self.surface, self.obstacle
        if obstacle is not None and (
            obstacle.heights.shape != surface.heights.shape or obstacle.size != surface.size
        ):
            raise CaseError(
                f"the obstacle must have the grid of the surface, "
                f"{surface.heights.shape} points on {surface.size} m, got "
                f"{obstacle.heights.shape} on {obstacle.size} m; resample it"
            )

    @property
    def raised_obstacle(self) -> np.ndarray:
        """Heights of the obstacle at first touch, m."""
        heights = 0.0 if self.obstacle is None else self.obstacle.heights
        return at_first_touch(self.surface.heights, heights)[0]

    @property
    def node_area(self) -> np.ndarray:
        """Nominal area of each point of the surface, m2."""
        return np.full(self.surface.heights.shape, float(np.prod(self.surface.spacing)))

    @property
    def unknowns(self) -> int:
        """Number of displacements of the mesh."""
        return 3 * self.surface.heights.size * self.layers

    def memory(self, friction_coefficient: float) -> int:
        """Estimate the peak memory of a solve, byte."""
        nx, ny = self.surface.heights.shape
        mixed = self.law.finite_strain and self.mean_dilatation
        vector = nx * self.layers * (4 if mixed else 3) * ny
        factors = (nx // 2 + 1) * self.layers * 12 * (ny // 2 + 1)
        if not self.law.finite_strain and friction_coefficient == 0.0:
            if self.nearly_incompressible:  # tilted, in double precision
                return int(8 * ((_VECTORS + 3) * vector + factors))
            return int(8 * ((_VECTORS + 0.5) * vector + 0.5 * factors))
        points = 8 * nx * self.layers * _LANES * -(-ny // _LANES)
        rows = 24 + 2 * self.law.n_state if self.law.finite_strain else 0  # 48 in single precision
        return int(8 * (2 * _KRYLOV * vector + factors + rows * points))

    @property
    def field_shape(self) -> tuple[int, int]:
        """Points along x and y of the fields that can be stored."""
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
    def faces(self) -> np.ndarray:
        """Heights of the lower faces of the coatings, outermost first, m."""
        return coating_faces(self.coating, self.depth)

    @property
    def planes(self) -> np.ndarray:
        """Heights of the node planes from the base up, shape (layers + 1,), m."""
        planes = graded_planes(self.depth, self.layers, min(self.surface.spacing))
        if not self.coating:
            return planes
        # move the nearest inner plane onto each face
        nearest = 1 + np.argmin(np.abs(planes[1:-1] - self.faces[:, None]), axis=1)
        if np.any(np.diff(nearest) == 0):
            raise CaseError(
                f"one of {len(self.coating)} coatings has none of the {self.layers} layers of "
                f"elements: it is thinner than an element there; raise layers, or join coatings"
            )
        planes[nearest] = self.faces
        return planes

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
        """Whether the preconditioner is tilted, and elements use their mean change of volume."""
        ratios = [float(np.max(self.law.poissons_ratio))]
        return max(ratios + [film.poissons_ratio for film in self.coating]) >= 0.4

    @property
    def mean_dilatation(self) -> bool:
        """Whether elements use the change of volume averaged over their points."""
        return self.nearly_incompressible or self.law.flows

    def cautions(self) -> list[str]:
        """Return warnings about the accuracy of the results, a sentence each."""
        period = max(self.surface.size)
        shallow = [depth_caution(body.depth, period) for body in self.bodies]
        return [caution for caution in shallow if caution] + self.element_cautions()

    def element_cautions(self) -> list[str]:
        """Return a warning for each coating with too few elements."""
        return [
            f"a coating of {film.thickness:.3g} m gets {count} layer(s) of elements, and "
            f"{FEWEST_ELEMENTS} or more resolve its bending; raise layers and points"
            for body in self.bodies
            if body.coating
            for film, count in zip(
                body.coating, elements_of(body.coating, body.planes), strict=True
            )
            if count < FEWEST_ELEMENTS
        ]

    def surface_record(self, *, heights: bool) -> dict[str, np.ndarray]:
        """Return the statistics of the surface for a response, with its heights on request, m."""
        return statistics_of(self.surface, heights=heights)


@dataclass(frozen=True, eq=False)
class SecondBody:
    """A layer above the underside of the obstacle, which makes the obstacle deformable.

    Parameters
    ----------
    depth : float, distance from its clamped base to the mean plane of its underside, m
    layers : int, layers of elements, graded towards the underside
    law : Elastic, GradedElastic, NeoHookean, J2 or Prony
    coating : tuple of Coating, see :class:`PeriodicLayer`
    """

    depth: float
    layers: int
    law: LayerLaw
    coating: tuple[Coating, ...] = ()

    def layer(self, surface: Surface) -> PeriodicLayer:
        """Return the body below a surface, in its local frame, with z out of the body."""
        return PeriodicLayer(surface, self.depth, self.layers, self.law, coating=self.coating)


def depth_caution(depth: float, period: float) -> str | None:
    """Return a warning if the layer is thinner than the period."""
    from multiscale.micro.elastic.compliance import layered_compliance

    if depth >= 0.99 * period:
        return None
    nu, planes = 0.3, np.array([0.0, depth])
    moduli = lame_parameters(np.ones(1), nu)
    compliance = layered_compliance((2, 1), (period, period), planes, *moduli)
    share = float(compliance[1, 0]) * np.pi / (period * (1.0 - nu**2))  # relative to a half-space
    return (
        f"a depth of {depth:.3g} m below a period of {period:.3g} m makes the longest mode "
        f"{100.0 * (1.0 - share):.2g} % too stiff"
    )


def statistics_of(surface: Surface, *, heights: bool) -> dict[str, np.ndarray]:
    """Statistics of a surface as variables of a response, with its heights on request, m."""
    statistics = (rms_height, rms_slope, nayak_parameter)
    record = {function.__name__: np.array([function(surface)]) for function in statistics}
    return record | ({"height": surface.heights.T[None]} if heights else {})


def at_first_touch(
    heights: np.ndarray, obstacle: np.ndarray | float = 0.0
) -> tuple[np.ndarray, float]:
    """Return the heights of an obstacle raised to first touch, and the rise, m."""
    distance = float(np.max(heights - obstacle))
    return np.broadcast_to(obstacle + distance, heights.shape), distance


def graded_planes(depth: float, layers: int, top_thickness: float) -> np.ndarray:
    r"""Heights of the node planes, geometrically coarser from the top to the base, m."""
    if top_thickness * layers >= depth:
        return np.linspace(0.0, depth, layers + 1)

    power, total = np.arange(layers), depth / top_thickness
    # Newton from above the root; the import of scipy.optimize takes longer than a cell
    ratio, step = total ** (1.0 / (layers - 1)), np.inf
    while step > 1e-15 * ratio:
        thickness = ratio**power
        step = (thickness.sum() - total) / (power @ thickness / ratio)
        ratio -= step
    thickness = ratio ** power[::-1]
    planes = np.concatenate([[0.0], np.cumsum(thickness)])
    return np.asarray(planes * (depth / planes[-1]))


class GraphArrays(NamedTuple):
    """Arrays of a graph mesh for kernels."""

    heights: np.ndarray  # (nx, ny), heights of the surface, m
    planes: np.ndarray  # (layers + 1,), heights of the node planes below a flat surface, m
    factor: np.ndarray  # (layers + 1,), share of the surface height in the height of each plane
    dx: float  # spacing of the nodes, m
    dy: float


@dataclass(frozen=True)
class GraphMesh:
    r"""Nodes :math:`z = Z_l + \varphi_l h(x, y)`, periodic in x, y; :math:`\varphi_l = Z_l / H`."""

    surface: Surface  # even numbers of points; a single point across is plane strain
    planes: np.ndarray  # (layers + 1,), Z_l, m

    def __post_init__(self) -> None:
        nx, ny = self.surface.heights.shape
        if any(n % 2 and n > 1 for n in (nx, ny)):
            raise CaseError(
                f"the cell needs an even number of points in each direction, or 1 across, got "
                f"{nx} x {ny}; resample the surface to {nx + nx % 2} x {ny + ny % 2}"
            )
        depth, lowest = float(self.planes[-1]), float(self.surface.heights.min())
        if depth + lowest <= 0.0:
            raise CaseError(
                f"the cell folds over: its lowest valley is {-lowest:.3g} m below the mean plane, "
                f"its depth only {depth:.3g} m; choose a larger depth"
            )

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of elements in x, y and depth."""
        nx, ny = self.surface.heights.shape
        return nx, ny, len(self.planes) - 1

    @property
    def map_factor(self) -> np.ndarray:
        """Share of the surface height in each node plane, shape (layers + 1,)."""
        return np.asarray(self.planes / self.planes[-1])

    @property
    def arrays(self) -> GraphArrays:
        """Arrays of the mesh for kernels."""
        heights = np.ascontiguousarray(self.surface.heights, dtype=np.float64)
        return GraphArrays(heights, self.planes, self.map_factor, *self.surface.spacing)

    def hexahedra(self, first_layer: int = 0) -> "MeshHex":
        """Return the scikit-fem mesh, not joined at its periodic faces."""
        from skfem import MeshHex

        (nx, ny, _), (dx, dy) = self.shape, self.surface.spacing
        planes = self.planes[first_layer:]
        mesh = MeshHex.init_tensor(np.arange(nx + 1) * dx, np.arange(ny + 1) * dy, planes)
        i, j = (np.rint(mesh.p[k] / step).astype(int) for k, step in ((0, dx), (1, dy)))
        points = mesh.p.copy()
        points[2] *= 1.0 + self.surface.heights[i % nx, j % ny] / self.planes[-1]
        top = mesh.facets_satisfying(lambda x: x[2] > planes[-1] - 1e-9 * planes[-1])
        return MeshHex(points, mesh.t).with_boundaries({"top": top})
