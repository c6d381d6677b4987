"""A rough joint whose blocks and interface are damaged by cycles."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws import Damaged, NormalLaw
from multiscale.laws.bulk import AnisotropicElastic
from multiscale.macro.joint.even import press_joint
from multiscale.macro.joint.geometry import Block, RoughJoint
from multiscale.schema import FATIGUE, MACRO_RESULT, RVE_STIFFNESS

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["cycled_joint", "soften"]


def soften(block: Block, stiffness: "float | xr.Dataset") -> Block:
    """Return a block with less stiffness.

    Parameters
    ----------
    block : Block, sound, or softened before
    stiffness : float or Dataset
        A share of what it was, above 0 and up to 1, such as 1 - D, for all its stiffness alike.
        Or a dataset that follows ``RVE_STIFFNESS``: the block takes the whole tensor of the
        representative volume, whose axes are the axes of the joint, in place of its moduli.

    Raises
    ------
    CaseError
        If the share is outside its range, or the volume is cut through.
    SchemaError
        If the dataset does not follow its schema.
    """
    if not isinstance(stiffness, int | float | np.number):
        RVE_STIFFNESS.check(stiffness)
        return replace(block, effective=AnisotropicElastic(stiffness["stiffness"].values))
    if not 0.0 < stiffness <= 1.0:
        raise CaseError(
            f"the stiffness factor of a block must lie above 0 and up to 1, got {stiffness:g}; a "
            f"block without stiffness carries no joint"
        )
    share = float(stiffness)
    return replace(
        block,
        youngs_modulus=share * block.youngs_modulus,
        effective=block.effective and block.effective.scaled(share),
    )


def cycled_joint(
    joint: RoughJoint,
    law: NormalLaw,
    preload: float,
    fatigue: "xr.Dataset",
    *,
    damage_interface: bool = False,
    steps: int = 9,
) -> "xr.Dataset":
    """Solve a rough joint at several times of its life.

    Parameters
    ----------
    joint : RoughJoint
        Geometry, elasticity without fatigue (see :func:`soften` for blocks with cavities) and
        mesh.
    law : NormalLaw, sound interface law
    preload : float, nominal pressure, Pa
    fatigue : Dataset, follows ``FATIGUE``: damage against cycles
    damage_interface : bool
        Whether the law is damaged as well: its asperities belong to the same material.
    steps : int, number of times, at equal steps of damage

    Returns
    -------
    Dataset, follows ``MACRO_RESULT``, with ``cycles`` and ``damage`` of every step

    Raises
    ------
    CaseError
        If there are no steps, or the damage of a block is total.
    SchemaError
        If ``fatigue`` does not follow its schema.
    """
    FATIGUE.check(fatigue)
    if steps < 1:
        raise CaseError(f"steps must be at least 1, got {steps}")
    known, cycles = fatigue["damage"].values, fatigue["cycles"].values
    damage = np.linspace(0.0, known[-1], steps) if known[-1] > 0.0 else np.zeros(1)
    # until damage sets in, time passes without it: the first step is the end of that time
    start = int(np.flatnonzero(known > 0.0)[0]) - 1 if known[-1] > 0.0 else 0
    found = []
    for D in damage:
        if D >= 1.0:
            raise CaseError("the blocks are broken through, D = 1: their stiffness is zero")
        worn = replace(
            joint, lower=soften(joint.lower, 1.0 - D), upper=soften(joint.upper, 1.0 - D)
        )
        found.append(
            press_joint(worn, Damaged(law, D) if damage_interface else law, np.array([preload]))
        )
    names = [str(name) for name, value in found[0].data_vars.items() if "step" in value.dims]
    values = {name: np.concatenate([one[name].values for one in found]) for name in names}
    return MACRO_RESULT.build(
        {
            **values,
            "preload": np.full(damage.size, preload),
            "damage": damage,
            "cycles": np.interp(damage, known[start:], cycles[start:]),
        },
        cautions="\n".join(
            dict.fromkeys(one.attrs["cautions"] for one in found if one.attrs["cautions"])
        ),
    )
