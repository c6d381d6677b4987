"""Load paths of cells, the protocol of the models that follow them, and the elastic model."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Generic, Protocol, TypeVar

import numpy as np

from multiscale.convergence import Status
from multiscale.errors import CaseError, require
from multiscale.micro.averages import HALF_SPACE, ContactSurface, EdgeLayer, to_components
from multiscale.needs import Choice
from multiscale.schema import branch_of

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

State = TypeVar("State", bound="DataclassInstance")


@dataclass(frozen=True, eq=False)
class Target:
    """Prescribed end of a step or an increment: either load or approach is given."""

    load: float | None  # vertical force, N
    approach: float | None  # approach of the obstacle, m
    slide: np.ndarray  # (2,), displacement of the obstacle in its plane, m
    time_step: float = 0.0  # s


@dataclass(frozen=True, eq=False)
class Step(Generic[State]):
    """Result of a step."""

    state: State  # at the end of the step, or the last equilibrium before a failure
    cost: Mapping[str, float]  # variables of the response that count iterations
    ended: str = ""  # reason for a failure, or empty


class CellModel(Protocol[State]):
    """Model of a cell for the loop over steps."""

    @property
    def area(self) -> float:
        """Nominal area, m2."""

    @property
    def remembers(self) -> bool:
        """Whether later steps depend on the state, so that a path ends at a failed step."""

    def rest(self) -> State:
        """Return the state before any load."""

    def step(self, state: State, target: Target, tolerance: float) -> Step[State]:
        """Solve for the state at a target, starting from another state."""

    def surface(self, state: State) -> ContactSurface:
        """Contact surface of a state, from which all averages follow."""


@dataclass(frozen=True, eq=False)
class Path:
    """A sequence of load steps, each started from the previous step.

    Parameters
    ----------
    pressure : tuple of float, optional, mean pressure at each step, Pa, at least 0
    approach : tuple of float, optional
        Approach of the obstacle counted from the first touch, m, instead of pressures.
    slide : tuple of pairs of float, optional
        Displacement of the obstacle in its plane at each step, m.
    time : tuple of float, optional
        Time at the end of each step, s, rising from 0: for a viscous body.
    increments : int
        Fewest increments of a step. More are taken where a body flows, slides or does not
        converge.
    refinement : int, divides the length of the default increments of a body that flows
    """

    pressure: tuple[float, ...] | None = None
    approach: tuple[float, ...] | None = None
    slide: tuple[tuple[float, float], ...] | None = None
    time: tuple[float, ...] | None = None
    increments: int = 1
    refinement: int = 1

    def __post_init__(self) -> None:
        if (self.pressure is None) == (self.approach is None):
            raise CaseError("a path prescribes either pressures or approaches; give one of them")
        name = "approach" if self.pressure is None else "pressure"
        steps = tuple(float(value) for value in getattr(self, name))
        if not steps or not np.all(np.isfinite(steps)):
            raise CaseError(f"a path needs at least one step and finite values, got {steps}")
        if self.pressure is not None and min(steps) < 0.0:
            raise CaseError(
                f"pressures must not be negative (Pa), got {min(steps):g}; adhesion is not modelled"
            )
        object.__setattr__(self, name, steps)
        for name in ("increments", "refinement"):
            require(f"{name} of a path", getattr(self, name), "[1, inf)", integer=True)
        if self.slide is not None:
            slide = np.asarray(self.slide, dtype=float)
            if slide.shape != (len(steps), 2) or not np.all(np.isfinite(slide)):
                raise CaseError(
                    f"slide needs two finite lengths (m) for each of the {len(steps)} steps, got "
                    f"shape {slide.shape}"
                )
        if self.time is not None:
            times = np.array([0.0, *self.time], dtype=float)
            if len(times) != len(steps) + 1 or not np.all(np.diff(times) >= 0.0):
                raise CaseError(
                    f"time needs one value for each of the {len(steps)} steps, rising from 0 (s), "
                    f"got {self.time}"
                )

    @property
    def branch(self) -> np.ndarray:
        """Branch of each step: loading, unloading or holding; see `multiscale.schema.branch_of`."""
        return branch_of(np.array(self.pressure or self.approach))

    def __len__(self) -> int:
        return len(self.pressure or self.approach or ())

    def check_still(self) -> None:
        """Refuse slide and time for a cell without history."""
        if self.slide is not None or self.time is not None:
            raise CaseError(
                "a linear elastic body does not depend on time, and slides neither as a flat cell "
                "nor on a mesh without friction; leave out slide and time"
            )

    def target(self, k: int, area: float) -> Target:
        """End of step k on a cell with a nominal area, m2."""
        before = self.time[k - 1] if self.time is not None and k > 0 else 0.0
        return Target(
            None if self.pressure is None else self.pressure[k] * area,
            None if self.approach is None else self.approach[k],
            np.zeros(2) if self.slide is None else np.array(self.slide[k], dtype=float),
            0.0 if self.time is None else self.time[k] - before,
        )


@dataclass(frozen=True)
class ContactState:
    """A solution of a contact problem, or the last iterate."""

    displacement: np.ndarray  # m
    force: np.ndarray  # contact forces, N
    approach: float  # counted from the first touch, m
    active: np.ndarray  # contact nodes
    reference_force: np.ndarray  # contact forces of the problem with K_0 in place of K, N
    status: Status = Status.MAX_ITERATIONS
    residuals: tuple[float, ...] = ()  # relative residual force after each iteration
    linear_iterations: int = 0


@dataclass(frozen=True, eq=False)
class ElasticCell:
    """Model of a linear elastic cell; each step starts from the previous state."""

    solve: Callable[..., ContactState]  # solve(load=, approach=, start=, tolerance=)
    normal: np.ndarray  # (nx, 3, ny) or (nodes, 3), unit normals into the obstacle
    surface_height: np.ndarray  # of the body before deformation, m
    obstacle_height: np.ndarray  # at first touch, m
    node_area: np.ndarray  # nominal area of each contact node, m2
    surface_displacement: Callable[[np.ndarray], np.ndarray]  # of the nodes, components in axis 1
    recover: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None  # stress to force, N
    cap: float = np.inf  # largest contact force of a node, N
    edges: tuple[EdgeLayer, EdgeLayer] = (HALF_SPACE, HALF_SPACE)
    arrange: Callable[[ContactSurface], ContactSurface] = lambda surface: surface
    remembers: ClassVar[bool] = False

    @property
    def area(self) -> float:
        """Area of the cell's projection on its mean plane, m2."""
        return float(np.sum(self.node_area))

    def rest(self) -> ContactState:
        """Return the state without load."""
        return self.solve(load=0.0)

    def step(self, state: ContactState, target: Target, tolerance: float) -> Step[ContactState]:
        """Solve for a target; a failed step returns the previous state."""
        solution = self.solve(
            load=target.load, approach=target.approach, start=state, tolerance=tolerance
        )
        cost = {
            "active_set_iterations": len(solution.residuals),
            "linear_iterations": solution.linear_iterations,
        }
        if solution.status is Status.CONVERGED:
            return Step(solution, cost)
        counts = (
            f"{cost['active_set_iterations']} active sets and {cost['linear_iterations']} linear "
            f"iterations"
        )
        return Step(state, cost, f"{counts}: {solution.status.value}")

    def surface(self, state: ContactState) -> ContactSurface:
        """Contact surface of a state."""
        moved = self.surface_displacement(state.displacement)
        gap = self.obstacle_height - state.approach - (self.surface_height + moved[:, 2])
        mean = [np.sum(self.node_area * moved[:, k]) for k in range(3)]
        recover = self.recover
        surface = ContactSurface(
            -state.force[:, None] * self.normal,
            self.normal,
            state.force,
            gap,
            self.node_area,
            self.node_area,
            np.array([-state.approach, 0.0, 0.0]) - to_components(np.array(mean)) / self.area,
            float(np.sum(self.node_area * gap)) / self.area,
            edges=self.edges,
            flowing=self.cap < np.inf and state.force >= self.cap,
            recovered_force=recover and recover(state.displacement, state.active),
        )
        return self.arrange(surface)


def obstacle_normal(slope_x: np.ndarray, slope_y: np.ndarray) -> np.ndarray:
    """Return unit normals into an obstacle from its slopes, components along axis 1."""
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=1)
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def untouched(
    shape: tuple[int, ...], gap: np.ndarray, closing: np.ndarray, approach: float | None
) -> ContactState:
    """Return the state without contact forces, at first touch or before it."""
    nothing, rest = np.zeros_like(gap), np.broadcast_to(0.0, shape)  # takes no memory
    delta = float(np.min(gap / closing)) if approach is None else approach
    return ContactState(rest, nothing, delta, nothing > 0.0, nothing, Status.CONVERGED, (0.0,))


AVERAGES = "averages the change of volume over an element, which is too stiff otherwise ({})"

NO_ELEMENTS = "Poisson's ratio below 0.4, or no elements"

COMPONENTS = {  # in the order of the text: why a component is built, and why it is left out
    "stiffness": (
        "applied element by element, without a matrix",
        "it changes with the strain, as in the tangent",
    ),
    "tangent": (
        "stiffness of the elements as they are strained, in single precision",
        "the material is linear elastic: its stiffness does not change",
    ),
    "friction": (
        "three unknowns at a contact node: one normal, two tangential",
        "without friction a contact node has only its normal unknown",
    ),
    "factors": (
        "the stiffness is factorised once: the cell is small",
        "the stiffness is applied, or too large for its factors",
    ),
    "multigrid": (
        "the stiffness is too large for factors; coarse spaces hold the rigid motions",
        "the stiffness has factors, or another inverse speeds up the iteration",
    ),
    "opposite body": ("a second deformable body", "the counterface is rigid"),
    "layer factors": (
        "the solution of the same cell with a flat face, which speeds up the iteration",
        "a flat cell has a closed form for each wavelength of the surface",
    ),
    "mean dilatation": (AVERAGES.format("B-bar"), NO_ELEMENTS),
    "tilt": ("speeds up the iteration where Poisson's ratio is near 0.5", NO_ELEMENTS),
    "obstacle normals": (
        "directions of contact: the counterface is rough or moves",
        "contact acts along z only",
    ),
    "element moduli": (
        "moduli that differ from element to element",
        "moduli vary at most from layer to layer",
    ),
    "stress recovery": (
        "means of the stress in the body, in addition to means of the contact forces",
        "the stress is not required, or the material is not linear",
    ),
    "hardness cap": (
        "local pressure stays below the hardness",
        "no hardness is given, or the law of the metal has its yield stress",
    ),
    "coating": (
        "layers of other materials at the top of a body",
        "every body has a single material, or is graded by its law",
    ),
    "slope expansion": (
        "compliance to first order in the slopes: six transforms instead of two",
        "the mesh follows the surface, however steep",
    ),
}


def cell_choices(
    built: Mapping[str, bool | str], omitted: Mapping[str, str] = {}
) -> tuple[Choice, ...]:
    """Return the choices of all components; a kind of cell can replace the usual reasons."""
    choices = []
    for component, (why, why_not) in COMPONENTS.items():
        reason = built.get(component, False)
        if reason:
            choices.append(Choice(component, why if reason is True else str(reason), True))
        else:
            choices.append(Choice(component, omitted.get(component, why_not), False))
    return tuple(choices)
