"""Closed cycles of rising amplitudes of shear at every preload of a joint."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from multiscale.macro.data_range import FAR_FACTOR, FAR_SHARE
from multiscale.macro.substructures.bolted_path import CutSolver, follow_bolts
from multiscale.macro.substructures.closed_cycles import closed_cycle, cycle_work
from multiscale.macro.substructures.joint_state import contact_state, joint_shares
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.whole_structure import Assembled
from multiscale.schema import MACRO_RESULT, with_cautions
from multiscale.units import readable

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["follow_amplitudes", "with_amplitudes"]


def follow_amplitudes(
    problem: CutProblem,
    path: "xr.Dataset",
    preloads: tuple[float, ...],
    amplitudes: tuple[float, ...],
    steps: int,
    *,
    method: CutSolver,
    near: "Sequence[xr.Dataset]" = (),
) -> "list[xr.Dataset]":
    """Follow closed cycles of all amplitudes from every preload.

    Parameters
    ----------
    problem, path, preloads, amplitudes
        As of :func:`with_amplitudes`.
    steps : int
        Load steps from zero to each amplitude in a cycle.
    method : CutSolver
    near : sequence of Dataset
        The same cycles under other laws, if they are known.

    Returns
    -------
    list of Dataset
        For each preload the path to it, then the cycles; none from the first that has failed.
    """
    shear, found = _shear(amplitudes, steps), []
    for level, preload in enumerate(preloads):
        if path["converged"].values[level] != 1:
            break
        factors = np.stack([np.full(shear.size, preload), shear], axis=1)
        start, like = path.isel(step=slice(level + 1)), near[level] if level < len(near) else None
        found.append(follow_bolts(problem, factors, method, start, like))
    return found


def _shear(amplitudes: tuple[float, ...], steps: int) -> np.ndarray:
    """Shear of all steps: to each amplitude, then a closed cycle, Pa."""
    return np.ravel(np.array(amplitudes)[:, None] * np.append(1.0, closed_cycle(steps)))


def with_amplitudes(
    result: "xr.Dataset",
    problem: CutProblem,
    path: "xr.Dataset",
    preloads: tuple[float, ...],
    amplitudes: tuple[float, ...],
    runs: "Sequence[xr.Dataset]",
    *,
    whole: Assembled,
    area: float,
    extrapolate: bool = False,
) -> "xr.Dataset":
    r"""Return the result of a joint with secant stiffness, slip and loss of cycles of shear.

    Parameters
    ----------
    result : Dataset
        Follows ``MACRO_RESULT``.
    problem : CutProblem
    path : Dataset
        Its solution, at the preloads first.
    preloads, amplitudes : tuple of float
        Pa; the amplitudes rise.
    runs : sequence of Dataset
        Of :func:`follow_amplitudes`.
    whole : Assembled
        The structure; its second load is 1 Pa of shear.
    area : float
        Area of the sheared face, m².
    extrapolate : bool
        As for :func:`load_joint`.

    Returns
    -------
    Dataset
        With the variables over ``level``, the number of a preload, and ``amplitude``. Values are
        NaN, and a caution says why, where a cycle has no answer.

    Notes
    -----
    From each preload the shear rises in one step to an amplitude, makes a closed cycle there and
    rises to the next amplitude. Every cycle is solved: pressing makes points slip, and the shear of
    a lap joint changes its pressure, so that Masing's rule from the first loading does not hold.
    The secant stiffness is the shear over the displacement between both ends of a cycle. Where the
    loss arises comes from the dissipation of the steps, whose sum is of first order in the step and
    is scaled to the work of the cycle.
    """
    shape = (len(preloads), len(amplitudes))
    loss, secant, slip = (np.full(shape, np.nan) for _ in range(3))
    density = np.full((*shape, path.sizes["point"]), np.nan)
    top, cautions = np.array(amplitudes), []
    for level, (preload, run) in enumerate(zip(preloads, runs, strict=False)):
        first = level + 1
        u = problem.unknowns(run["displacement"].values[first:])
        along = (u @ whole.load[:, 1] / area).reshape(top.size, -1)
        state = contact_state(problem.joints, run)
        far = joint_shares(problem.joints, run)[0][2].max(axis=1)
        inside = extrapolate | (far[first:] <= FAR_SHARE).reshape(top.size, -1).all(axis=1)
        kept = inside & np.isfinite(along).all(axis=1)
        half = along.shape[1] // 2
        apart = 0.5 * (along[:, 0] + along[:, -1]) - along[:, half]
        lost = state["dissipation"][first:].reshape(*along.shape, -1)[:, 1:].sum(axis=1)
        loss[level] = np.where(kept, area * cycle_work(top, along), np.nan)
        secant[level] = np.where(kept, 2.0 * top / apart, np.nan)
        reached = state["slipping_load"][first:].reshape(along.shape)[:, -1]
        slip[level] = np.where(kept, reached, np.nan)
        scale = loss[level] / (lost @ path["point_area"].values)  # of first order in the step
        density[level] = scale[:, None] * lost
        if not kept.all():
            why = run.attrs.get(
                "failure",
                f"more than {100.0 * FAR_SHARE:g} % of the load lies more than a factor of "
                f"{FAR_FACTOR:g} outside the pressures of the law",
            )
            cautions.append(
                f"cycles at the preload {readable(f'{preload:.4g} Pa')} have no answer from the "
                f"amplitude {readable(f'{top[~kept][0]:.4g} Pa')} on: {why}"
            )
    values = {
        "cycle_preload": np.array(preloads),
        "cycle_shear": top,
        "cycle_loss": loss,
        "cycle_slip": slip,
        "secant_stiffness": secant,
        "loss_density": density,
    }
    result = MACRO_RESULT.assign(result, values)
    labels = {"level": range(shape[0]), "amplitude": range(shape[1])}
    return with_cautions(result.assign_coords(labels), *cautions)
