"""What a chain of methods leaves behind: errors, times, trail, and the best answer so far.

A friction method takes a dimensionless problem, impulses to start from, shape (contacts, 3), a
recorder that looks at the error every few iterations and says when to stop, and the limit of its
iterations; it returns its last impulses.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

from multiscale.nonsmooth.friction_problem import ScaledFriction

__all__ = ["Progress"]


@dataclass
class Progress:
    """Record of a run, kept by the methods through :meth:`note`.

    Attributes
    ----------
    problem : ScaledFriction, which measures the errors
    target : float, error at which the run may stop; dimensionless
    callback : callable, optional, called as ``callback(iteration, residual)``
    started : float, start on the clock, s
    residuals, seconds : list of float, error and time, s, of every iterate that was noted
    trail : list of str, methods in their order
    best : ndarray, shape (contacts, 3), or None, best iterate so far, dimensionless
    smallest : float, error of it
    """

    problem: ScaledFriction
    target: float
    callback: Callable[[int, float], None] | None = None
    started: float = field(default_factory=perf_counter)
    residuals: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    trail: list[str] = field(default_factory=list)
    best: np.ndarray | None = None
    smallest: float = np.inf

    def note(self, reaction: np.ndarray) -> bool:
        """Measure an answer, shape (contacts, 3); keep the best, and say whether it will do."""
        error = self.problem.error(reaction)
        if self.callback is not None:
            self.callback(len(self.residuals), error)
        self.residuals.append(error)
        self.seconds.append(perf_counter() - self.started)
        if error < self.smallest:
            self.smallest, self.best = error, reaction.copy()
        return self.smallest <= self.target
