"""A path on a cell with friction or at large strain, and the averages of its steps."""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.micro import averages
from multiscale.micro.cell import FiniteCell, PeriodicLayer
from multiscale.micro.checkpoint import Checkpoint
from multiscale.micro.contact_area import EdgeLayer, contact_areas
from multiscale.micro.finite.finite_cell import make_scene
from multiscale.micro.finite.history import Walk, rest_state, walk_step
from multiscale.micro.finite.pair_scene import PairScene
from multiscale.micro.finite.scene import CellScene, CellState, Target
from multiscale.micro.flat_reference import surface_slopes
from multiscale.micro.graph_cell import element_edges
from multiscale.micro.path import Path
from multiscale.micro.spots import grid_neighbours, spot_averages

__all__ = [
    "Way",
    "current_weight",
    "follow_path",
    "largest_approach",
    "plastic_approach",
    "pressed_increments",
    "walk_path",
]

logger = logging.getLogger(__name__)

PLASTIC_APPROACH = 0.05  # largest approach of an increment over the gap amplitude, plastic body
LONGEST_SLIDE = 1000  # largest number of increments of a slide in one step of the path


def follow_path(
    cell: FiniteCell,
    path: Path,
    *,
    fields: bool,
    spots: bool,
    tolerance: float,
    checkpoint: Checkpoint | None = None,
) -> list[dict[str, Any]]:
    """Follow a path to its end, or to the first step without an answer."""
    _check(cell, path)
    scene, edges = make_scene(cell), element_edges(cell)
    way = Way(
        scene,
        float(np.prod(cell.surface.size)),
        largest_approach(cell, path.refinement),
        lambda state, target: _fewest_increments(cell, path, state, target),
        lambda state: _average(cell, edges, scene, state, fields=fields, spots=spots),
    )
    return walk_path(way, path, tolerance=tolerance, checkpoint=checkpoint)


@dataclass(frozen=True, eq=False)
class Way:
    """What walking along a path takes of a cell.

    Attributes
    ----------
    scene : CellScene
    area : float, nominal area, m2
    largest_approach : float, largest change of the approach in one increment, m
    fewest_increments : callable
        ``fewest_increments(state, target)`` of the step from a state to a target.
    average : callable
        ``average(state)`` returns the averages of a state in equilibrium.
    """

    scene: CellScene
    area: float
    largest_approach: float
    fewest_increments: Callable[[CellState, Target], int]
    average: Callable[[CellState], dict[str, Any]]


def walk_path(
    way: Way, path: Path, *, tolerance: float, checkpoint: Checkpoint | None
) -> list[dict[str, Any]]:
    """Walk along a path step by step; see :func:`follow_path`."""
    scene = way.scene
    steps, known = ([], None) if checkpoint is None else checkpoint.found(CellState)
    if known is not None and known.displacement.shape != scene.body.shape:
        steps, known = [], None  # kept by a version with other unknowns
    state = known or rest_state(scene)
    for k in range(len(steps), len(path)):
        begin = perf_counter()
        if any("ended" in step for step in steps):
            steps.append(_cost(None, 0.0))
            continue
        before = path.time[k - 1] if path.time is not None and k > 0 else 0.0
        target = Target(
            None if path.pressure is None else path.pressure[k] * way.area,
            None if path.approach is None else path.approach[k],
            np.zeros(2) if path.slide is None else np.array(path.slide[k], dtype=float),
            0.0 if path.time is None else path.time[k] - before,
        )
        walk = walk_step(
            scene,
            state,
            target,
            increments=max(path.increments, way.fewest_increments(state, target)),
            tolerance=tolerance,
            largest_approach=way.largest_approach,
        )
        logger.info(
            "step %d: %s, %d increments, %d Newton, %d linear iterations",
            k,
            walk.state.status.value,
            walk.increments,
            walk.newton_iterations,
            walk.linear_iterations,
        )
        if walk.reached < 1.0:
            ended = (
                f"step {k} ended after {100.0 * walk.reached:.3g} % of its way, {walk.increments} "
                f"increments and {walk.linear_iterations} linear iterations: "
                f"{walk.state.status.value}"
            )
            logger.warning("%s", ended)
            steps.append(_cost(walk, perf_counter() - begin) | {"ended": ended})
        else:
            state = walk.state
            solved = {"converged": 1, "increments": float(walk.increments)}
            steps.append(_cost(walk, perf_counter() - begin) | solved | way.average(state))
        if checkpoint is not None:
            checkpoint.keep(steps, state)
    return steps


def _check(cell: FiniteCell, path: Path) -> None:
    viscous = any(body.law.rate_dependent for body in cell.bodies)
    if path.time is not None and not viscous:
        raise CaseError(
            "the path has times, but the body has no viscosity and its answer no rate; leave out "
            "time or take a Prony law"
        )
    if viscous and path.time is None:
        raise CaseError("a viscous body needs the time (s) at the end of each step of its path")
    if path.slide is not None and _passes(cell):
        steps = np.diff(np.array([(0.0, 0.0), *path.slide]), axis=0)
        longest = float(np.hypot(*steps.T).max())
        if _slid_increments(cell, longest, largest_approach(cell, path.refinement)) > LONGEST_SLIDE:
            raise CaseError(
                f"a slide of {longest:.3g} m in one step is "
                f"{longest / min(cell.surface.size):.3g} periods of the cell and needs more than "
                f"{LONGEST_SLIDE} increments; the cell repeats itself after one period"
            )


def _fewest_increments(cell: FiniteCell, path: Path, state: CellState, target: Target) -> int:
    largest = largest_approach(cell, path.refinement)
    count = pressed_increments(state, target, largest)
    if _passes(cell):
        length = float(np.hypot(*(target.slide - state.slide)))
        count = max(count, _slid_increments(cell, length, largest))
    return count


def pressed_increments(state: CellState, target: Target, largest: float) -> int:
    """Count the increments of a prescribed approach, with the largest in one of them, m."""
    if target.approach is None or not np.isfinite(largest):
        return 1
    return int(np.ceil(abs(target.approach - state.approach) / largest - 1e-9))


def _slid_increments(cell: FiniteCell, length: float, largest: float) -> int:
    """Count the increments of a slide: a node passes at most one point of the other side in each.

    In a body that flows, sliding up the slopes closes at most one largest approach in each.
    """
    surfaces = [cell.surface] + ([] if cell.obstacle is None else [cell.obstacle])
    slopes = [surface_slopes(surface.heights, surface.spacing) for surface in surfaces]
    closed = length * float(np.sqrt(sum(np.mean(x**2 + y**2) for x, y in slopes)))
    spacing = min(min(body.surface.spacing) for body in cell.bodies)
    passed = max(length / spacing, closed / largest)
    return int(np.ceil(passed - 1e-9))


def largest_approach(cell: FiniteCell, refinement: int = 1) -> float:
    """Return the largest change of the approach in one increment, m."""
    if not cell.flows:
        return np.inf
    heights, obstacle = cell.surface.heights, cell.obstacle
    if obstacle is None or obstacle.heights.shape != heights.shape:
        span = np.ptp(heights) + (0.0 if obstacle is None else np.ptp(obstacle.heights))
    else:
        span = np.ptp(heights - obstacle.heights)
    return plastic_approach(float(span), refinement)


def plastic_approach(span: float, refinement: int) -> float:
    """Return the largest approach of an increment of a body that flows, m, for a span of gaps."""
    return PLASTIC_APPROACH * 0.5 * span / refinement or np.inf


def _passes(cell: FiniteCell) -> bool:
    """Whether a node that slides passes points of the other surface."""
    return cell.obstacle is not None or cell.second is not None


def _cost(walk: Walk | None, seconds: float) -> dict[str, Any]:
    """Entry of a step without a result."""
    newton, linear = (walk.newton_iterations, walk.linear_iterations) if walk else (0, 0)
    return {
        "converged": 0,
        "active_set_iterations": newton,
        "linear_iterations": linear,
        "wall_time": seconds,
    }


def _average(
    cell: FiniteCell,
    edges: tuple[EdgeLayer, EdgeLayer],
    scene: CellScene,
    state: CellState,
    *,
    fields: bool,
    spots: bool,
) -> dict[str, Any]:
    """Averages (2), (3) of the source, and geometry, in the current configuration."""
    area = float(np.prod(cell.surface.size))
    moved = scene.surface(state.displacement)
    weight = _weight(cell, moved)
    mean, height = _means(cell, moved)
    jump = np.array([-state.approach, *state.slide]) - mean
    opposite_height = scene.obstacle.mean_height(state.approach)
    if isinstance(scene, PairScene):
        mean, depth = _means(cell.second_layer, scene.halves.surfaces(state.displacement)[1])
        jump += mean * (-1.0, 1.0, 1.0)
        opposite_height = scene.obstacle.distance - state.approach - depth
    nodal = np.moveaxis(state.force, 1, -1).reshape(-1, 3)
    carried = np.where(state.active, -state.force[:, 2], 0.0)
    real = contact_areas(carried, weight, edges=edges, flowing=cell.flows)
    step: dict[str, Any] = {
        "traction": averages.average_traction(nodal, area),
        "displacement_jump": jump,
        "mean_gap": opposite_height - height,
        "contact_fraction": max(float(np.sum(real) / np.sum(weight)), 0.0),
    }
    meeting = scene.meet(state.displacement, state.approach, state.slide)
    along = np.sum(state.force * meeting.normal, axis=1, keepdims=True)
    normal = np.moveaxis(along * meeting.normal, 1, -1).reshape(-1, 3)
    if spots:
        active, beside = carried.ravel() > 0.0, grid_neighbours(weight.shape)
        step |= spot_averages(nodal, normal, real.ravel(), active, beside, area)
    if cell.friction_coefficient > 0.0:
        step["traction_by_normal"] = averages.average_traction(normal, area)
        step["slip_fraction"] = float(state.slipping.sum() / max(state.active.sum(), 1))
        step["friction_work"] = state.dissipation / area
    if cell.flows:
        step["flowing_fraction"] = state.flowing
    if fields:
        step["pressure"] = (-state.force[:, 2] * cell.surface.heights.size / area).T
        step["gap"] = (meeting.gap / meeting.normal[:, 2]).T
    return step


def _weight(cell: PeriodicLayer, moved: np.ndarray) -> np.ndarray:
    """Area of each node on the mean plane, m²; at large strain of the deformed surface."""
    if cell.law.finite_strain:
        return current_weight(cell, moved)
    heights = cell.surface.heights
    return np.full(heights.shape, float(np.prod(cell.surface.size)) / heights.size)


def _means(cell: PeriodicLayer, moved: np.ndarray) -> tuple[np.ndarray, float]:
    """Mean displacement of a surface, normal first, and mean height after deformation, m."""
    area = float(np.prod(cell.surface.size))
    height = float(np.sum(_weight(cell, moved) * (cell.surface.heights + moved[:, 2]))) / area
    return moved.mean(axis=(0, 2))[[2, 0, 1]], height


def current_weight(cell: PeriodicLayer, moved: np.ndarray) -> np.ndarray:
    """Area of each node of a surface moved by (nx, 3, ny), m, projected on the mean plane, m²."""
    dx, dy = cell.surface.spacing
    # diagonals of each facet: to the next node in x and y, and from the next in x to the next in y
    change = [np.roll(moved[:, k], (-1, -1), axis=(0, 1)) - moved[:, k] for k in range(2)]
    other = [np.roll(moved[:, k], -1, axis=1) - np.roll(moved[:, k], -1, axis=0) for k in range(2)]
    facet = 0.5 * ((dx + change[0]) * (dy + other[1]) - (dy + change[1]) * (other[0] - dx))
    nodes = facet + np.roll(facet, 1, axis=0)
    return np.asarray(0.25 * (nodes + np.roll(nodes, 1, axis=1)))
