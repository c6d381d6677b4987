"""Components of Newton's methods: stopping and record, line search, and steps along a path."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Generic, TypeVar

import numpy as np

from multiscale.convergence import Solution, Status, check_limits, verdict
from multiscale.errors import ConvergenceError

State = TypeVar("State")

SUFFICIENT = 0.1  # share of the first slope that may be left after a full step
BRACKET = 0.05  # width, relative to its end, at which a bracket of the minimum is narrow enough

MAX_EVALUATIONS = 2200
"""Doublings or halvings that cross the whole range of the floating-point numbers."""


@dataclass(frozen=True)
class Limits:
    """Limits of a Newton iteration, as the user gives them."""

    max_iterations: int = 60  # of Newton steps
    tolerance: float = 1e-10  # bound on the residual of the solver, dimensionless
    callback: Callable[[int, float], None] | None = None  # called as callback(iteration, residual)

    def __post_init__(self) -> None:
        check_limits(self.tolerance, self.max_iterations)


@dataclass
class NewtonRun:
    """Record of a Newton iteration that decides when to stop; the iterates stay in the loop."""

    limits: Limits
    patience: float = np.inf  # iterations without a smaller residual after which the run stops
    status: Status = Status.MAX_ITERATIONS
    residuals: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    begin: float = field(default_factory=perf_counter)  # on the clock, s

    def goes_on(self, residual: float, floor: float = 0.0) -> bool:
        """Record a residual, converged up to ``floor``, and return whether to take another step."""
        if self.limits.callback is not None:
            self.limits.callback(len(self.residuals), residual)
        self.residuals.append(residual)
        self.seconds.append(perf_counter() - self.begin)
        reason = verdict(self.residuals, max(self.limits.tolerance, floor), self.patience)
        self.status = reason or self.status
        return reason is None and self.steps < self.limits.max_iterations

    def stop(self, status: Status) -> None:
        """Set the reason for leaving the loop before its limits."""
        self.status = status

    @property
    def steps(self) -> int:
        """Newton steps so far."""
        return len(self.residuals) - 1

    @property
    def since_best(self) -> int:
        """Steps since the smallest residual."""
        return self.steps - int(np.argmin(self.residuals))

    @property
    def converged(self) -> bool:
        """Whether the last residual is small enough."""
        return self.status is Status.CONVERGED

    def solution(self, value: np.ndarray) -> Solution:
        """Return the last iterate with the record."""
        return Solution(value, self.status, tuple(self.residuals), tuple(self.seconds))


def enough(first: float, last: float) -> bool:
    """Whether the slope after a step, J, is so small that it needs no search."""
    return abs(last) <= SUFFICIENT * abs(first)


def step_length(slope: Callable[[float], float], first: float) -> float:
    """Return the step that (nearly) minimises a convex potential along a direction."""
    if not first < 0.0 or enough(first, slope(1.0)):
        return 1.0
    # bracket of the minimum by doubling
    lower, upper = 0.0, 1.0
    for _ in range(MAX_EVALUATIONS):
        if not slope(upper) < 0.0:
            break
        lower, upper = upper, 2.0 * upper
    # bisection
    for _ in range(MAX_EVALUATIONS):
        if upper - lower <= BRACKET * upper:
            break
        middle = 0.5 * (lower + upper)
        if slope(middle) < 0.0:
            lower = middle
        else:
            upper = middle
    return lower


@dataclass(frozen=True)
class PathPart(Generic[State]):
    """Attempted step on a path: its aim, the solution, and the state at its end."""

    aim: float
    solution: Solution
    state: State


def march(
    attempt: Callable[[State, float], tuple[Solution, State]],
    start: State,
    way: tuple[float, float],
    cuts: int,
) -> list[PathPart[State]]:
    """Follow a path between two places in a single step, which is halved up to ``cuts`` times."""
    state, (reached, target) = start, way
    length = target - reached
    smallest = abs(length) * 0.5**cuts
    attempts: list[PathPart[State]] = []
    while True:
        # a last step may be longer by a half, so that no sliver remains
        aim = target if abs(target - reached) <= 1.5 * abs(length) else reached + length
        try:
            step = PathPart(aim, *attempt(state, aim))
        except ConvergenceError:
            if abs(length) <= smallest or not attempts:
                raise
            length *= 0.5
            continue
        attempts.append(step)
        if step.solution.converged:
            state, reached = step.state, aim
            if aim == target:
                return attempts
        elif abs(length) > smallest:
            length *= 0.5
        else:
            return attempts


def join_solutions(solutions: Sequence[Solution], trail: Sequence[str] = ()) -> Solution:
    """Return the last of successive solutions with the residuals and times of all."""
    seconds: list[float] = []
    for solution in solutions:
        done = seconds[-1] if seconds else 0.0
        seconds += [done + second for second in solution.seconds]
    residuals = [residual for solution in solutions for residual in solution.residuals]
    return replace(
        solutions[-1], residuals=tuple(residuals), seconds=tuple(seconds), trail=tuple(trail)
    )
