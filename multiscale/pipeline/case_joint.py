"""The joint of a case: two blocks pressed together through the law, with the error budget."""

from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.laws import NormalLaw
from multiscale.macro import Block, RoughJoint, press_joint
from multiscale.pipeline.case_cells import longest_wave
from multiscale.pipeline.real_contact import behaviour, real_pressure
from multiscale.pipeline.settings import Case
from multiscale.schema import MACRO_RESULT, with_cautions
from multiscale.upscaling import (
    area_from_dataset,
    cell_share,
    compare_scales,
    fitted_laws,
    law_from_dataset,
    over_steps,
    require_law,
    structure_budget,
    with_budget,
)
from multiscale.upscaling.scales import ScaleSeparation

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["STIFFNESSES", "joint_scales", "solve_joint"]

STIFFNESSES = ("joint_stiffness", "interface_stiffness", "solid_stiffness")
"""Of the whole, of its interface and of its bodies: all have an error budget."""


def joint_scales(case: Case) -> ScaleSeparation:
    """Compare the scales of the cells with those of the joint, whose pressure is even.

    Nothing varies over less than its width, which holds only so many cells.
    """
    return compare_scales(longest_wave(case), max(case.cell.size), case.joint.width)


def solve_joint(case: Case, law: "xr.Dataset") -> "xr.Dataset":
    """Press two blocks together through the law and its samples.

    Parameters
    ----------
    case : Case
    law : Dataset
        Follows ``INTERFACE_LAW`` and carries its budget, which tells the sampling error of the
        joint if the law has no samples.

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``, with the budget of :data:`STIFFNESSES`.
    """
    joint, preload, extrapolate = _joint(case), np.array(case.joint.preloads), case.law.extrapolate
    samples = range(law.sizes["sample"])
    result = press_joint(
        joint,
        law_from_dataset(law),
        preload,
        samples=fitted_laws(law, samples),
        extrapolate=extrapolate,
    )
    fraction = area_from_dataset(law).contact_fraction(preload)
    areas = {"contact_fraction": fraction, "real_pressure": real_pressure(preload, fraction)}
    kept = np.isfinite(result["joint_stiffness"].to_numpy())
    areas |= _unloading_stiffness(law, result)
    areas = {name: np.where(kept, value, np.nan) for name, value in areas.items()}
    result = MACRO_RESULT.assign(with_cautions(result, *joint_scales(case).cautions), areas)
    result = result.assign_attrs(
        facts="\n".join([*behaviour(law), cell_share(max(case.cell.size), case.joint.width)]),
    )
    steps = np.flatnonzero(kept & (result["known"].values == 1))
    if not steps.size:
        return result

    def stiffness(one: NormalLaw) -> np.ndarray:
        pressed = press_joint(joint, one, preload[steps], extrapolate=True)
        return np.stack([pressed[name].to_numpy() for name in STIFFNESSES])

    known = result.isel(step=steps)
    drawn: np.ndarray | int = 0
    if samples:
        names = ("joint_stiffness_sample", "interface_stiffness_sample")
        rows = [known[name].to_numpy() for name in names]
        solid = np.broadcast_to(known["solid_stiffness"].to_numpy(), rows[0].shape)
        drawn = np.stack([*rows, solid], axis=1)
    budget = structure_budget(
        STIFFNESSES,
        law,
        stiffness,
        answer=np.stack([known[name].to_numpy() for name in STIFFNESSES]),
        pressure=preload[steps],
        exact="none: blocks and law in series are a closed form under even pressure",
        samples=drawn,
    )
    return with_budget(result, over_steps(budget, steps, preload.size))


def _unloading_stiffness(law: "xr.Dataset", result: "xr.Dataset") -> dict[str, np.ndarray]:
    r"""Stiffness of the joint whose preload begins to fall, and its samples; if cells unloaded.

    With the factor :math:`\beta` of the unloading branch, (1) of
    :func:`~multiscale.macro.press_joint` for :math:`\beta K` instead of :math:`K`.
    """
    if "unloading_stiffness_ratio" not in law:
        return {}
    K, solid = (result[name].to_numpy() for name in ("interface_stiffness", "solid_stiffness"))
    ratio: dict[str, Any] = {"unloading_stiffness": float(law["unloading_stiffness_ratio"])}
    if law.sizes.get("unloading_sample"):
        require_law(law, "unloading_stiffness_ratio_sample")
        drawn = law["unloading_stiffness_ratio_sample"].to_numpy()[:, None]
        ratio["unloading_stiffness_sample"] = drawn
    return {name: 1.0 / (1.0 / (beta * K) + 1.0 / solid) for name, beta in ratio.items()}


def _joint(case: Case) -> RoughJoint:
    """Make the joint of a case."""
    lower, upper = (
        Block(case.joint.height, body.youngs_modulus, body.poissons_ratio) for body in case.bodies
    )
    return RoughJoint((case.joint.width, case.joint.width), lower, upper)
