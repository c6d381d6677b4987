"""Residuals of the conditions of joints and grains, from their answers only."""

from typing import TYPE_CHECKING

import numpy as np

from multiscale.schema import Dataset

if TYPE_CHECKING:
    from collections.abc import Iterable

    from multiscale.laws import Sliders
    from multiscale.macro.monolithic import Assembled


def joint_faults(
    whole: "Assembled",
    law: "Sliders",
    steps: "Iterable[tuple[np.ndarray, np.ndarray, np.ndarray]]",
    stiffness: float,
) -> float:
    r"""Measure the distance of tractions and jumps from bodies and law.

    Notes
    -----
    Errors are backward errors, as the jumps of a law that is much stiffer than the bodies do not
    determine its tractions. The bodies have exactly the jumps :math:`B u` under the tractions
    :math:`t + k (B u - y)` for

    .. math:: (K + k B^T w B)\, u = f + B^T w\, (k y - t),

    so that :math:`k |B u - y|` is the error of jumps and tractions together. The law gives the
    tractions :math:`\hat t` at jumps that differ from y by no more than the rounding of y and of
    the jumps before, with the error :math:`|\hat t - t|`. They are evaluated by ``respond`` only;
    the resolvent just gives the nearest jumps within the rounding.
    """
    from scipy.sparse import csr_array, diags_array

    from multiscale.numerics.factorisation import factorise

    B, weight = whole.jump, np.tile(whole.weight, 3)
    solve = factorise(csr_array(whole.stiffness + stiffness * (B.T @ diags_array(weight) @ B)))
    state = np.zeros((law.n_state, whole.weight.size))
    before, faults = np.zeros((3, whole.weight.size)), []
    for factor, jump, traction in steps:
        y, t = jump.T, traction.T
        # the jumps of the bodies under the tractions
        u = solve(whole.load @ factor + B.T @ (weight * (stiffness * y - t).ravel()))
        faults.append(stiffness * np.abs((B @ u).reshape(y.shape) - y).max())

        # the tractions of the law at jumps within the rounding
        moved = y - before  # a bed depends on the change of the tangential jumps only
        moved[0] = y[0]
        rounding = 4.0 * np.finfo(float).eps * np.maximum(np.abs(y), np.abs(before))
        nearest = law.resolvent(t + stiffness * moved, stiffness, state) - moved
        response = law.respond(moved + np.clip(nearest, -rounding, rounding), state)
        faults.append(np.abs(response.traction - t).max())
        state, before = law.from_here(response.state), y
    return float(np.max(faults))


def largest_overlap(position: np.ndarray, radius: np.ndarray) -> float:
    """Return the largest overlap over the radius, m, of equal grains (frames, grains, 3)."""
    away = np.linalg.norm(position[:, :, None] - position[:, None], axis=-1)
    away[:, np.arange(len(radius)), np.arange(len(radius))] = np.inf
    return float(2.0 - away.min() / radius[0])


def unbalanced_share(result: Dataset, friction: float) -> float:
    """Return the largest fault in momentum and in Coulomb's cone, over the largest force."""
    mass, n = result["mass"].values, result.sizes["grain"]
    ends, force = result["contact_ends"].values, result["contact_force"].values
    normal = result["branch"].values / np.linalg.norm(result["branch"], axis=1)[:, None]
    pressing = np.sum(force * normal, axis=1)
    shear = np.linalg.norm(force - pressing[:, None] * normal, axis=1)
    gain = np.diff(result["velocity"].values, axis=0) * mass[:, None]
    gain /= result["time_step"].values[:, None, None]
    gain[..., 2] += 9.81 * mass
    after = result["contact_frame"].values > 0
    frame, at = result["contact_frame"].values[after] - 1, ends[after]
    np.subtract.at(gain, (frame, at[:, 0]), force[after])
    inner = at[:, 1] < n
    np.add.at(gain, (frame[inner], at[inner, 1]), force[after][inner])
    largest = max(float(np.abs(force).max(initial=0.0)), float(9.81 * mass.max()))
    faults = (
        np.abs(gain).max(),
        -pressing.min(initial=0.0),
        (shear - friction * pressing).max(initial=0.0),
    )
    return float(max(faults)) / largest
