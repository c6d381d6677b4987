"""The joint of a case: two blocks pressed together through the law, with the error budget."""

from typing import TYPE_CHECKING

import numpy as np

from multiscale.laws import NormalLaw
from multiscale.macro import Block, RoughJoint, press_joint
from multiscale.pipeline.cells import longest_wave
from multiscale.pipeline.settings import Case
from multiscale.schema import MACRO_RESULT
from multiscale.upscaling import (
    area_from_dataset,
    compare_scales,
    hysteretic_from_dataset,
    law_from_dataset,
    structure_budget,
    with_budget,
)
from multiscale.upscaling.scales import ScaleSeparation

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["joint_scales", "solve_joint"]


def joint_scales(case: Case) -> ScaleSeparation:
    """Compare the scales of the cells with those of the joint, whose pressure is even.

    Nothing varies over less than its width, which holds only so many cells.
    """
    return compare_scales(longest_wave(case), max(case.cell.size), case.joint.width)


def solve_joint(case: Case, law: "xr.Dataset", *, bootstrap: bool = True) -> "xr.Dataset":
    """Press two blocks together through the law and its samples.

    Parameters
    ----------
    case : Case
    law : Dataset
        Follows ``INTERFACE_LAW`` and carries its budget.
    bootstrap : bool
        Whether the samples of the law tell the sampling error of the joint, or its own budget.

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``, with the budget of the joint stiffness.
    """
    samples = range(law.sizes["sample"])
    preload = np.array(case.joint.preloads)
    result = press_joint(
        _joint(case),
        law_from_dataset(law),
        preload,
        samples=[law_from_dataset(law, sample) for sample in samples],
    )
    areas = {"contact_fraction": area_from_dataset(law).contact_fraction(preload)}
    if samples:
        areas["contact_fraction_sample"] = np.array(
            [area_from_dataset(law, sample).contact_fraction(preload) for sample in samples]
        )
    result = MACRO_RESULT.assign(result, areas | _unloading_stiffness(case, law, preload))
    if not result["converged"].values.any():
        return result

    def stiffness(one: NormalLaw) -> np.ndarray:
        return np.asarray(press_joint(_joint(case), one, preload)["joint_stiffness"].to_numpy())

    budget = structure_budget(
        "joint_stiffness",
        law,
        stiffness,
        answer=result["joint_stiffness"].to_numpy(),
        pressure=preload,
        exact="none: blocks and law in series are a closed form under even pressure",
        samples=result["joint_stiffness_sample"].to_numpy() if samples and bootstrap else 0,
    )
    return with_budget(result, budget)


def _unloading_stiffness(
    case: Case, law: "xr.Dataset", preload: np.ndarray
) -> dict[str, np.ndarray]:
    """Stiffness of the joint whose preload begins to fall, and its samples; if cells unloaded."""
    if "unloading_stiffness_ratio" not in law:
        return {}
    samples = range(law.sizes.get("unloading_sample", 0))
    result = press_joint(
        _joint(case),
        hysteretic_from_dataset(law),
        preload,
        samples=[hysteretic_from_dataset(law, sample) for sample in samples],
    )
    names = ("unloading_stiffness", "unloading_stiffness_sample")
    return {name: result[name].to_numpy() for name in names if name in result}


def _joint(case: Case) -> RoughJoint:
    """Make the joint of a case."""
    lower, upper = (
        Block(case.joint.height, body.youngs_modulus, body.poissons_ratio) for body in case.bodies
    )
    return RoughJoint((case.joint.width, case.joint.width), lower, upper)
