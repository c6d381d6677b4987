"""Finished steps of a path in a file, with which a process that was killed goes on."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar
from zipfile import BadZipFile

import numpy as np

from multiscale.convergence import Status
from multiscale.io.files import make_folder, replacing

__all__ = ["WORTH", "Checkpoint"]

State = TypeVar("State")
Steps = list[dict[str, Any]]

WORTH = 2.0
"""Time, s, from which on a step is kept, and of sparing runs a realisation and a dataset: cheaper
ones are computed again."""

NONE = np.zeros(0)  # stands for None
OF_THE_WAY = ("status", "residuals", "linear_iterations")  # nothing starts from these


@dataclass(frozen=True)
class Checkpoint:
    """Where the finished steps of one path are kept, and the state of the last that converged.

    Attributes
    ----------
    file : Path
    identity : str, what the cell was made from; steps of another identity are not taken
    """

    file: Path
    identity: str

    def keep(self, steps: Steps, state: Any) -> None:
        """Write steps and state, if the last step was worth it."""
        if steps[-1]["wall_time"] < WORTH:
            return
        content: dict[str, Any] = {"identity": self.identity, "count": len(steps)}
        for k, step in enumerate(steps):
            content |= {f"{k}/{name}": value for name, value in step.items()}
        for name, value in vars(state).items() if state is not None else ():
            parts = enumerate(value) if isinstance(value, tuple) else [("", value)]
            if name not in OF_THE_WAY:
                content |= {f"state/{name}/{k}": NONE if one is None else one for k, one in parts}
        make_folder(self.file.parent)
        with replacing(self.file) as part, part.open("wb") as file:
            np.savez(file, allow_pickle=False, **content)

    def found(self, kind: Callable[..., State]) -> tuple[Steps, State | None]:
        """Read steps and state of a kind; none from a missing, damaged or another's file."""
        try:
            with np.load(self.file, allow_pickle=False) as archive:
                content = {name: value[()] for name, value in archive.items()}
        except (OSError, ValueError, EOFError, BadZipFile):
            return [], None
        if content.pop("identity") != self.identity:
            return [], None
        steps: Steps = [{} for _ in range(content.pop("count"))]
        state: dict[str, Any] = {}
        for key, value in content.items():
            place, name = key.split("/", 1)
            if place == "state":
                name, part = name.split("/")
                one = None if np.size(value) == 0 else value
                state[name] = (*state.get(name, ()), one) if part else one
            else:
                steps[int(place)][name] = value
        if not state:
            return steps, None
        return steps, kind(status=Status.CONVERGED, residuals=(0.0,), **state)
