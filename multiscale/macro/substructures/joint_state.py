"""What the tractions of a joint say: open, sticking, slipping, stiff, beyond the data."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csr_array, diags_array

from multiscale.laws.base import InterfaceLaw
from multiscale.laws.frictional import Frictional
from multiscale.macro.substructures.assembled import Assembled
from multiscale.macro.substructures.problem import Interface
from multiscale.macro.substructures.stack import Factors

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["OPENED", "SLIPS", "STICKS", "cautions", "contact_state", "stiffness", "without_slip"]

OPENED, STICKS, SLIPS = 0, 1, 2
"""States of a point of a joint."""

OPEN = 1e-6
"""Pressure, relative to the largest of the step, up to which a point counts as open."""

CREEP = 1e-3
"""Slip in a step up to which a point counts as sticking, relative to its elastic displacement at
the friction limit."""


def contact_state(joints: Sequence[Interface], result: "xr.Dataset") -> dict[str, Any]:
    """State of every point and its shares of the area.

    Parameters
    ----------
    joints : sequence of Interface
    result : Dataset
        Of :func:`solve_latin`.

    Returns
    -------
    dict
        Variables of ``MACRO_RESULT``, NaN where a step failed. A point without friction slips;
        one that stays at its limit without further slip sticks.
    """
    pressure = -result["traction"].values[..., 0]
    state = np.where(_slips(joints, result), SLIPS, STICKS)
    state = np.where(pressure <= OPEN * pressure.max(axis=1, keepdims=True), OPENED, state)
    failed = np.isnan(pressure)
    largest = _at_points(joints, "pressure_range", (0.0, np.inf))[:, 1]
    area = np.concatenate([face.weight for face in joints])
    share = area / area.sum()

    def fraction(where: np.ndarray) -> np.ndarray:
        return np.asarray(np.where(failed, np.nan, where) @ share)

    return {
        "gap": result["jump"].values[..., 0] + _at_points(joints, "gap", 0.0),
        "point_damage": _at_points(joints, "damage", 0.0),
        "contact_state": np.where(failed, np.nan, state),
        "open_fraction": fraction(state == OPENED),
        "stick_fraction": fraction(state == STICKS),
        "slip_fraction": fraction(state == SLIPS),
        "beyond_fraction": fraction(pressure > largest),
    }


def stiffness(
    joints: Sequence[Interface],
    whole: Assembled,
    result: "xr.Dataset",
    area: np.ndarray,
    steps: Sequence[int],
) -> np.ndarray:
    r"""Stiffness :math:`A / (f \cdot K_T^{-1} f)` of every load case, no point slipping.

    Parameters
    ----------
    joints : sequence of Interface
    whole : Assembled
        The structure; its loads are those of 1 Pa on the faces.
    result : Dataset
        Of :func:`solve_latin`.
    area : ndarray, shape (cases,)
        Of these faces, m².
    steps : sequence of int
        Where it is wanted; NaN elsewhere, and where a step failed.

    Returns
    -------
    ndarray, shape (all steps, cases)
        Pa/m.
    """
    found = np.full((result.sizes["step"], area.size), np.nan)
    factorise, weight = Factors(), np.tile(whole.weight, 3)
    for step in steps:
        if result["converged"].values[step] != 1:
            continue
        at = np.cumsum([0, *(face.weight.size for face in joints)])
        jump = result["jump"].values[step].T
        k = np.concatenate(
            [
                without_slip(face.law, jump[:, first:last])
                for face, first, last in zip(joints, at[:-1], at[1:], strict=True)
                if face.law is not None
            ],
            axis=1,
        )
        tangent = whole.jump.T @ diags_array(weight * k.ravel()) @ whole.jump
        u = factorise(csr_array(whole.stiffness + tangent))(whole.load)
        found[step] = area / np.sum(whole.load * u, axis=0)
    return found


def cautions(result: "xr.Dataset") -> Iterator[str]:
    """Say where pressures lie beyond the data of a law."""
    beyond = result["beyond_fraction"].values
    if np.any(beyond > 0.0):
        step = int(np.nanargmax(beyond))
        pressure = -float(result["traction"].values[step, :, 0].min())
        yield (
            f"up to {100.0 * beyond[step]:.3g} % of the joint area carries pressures beyond those "
            f"that its law was fitted to, at most {1e-6 * pressure:.3g} MPa in step {step}; there "
            f"the law extrapolates: fit it to higher pressures"
        )


def _slips(joints: Sequence[Interface], result: "xr.Dataset") -> np.ndarray:
    """Whether a point slips in a step, shape (steps, points): eq (1) of :class:`Frictional`."""
    traction = np.moveaxis(result["traction"].values, 2, 0)  # (3, steps, points)
    jump = np.moveaxis(result["jump"].values, 2, 0)
    before = np.concatenate([traction[1:], jump[1:]])
    before = np.concatenate([np.zeros_like(before[:, :1]), before[:, :-1]], axis=1)
    found, first = [], 0
    for face in joints:
        points, law = slice(first, first + face.weight.size), face.law
        first = points.stop
        if not isinstance(law, Frictional):
            found.append(np.ones(jump[0, :, points].shape, dtype=bool))
            continue
        gap = jump[0, :, points] + law.normal.gap
        k = law.stiffness_ratio * law.normal.stiffness(gap)
        trial = before[:2, :, points] + k * (jump[1:, :, points] - before[2:, :, points])
        limit = law.friction * law.normal.pressure(gap)
        found.append(np.hypot(*trial) > (1.0 + CREEP) * limit)
    return np.concatenate(found, axis=1)


def without_slip(law: InterfaceLaw, jump: np.ndarray) -> np.ndarray:
    """Diagonal of the tangent about a jump at which nothing slips, shape (3, points), Pa/m."""
    state = np.zeros((law.n_state, jump.shape[1]))
    if isinstance(law, Frictional):
        state[2:] = jump[1:]  # far from the limit, where the traction is zero
    tangent = law.respond(jump, state).tangent
    return np.stack([tangent[i, i] for i in range(3)])


def _at_points(joints: Sequence[Interface], name: str, default: Any) -> np.ndarray:
    """Give every point what the normal law of its joint has of that name."""
    laws = [face.law.normal if isinstance(face.law, Frictional) else face.law for face in joints]
    values = np.array([getattr(law, name, default) for law in laws], dtype=float)
    return np.repeat(values, [face.weight.size for face in joints], axis=0)
