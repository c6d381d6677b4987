"""The frame that Newton's methods share: stopping, record, and steps on a path.

Loops that are other algorithms stay apart: active sets, conjugate gradients and LATIN, friction
methods (they keep the best iterate, see :mod:`multiscale.nonsmooth.progress`), and many small
problems solved at once, where each has its own damping. Cells at large strain lengthen their
increments too, and extrapolate.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Generic, TypeVar

import numpy as np

from multiscale.convergence import Solution, Status, check_limits, verdict
from multiscale.errors import ConvergenceError

__all__ = ["Limits", "NewtonRun", "PathPart", "join_solutions", "march"]

State = TypeVar("State")


@dataclass(frozen=True)
class Limits:
    """When the user wants a Newton iteration to stop.

    Attributes
    ----------
    max_iterations : int, limit of Newton steps
    tolerance : float, bound on the residual of the solver; dimensionless
    callback : callable, optional, called as ``callback(iteration, residual)``
    """

    max_iterations: int = 60
    tolerance: float = 1e-10
    callback: Callable[[int, float], None] | None = None

    def __post_init__(self) -> None:
        check_limits(self.tolerance, self.max_iterations)


@dataclass
class NewtonRun:
    """Record of one Newton iteration, which says when to stop; the iterates stay in the loop.

    Attributes
    ----------
    limits : Limits, when the user wants it to stop
    patience : float, iterations without a smaller residual after which the iteration gives up
    status : Status, why it stopped
    residuals, seconds : list of float, residual and time, s, of every iterate
    begin : float, start on the clock, s

    Examples
    --------
    >>> x, run = 2.0, NewtonRun(Limits(tolerance=1e-12))
    >>> while run.goes_on(abs(x * x - 2.0)):
    ...     x -= (x * x - 2.0) / (2.0 * x)
    >>> solution = run.solution(np.array(x))
    >>> solution.status.name, len(solution.residuals)
    ('CONVERGED', 6)
    """

    limits: Limits
    patience: float = np.inf
    status: Status = Status.MAX_ITERATIONS
    residuals: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    begin: float = field(default_factory=perf_counter)

    def goes_on(self, residual: float, floor: float = 0.0) -> bool:
        """Record the residual of an iterate and say whether another step is worth taking.

        A residual up to ``floor``, which rounding leaves, counts as converged too.
        """
        if self.limits.callback is not None:
            self.limits.callback(len(self.residuals), residual)
        self.residuals.append(residual)
        self.seconds.append(perf_counter() - self.begin)
        reason = verdict(self.residuals, max(self.limits.tolerance, floor), self.patience)
        self.status = reason or self.status
        return reason is None and self.steps < self.limits.max_iterations

    def stop(self, status: Status) -> None:
        """Say why the loop is left although it could go on."""
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


@dataclass(frozen=True)
class PathPart(Generic[State]):
    """An attempt to get further on a path: its aim, the solution, and the state at its end."""

    aim: float
    solution: Solution
    state: State


def march(
    attempt: Callable[[State, float], tuple[Solution, State]],
    start: State,
    way: tuple[float, float],
    cuts: int,
) -> list[PathPart[State]]:
    """Go from one place of a path to another, in one step or in halves of it."""
    state, (reached, target) = start, way
    length = target - reached
    smallest = abs(length) * 0.5**cuts
    parts: list[PathPart[State]] = []
    while True:
        aim = target if abs(target - reached) <= 1.5 * abs(length) else reached + length
        try:
            part = PathPart(aim, *attempt(state, aim))
        except ConvergenceError:
            if abs(length) <= smallest or not parts:
                raise
            length *= 0.5
            continue
        parts.append(part)
        if part.solution.converged:
            state, reached = part.state, aim
            if aim == target:
                return parts
        elif abs(length) > smallest:
            length *= 0.5
        else:
            return parts


def join_solutions(solutions: Sequence[Solution], trail: Sequence[str] = ()) -> Solution:
    """Give the last of some solutions in turn the residuals and times of all."""
    seconds: list[float] = []
    for part in solutions:
        done = seconds[-1] if seconds else 0.0
        seconds += [done + second for second in part.seconds]
    residuals = [residual for part in solutions for residual in part.residuals]
    return replace(
        solutions[-1], residuals=tuple(residuals), seconds=tuple(seconds), trail=tuple(trail)
    )
