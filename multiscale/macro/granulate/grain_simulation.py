"""Granulates followed in time, as a dataset."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.macro.granulate.grain_motion import Step, step_grains
from multiscale.macro.granulate.grain_state import GrainState, start
from multiscale.macro.granulate.model import Model, Solver
from multiscale.schema import GRANULATE

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Record", "final_grains", "simulate_grains"]


def simulate_grains(
    model: Model,
    duration: float,
    step: float,
    *,
    accuracy: float | None = None,
    solver: Solver | None = None,
    n_frames: int = 2,
    callback: Callable[[int, float], None] | None = None,
) -> "xr.Dataset":
    """Follow grains in time.

    Parameters
    ----------
    model : Model
        Grains, walls and what acts on them.
    duration, step : float
        s. The step is shortened so that a whole number of them fills the duration. Times of
        impacts have an error of the order of the step.
    accuracy : float, optional
        Steps change their length, up to ``step`` and to where the fastest grain moves by the mean
        radius: in the step of an impact grains approach by at most this share of the smaller
        radius, and where they roll on each other a step follows the curvature as well.
        Dimensionless. All steps are alike if not given.
    solver : Solver, optional
        Tolerance, limit of sweeps and threads.
    n_frames : int
        Number of times, the start and the end among them, at which positions and forces are kept:
        those of the nearest steps, or steps that end there if an accuracy is given.
    callback : callable, optional
        Called as ``callback(step, residual)``.

    Returns
    -------
    Dataset
        Follows ``GRANULATE``. A step whose contacts missed the tolerance has ``converged`` 0 and
        the motion goes on; the attribute ``cautions`` counts them. If a number becomes infinite,
        the motion ends and ``failure`` says when.

    Raises
    ------
    CaseError
        If the model, duration or step is refused.
    """
    if not (0.0 < step <= duration < np.inf):
        raise CaseError(
            f"step must be positive and at most the duration {duration:g} s, got {step:g} s"
        )
    if n_frames < 2:
        raise CaseError(f"n_frames must be at least 2, the start and the end, got {n_frames}")
    if accuracy is not None and not 0.0 < accuracy < 1.0:
        raise CaseError(
            f"accuracy must lie between 0 and 1, a share of the radius, got {accuracy:g}"
        )
    solver = solver or Solver()
    state, record = start(model), Record(model)
    steps = int(np.ceil(duration / step * (1.0 - 1e-12)))
    if accuracy is None:
        longest = duration / steps
        ends = (np.linspace(0, steps, n_frames).round() * longest).tolist()
    else:
        longest, ends = step, np.linspace(0.0, duration, n_frames).tolist()
    record.show(state)
    for end in ends[1:]:
        while state.time < end - 1e-9 * longest:
            h = longest if accuracy is None else min(longest, end - state.time)
            state, done = step_grains(model, state, h, solver, accuracy)
            record.add(state, done)
            if callback is not None:
                callback(len(record.steps) - 1, done.residual)
            if not np.isfinite(done.kinetic):
                record.failure = (
                    f"a velocity became infinite at {state.time:g} s; take smaller steps"
                )
                return record.dataset()
        record.show(state)
    return record.dataset()


class Record:
    """Rows of a granulate's dataset as they come.

    Parameters
    ----------
    model : Model
        Whose motion is recorded.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self.failure = ""
        self.steps: list[Step] = []
        self.rows: list[dict[str, Any]] = []
        self.frames: list[dict[str, Any]] = []

    def add(self, state: GrainState, step: Step) -> None:
        """Keep what is known of every step."""
        n, walls = self.model.grains.n, len(self.model.walls)
        ends, impulse = state.contacts.ends, state.contacts.vectors
        on_wall = ends[:, 1] >= n
        force = np.zeros((walls, 3))
        np.add.at(force, ends[on_wall, 1] - n, -impulse[on_wall] / state.acted)
        self.steps.append(step)
        self.rows.append(
            {
                "time": state.time,
                "time_step": state.last,
                "wall_force": force,
                "wall_position": state.point,
                "period": state.period,
                "strain": self._strain(state.period),
            }
        )

    def _strain(self, period: np.ndarray) -> np.ndarray:
        """Logarithmic strain of the cell along its axes, zero where space does not repeat."""
        strain, repeats = np.zeros(3), self.model.strained
        strain[repeats] = np.log(period[repeats] / np.asarray(self.model.period)[repeats])
        return strain

    def show(self, state: GrainState) -> None:
        """Keep positions and forces of the last step."""
        n, grains = self.model.grains.n, self.model.grains
        contacts = state.contacts
        loaded, force = contacts.impulse.any(axis=1), contacts.vectors / state.acted
        ends, normal = contacts.ends[loaded], contacts.data[loaded, :3]
        radius = np.append(grains.radius, np.zeros(len(self.model.walls)))
        self.frames.append(
            {
                "frame_step": len(self.steps) - 1,
                "position": state.position,
                "velocity": state.velocity[:n, :3],
                "contact_ends": ends,
                "contact_force": force[loaded],
                "branch": normal * radius[ends].sum(axis=1)[:, None],
            }
        )
        if self.model.turns:
            self.frames[-1]["spin"] = state.velocity[:n, 4:7] / grains.radius[:, None]

    def dataset(self) -> "xr.Dataset":
        """Return what has been kept, after ``GRANULATE``."""
        import xarray as xr

        steps, frames, rows = self.steps, self.frames, self.rows
        values: dict[str, Any] = {
            "converged": [int(s.converged) for s in steps],
            "residual": [s.residual for s in steps],
            "iterations": [s.sweeps for s in steps],
            "penetration": [s.penetration for s in steps],
            "n_contacts": [s.n_contacts for s in steps],
            "kinetic_energy": [s.kinetic for s in steps],
            "elastic_energy": [s.elastic for s in steps],
            "work": np.cumsum([s.work for s in steps]),
            "contact_dissipation": np.cumsum([s.contact_dissipation for s in steps]),
            "numerical_dissipation": np.cumsum([s.numerical_dissipation for s in steps]),
            "damping_dissipation": np.cumsum([s.damping for s in steps]),
            "search_time": [s.search_time for s in steps],
            "wall_time": [s.search_time + s.solver_time for s in steps],
            "radius": self.model.grains.radius,
            "mass": self.model.grains.mass,
            "contact_frame": np.repeat(
                np.arange(len(frames)), [len(frame["contact_ends"]) for frame in frames]
            ),
        }
        spin = ("spin",) if self.model.turns else ()
        for name in ("frame_step", "position", "velocity", *spin):
            values[name] = np.array([frame[name] for frame in frames])
        for name in ("contact_ends", "contact_force", "branch"):
            values[name] = np.concatenate([frame[name] for frame in frames])
        for name in ("time", "time_step"):
            values[name] = np.array([row[name] for row in rows])
        if self.model.pressure is not None:
            values["stress"] = np.array([step.stress for step in steps])
            values["strain"] = np.array([row["strain"] for row in rows])
        if np.isfinite(self.model.period).any():
            values["period"] = np.array([row["period"] for row in rows])
        if self.model.walls:
            _, values["wall_direction"], values["wall_radius"] = self.model.shapes
            for name in ("wall_force", "wall_position"):
                values[name] = np.array([row[name] for row in rows])
        result = GRANULATE.assign(xr.Dataset(), values)
        result = result.assign_coords(
            step=range(len(steps)),
            frame=range(len(frames)),
            grain=range(self.model.grains.n),
            component=["x", "y", "z"],
        ).assign_attrs(failure=self.failure, cautions=self._cautions())
        if self.model.grains.thickness is not None:
            result = result.assign_attrs(thickness=float(self.model.grains.thickness))
        GRANULATE.check(result)
        return result

    def _cautions(self) -> str:
        """Say which steps missed the tolerance."""
        missed = [s.residual for s in self.steps if not s.converged]
        if not missed:
            return ""
        return (
            f"{len(missed)} of {len(self.steps)} steps missed the tolerance of their contacts; the "
            f"largest error is {max(missed):.1e} of the closing velocities"
        )


def final_grains(model: Model, result: "xr.Dataset") -> Any:
    """Return the grains of a model where a motion left them, to start another from.

    Parameters
    ----------
    model : Model
        That the motion is of.
    result : Dataset
        Follows ``GRANULATE``.
    """
    last = result.isel(frame=-1)
    spin = last["spin"].values if "spin" in last else None
    return model.grains.moved(last["position"].values, last["velocity"].values, spin)
