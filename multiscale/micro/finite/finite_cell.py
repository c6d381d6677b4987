"""Cells with friction, at large strain or sliding: parameters, steps and contact surface."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from multiscale.errors import CaseError, require
from multiscale.laws.bulk import Elastic, GradedElastic
from multiscale.micro.averages import ContactSurface, EdgeLayer
from multiscale.micro.layer import GraphMesh, PeriodicLayer, SecondBody
from multiscale.micro.path import AVERAGES, Path, Step, Target, cell_choices
from multiscale.needs import Needs
from multiscale.surfaces.surface import Surface

if TYPE_CHECKING:
    from multiscale.micro.elastic.flat_reference import Reference
    from multiscale.micro.elastic.lateral_fft import LateralInverse
    from multiscale.micro.finite.equations import CellScene, CellState, FiniteBody

PLASTIC_APPROACH = 0.05  # largest approach of an increment over the gap amplitude, if a body flows
LONGEST_SLIDE = 1000  # largest number of increments of a slide in a step of the path
TANGENTIAL_WEIGHT = 0.3  # relative to the tangential stiffness of a single node
PAIR, FLOWING = 3e-6, 4.5e-5  # s per load step and unknown on a core, measured


@dataclass(frozen=True, eq=False)
class FiniteCell(PeriodicLayer):
    """A layer at large strain, with friction or against a second deformable body.

    Contact is searched in the current configuration. In addition to the parameters of
    :class:`PeriodicLayer`:

    Parameters
    ----------
    friction_coefficient : float, coefficient of the local Coulomb law
    second : SecondBody, optional
        Makes the obstacle deformable, which may then have another grid on the same area.
    """

    friction_coefficient: float = 0.0
    second: SecondBody | None = None
    recovers_stress: ClassVar[bool] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        mu = self.friction_coefficient
        require("the friction coefficient", mu, "[0, inf)")

    def _check_obstacle(self) -> None:
        if self.second is None:
            super()._check_obstacle()
            return
        if self.obstacle is not None and self.obstacle.size != self.surface.size:
            raise CaseError(
                f"both bodies need the same area, the first has {self.surface.size} m, the "
                f"opposite {self.obstacle.size} m; crop or repeat a surface"
            )
        grid = self.surface.heights.shape
        if self.obstacle is not None and np.any(np.less(grid, self.obstacle.heights.shape)):
            raise CaseError(
                f"contact is evaluated at the nodes of the first body, which has {grid} points, "
                f"fewer than the opposite body with {self.obstacle.heights.shape}; exchange the "
                f"bodies or resample a surface"
            )
        try:
            self.second_layer  # noqa: B018  raises if it is not valid
        except CaseError as error:
            raise CaseError(f"the opposite body: {error}") from error

    @property
    def second_layer(self) -> PeriodicLayer:
        """The second body in its local frame, with z out of its surface."""
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

    def needs(self) -> Needs:
        """Return components, memory and time of a load step."""
        laws, mu = [body.law for body in self.bodies], self.friction_coefficient
        large, pair = any(law.finite_strain for law in laws), self.second is not None
        linear = not all(law.finite_strain for law in laws)
        small = "small strain, the mesh follows the surface"
        here = ", contact in the current configuration"
        return Needs(
            unknowns_per_contact=3 if mu > 0.0 else 1,
            kinematics=small.replace("small", "large") + here
            if large
            else small + (here if pair else ""),
            choices=cell_choices(
                {
                    "stiffness": linear,
                    "tangent": large,
                    "friction": mu > 0.0,
                    "opposite body": pair,
                    "layer factors": True,
                    "mean dilatation": (self.mean_dilatation or self.flows)
                    and (not large or AVERAGES.format("pressures are unknowns")),
                    "tilt": self.nearly_incompressible and linear,
                    "obstacle normals": self.obstacle is not None or pair,
                    "element moduli": self.heterogeneous,
                    "coating": any(body.coating for body in self.bodies),
                }
            ),
            state_variables=tuple(name for law in laws for name in law.history),
            libraries=("numba",),
            memory=sum(body.memory(mu) for body in self.bodies),
            seconds=(FLOWING if large or self.flows else PAIR)
            * sum(body.unknowns for body in self.bodies),
        )

    def model(self, path: Path, *, recover_stress: bool = False) -> "FiniteModel":
        """Set up the scene of the cell for a path."""
        from multiscale.micro.elastic.flat_reference import element_edges

        viscous = any(body.law.rate_dependent for body in self.bodies)
        if path.time is not None and not viscous:
            raise CaseError(
                "the path has times, but the body is not viscous and does not depend on time; "
                "leave out time or give a Prony law"
            )
        if viscous and path.time is None:
            raise CaseError("a viscous body needs the time (s) at the end of each step of its path")
        largest = self.largest_approach(path.refinement)
        if path.slide is not None:
            steps = np.diff(np.array([(0.0, 0.0), *path.slide]), axis=0)
            longest = float(np.hypot(*steps.T).max())
            if self.slid_increments(longest, largest) > LONGEST_SLIDE:
                raise CaseError(
                    f"a slide of {longest:.3g} m in a step is "
                    f"{longest / min(self.surface.size):.3g} periods of the cell and needs more "
                    f"than {LONGEST_SLIDE} increments; the cell repeats itself after a period"
                )
        area, edges = float(np.prod(self.surface.size)), element_edges(self)
        return FiniteModel(make_scene(self), area, largest, path.increments, self, edges)

    def largest_approach(self, refinement: int = 1) -> float:
        """Return the largest change of the approach in an increment, m."""
        if not self.flows:
            return np.inf
        heights, obstacle = self.surface.heights, self.obstacle
        if obstacle is None or obstacle.heights.shape != heights.shape:
            span = np.ptp(heights) + (0.0 if obstacle is None else np.ptp(obstacle.heights))
        else:
            span = np.ptp(heights - obstacle.heights)
        return plastic_approach(float(span), refinement)

    def slid_increments(self, length: float, largest: float) -> int:
        """Count the increments of a slide: in each a node passes at most a single point.

        In a body that flows, sliding up the slopes closes the gap by at most ``largest`` in each. A
        rigid flat has no points to pass.
        """
        from multiscale.micro.elastic.flat_reference import surface_slopes

        if self.obstacle is None and self.second is None:
            return 1
        surfaces = [self.surface] + ([] if self.obstacle is None else [self.obstacle])
        slopes = [surface_slopes(surface.heights, surface.spacing) for surface in surfaces]
        closed = length * float(np.sqrt(sum(np.mean(x**2 + y**2) for x, y in slopes)))
        spacing = min(min(body.surface.spacing) for body in self.bodies)
        return int(np.ceil(max(length / spacing, closed / largest) - 1e-9))


@dataclass(frozen=True, eq=False)
class HistoryModel(ABC):
    """Model of a cell with history: each step is solved in increments."""

    scene: "CellScene"
    area: float  # nominal area, m2
    largest_approach: float  # largest change of the approach in an increment, m
    increments: int  # fewest increments of a step
    remembers: ClassVar[bool] = True

    def rest(self) -> "CellState":
        """Return the cell before any load."""
        return self.scene.rest()

    def step(self, state: "CellState", target: Target, tolerance: float) -> "Step[CellState]":
        """Solve for a target in increments, or as far as there is equilibrium."""
        from multiscale.micro.finite.cell_newton import walk_step

        walk = walk_step(
            self.scene,
            state,
            target,
            increments=max(self.increments, self.fewest_increments(state, target)),
            tolerance=tolerance,
            largest_approach=self.largest_approach,
        )
        cost: dict[str, float] = {
            "active_set_iterations": walk.newton_iterations,
            "linear_iterations": walk.linear_iterations,
        }
        if walk.reached < 1.0:
            return Step(
                state,
                cost,
                f"{100.0 * walk.reached:.3g} % of its way, {walk.increments} increments and "
                f"{walk.linear_iterations} linear iterations: {walk.state.status.value}",
            )
        return Step(walk.state, cost | {"increments": float(walk.increments)})

    def fewest_increments(self, state: "CellState", target: Target) -> int:
        """Count the increments of a prescribed approach."""
        if target.approach is None or not np.isfinite(self.largest_approach):
            return 1
        change = abs(target.approach - state.approach)
        return int(np.ceil(change / self.largest_approach - 1e-9))

    def slip(self, state: "CellState") -> tuple[float, float] | None:
        """Share of the contact nodes that slip, and work of friction per area, J/m2."""
        if self.scene.friction == 0.0:
            return None
        share = float(state.slipping.sum() / max(state.active.sum(), 1))
        return share, state.dissipation / self.area

    @abstractmethod
    def surface(self, state: "CellState") -> ContactSurface:
        """Contact surface of a state in the current configuration."""


@dataclass(frozen=True, eq=False)
class FiniteModel(HistoryModel):
    """Model of a cell of one or two layers that follow height maps."""

    cell: FiniteCell
    edges: tuple[EdgeLayer, EdgeLayer]  # of contact, along x and y

    def fewest_increments(self, state: "CellState", target: Target) -> int:
        """Count the increments of a prescribed approach or slide."""
        length = float(np.hypot(*(target.slide - state.slide)))
        slid = self.cell.slid_increments(length, self.largest_approach)
        return max(super().fewest_increments(state, target), slid)

    def surface(self, state: "CellState") -> ContactSurface:
        """Contact surface of a state in the current configuration."""
        cell, scene, grid = self.cell, self.scene, self.cell.surface.heights.shape
        # mean displacement jump and mean heights of both sides
        moved, *second = scene.surfaces(state.displacement)
        weight = _weight(cell, moved)
        mean, height = _means(cell, moved)
        jump = np.array([-state.approach, *state.slide]) - mean
        opposite_height = scene.opposite.mean_height(state.approach)
        for other in second:
            mean, depth = _means(cell.second_layer, other)
            jump += mean * (-1.0, 1.0, 1.0)
            opposite_height = scene.opposite.distance - state.approach - depth
        meeting = scene.meet(state.displacement, state.approach, state.slide)
        return ContactSurface(
            state.force,
            meeting.normal,
            np.where(state.active, -state.force[:, 2], 0.0),
            meeting.gap / meeting.normal[:, 2],
            np.full(grid, self.area / np.prod(grid)),
            weight,
            jump,
            opposite_height - height,
            edges=self.edges,
            flowing=cell.flows,
            slip=self.slip(state),
            flowing_share=state.flowing if cell.flows else None,
        )


def plastic_approach(span: float, refinement: int) -> float:
    """Return the largest approach of an increment of a body that flows, m, for a span of gaps."""
    return PLASTIC_APPROACH * 0.5 * span / refinement or np.inf


def _weight(cell: PeriodicLayer, moved: np.ndarray) -> np.ndarray:
    """Area of each node on the mean plane, m²; at large strain in the deformed surface."""
    return current_weight(cell, moved) if cell.law.finite_strain else cell.node_area


def _means(cell: PeriodicLayer, moved: np.ndarray) -> tuple[np.ndarray, float]:
    """Mean displacement of a surface, normal first, and mean height after deformation, m."""
    area = float(np.prod(cell.surface.size))
    height = float(np.sum(_weight(cell, moved) * (cell.surface.heights + moved[:, 2]))) / area
    return moved.mean(axis=(0, 2))[[2, 0, 1]], height


def current_weight(cell: PeriodicLayer, moved: np.ndarray) -> np.ndarray:
    """Area of each node of a surface moved by (nx, 3, ny), m, projected on the mean plane, m²."""
    dx, dy = cell.surface.spacing
    # diagonals of each facet: to the next node in x and y, and between the next nodes in x and y
    change = [np.roll(moved[:, k], (-1, -1), axis=(0, 1)) - moved[:, k] for k in range(2)]
    other = [np.roll(moved[:, k], -1, axis=1) - np.roll(moved[:, k], -1, axis=0) for k in range(2)]
    facet = 0.5 * ((dx + change[0]) * (dy + other[1]) - (dy + change[1]) * (other[0] - dx))
    nodes = facet + np.roll(facet, 1, axis=0)
    return np.asarray(0.25 * (nodes + np.roll(nodes, 1, axis=1)))


def make_scene(cell: FiniteCell) -> "CellScene":
    """Set up the scene of a cell with friction, at large strain or with two bodies."""
    from multiscale.micro.elastic.flat_reference import flat_inverse
    from multiscale.micro.finite.equations import CellScene
    from multiscale.micro.finite.preconditioner import FlatCells, join_flat_cells
    from multiscale.micro.finite.surfaces import OppositeSide

    body, reference = _layer(cell)
    bodies: tuple[FiniteBody, ...] = (body,)
    cells = FlatCells((reference,), reference)
    opposite = OppositeSide(cell.surface, cell.obstacle, follows=cell.law.finite_strain)
    if cell.second is not None:
        other = cell.second_layer
        second, opposite_reference = _layer(other)
        grid = cell.surface.heights.shape, cell.surface.spacing
        compliance = flat_inverse(other, *grid).surface_compliance
        bodies, cells = (body, second), join_flat_cells(reference, opposite_reference, compliance)
        underside = Surface(-other.surface.heights, other.surface.size)
        opposite = OppositeSide(cell.surface, underside)
    weights = _weights(cells.both.inverse)
    return CellScene(bodies, opposite, cell.friction_coefficient, weights, cells)


def _weights(inverse: "LateralInverse") -> tuple[float, float]:
    """Weights of the contact equations, N/m."""
    from scipy import fft

    symbols = inverse.surface_compliance
    nx, _, ny = inverse.shape
    single = float(fft.irfft2(symbols[0], s=(nx, ny))[0, 0])
    return float(np.median(1.0 / symbols[5])), TANGENTIAL_WEIGHT / single


def _layer(cell: PeriodicLayer) -> tuple["FiniteBody", "Reference"]:
    """Return a body and its flat cell; at large strain with pressures for mean dilatation."""
    from multiscale.micro.elastic.flat_reference import flat_reference
    from multiscale.micro.elastic.stiffness import stiffness_operator
    from multiscale.micro.finite.equations import LinearLayer
    from multiscale.micro.finite.large_strain import LargeStrainLayer
    from multiscale.micro.finite.preconditioner import mixed_reference

    mesh, law = GraphMesh(cell.surface, cell.planes), cell.law
    precision = np.float64 if cell.nearly_incompressible else np.float32  # of the preconditioner
    if isinstance(law, Elastic | GradedElastic):
        nx, ny, layers = mesh.shape
        stiffness = stiffness_operator(mesh, *cell.moduli, mean_dilatation=cell.mean_dilatation)
        body = LinearLayer((nx, layers, 3, ny), stiffness)
        return body, flat_reference(cell, mesh, precision)
    make = mixed_reference if cell.mean_dilatation else flat_reference
    return LargeStrainLayer(mesh, law, cell.mean_dilatation), make(cell, mesh, precision)
