"""What the tractions of a joint say: open, sticking, slipping, stiff, beyond the data."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from multiscale.laws.interface_law import InterfaceLaw, Sliding
from multiscale.macro.data_range import load_shares
from multiscale.macro.substructures.problem import CutProblem
from multiscale.schema import Dataset

__all__ = [
    "OPENED",
    "SLIPS",
    "STICKS",
    "contact_state",
    "joint_shares",
    "state_after",
    "without_slip",
]

OPENED, STICKS, SLIPS = 0, 1, 2
"""States of a point of a joint."""

OPEN = 1e-6
"""Pressure, relative to the largest of the step, up to which a point counts as open."""

MOST = 0.5
"""Share of the pressure of a point above which what slips makes it a slipping one."""


def contact_state(problem: CutProblem, result: Dataset) -> dict[str, Any]:
    """State of every point and its shares of the area.

    Parameters
    ----------
    problem : CutProblem
    result : Dataset, of :func:`solve_latin`

    Returns
    -------
    dict
        Variables of ``MACRO_RESULT``, NaN where a step failed. A point slips if what slips in the
        step carries most of its pressure, so that one without friction slips, and one that stays
        at its limit without further slip sticks.

    Raises
    ------
    ConvergenceError
        If a step wins energy; see :func:`~multiscale.laws.side_by_side.advance_state`.
    """
    pressure = -result["traction"].values[..., 0]
    slipping, dissipated, reached = _slip_and_loss(problem, result)
    state = np.where(slipping > MOST, SLIPS, STICKS)
    state = np.where(pressure <= OPEN * pressure.max(axis=1, keepdims=True), OPENED, state)
    failed = np.isnan(pressure)
    area = result["point_area"].values
    share = area / area.sum()
    laws = [_normal(face.law) for face in problem.joints]
    sizes = [face.weight.size for face in problem.joints]
    initial = [np.broadcast_to(law.gap, size) for law, size in zip(laws, sizes, strict=True)]

    def fraction(where: np.ndarray) -> np.ndarray:
        return np.asarray(np.where(failed, np.nan, where) @ share)

    return {
        "gap": result["jump"].values[..., 0] + np.concatenate(initial) + problem.gap,
        "point_damage": np.repeat([law.damage for law in laws], sizes),
        "contact_state": np.where(failed, np.nan, state),
        "open_fraction": fraction(state == OPENED),
        "stick_fraction": fraction(state == STICKS),
        "slip_fraction": fraction(state == SLIPS),
        "slipping_load": np.sum(reached * pressure * area, axis=1) / (pressure @ area),
        "dissipation": dissipated,
    }


def joint_shares(problem: CutProblem, result: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Shares of the load of every joint, however cut, outside the data of its law, and these data.

    Parameters
    ----------
    problem : CutProblem
    result : Dataset, of :func:`solve_latin`

    Returns
    -------
    shares : ndarray, shape (3, steps, joints), see :func:`~multiscale.macro.data_range.load_shares`
    data : ndarray, shape (joints, 2), Pa
    """
    pressure, number = -result["traction"].values[..., 0], result["point_joint"].values
    area = result["point_area"].values
    ranges = {face.joint: _normal(face.law).pressure_range for face in problem.joints}
    shares = [
        load_shares(pressure[:, number == joint], area[number == joint], one)
        for joint, one in ranges.items()
    ]
    return np.stack(shares, axis=2), np.array(list(ranges.values()))


def _slip_and_loss(problem: CutProblem, result: Dataset) -> np.ndarray:
    """Return what slips in a step, what slip loses, J/m², and what the shear makes slip.

    The shape is (3, steps, points). What slips is a share of the pressure of a point, counted by
    slabs and continuous.
    """
    jump = np.moveaxis(result["jump"].values, 2, 0)  # (3, steps, points)
    found = np.full(jump.shape, np.nan)
    for step, state, account in _replay(problem, result):
        reached = problem.law.slipping_load(jump[:, step], state)
        found[:, step] = account.slipping, account.dissipated, reached
    return found


def state_after(problem: CutProblem, path: Dataset | None) -> np.ndarray:
    """State of the laws of joints after a path, shape (rows, points); zero without one."""
    state = np.zeros((problem.law.n_state, problem.weight.size))
    if path is not None and problem.joints:
        for _, last, _ in _replay(problem, path):
            state = last
    return state


def _replay(problem: CutProblem, result: Dataset) -> Iterator[tuple[int, np.ndarray, Sliding]]:
    """State after and account of each step that converged: jumps tell the states."""
    state = np.zeros((problem.law.n_state, problem.weight.size))
    for step in np.flatnonzero(result["converged"].values == 1):
        account = problem.law.sliding(result["jump"].values[step].T, state)
        state = account.state
        yield int(step), state, account


def without_slip(law: InterfaceLaw, jump: np.ndarray) -> np.ndarray:
    """Diagonal of the tangent about a jump at which nothing slips, shape (3, points), Pa/m."""
    tangent = law.respond(jump, law.at_rest(jump)).tangent
    return np.stack([tangent[i, i] for i in range(3)])


def _normal(law: InterfaceLaw | None) -> InterfaceLaw:
    """Law of the pressure of a joint."""
    assert law is not None  # a joint has one
    return law.normal_law
