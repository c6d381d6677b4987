"""Results of iterative solvers, and why they stopped."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from math import isfinite

import numpy as np

from multiscale.errors import ConvergenceError, require


class Status(Enum):
    """Why an iterative solver stopped. The value is the sentence shown to the user."""

    CONVERGED = "converged"
    MAX_ITERATIONS = "the iteration limit was reached; raise max_iterations or cut the load step"
    WORK_SPENT = (
        "the limit on linear iterations was reached; Poisson's ratios near .5, steep slopes and "
        "long steps need most iterations: reduce one of these"
    )
    NOT_FINITE = "a value became NaN or infinite; check units and boundary conditions"
    STALLED = "the residual stopped falling; the problem is too ill-conditioned for the tolerance"
    JAMMED = "no method converged, and there may be no solution, as friction can jam bodies"
    INFEASIBLE = "no admissible state exists: the data contradict the constraints"


@dataclass(frozen=True)
class Solution:
    """Result of an iterative solver."""

    value: np.ndarray  # with the shape and unit in the docstring of the solver
    status: Status  # why the solver stopped
    residuals: tuple[float, ...] = ()  # dimensionless, after each iteration; maybe empty
    seconds: tuple[float, ...] = ()  # from the start to each residual; empty if it is not measured
    trail: tuple[str, ...] = ()  # methods in the order in which they ran; empty of a single method
    detail: str = ""  # place and remedy of a failure, beyond the status

    def __post_init__(self) -> None:
        if self.status is Status.CONVERGED and not (
            self.residuals and isfinite(self.residuals[-1])
        ):
            raise ValueError("a converged solution needs a finite last residual")

    @property
    def converged(self) -> bool:
        """Whether the solver reached its tolerance."""
        return self.status is Status.CONVERGED

    def unwrap(self) -> np.ndarray:
        """Return the value, or raise a ``ConvergenceError`` if the solver did not converge."""
        if not self.converged:
            last = f"{self.residuals[-1]:.1e}" if self.residuals else "never computed"
            detail = f"; {self.detail}" if self.detail else ""
            raise ConvergenceError(
                f"no convergence in {len(self.residuals)} iterations (last residual {last}): "
                f"{self.status.value}{detail}"
            )
        return self.value


def check_limits(tolerance: float, max_iterations: int | None = None) -> None:
    """Refuse limits with which no iteration can converge or stop."""
    require("tolerance is relative and", tolerance, "(0, 1)")
    if max_iterations is not None:
        require("max_iterations", max_iterations, "[1, inf)", integer=True)


def verdict(residuals: Sequence[float], tolerance: float, patience: float) -> Status | None:
    """Return why an iteration should stop after its last residual, or ``None`` to continue."""
    if not isfinite(residuals[-1]):
        return Status.NOT_FINITE
    if residuals[-1] <= tolerance:
        return Status.CONVERGED
    if int(np.argmin(residuals)) < len(residuals) - 1 - patience:
        return Status.STALLED
    return None
