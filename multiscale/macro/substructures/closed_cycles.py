"""Closed cycles of a load: their factors, their steps, and what they say of a joint."""

from typing import TYPE_CHECKING

import numpy as np

from multiscale.macro.data_range import FAR_FACTOR, FAR_SHARE
from multiscale.macro.substructures.joint_state import contact_state, joint_shares
from multiscale.schema import MACRO_RESULT, Dataset, with_cautions
from multiscale.units import readable

if TYPE_CHECKING:
    from multiscale.macro.substructures.joint_loading import FollowedJoint

__all__ = ["closed_cycle", "cycle_work", "find_cycles", "to_and_fro", "with_amplitudes"]

ROUNDING = 1e-9
"""Loss of a cycle, relative to the amplitude of its load times its displacement, that is zero."""


def to_and_fro(steps: int, cycles: int) -> np.ndarray:
    """Rise to 1 in some steps, then closed cycles to -1 and back."""
    rise = np.arange(1, steps + 1) / steps
    return np.concatenate([rise, np.tile(closed_cycle(steps), cycles)])


def find_cycles(first: int, steps: int, cycles: int) -> list[slice]:
    """Find the steps of each cycle, with both ends, after a rise that begins at one of them."""
    start = first + steps - 1 + 4 * steps * np.arange(cycles)
    return [slice(at, at + 4 * steps + 1) for at in start]


def closed_cycle(steps: int) -> np.ndarray:
    """Shear over its amplitude from the positive amplitude to the negative one and back."""
    rise = np.arange(1, steps + 1) / steps
    return np.concatenate([1.0 - rise, -rise, rise - 1.0, rise])


def cycle_work(amplitude: np.ndarray | float, displacement: np.ndarray) -> np.ndarray:
    r"""Work of a closed cycle of shear."""
    half = displacement.shape[-1] // 2
    weight = np.ones(half + 1)
    weight[1:-1:2], weight[2:-1:2] = 4.0, 2.0
    back, forth = displacement[..., : half + 1], displacement[..., half:]
    enclosed = 2.0 / (3.0 * half) * np.asarray(amplitude) * ((back - forth) @ weight)
    work = np.asarray(amplitude * (displacement[..., -1] - displacement[..., 0]) + enclosed)
    rounding = ROUNDING * np.abs(amplitude) * np.ptp(displacement, axis=-1)
    return np.where(np.abs(work) < rounding, 0.0, work)


def with_amplitudes(
    result: Dataset, followed: "FollowedJoint", area: float, *, extrapolate: bool = False
) -> Dataset:
    r"""Return the result of a joint with secant stiffness, slip and loss of its cycles of shear.

    Notes
    -----
    Every cycle is solved: pressing makes points slip, and the shear of
    a lap joint changes its pressure, so that Masing's rule from the first loading does not hold.
    The secant stiffness is the shear over the displacement between both ends of a cycle. Where the
    loss arises comes from the dissipation of the steps, whose sum is of first order in the step and
    is scaled to the work of the cycle.
    """
    preloads, problem = followed.loading.preloads, followed.path.problem
    top, cautions = np.array(followed.loading.amplitudes), []
    shape = (len(preloads), top.size)
    loss, secant, slip = (np.full(shape, np.nan) for _ in range(3))
    density = np.full((*shape, result.sizes["point"]), np.nan)
    for level, (preload, run) in enumerate(zip(preloads, followed.cycles, strict=False)):
        first = level + 1
        u = problem.unknowns(run["displacement"].values[first:])
        along = (u @ followed.path.whole.load[:, 1] / area).reshape(top.size, -1)
        state = contact_state(problem, run)
        far = joint_shares(problem, run)[0][2].max(axis=1)
        inside = extrapolate | (far[first:] <= FAR_SHARE).reshape(top.size, -1).all(axis=1)
        kept = inside & np.isfinite(along).all(axis=1)
        half = along.shape[1] // 2
        apart = 0.5 * (along[:, 0] + along[:, -1]) - along[:, half]
        lost = state["dissipation"][first:].reshape(*along.shape, -1)[:, 1:].sum(axis=1)
        loss[level] = np.where(kept, area * cycle_work(top, along), np.nan)
        secant[level] = np.where(kept, 2.0 * top / apart, np.nan)
        reached = state["slipping_load"][first:].reshape(along.shape)[:, -1]
        slip[level] = np.where(kept, reached, np.nan)
        slipped = lost @ result["point_area"].values  # of first order in the step
        density[level] = (loss[level] / np.where(slipped > 0.0, slipped, 1.0))[:, None] * lost
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
