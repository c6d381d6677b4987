"""The protocol of all kinds of cells, and the loop over the steps of a path, with checkpoints."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from time import perf_counter
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar
from zipfile import BadZipFile

import numpy as np

from multiscale.convergence import Status
from multiscale.io.files import make_folder, replacing
from multiscale.micro.averages import ContactSurface, Keep, average_surface
from multiscale.micro.path import Path, Target

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

__all__ = ["WORTH", "CellModel", "Checkpoint", "Step", "follow_path"]

logger = logging.getLogger(__name__)

State = TypeVar("State", bound="DataclassInstance")
Steps = list[dict[str, Any]]

WORTH = 2.0
"""Time, s, from which on a step is kept, and of sparing runs a realisation and a dataset: cheaper
ones are computed again."""

NONE = np.zeros(0)  # stands for None
OF_THE_WAY = {"status", "residuals", "linear_iterations"}  # nothing starts from these


@dataclass(frozen=True, eq=False)
class Step(Generic[State]):
    """Result of one step.

    Attributes
    ----------
    state : state at the end of the step, or the last equilibrium before a failure
    cost : mapping, variables of the response that count iterations
    ended : str, why the step ended without a result; empty if it did not
    """

    state: State
    cost: Mapping[str, float]
    ended: str = ""


class CellModel(Protocol[State]):
    """Model of a cell for the loop over steps; the cell itself answers the fourth, ``needs``.

    Attributes
    ----------
    area : float, nominal area, m2
    remembers : bool, whether a path ends at a failed step, on whose state the later ones depend
    """

    @property
    def area(self) -> float: ...  # noqa: D102

    @property
    def remembers(self) -> bool: ...  # noqa: D102

    def rest(self) -> State:
        """Return the state before any load."""

    def step(self, state: State, target: Target, tolerance: float) -> Step[State]:
        """Solve for the state at a target, starting from another state."""

    def surface(self, state: State) -> ContactSurface:
        """Contact surface of a state, from which all averages follow."""


@dataclass(frozen=True)
class Checkpoint:
    """File with the finished steps of one path and the last state, from which a killed run goes on.

    Attributes
    ----------
    file : Path
    identity : str, checksum of the origin of the cell; steps of another identity are not taken
    """

    file: FilePath
    identity: str

    def write(self, steps: Steps, state: Any) -> None:
        """Write steps and state, if the last step was worth it."""
        if steps[-1]["wall_time"] < WORTH:
            return
        content: dict[str, Any] = {"identity": self.identity, "count": len(steps)}
        for k, step in enumerate(steps):
            content |= {f"{k}/{name}": value for name, value in step.items()}
        for name in vars(state).keys() - OF_THE_WAY:
            value = vars(state)[name]
            parts: list[Any] = [*enumerate(value)] if isinstance(value, tuple) else [("", value)]
            for k, part in parts:
                content[f"state/{name}/{k}"] = NONE if part is None else part
        make_folder(self.file.parent)
        with replacing(self.file) as part, part.open("wb") as file:
            np.savez(file, allow_pickle=False, **content)

    def read(self, rest: State) -> tuple[Steps, State]:
        """Read steps and state; none and ``rest`` if the file is missing, damaged or of another."""
        try:
            with np.load(self.file, allow_pickle=False) as archive:
                content = {name: value[()] for name, value in archive.items()}
        except (OSError, ValueError, EOFError, BadZipFile):
            return [], rest
        if content.pop("identity") != self.identity:
            return [], rest
        steps: Steps = [{} for _ in range(content.pop("count"))]
        state: dict[str, Any] = {}
        for key, value in content.items():
            place, name = key.split("/", 1)
            if place == "state":
                name, part = name.split("/")
                array = None if np.size(value) == 0 else value
                state[name] = (*state.get(name, ()), array) if part else array
            else:
                steps[int(place)][name] = value
        last = replace(rest, status=Status.CONVERGED, residuals=(0.0,), **state)
        if np.shape(vars(last)["displacement"]) != np.shape(vars(rest)["displacement"]):
            return [], rest  # kept by a version with other unknowns
        return steps, last


def follow_path(
    model: CellModel[State],
    path: Path,
    keep: Keep,
    *,
    spacing: tuple[float, float] | None,
    tolerance: float,
    checkpoint: Checkpoint | None,
) -> Steps:
    """Solve a path step by step, each from the state of the one before; a dict of each step."""
    steps, state = Steps(), model.rest()
    if checkpoint is not None:
        steps, state = checkpoint.read(state)
    for k in range(len(steps), len(path)):
        begin = perf_counter()
        if model.remembers and any("ended" in step for step in steps):
            nothing = dict.fromkeys(("converged", "active_set_iterations", "linear_iterations"), 0)
            steps.append({**nothing, "wall_time": 0.0})
            continue
        result = model.step(state, path.target(k, model.area), tolerance)
        state = result.state
        step: dict[str, Any] = {"converged": int(not result.ended), **result.cost}
        if result.ended:
            step["ended"] = f"step {k} ended after {result.ended}"
            logger.warning("%s", step["ended"])
        else:
            step |= average_surface(model.surface(state), keep, spacing)
        steps.append(step | {"wall_time": perf_counter() - begin})
        if checkpoint is not None:
            checkpoint.write(steps, state)
        logger.info("step %d: %s", k, ", ".join(f"{n} {name}" for name, n in result.cost.items()))
    return steps
