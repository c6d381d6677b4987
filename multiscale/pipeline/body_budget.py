"""The error budget of rough joints, from the error budget of their law."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.pipeline.body_settings import RoughBodies
from multiscale.pipeline.real_contact import behaviour, real_pressure
from multiscale.pipeline.stages.joint import STIFFNESSES
from multiscale.schema import MACRO_RESULT, with_cautions
from multiscale.upscaling import (
    area_from_dataset,
    cell_share,
    compare_scales,
    law_from_dataset,
    over_steps,
    pressure_length_of_points,
    structure_budget,
    with_budget,
    with_scales,
)
from multiscale.upscaling.budget import how_attribute

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["with_contact", "with_joint_budget"]


def with_joint_budget(
    result: "xr.Dataset",
    law: "xr.Dataset",
    stiffness: Callable[..., np.ndarray],
    coarser: RoughBodies | None,
) -> "xr.Dataset":
    """Return the result of rough joints with the error budget of their stiffnesses.

    Parameters
    ----------
    result : Dataset
        Follows ``MACRO_RESULT``; joints at their preloads, then in cycles.
    law : Dataset
        Follows ``INTERFACE_LAW`` and carries its budget.
    stiffness : callable
        From a normal law, and optionally another mesh of the structure, to the stiffnesses of
        :data:`~multiscale.pipeline.stages.joint.STIFFNESSES` at the preloads, shape (3, preloads),
        Pa/m.
    coarser : RoughBodies, optional
        The structure on elements of twice the size, if it has them.

    Returns
    -------
    Dataset
        The budget is NaN at the steps of the cycles, which have no stiffness, and at those of
        which the law knows nothing.
    """
    known = np.isfinite(result["joint_stiffness"].to_numpy()) & (result["known"].to_numpy() == 1)
    steps = np.flatnonzero(known)
    if not steps.size:
        return result
    area, traction = result["point_area"].to_numpy(), result["traction"].to_numpy()
    pressure = -traction[steps, :, 0]
    closed = pressure > 0.0
    mean = np.sum(pressure * area, axis=1) / np.sum(closed * area, axis=1)
    if {"longest_wave", "cell_size", "sampling_factor"} <= set(law.attrs):
        wave, cell = float(law.attrs["longest_wave"]), float(law.attrs["cell_size"])
        length, extent = _lengths(result, pressure[-1])
        scales = compare_scales(wave, cell, length, extent=extent)
        law, result = with_scales(law, scales), with_cautions(result, *scales.cautions)

    def known_stiffness(*changed: Any) -> np.ndarray:
        return stiffness(*changed)[:, steps]

    budget = structure_budget(
        STIFFNESSES,
        law,
        known_stiffness,
        answer=np.stack([result[name].to_numpy()[steps] for name in STIFFNESSES]),
        pressure=mean,
        coarser=None if coarser is None else {2.0: known_stiffness(law_from_dataset(law), coarser)},
        samples=0,
    )
    if coarser is None:
        why = (
            "not known: elements of twice the size do not fit; give smaller ones, or an even "
            "number of them, in [structure]"
        )
        budget = budget.assign_attrs({how_attribute("macro discretisation"): why})
    return with_budget(result, over_steps(budget, steps, result.sizes["step"]))


def with_contact(result: "xr.Dataset", law: "xr.Dataset") -> "xr.Dataset":
    """Return the result of rough joints with their real contact, and what is told of the cells.

    As of :func:`with_joint_budget`; if the law has no contact area, nothing is known of it.
    """
    facts, area = behaviour(law), result["point_area"].to_numpy()
    if "cell_size" in law.attrs:
        number = result["point_joint"].to_numpy()
        edge = min(np.sqrt(area[number == joint].sum()) for joint in np.unique(number))
        facts.append(cell_share(float(law.attrs["cell_size"]), float(edge)))
    else:
        facts.append("The law does not say how large its cells were.")
    if "area_pressure" in law:
        pressure = np.maximum(-result["traction"].to_numpy()[..., 0], 0.0)
        sound = 1.0 - result["point_damage"].to_numpy()
        known = np.isfinite(pressure)
        local = area_from_dataset(law).contact_fraction(np.where(known, pressure, 0.0) / sound)
        fraction = np.where(known, sound * local, np.nan) @ area / area.sum()
        carried = pressure @ area / area.sum()
        values = {"contact_fraction": fraction, "real_pressure": real_pressure(carried, fraction)}
        result = MACRO_RESULT.assign(result, values)
    return result.assign_attrs(facts="\n".join(facts))


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
