"""Simulation of granulates in time, recorded as a dataset."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.macro.granulate.grain_motion import Step, step_grains
from multiscale.macro.granulate.grain_state import GrainState, initial_state
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
    """Simulate the motion of grains.

    Parameters
    ----------
    model : Model
    duration, step : float
        Simulated time and length of a step, s. The step is shortened so that a whole number of
        steps fills the duration. Times of impacts have an error of the order of the step.
    accuracy : float, optional
        Largest approach of grains in the step of their impact, relative to the smaller radius. The
        length of the steps then varies, up to ``step`` and to the time in which the fastest grain
        moves by the mean radius; where grains roll on each other a step resolves the curvature as
        well. All steps are equal if not given.
    solver : Solver, optional, tolerance, limit of sweeps and threads
    n_frames : int
        Number of equidistant times, from start to end, at which positions and forces are stored:
        at the end of the nearest step, or exactly if an accuracy is given.
    callback : callable, optional, called as ``callback(step, residual)``

    Returns
    -------
    Dataset
        Follows ``GRANULATE``. A step whose contacts missed the tolerance has ``converged`` 0 and
        the motion goes on; the attribute ``cautions`` counts such steps. If a velocity becomes
        infinite the motion ends, and ``failure`` states the time.

    Raises
    ------
    CaseError
        If the initial state, duration, step, accuracy or number of frames is refused.
    """
    if not (0.0 < step <= duration < np.inf):
        raise CaseError(
            f"step must be positive and at most the duration {duration:g} s, got {step:g} s"
        )
    if n_frames < 2:
        raise CaseError(f"n_frames must be at least 2, the start and the end, got {n_frames}")
    if accuracy is not None and not 0.0 < accuracy < 1.0:
        raise CaseError(
            f"accuracy must lie between 0 and 1, relative to the radius, got {accuracy:g}"
        )
    solver = solver or Solver()
    state, record = initial_state(model), Record(model)
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
    """Recorder of the steps and frames of a simulation.

    Parameters
    ----------
    model : Model, model whose motion is recorded

    Attributes
    ----------
    failure : str, reason for which the simulation ended early; empty if none
    steps : list of Step, result of each step
    rows : list of dict, state after each step, by variable
    frames : list of dict, stored positions and forces, by variable
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self.failure = ""
        self.steps: list[Step] = []
        self.rows: list[dict[str, Any]] = []
        self.frames: list[dict[str, Any]] = []

    def add(self, state: GrainState, step: Step) -> None:
        """Record the variables of every step."""
        n, walls, repeats = self.model.grains.n, len(self.model.walls), self.model.strained
        ends, impulse = state.contacts.ends, state.contacts.vectors
        on_wall = ends[:, 1] >= n
        force = np.zeros((walls, 3))
        np.add.at(force, ends[on_wall, 1] - n, -impulse[on_wall] / state.force_time)
        strain = np.zeros(3)  # logarithmic, zero along axes without a period
        strain[repeats] = np.log(state.period[repeats] / np.asarray(self.model.period)[repeats])
        self.steps.append(step)
        self.rows.append(
            {
                "time": state.time,
                "time_step": state.step_length,
                "wall_force": force,
                "wall_position": state.point,
                "period": state.period,
                "strain": strain,
            }
        )

    def show(self, state: GrainState) -> None:
        """Record positions and forces of the last step as a frame."""
        n, grains = self.model.grains.n, self.model.grains
        contacts = state.contacts
        loaded, force = contacts.impulse.any(axis=1), contacts.vectors / state.force_time
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
        """Return the record as a dataset that follows ``GRANULATE``."""
        import xarray as xr

        steps, frames, rows = self.steps, self.frames, self.rows
        values: dict[str, Any] = {
            "converged": [int(s.converged) for s in steps],
            "iterations": [s.sweeps for s in steps],
            "kinetic_energy": [s.kinetic for s in steps],
            "elastic_energy": [s.elastic for s in steps],
            "damping_dissipation": np.cumsum([s.damping for s in steps]),
            "wall_time": [s.search_time + s.solver_time for s in steps],
            "radius": self.model.grains.radius,
            "mass": self.model.grains.mass,
            "contact_frame": np.repeat(
                np.arange(len(frames)), [len(frame["contact_ends"]) for frame in frames]
            ),
        }
        for name in ("residual", "penetration", "n_contacts", "search_time"):
            values[name] = [getattr(step, name) for step in steps]
        for name in ("work", "contact_dissipation", "numerical_dissipation"):
            values[name] = np.cumsum([getattr(step, name) for step in steps])
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
        ).assign_attrs(failure=self.failure, cautions="")
        if missed := [s.residual for s in steps if not s.converged]:
            cautions = (
                f"{len(missed)} of {len(steps)} steps missed the tolerance of their contacts; the "
                f"largest error is {max(missed):.1e} of the closing velocities"
            )
            result = result.assign_attrs(cautions=cautions)
        if self.model.grains.thickness is not None:
            result = result.assign_attrs(thickness=float(self.model.grains.thickness))
        GRANULATE.check(result)
        return result


def final_grains(model: Model, result: "xr.Dataset") -> Any:
    """Return the grains of a model with the motion of the last frame of its simulation."""
    last = result.isel(frame=-1)
    spin = last["spin"].values if "spin" in last else None
    return model.grains.moved(last["position"].values, last["velocity"].values, spin)
