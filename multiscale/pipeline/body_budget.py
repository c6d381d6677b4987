"""The error budget of the joints of a scene, from that of their law."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from multiscale.pipeline.body_settings import LapJoint, StackedBlocks
from multiscale.schema import ERROR_BUDGET
from multiscale.upscaling import (
    compare_scales,
    law_from_dataset,
    pressure_length_of_points,
    structure_budget,
    with_budget,
    with_scales,
)
from multiscale.upscaling.budget import how_attribute

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["with_joint_budget"]


def with_joint_budget(
    result: "xr.Dataset",
    law: "xr.Dataset",
    stiffness: Callable[..., np.ndarray],
    coarser: StackedBlocks | LapJoint | None,
) -> "xr.Dataset":
    """Return the result of a scene with the error budget of its joint stiffness.

    Parameters
    ----------
    result : Dataset
        Follows ``MACRO_RESULT``; joints at their preloads, then in cycles.
    law : Dataset
        Follows ``INTERFACE_LAW`` and carries its budget.
    stiffness : callable
        From a normal law, and optionally another mesh of the structure, to the joint stiffness at
        the preloads, Pa/m.
    coarser : StackedBlocks or LapJoint, optional
        The structure on elements of twice the size, if it has them.

    Returns
    -------
    Dataset
        The budget is NaN at the steps of the cycles, which have no stiffness.
    """
    preloads = np.flatnonzero(np.isfinite(result["joint_stiffness"].to_numpy()))
    area, traction = result["point_area"].to_numpy(), result["traction"].to_numpy()
    pressure = -traction[preloads, :, 0]
    closed = pressure > 0.0
    mean = np.sum(pressure * area, axis=1) / np.sum(closed * area, axis=1)
    if {"longest_wave", "cell_size", "sampling_factor"} <= set(law.attrs):
        wave, cell = float(law.attrs["longest_wave"]), float(law.attrs["cell_size"])
        length, extent = _lengths(result, pressure[-1])
        law = with_scales(law, compare_scales(wave, cell, length, extent=extent))
    budget = structure_budget(
        "joint_stiffness",
        law,
        stiffness,
        answer=result["joint_stiffness"].to_numpy()[preloads],
        pressure=mean,
        coarser=None if coarser is None else {2.0: stiffness(law_from_dataset(law), coarser)},
        samples=0,
    )
    if coarser is None:
        told = (
            "not known: elements of twice the size do not fit; give smaller ones, or an even "
            "number of them, in [structure]"
        )
        budget = budget.assign_attrs({how_attribute("macro discretisation"): told})
    names = ("error_half_width", "error_bias", "error_total")
    values = {}
    for name in names:
        values[name] = np.full((*budget[name].shape[:-1], result.sizes["step"]), np.nan)
        values[name][..., preloads] = budget[name].to_numpy()
    whole = ERROR_BUDGET.build(values, **budget.attrs).assign_coords(
        quantity=budget["quantity"].values, error_term=budget["error_term"].values
    )
    return with_budget(result, whole)


def _lengths(result: "xr.Dataset", pressure: np.ndarray) -> tuple[float, float]:
    """Length over which the pressure of a joint varies, at most its edge, and that edge, m."""
    number, area = result["point_joint"].to_numpy(), result["point_area"].to_numpy()
    place, lengths, extents = result["point_position"].to_numpy()[:, :2], [], []
    for joint in np.unique(number):
        mine = number == joint
        extents.append(float(np.sqrt(area[mine].sum())))
        varies = pressure_length_of_points(place[mine], pressure[mine], area[mine])
        lengths.append(min(extents[-1], varies))
    return float(min(lengths)), float(min(extents))
