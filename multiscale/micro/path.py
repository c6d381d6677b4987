"""Load paths of cells, and the protocol of the models that follow them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

import numpy as np

from multiscale.errors import CaseError
from multiscale.micro.averages import ContactSurface
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
    pressure : tuple of float, optional
        Mean pressure at each step, Pa, at least 0.
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

    Raises
    ------
    CaseError
        If both or neither of pressure and approach are given, or a value is outside its range.
    """

    pressure: tuple[float, ...] | None = None
    approach: tuple[float, ...] | None = None
    slide: tuple[tuple[float, float], ...] | None = None
    time: tuple[float, ...] | None = None
    increments: int = 1
    refinement: int = 1

    def __post_init__(self) -> None:
        if (self.pressure is None) == (self.approach is None):
            raise CaseError("a path prescribes either pressures or approaches; give one of both")
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
            if getattr(self, name) < 1:
                raise CaseError(f"{name} of a path must be at least 1, got {getattr(self, name)}")
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
