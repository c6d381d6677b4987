"""Simulation of granulates in time, recorded as a dataset, and its averages."""

from collections.abc import Callable
from typing import Any

import numpy as np

from multiscale.errors import CaseError, require
from multiscale.macro.granulate.contact_solver import MOST_IMPACTS
from multiscale.macro.granulate.grain_motion import GrainState, initial_state, step_grains
from multiscale.macro.granulate.model import Model, Solver
from multiscale.schema import GRANULATE, Dataset, with_cautions


def simulate_grains(
    model: Model,
    duration: float,
    step: float,
    *,
    accuracy: float | None = None,
    solver: Solver | None = None,
    n_frames: int = 2,
    callback: Callable[[int, float], None] | None = None,
) -> Dataset:
    """Simulate the motion of grains.

    Parameters
    ----------
    duration, step : float
        Simulated time and length of a step, s. The step is shortened so that the duration is a
        multiple of it. Times of impacts have an error of the order of the step.
    accuracy : float, optional
        Largest approach of grains in the step of their impact, relative to the smaller radius. The
        length of the steps then varies, up to ``step`` and to the time in which the fastest grain
        moves by the mean radius; where grains roll on each other a step resolves the curvature as
        well. All steps are equal if not given.
    solver : Solver, optional, tolerance and limit of sweeps
    n_frames : int
        Number of equidistant times, from start to end, at which positions and forces are stored:
        at the end of the nearest step, once, or exactly if an accuracy is given.
    callback : callable, optional, called as ``callback(step, residual)``

    Returns
    -------
    Dataset
        Follows ``GRANULATE``. A step with contacts that missed the tolerance, or with impacts left
        over, has ``converged`` 0, and the motion continues; the attribute ``cautions`` counts such
        steps. If a velocity becomes infinite, or a grain too fast for the period, the motion ends,
        and ``failure`` states the time.

    Raises
    ------
    CaseError
        If the initial state, duration, step, accuracy or number of frames is refused.
    """
    if not (0.0 < step <= duration < np.inf):
        raise CaseError(
            f"step must be positive and at most the duration {duration:g} s, got {step:g} s"
        )
    require("n_frames, with the start and the end,", n_frames, "[2, inf)", integer=True)
    if accuracy is not None:
        require("accuracy", accuracy, "(0, 1)", "relative to the radius")
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
            try:
                state, done = step_grains(model, state, h, solver, accuracy)
            except CaseError as error:
                if not record.rows:  # the start is refused, not the motion
                    raise
                record.failure = f"the motion ends at {state.time:.4g} s: {error}"
                record.show(state)
                return record.dataset()
            record.add(state, done)
            if callback is not None:
                callback(len(record.rows) - 1, done["residual"])
            if not np.isfinite(done["kinetic_energy"]):
                record.failure = (
                    f"a velocity became infinite at {state.time:g} s; use smaller steps"
                )
                return record.dataset()
        record.show(state)
    return record.dataset()


class Record:
    """Recorder of the steps and frames of the motion of a model."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.failure = ""  # reason for which the simulation ended early
        self.rows: list[dict[str, Any]] = []  # each step and the state after it, by variable
        self.missed: list[float] = []  # errors of the steps that missed their tolerance
        self.hasty = 0  # number of steps with impacts left
        self.frames: list[dict[str, Any]] = []  # stored positions and forces, by variable

    def add(self, state: GrainState, step: dict[str, Any]) -> None:
        """Record the variables of a step."""
        model, repeats = self.model, self.model.strained
        row = step | {"time": state.time, "time_step": state.step_length}
        if row.pop("impacts_left"):
            self.hasty += 1
        elif not row["converged"]:
            self.missed.append(row["residual"])
        if model.walls:
            wall = state.contacts.ends[:, 1] - model.grains.n
            force, on_wall = np.zeros((len(model.walls), 3)), wall >= 0
            np.add.at(force, wall[on_wall], -state.contact_forces[on_wall])
            row |= {"wall_force": force, "wall_position": state.point}
        if repeats.any():
            row["period"] = state.period
        if model.pressure is not None:
            strain = np.zeros(3)  # logarithmic, zero along axes without a period
            strain[repeats] = np.log(state.period[repeats] / np.asarray(model.period)[repeats])
            row["strain"] = strain
        self.rows.append(row)

    def show(self, state: GrainState) -> None:
        """Record positions and forces of the last step as a frame, unless it is the last frame."""
        if self.frames and self.frames[-1]["frame_step"] == len(self.rows) - 1:
            return
        n, grains = self.model.grains.n, self.model.grains
        loaded = state.contacts.loaded
        ends, normal = state.contacts.ends[loaded], state.contacts.normal[loaded]
        radius = np.append(grains.radius, np.zeros(len(self.model.walls)))
        frame = {
            "frame_step": len(self.rows) - 1,
            "position": state.position,
            "velocity": state.velocity[:n, :3],
            "contact_ends": ends,
            "contact_force": state.contact_forces[loaded],
            "branch": normal * radius[ends].sum(axis=1)[:, None],
        }
        if self.model.turns:
            frame["spin"] = state.velocity[:n, 4:7] / grains.radius[:, None]
        self.frames.append(frame)

    def dataset(self) -> Dataset:
        """Return the record as a dataset that follows ``GRANULATE``."""
        import xarray as xr

        frames, rows = self.frames, self.rows
        values: dict[str, Any] = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        for name in ("work", *(name for name in rows[0] if name.endswith("_dissipation"))):
            values[name] = np.cumsum(values[name])
        values |= {"radius": self.model.grains.radius, "mass": self.model.grains.mass}
        counts = [len(frame["contact_ends"]) for frame in frames]
        values["contact_frame"] = np.repeat(np.arange(len(frames)), counts)
        of_contacts = ("contact_ends", "contact_force", "branch")
        for name in frames[0]:
            join = np.concatenate if name in of_contacts else np.array
            values[name] = join([frame[name] for frame in frames])
        if self.model.walls:
            _, values["wall_direction"], values["wall_radius"] = self.model.shapes
        result = GRANULATE.assign(xr.Dataset(), values)
        result = result.assign_coords(
            step=range(len(rows)),
            frame=range(len(frames)),
            grain=range(self.model.grains.n),
            component=["x", "y", "z"],
        ).assign_attrs(failure=self.failure, cautions="")
        cautions = list[str]()
        if self.missed:
            finite = [error for error in self.missed if np.isfinite(error)]
            caution = (
                f"{len(self.missed)} of {len(rows)} steps missed the tolerance of their contacts"
            )
            if finite:
                caution += f"; the largest error is {max(finite):.1e} of the closing velocities"
            if infinite := len(self.missed) - len(finite):
                caution += f"; the errors of {infinite} of them are not finite"
            cautions.append(caution)
        if self.hasty:
            cautions.append(
                f"impacts are left after {MOST_IMPACTS} visits of the pairs in {self.hasty} of "
                f"{len(rows)} steps, in which these pairs do not bounce; use smaller steps"
            )
        result = with_cautions(result, *cautions)
        if self.model.grains.thickness is not None:
            result = result.assign_attrs(thickness=float(self.model.grains.thickness))
        GRANULATE.check(result)
        return result


def final_grains(model: Model, result: Dataset) -> Any:
    """Return the grains of a model with the motion of the last frame of its simulation."""
    last = result.isel(frame=-1)
    spin = last["spin"].values if "spin" in last else None
    return model.grains.moved(last["position"].values, last["velocity"].values, spin)


def network(result: Dataset, frame: int = -1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ends, forces (N) and branches (m) of the contacts of a frame.

    Parameters
    ----------
    result : Dataset, result of a simulation; follows ``GRANULATE``
    frame : int, number of the frame, counted from the end if negative

    Returns
    -------
    ends, force, branch : ndarray, shapes (contacts, 2), (contacts, 3) and (contacts, 3)
        The force acts on the first end.
    """
    frame = range(result.sizes["frame"])[frame]
    here = result["contact_frame"].values == frame
    ends, force, branch = (
        result[name].values[here] for name in ("contact_ends", "contact_force", "branch")
    )
    return ends, force, branch


def coordination(ends: np.ndarray, n_grains: int, *, rattlers_below: int = 4) -> tuple[float, int]:
    """Return the mean number of contacts of grains that carry load, and the number of rattlers.

    Parameters
    ----------
    ends : ndarray, shape (contacts, 2), bodies in contact; walls from ``n_grains`` on
    rattlers_below : int
        A grain with fewer contacts is a rattler: 4 for spheres and 3 for discs without friction, 2
        with friction. Rattlers are removed with their contacts until all are removed.

    Returns
    -------
    coordination : float
        Contacts per grain, without rattlers; zero if all grains are rattlers. A contact of two
        grains counts for both.
    rattlers : int

    Examples
    --------
    Three grains in a ring, and a grain that touches the ring once:

    >>> coordination(np.array([[0, 1], [1, 2], [2, 0], [3, 0]]), 4, rattlers_below=2)
    (2.0, 1)
    """
    remains = np.ones(n_grains, dtype=bool)
    while True:
        carries = np.append(remains, True)[np.minimum(ends, n_grains)].all(axis=1)
        grains = ends[carries].ravel()
        count = np.bincount(grains[grains < n_grains], minlength=n_grains)
        rattlers = remains & (count < rattlers_below)
        if not rattlers.any():
            break
        remains &= ~rattlers
    number = int(remains.sum())
    return (float(count[remains].sum()) / number if number else 0.0), n_grains - number


def with_weight_shares(result: Dataset, floor: int) -> Dataset:
    """Return a result with the shares of the weight on the side walls and on the floor.

    Parameters
    ----------
    result : Dataset, follows ``GRANULATE``; grains under their weight
    floor : int, number of the wall that is the floor; the other walls are sides
    """
    weight = -Model.gravity[2] * float(result["mass"].sum())
    share = -result["wall_force"].to_numpy()[..., 2] / weight
    sides = np.delete(share, floor, axis=1).sum(axis=1)
    return GRANULATE.assign(result, {"side_share": sides, "floor_share": share[:, floor]})


def with_run_out(result: Dataset, gate: float) -> Dataset:
    """Return a result with the distance of the farthest grain beyond a gate at x, m, by frame."""
    edge = (result["position"].to_numpy()[..., 0] + result["radius"].to_numpy()).max(axis=1)
    return GRANULATE.assign(result, {"run_out": edge - gate})


def with_plate_stress(result: Dataset, plate: int, area: float, speed: float) -> Dataset:
    """Return a result with shear stress and pressure on the upper plate, and its slip.

    Parameters
    ----------
    result : Dataset, follows ``GRANULATE``
    plate : int, number of the wall, which moves along x
    area, speed : float, area and speed of the plate, m2 and m/s
    """
    force = result["wall_force"].to_numpy()[:, plate]
    values = {
        "plate_shear": -force[:, 0] / area,
        "plate_pressure": force[:, 2] / area,
        "plate_slip": speed * result["time"].to_numpy(),
    }
    return GRANULATE.assign(result, values)
