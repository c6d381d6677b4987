"""The error budget of rough joints, from the error budget of their law."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from multiscale.laws import NormalLaw, Sliders
from multiscale.macro.bodies import Assembly
from multiscale.macro.substructures import FEW_STEPS
from multiscale.pipeline.body_settings import RoughBodies
from multiscale.pipeline.real_contact import behaviour, contact_dependence, real_pressure
from multiscale.pipeline.stages.joint import STIFFNESSES
from multiscale.schema import MACRO_RESULT, with_cautions
from multiscale.upscaling import (
    Dependence,
    area_from_dataset,
    cell_share,
    compare_scales,
    effective_cells,
    interval_errors,
    law_from_dataset,
    limits,
    over_steps,
    pressure_length_of_points,
    shear_errors,
    structure_budget,
    with_budget,
    with_intervals,
    with_scales,
)
from multiscale.upscaling.budget import how_attribute
from multiscale.upscaling.budget_terms import FEW_CELLS, Term
from multiscale.upscaling.shear_budget import loss_term
from multiscale.upscaling.structure_errors import STRETCH

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["JointSolve", "change_friction", "with_contact", "with_joint_budget"]

JointSolve = Callable[[NormalLaw, RoughBodies | None, Mapping[str, float]], "xr.Dataset"]
"""From a normal law, another mesh of the structure if not its own, and factors of the parameters of
friction to the joints at their preloads and, if they slip, in cycles of few steps."""

AT_PRELOADS = (*STIFFNESSES, "tangential_stiffness", "real_pressure")
IN_CYCLES = ("cycle_slip", "cycle_loss", "secant_stiffness")
AT_END = {"cycle_slip": "slipping_load", "cycle_loss": "cycle_energy"}
"""Answers that have an error budget: at the preloads, in the cycles of every preload and amplitude,
and of the latter those that the path ends with, by their names there."""

UNKNOWN_LOSS = (
    "the error of the loss of a cycle is not known, since the law tells of no cells that went "
    "through closed cycles; shear cells by [micro.shear]"
)


def change_friction(assembly: Assembly, factors: Mapping[str, float]) -> Assembly:
    """Return an assembly whose sliders have some parameters times their factors."""

    def changed(law: Sliders) -> Sliders:
        return replace(
            law, **{name: factor * getattr(law, name) for name, factor in factors.items()}
        )

    return replace(
        assembly,
        interfaces=tuple(
            replace(one, law=changed(one.law))  # type: ignore[arg-type]  # rough joints have sliders
            for one in assembly.interfaces
        ),
    )


def with_joint_budget(
    result: "xr.Dataset",
    law: "xr.Dataset",
    solve: JointSolve,
    coarser: RoughBodies | None,
    measured: Collection[str],
) -> "xr.Dataset":
    """Return the result of rough joints with error budget and intervals of their answers.

    Parameters
    ----------
    result : Dataset
        Follows ``MACRO_RESULT``; joints at their preloads, then in cycles, with their contact.
    law : Dataset
        Follows ``INTERFACE_LAW`` and carries its budget.
    solve : callable
        Its cycles have the preloads and amplitudes of the result.
    coarser : RoughBodies, optional
        The structure on elements of twice the size, if it has them.
    measured : collection of str
        Parameters of the sliders, ``friction`` and ``stiffness_ratio``, that come from the law,
        and not given.

    Returns
    -------
    Dataset
        With the budget of stiffnesses and real pressure at the preloads, and of the slip and the
        loss of the last cycle at its end, NaN elsewhere and where the law knows nothing; and with
        the intervals of :func:`~multiscale.upscaling.with_intervals`, also those of the cycles at
        every preload and amplitude.
    """
    known = result["known"].to_numpy() == 1
    pressed = np.flatnonzero(np.isfinite(result["joint_stiffness"].to_numpy()) & known)
    if not pressed.size:
        return result
    level, amplitude = np.zeros((2, 0), dtype=int)
    if "cycle_loss" in result and result["converged"].to_numpy().all():
        level, amplitude = np.nonzero(np.isfinite(result["cycle_loss"].to_numpy()))
    at_preloads = AT_PRELOADS if "area_pressure" in law else AT_PRELOADS[:-1]
    names = (*at_preloads, *IN_CYCLES) if level.size else at_preloads
    first, steps = pressed.size, np.append(pressed, level)  # a preload is the step of its number
    cycled = np.arange(steps.size) >= first

    def answers(found: "xr.Dataset") -> np.ndarray:
        """Answers at the preloads, then in the cycles, and one for what stays as it is."""
        rows = np.full((len(names), steps.size), np.nan)
        for row, name in zip(rows, names, strict=True):
            if name in IN_CYCLES:
                row[first:] = found[name].to_numpy()[level, amplitude]
            else:
                row[:first] = 1.0 if name == "real_pressure" else found[name].to_numpy()[pressed]
        return rows

    def solved(one: NormalLaw, structure: RoughBodies | None = None) -> np.ndarray:
        return answers(solve(one, structure, {}))

    area, normal = result["point_area"].to_numpy(), law_from_dataset(law)
    pressure = np.maximum(-result["traction"].to_numpy()[steps, :, 0], 0.0)
    mean = np.sum(pressure * area, axis=1) / np.sum((pressure > 0.0) * area, axis=1)
    cells = np.ones((len(names), steps.size))
    if {"longest_wave", "cell_size", "sampling_factor"} <= set(law.attrs):
        wave, cell = float(law.attrs["longest_wave"]), float(law.attrs["cell_size"])
        length, extent = _lengths(result, pressure[first - 1])
        scales = compare_scales(wave, cell, length, extent=extent)
        law, result = with_scales(law, scales), with_cautions(result, *scales.cautions)
        cells[:] = effective_cells(pressure, area, cell)
        if level.size:
            density = result["loss_density"].to_numpy()[level, amplitude]
            cells[names.index("cycle_loss"), first:] = effective_cells(density, area, cell)
        law = law.assign_attrs(
            {
                how_attribute(FEW_CELLS): f"scatter of single cells, of which {cells.min():.3g} or "
                f"more share the answers"
            }
        )
        cells *= scales.cell_ratio**2

    value, others = answers(result), []
    if level.size:
        fine, value = value, solved(normal)
        left = np.where(cycled, np.abs(value / fine - 1.0) / (FEW_STEPS**2 - 1.0), 0.0)
        others.append(Dependence(np.ones(left.shape), {"macro discretisation": left}))
        others.append(_uneven_slip(result, law, level, amplitude, mean, np.array(names)))
    others.append(contact_dependence(law, mean, np.array(names) == "real_pressure"))
    lost = np.array(names)[:, None] == "cycle_loss"
    own = {}
    if level.size:
        own["friction bed"] = _part_of(loss_term(law), lost)
        if "shear_loss_grid_error" in law:
            told = "the loss ratio on two grids"
            grid = Term(told, law["shear_loss_grid_error"].to_numpy())
            own["micro discretisation"] = _part_of(grid, lost)
        if "shear_loss_ratio" not in law:
            result = with_cautions(result, UNKNOWN_LOSS)
    for name, half_width in shear_errors(law, mean).items():
        if name in measured:
            # cycles of the cells tell all that the loss has of the bed
            half_width |= {k: np.where(lost, 0.0, half_width[k]) for k in own if k in half_width}
            changed = answers(solve(normal, None, {name: 1.0 + STRETCH}))
            change = np.abs(changed / value - 1.0) / STRETCH
            others.append(Dependence(change, half_width))
    budget = structure_budget(
        names,
        law,
        solved,
        answer=value,
        pressure=mean,
        coarser=None if coarser is None else {2.0: solved(normal, coarser)},
        samples=0,
        others=others,
        own=own,
        cells=cells,
    )
    if coarser is None:
        why = (
            "not known: elements of twice the size do not fit; give smaller ones, or an even "
            "number of them, in [structure]"
        )
        budget = budget.assign_attrs({how_attribute("macro discretisation"): why})
    result = _with_cycle_intervals(result, budget, level, amplitude)
    ends, at = budget.isel(step=~cycled), pressed
    if level.size and known[-1] and np.isfinite(result["cycle_loss"].to_numpy()[-1, -1]):
        ends, at = budget.isel(step=[*range(first), -1]), np.append(pressed, known.size - 1)
    kept = [name for name in names if name not in IN_CYCLES or name in AT_END]
    ends = ends.sel(quantity=kept).assign_coords(quantity=[AT_END.get(name, name) for name in kept])
    return with_intervals(with_budget(result, over_steps(ends, at, known.size)))


def _with_cycle_intervals(
    result: "xr.Dataset", budget: "xr.Dataset", level: np.ndarray, amplitude: np.ndarray
) -> "xr.Dataset":
    """Add the intervals of cycles, which the budget has in its last columns, by their numbers."""
    values, errors = {}, interval_errors(budget)
    for row, name in enumerate(map(str, budget["quantity"].values)):
        for kind, error in errors.items() if name in IN_CYCLES else ():
            half = np.full(result[name].shape, np.nan)
            half[level, amplitude] = error[row, -level.size :]
            values[f"{name}_{kind}"] = limits(result[name].to_numpy(), half)
    return MACRO_RESULT.assign(result, values)


def _part_of(term: Term, rows: np.ndarray) -> Term:
    """Return a term of single numbers as one of some rows (answers, 1), zero for the others."""
    half, bias = (
        np.where(rows, np.asarray(one, dtype=float), 0.0) for one in (term.half_width, term.bias)
    )
    return replace(term, half_width=half, bias=bias)


def _uneven_slip(
    result: "xr.Dataset",
    law: "xr.Dataset",
    level: np.ndarray,
    amplitude: np.ndarray,
    pressure: np.ndarray,
    rows: np.ndarray,
) -> Dependence:
    """Let slip change where a stiffer cell takes more of the shear, which others lose.

    A law that is stiffer everywhere leaves the shear of each point as it is, so that it tells
    nothing of one that is stiffer here and softer there. Each point slips more by its slope over
    the shear, from the amplitudes, or from the last steps of the path if there is one amplitude
    alone, and at most as its stiffness rises.
    """
    share, shear = result["cycle_slip"].to_numpy(), result["cycle_shear"].to_numpy()
    slope = np.full(share.shape, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):  # where nothing slips, nothing is known
        if shear.size > 1:
            slope = np.gradient(np.log(share), np.log(shear), axis=1)
        else:
            at = np.log([result[name].to_numpy()[-2:] for name in ("slipping_load", "shear")])
            slope[:] = np.ptp(at[0]) / np.ptp(at[1])
    one = law["error_half_width"].sel(quantity="stiffness", error_term=FEW_CELLS)
    data = np.log(law["fit_pressure"].to_numpy())
    few = np.interp(np.log(pressure), data, one.to_numpy())
    change = np.zeros((rows.size, pressure.size))
    change[rows == "cycle_slip", -level.size :] = slope[level, amplitude]
    return Dependence(change, {FEW_CELLS: few})


def with_contact(result: "xr.Dataset", law: "xr.Dataset") -> "xr.Dataset":
    """Return the result of rough joints with their real contact, and facts about the cells.

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
