"""What the tractions of a joint say: open, sticking, slipping, stiff, beyond the data."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from multiscale.laws.interface_law import InterfaceLaw, Sliding
from multiscale.macro.data_range import data_ends, load_shares
from multiscale.macro.substructures.problem import CutProblem
from multiscale.schema import Dataset

__all__ = [
    "OPENED",
    "SLIPS",
    "STICKS",
    "contact_state",
    "joint_shares",
    "replay",
    "sliding_share",
    "state_after",
]

OPENED, STICKS, SLIPS = 0, 1, 2
"""States of a point of a joint."""

OPEN = 0.01
"""Pressure, relative to the mean of its joint, up to which a point counts as open: all open points
together carry less than this share of the force, which laws without a last pressure leave them."""

MOST = 0.5
"""Share of the pressure of a point above which what slips makes it a slipping one."""

ALIKE = 0.1
"""Difference of the slipping share of a first loading and of the slabs that slip in a step, up to
which the first one, which is continuous, counts."""


def contact_state(problem: CutProblem, result: Dataset) -> dict[str, Any]:
    """State of every point and its shares of the area."""
    pressure, area = -result["traction"].values[..., 0], result["point_area"].values
    slipping, dissipated = _slip_and_loss(problem, result)
    failed = np.isnan(pressure)
    joint = np.unique(result["point_joint"].values, return_inverse=True)[1]
    shares = joint == np.arange(joint.max() + 1)[:, None]  # (joints, points)
    force = np.maximum(pressure, 0.0) * area
    total = force @ shares.T  # (steps, joints)
    mean = (total / (shares @ area))[:, joint]
    state = np.where(slipping > MOST, SLIPS, STICKS)
    state = np.where(pressure <= OPEN * mean, OPENED, state)
    slides = np.where(pressure > 0.0, slipping, 0.0) * force
    of_all = area / area.sum()
    laws = [_normal(face.law) for face in problem.joints]
    sizes = [face.weight.size for face in problem.joints]
    initial = [np.broadcast_to(law.gap, size) for law, size in zip(laws, sizes, strict=True)]

    def fraction(where: np.ndarray) -> np.ndarray:
        return np.asarray(np.where(failed, np.nan, where) @ of_all)

    def of_force(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
        return np.asarray(part / np.where(whole > 0.0, whole, 1.0) + 0.0 * whole)

    return {
        "gap": result["jump"].values[..., 0] + np.concatenate(initial) + problem.gap,
        "point_damage": np.repeat([law.damage for law in laws], sizes),
        "contact_state": np.where(failed, np.nan, state),
        "open_fraction": fraction(state == OPENED),
        "stick_fraction": fraction(state == STICKS),
        "slip_fraction": fraction(state == SLIPS),
        "slipping_load": of_force(slides.sum(axis=1), force.sum(axis=1)),
        "interface_slipping_load": of_force(slides @ shares.T, total),
        "dissipation": dissipated,
    }


def sliding_share(law: InterfaceLaw, jump: np.ndarray, account: Sliding) -> np.ndarray:
    """Share of the pressure of every point whose contacts slip in a step."""
    reached = law.slipping_load(jump, account.state)
    return np.where(np.abs(reached - account.slipping) <= ALIKE, reached, account.slipping)


def joint_shares(problem: CutProblem, result: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of each joint's load outside the data of its law, and the data's bound."""
    pressure, number = -result["traction"].values[..., 0], result["point_joint"].values
    area = result["point_area"].values
    ranges = {face.joint: data_ends(_normal(face.law)) for face in problem.joints}
    shares = [
        load_shares(pressure[:, number == joint], area[number == joint], one)
        for joint, one in ranges.items()
    ]
    return np.stack(shares, axis=2), np.array(list(ranges.values()))


def _slip_and_loss(problem: CutProblem, result: Dataset) -> np.ndarray:
    """Return the share of the pressure that slips in a step, and what slip loses, J/m².

    The shape is (2, steps, points).
    """
    jump = np.moveaxis(result["jump"].values, 2, 0)  # (3, steps, points)
    found = np.full((2, *jump.shape[1:]), np.nan)
    for step, _, account in replay(problem, result):
        found[:, step] = sliding_share(problem.law, jump[:, step], account), account.dissipated
    return found


def state_after(problem: CutProblem, path: Dataset | None) -> np.ndarray:
    """State of the laws of joints after a path, shape (rows, points); zero without one."""
    state = np.zeros((problem.law.n_state, problem.weight.size))
    if path is not None and problem.joints:
        for _, last, _ in replay(problem, path):
            state = last
    return state


def replay(problem: CutProblem, result: Dataset) -> Iterator[tuple[int, np.ndarray, Sliding]]:
    """Return number, state and account of each step that converged: jumps tell the states.

    The states have the shape (rows, points).
    """
    state = np.zeros((problem.law.n_state, problem.weight.size))
    for step in np.flatnonzero(result["converged"].values == 1):
        account = problem.law.sliding(result["jump"].values[step].T, state)
        state = account.state
        yield int(step), state, account


def _normal(law: InterfaceLaw | None) -> InterfaceLaw:
    """Law of the pressure of a joint."""
    assert law is not None  # a joint has one
    return law.normal_law
