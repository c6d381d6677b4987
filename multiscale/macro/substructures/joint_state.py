"""What the tractions of a joint say: open, sticking, slipping, stiff, beyond the data."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csr_array, diags_array

from multiscale.errors import ConvergenceError
from multiscale.laws.interface_law import InterfaceLaw, Sliding
from multiscale.macro.data_range import load_shares
from multiscale.macro.substructures.problem import CutInterface
from multiscale.macro.substructures.stack import Factors
from multiscale.macro.substructures.whole_structure import Assembled

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "OPENED",
    "SLIPS",
    "STICKS",
    "advance_state",
    "contact_state",
    "joint_shares",
    "load_stiffness",
    "measure_stiffness",
    "states_after",
    "without_slip",
]

OPENED, STICKS, SLIPS = 0, 1, 2
"""States of a point of a joint."""

OPEN = 1e-6
"""Pressure, relative to the largest of the step, up to which a point counts as open."""

MOST = 0.5
"""Share of the pressure of a point above which what slips makes it a slipping one."""

GAIN = 1e-12
"""Energy that rounding may win in a step, relative to the largest that a point has stored."""


def contact_state(joints: Sequence[CutInterface], result: "xr.Dataset") -> dict[str, Any]:
    """State of every point and its shares of the area.

    Parameters
    ----------
    joints : sequence of Interface
    result : Dataset
        Of :func:`solve_latin`.

    Returns
    -------
    dict
        Variables of ``MACRO_RESULT``, NaN where a step failed. A point slips if what slips in the
        step carries most of its pressure, so that one without friction slips, and one that stays
        at its limit without further slip sticks.

    Raises
    ------
    ConvergenceError
        If a step wins energy; see :func:`advance_state`.
    """
    pressure = -result["traction"].values[..., 0]
    slipping, dissipated, reached = _slip_and_loss(joints, result)
    state = np.where(slipping > MOST, SLIPS, STICKS)
    state = np.where(pressure <= OPEN * pressure.max(axis=1, keepdims=True), OPENED, state)
    failed = np.isnan(pressure)
    area = np.concatenate([face.weight for face in joints])
    share = area / area.sum()
    laws = [_normal(face.law) for face in joints]

    def fraction(where: np.ndarray) -> np.ndarray:
        return np.asarray(np.where(failed, np.nan, where) @ share)

    return {
        "gap": result["jump"].values[..., 0] + _at_points(joints, [law.gap for law in laws]),
        "point_damage": _at_points(joints, [law.damage for law in laws]),
        "contact_state": np.where(failed, np.nan, state),
        "open_fraction": fraction(state == OPENED),
        "stick_fraction": fraction(state == STICKS),
        "slip_fraction": fraction(state == SLIPS),
        "slipping_load": np.sum(reached * pressure * area, axis=1) / (pressure @ area),
        "dissipation": dissipated,
    }


def measure_stiffness(
    joints: Sequence[CutInterface],
    whole: Assembled,
    locked: Assembled,
    result: "xr.Dataset",
    area: np.ndarray,
    steps: Sequence[int],
) -> dict[str, np.ndarray]:
    r"""Stiffness of the structure, of its joints and of its bodies, no point slipping.

    Parameters
    ----------
    joints : sequence of Interface
    whole : Assembled
        The structure; its loads are 1 Pa on the faces.
    locked : Assembled
        The structure with the shanks of its bolts, which counts in shear; the same without bolts.
    result : Dataset
        Of :func:`solve_latin`.
    area : ndarray, shape (cases,)
        Areas of these faces, m².
    steps : sequence of int
        Where it is wanted; NaN elsewhere, and where a step failed.

    Returns
    -------
    dict
        Variables of ``MACRO_RESULT``, Pa/m, over all steps.

    Notes
    -----
    With the stiffness :math:`K` of the bodies, the tangents :math:`k` of the laws, the weights
    :math:`w` and the jump :math:`B u`, the compliance under the forces :math:`f` of 1 Pa on a face
    of area A adds up joints and bodies in series, by the work that each of them stores,

    .. math::
        \frac1{k_{\mathrm{all}}} = \frac{f \cdot u}{A}
            = \frac{B u \cdot w k B u}{A} + \frac{u \cdot K u}{A}, \qquad
        (K + B^T w k B)\, u = f.    \tag{1}
    """
    names = ("joint_stiffness", "tangential_stiffness", "interface_stiffness", "solid_stiffness")
    found = np.full((len(names), result.sizes["step"]), np.nan)
    factorise = Factors()
    for step in steps:
        if result["converged"].values[step] != 1:
            continue
        tangent = _tangent(joints, whole, result["jump"].values[step].T)
        u = factorise(csr_array(whole.stiffness + tangent))(whole.load)
        if locked is not whole:
            u[:, 1] = factorise(csr_array(locked.stiffness + tangent))(whole.load[:, 1])
        pressed = u[:, 0]
        work = [*np.sum(whole.load * u, axis=0), pressed @ (tangent @ pressed)]  # (1)
        work.append(pressed @ (whole.stiffness @ pressed))
        found[:, step] = area[[0, 1, 0, 0]] / np.array(work)
    return dict(zip(names, found, strict=True))


def load_stiffness(
    joints: Sequence[CutInterface],
    whole: Assembled,
    locked: Assembled,
    result: "xr.Dataset",
    forces: np.ndarray,
    steps: Sequence[int],
) -> dict[str, np.ndarray]:
    r"""Stiffness of a structure under each of its loads, no point slipping.

    Parameters
    ----------
    joints, whole, result, steps
        As of :func:`measure_stiffness`.
    locked : Assembled
        The structure with the shanks of its bolts, which counts for all loads but the tightening.
    forces : ndarray, shape (cases,)
        Resultant of each load at the factor one, N.

    Returns
    -------
    dict
        ``load_stiffness``, N/m, and ``interface_compliance``, the share of the interfaces in the
        compliance, shapes (steps, cases).

    Notes
    -----
    As (1) of :func:`measure_stiffness`, with the resultant F: :math:`F^2 / (f \cdot u)`.
    """
    found = np.full((2, result.sizes["step"], len(forces)), np.nan)
    factorise = Factors()
    tightening = int(locked is not whole)
    for step in steps:
        if result["converged"].values[step] != 1:
            continue
        tangent = _tangent(joints, whole, result["jump"].values[step].T)
        u = factorise(csr_array(locked.stiffness + tangent))(whole.load)
        if tightening:
            u[:, 0] = factorise(csr_array(whole.stiffness + tangent))(whole.load[:, 0])
        work = np.sum(whole.load * u, axis=0)
        found[:, step] = forces**2 / work, np.sum(u * (tangent @ u), axis=0) / work
    return {"load_stiffness": found[0], "interface_compliance": found[1]}


def _tangent(joints: Sequence[CutInterface], whole: Assembled, jump: np.ndarray) -> csr_array:
    """Stiffness of all joints about a jump, shape (3, points), no point slipping, N/m."""
    at = np.cumsum([0, *(face.weight.size for face in joints)])
    k = [
        without_slip(face.law, jump[:, first:last])
        for face, first, last in zip(joints, at[:-1], at[1:], strict=True)
        if face.law is not None
    ]
    weight = np.tile(whole.weight, 3)
    stiffness = diags_array(weight * np.concatenate(k, axis=1).ravel())
    return csr_array(whole.jump.T @ stiffness @ whole.jump)


def joint_shares(
    joints: Sequence[CutInterface], result: "xr.Dataset"
) -> tuple[np.ndarray, np.ndarray]:
    """Shares of the load of every joint, however cut, outside the data of its law, and these data.

    Parameters
    ----------
    joints : sequence of Interface
    result : Dataset
        Of :func:`solve_latin`.

    Returns
    -------
    shares : ndarray, shape (3, steps, joints)
        See :func:`~multiscale.macro.data_range.load_shares`.
    data : ndarray, shape (joints, 2)
        Pa.
    """
    pressure, number = -result["traction"].values[..., 0], result["point_joint"].values
    area = np.concatenate([face.weight for face in joints])
    ranges = {face.joint: _normal(face.law).pressure_range for face in joints}
    shares = [
        load_shares(pressure[:, number == joint], area[number == joint], one)
        for joint, one in ranges.items()
    ]
    return np.stack(shares, axis=2), np.array(list(ranges.values()))


def _slip_and_loss(joints: Sequence[CutInterface], result: "xr.Dataset") -> np.ndarray:
    """Return what slips in a step, what slip loses, J/m², and what the shear makes slip.

    The shape is (3, steps, points). What slips is a share of the pressure of a point, counted by
    slabs and continuous.
    """
    jump = np.moveaxis(result["jump"].values, 2, 0)  # (3, steps, points)
    found = np.full(jump.shape, np.nan)
    for step, points, law, state, account in _replay(joints, result):
        reached = law.slipping_load(jump[:, step, points], state)
        found[:, step, points] = account.slipping, account.dissipated, reached
    return found


def states_after(joints: Sequence[CutInterface], path: "xr.Dataset | None") -> list[np.ndarray]:
    """States of the laws of joints after a path, shapes (rows, points); zero without one."""
    states = [np.zeros((face.law.n_state if face.law else 0, face.weight.size)) for face in joints]
    if path is not None and joints:
        last = path.sizes["step"] - 1
        states = [state for step, _, _, state, _ in _replay(joints, path) if step == last]
    return states


def _replay(
    joints: Sequence[CutInterface], result: "xr.Dataset"
) -> Iterator[tuple[int, slice, InterfaceLaw, np.ndarray, Sliding]]:
    """Step, points, law, state and account of each joint at each step: jumps tell the states."""
    jump, first = np.moveaxis(result["jump"].values, 2, 0), 0  # (3, steps, points)
    for face in joints:
        law, points = face.law, slice(first, first + face.weight.size)
        first = points.stop
        assert law is not None
        state = np.zeros((law.n_state, face.weight.size))
        for step in np.flatnonzero(result["converged"].values == 1):
            state, account = advance_state(law, jump[:, step, points], state)
            yield int(step), points, law, state, account


def advance_state(
    law: InterfaceLaw, jump: np.ndarray, state: np.ndarray
) -> tuple[np.ndarray, Sliding]:
    """State after a step of a joint, and what the step did.

    Raises
    ------
    ConvergenceError
        If the dissipation, work less the change of the energy stored, is negative at a point.
    """
    account = law.sliding(jump, state)
    won, most = -account.dissipated.min(initial=0.0), account.stored.max(initial=0.0)
    if won > GAIN * most:
        raise ConvergenceError(
            f"a step wins {won:.3g} J/m2 at a point of a joint that stores {most:.3g} J/m2 at "
            f"most: {type(law).__name__} is wrong, as is every answer of the path; report the case"
        )
    return account.state, account


def without_slip(law: InterfaceLaw, jump: np.ndarray) -> np.ndarray:
    """Diagonal of the tangent about a jump at which nothing slips, shape (3, points), Pa/m."""
    tangent = law.respond(jump, law.at_rest(jump)).tangent
    return np.stack([tangent[i, i] for i in range(3)])


def _normal(law: InterfaceLaw | None) -> InterfaceLaw:
    """Law of the pressure of a joint."""
    assert law is not None  # a joint has one
    return law.normal_law


def _at_points(joints: Sequence[CutInterface], values: Sequence[float]) -> np.ndarray:
    """Give every point the value of its joint."""
    return np.repeat(values, [face.weight.size for face in joints])
