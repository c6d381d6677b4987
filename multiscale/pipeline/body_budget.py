"""The error budget of rough joints, from the error budget of their law."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from multiscale.fe.facets import plane_axes
from multiscale.laws import NormalLaw, Sliders
from multiscale.macro.bodies import Assembly
from multiscale.pipeline.assembly_settings import Bodies
from multiscale.pipeline.body_settings import RoughBodies
from multiscale.pipeline.real_contact import behaviour, contact_dependence, real_pressure
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stages.joint import STIFFNESSES
from multiscale.schema import MACRO_RESULT, with_cautions
from multiscale.upscaling import (
    Dependence,
    area_from_dataset,
    cell_share,
    compare_scales,
    effective_cells,
    law_from_dataset,
    over_steps,
    pressure_length_of_points,
    shear_errors,
    structure_budget,
    with_budget,
    with_intervals,
    with_scales,
)
from multiscale.upscaling.budget import how_attribute
from multiscale.upscaling.budget_terms import FEW_CELLS
from multiscale.upscaling.structure_errors import STRETCH

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "PARAMETERS",
    "JointAnswers",
    "JointSolve",
    "change_friction",
    "few_steps",
    "joint_answers",
    "load_answers",
    "with_contact",
    "with_joint_budget",
]

JointSolve = Callable[[NormalLaw, RoughBodies | Bodies | None, Mapping[str, float]], "xr.Dataset"]
"""From a normal law, another mesh of the structure if not its own, and factors of the parameters of
friction to the joints at their preloads and, if they slip, in a cycle of few steps."""

FEW_STEPS = 2
"""Most load steps to the amplitude of the cycle that tells how slip and loss depend on the law."""

PARAMETERS = ("friction", "stiffness_ratio")
"""Parameters of the sliders, which are those of the law where the case gives none."""

AT_PRELOADS = (*STIFFNESSES, "tangential_stiffness", "real_pressure")
IN_CYCLES = ("slipping_load", "cycle_energy")
"""Answers that have an error budget: at the preloads, and at the end of the last cycle."""


def few_steps(case: Case) -> int:
    """Return the steps to the amplitude of the cycle that is solved again with changed laws."""
    return max(1, min(FEW_STEPS, case.cycles.steps // 2)) if case.cycles else 0


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


@dataclass(frozen=True, eq=False)
class JointAnswers:
    """Answers of joints that have an error budget, and where.

    Attributes
    ----------
    read : mapping of str to callable
        From the name of an answer at rest to its values, which a result gives over its steps.
    rests : ndarray of int
        Steps at which these are wanted, the same in every path that is solved.
    rise, few : int
        Load steps from the middle of the cycles to their amplitude, in the result and in the paths
        that are solved for the budget; 0 without cycles.
    along : mapping of str to tuple of str
        Variable and load of those answers that are not variables themselves.
    """

    read: Mapping[str, Callable[["xr.Dataset"], np.ndarray]]
    rests: np.ndarray
    rise: int = 0
    few: int = 0
    along: Mapping[str, tuple[str, str]] = field(default_factory=dict)


def joint_answers(result: "xr.Dataset", few: int) -> JointAnswers:
    """Tell the answers of joints at their preloads, then in cycles that rise in few steps."""
    cycles = result.sizes.get("cycle", 0)
    return JointAnswers(
        {name: partial(_values, name) for name in AT_PRELOADS},
        np.flatnonzero(np.isfinite(result["joint_stiffness"].to_numpy())),
        _sheared(result) // (4 * cycles + 1) if cycles else 0,
        few,
    )


def load_answers(result: "xr.Dataset", rise: int, few: int) -> JointAnswers:
    """Tell the answers of bodies under named loads, then in cycles; arguments as their fields."""
    name, stiffness = "load_stiffness", result["load_stiffness"].to_numpy()
    loads = {f"{name} {load}": (name, str(load)) for load in result["load"].values}
    return JointAnswers(
        {name: partial(_of_load, *one) for name, one in loads.items()},
        np.flatnonzero(np.isfinite(stiffness).all(axis=1)),
        rise,
        few,
        loads,
    )


def _values(name: str, found: "xr.Dataset") -> np.ndarray:
    """Values of an answer; the real pressure stays as it is."""
    if name == "real_pressure":
        return np.ones(found.sizes["step"])
    return np.asarray(found[name].to_numpy())


def _of_load(name: str, load: str, found: "xr.Dataset") -> np.ndarray:
    """Values of an answer of one load."""
    return np.asarray(found[name].sel(load=load).to_numpy())


def with_joint_budget(
    result: "xr.Dataset",
    law: "xr.Dataset",
    solve: JointSolve,
    asked: JointAnswers,
    coarser: Mapping[float, RoughBodies | Bodies],
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
        Its cycle has the last preload, the shear and few of the steps of the result.
    asked : JointAnswers
    coarser : mapping of float to structure
        The structure on larger elements, if it has them, by the ratio of their sizes.
    measured : collection of str
        Parameters of the sliders, ``friction`` and ``stiffness_ratio``, that come from the law,
        and not given.

    Returns
    -------
    Dataset
        With the budget of the answers at rest, and of the slip and the loss of the last cycle at
        its end, NaN elsewhere and where the law knows nothing; and with the intervals of
        :func:`~multiscale.upscaling.with_intervals`.
    """
    known = result["known"].to_numpy() == 1
    pressed = asked.rests[known[asked.rests]]
    if not pressed.size:
        return result
    lost = result["cycle_energy"].to_numpy() if "cycle_energy" in result else np.full(1, np.nan)
    cycled = bool(known[-1] and np.isfinite(lost[-1]))
    rise = asked.rise
    steps = np.append(pressed, result.sizes["step"] - 1) if cycled else pressed
    read = dict(asked.read)
    if "area_pressure" not in law:
        read.pop("real_pressure", None)
    names = (*read, *IN_CYCLES) if cycled else tuple(read)

    def answers(found: "xr.Dataset", at: np.ndarray, cycle: int = -1) -> np.ndarray:
        """Answers at the preloads and at the end, and one for what stays as it is."""
        rows = np.full((len(names), steps.size), np.nan)
        for row, values in zip(rows, read.values(), strict=False):
            row[: pressed.size] = values(found)[at]
        if cycled:
            rows[-2:, -1] = found["slipping_load"][-1], found["cycle_energy"][cycle]
        return rows

    def solved(one: NormalLaw, structure: RoughBodies | Bodies | None = None) -> np.ndarray:
        return answers(solve(one, structure, {}), pressed)

    area, normal = result["point_area"].to_numpy(), law_from_dataset(law)
    pressure = np.maximum(-result["traction"].to_numpy()[steps, :, 0], 0.0)
    mean = np.sum(pressure * area, axis=1) / np.sum((pressure > 0.0) * area, axis=1)
    cells = np.ones((len(names), steps.size))
    if {"longest_wave", "cell_size", "sampling_factor"} <= set(law.attrs):
        wave, cell = float(law.attrs["longest_wave"]), float(law.attrs["cell_size"])
        length, extent = _lengths(result, pressure[pressed.size - 1])
        scales = compare_scales(wave, cell, length, extent=extent)
        law, result = with_scales(law, scales), with_cautions(result, *scales.cautions)
        cells[:] = effective_cells(pressure, area, cell)
        if cycled:
            loss = result["dissipation"].to_numpy()[-4 * rise :].sum(axis=0)
            cells[-1] = effective_cells(loss, area, cell)
        law = law.assign_attrs(
            {
                how_attribute(FEW_CELLS): f"scatter of single cells, of which {cells.min():.3g} or "
                f"more share the answers"
            }
        )
        cells *= scales.cell_ratio**2

    value, others = answers(result, pressed), []
    if cycled:
        path = solve(normal, None, {})
        first, value = answers(result, pressed, 0), answers(path, pressed)
        finer = rise / asked.few
        left = np.zeros(value.shape)
        left[-1] = np.abs(value / first - 1.0)[-1] / (finer**2 - 1.0) if finer > 1.0 else np.nan
        others.append(Dependence(np.ones(left.shape), {"macro discretisation": left}))
        others.append(_uneven_slip(result, law, mean, rise, np.array(names) == "slipping_load"))
    others.append(contact_dependence(law, mean, np.array(names) == "real_pressure"))
    for name, half_width in shear_errors(law, mean).items():
        if name in measured:
            changed = answers(solve(normal, None, {name: 1.0 + STRETCH}), pressed)
            change = np.abs(changed / value - 1.0) / STRETCH
            others.append(Dependence(change, half_width))
    budget = structure_budget(
        names,
        law,
        solved,
        answer=value,
        pressure=mean,
        coarser={ratio: solved(normal, structure) for ratio, structure in coarser.items()},
        samples=0,
        others=others,
        cells=cells,
    )
    if not coarser:
        why = (
            "not known: elements of twice the size do not fit; give smaller ones, or an even "
            "number of them, in [structure], or the coarser meshes of bodies"
        )
        budget = budget.assign_attrs({how_attribute("macro discretisation"): why})
    result = with_budget(result, over_steps(budget, steps, result.sizes["step"]))
    return with_intervals(result, asked.along)


def _uneven_slip(
    result: "xr.Dataset", law: "xr.Dataset", pressure: np.ndarray, rise: int, rows: np.ndarray
) -> Dependence:
    """Let slip change where a stiffer cell takes more of the shear, which others lose.

    A law that is stiffer everywhere leaves the shear of each point as it is, so that it tells
    nothing of one that is stiffer here and softer there. Each point slips more by its slope over
    the shear, taken at the last step to the amplitude, and at most as its stiffness rises.
    """
    share = result["slipping_load"].to_numpy()[-2:]
    slope = np.nan
    if rise > 1 and share.min() > 0.0:
        slope = float(np.log(share[1] / share[0]) / np.log(rise / (rise - 1)))
    one = law["error_half_width"].sel(quantity="stiffness", error_term=FEW_CELLS)
    data = np.log(law["fit_pressure"].to_numpy())
    few = np.interp(np.log(pressure), data, one.to_numpy())
    change = np.where(rows[:, None], slope, np.zeros(pressure.size))
    return Dependence(change, {FEW_CELLS: few})


def _sheared(result: "xr.Dataset") -> int:
    """Count the steps of a path from the first shear on."""
    return int(np.count_nonzero(np.cumsum(np.abs(result["shear"].to_numpy()))))


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
    place, lengths, extents = result["point_position"].to_numpy(), [], []
    for joint in np.unique(number):
        mine = number == joint
        extents.append(float(np.sqrt(area[mine].sum())))
        flat = place[mine] @ plane_axes(place[mine])[1:].T
        varies = pressure_length_of_points(flat, pressure[mine], area[mine])
        lengths.append(min(extents[-1], varies))
    return float(min(lengths)), float(min(extents))
