"""The error budget of rough joints, from the error budget of their law."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from multiscale.fe.facets import plane_axes
from multiscale.laws import NormalLaw, Sliders
from multiscale.macro.bodies import Assembly
from multiscale.macro.substructures import FEW_STEPS
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

__all__ = [
    "PARAMETERS",
    "CycleAnswers",
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
friction to the joints at their preloads and, if they slip, in cycles of few steps."""

Reader = Callable[["xr.Dataset"], np.ndarray]
"""From a result to the values of an answer."""

PARAMETERS = ("friction", "stiffness_ratio")
"""Parameters of the sliders, which are those of the law where the case gives none."""

AT_PRELOADS = (*STIFFNESSES, "tangential_stiffness", "real_pressure")
IN_CYCLES = ("cycle_slip", "cycle_loss", "secant_stiffness")
AT_END = {"cycle_slip": "slipping_load", "cycle_loss": "cycle_energy"}
"""Answers that have an error budget: at the preloads, in the cycles of every preload and amplitude,
and of the latter those that the path ends with, by their names there."""

UNKNOWN_LOSS = (
    "the error of the loss of a cycle is not known, since no cells of the law went through closed "
    "cycles; shear cells by [micro.shear]"
)


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
class CycleAnswers:
    """Answers of closed cycles that have an error budget.

    Attributes
    ----------
    read : mapping of str to callable
        From the name of an answer to its values, one for each cycle.
    slip, loss : str
        Names of the share of the load that slips and of the energy that is lost.
    steps : ndarray of int, shape (cycles,)
        Steps of the result with the pressure of each cycle.
    slope : ndarray, shape (cycles,)
        Logarithmic slope of the slipping share over the amplitude, NaN where it is not known.
    density : ndarray, shape (cycles, points)
        Where each cycle loses its energy, J/m².
    finer : float
        Load steps of a cycle of the result, over those of the paths that the budget solves.
    """

    read: Mapping[str, Reader]
    slip: str
    loss: str
    steps: np.ndarray
    slope: np.ndarray
    density: np.ndarray
    finer: float


@dataclass(frozen=True, eq=False)
class JointAnswers:
    """Answers of joints that have an error budget, and where.

    Attributes
    ----------
    read : mapping of str to callable
        From the name of an answer at rest to its values, which a result gives over its steps.
    rests : ndarray of int
        Steps at which these are wanted, the same in every path that is solved.
    cycles : CycleAnswers, optional
    place : callable
        From the result and a budget whose columns are the known rests, then the cycles, to the
        result with budget and intervals.
    """

    read: Mapping[str, Reader]
    rests: np.ndarray
    place: Callable[["xr.Dataset", "xr.Dataset"], "xr.Dataset"]
    cycles: CycleAnswers | None = None


def joint_answers(result: "xr.Dataset") -> JointAnswers:
    """Return the answers of joints at their preloads, then in the cycles of every amplitude."""
    known = result["known"].to_numpy() == 1
    rests = np.flatnonzero(np.isfinite(result["joint_stiffness"].to_numpy()))
    read = {name: partial(_values, name) for name in AT_PRELOADS}
    level, amplitude = np.zeros((2, 0), dtype=int)
    if "cycle_loss" in result and result["converged"].to_numpy().all():
        level, amplitude = np.nonzero(np.isfinite(result["cycle_loss"].to_numpy()))
    cycles = None
    if level.size:
        cycles = CycleAnswers(
            {name: partial(_of_cycles, name, level, amplitude) for name in IN_CYCLES},
            "cycle_slip",
            "cycle_loss",
            level,  # a preload is the step of its number
            _slip_slope(result)[level, amplitude],
            result["loss_density"].to_numpy()[level, amplitude],
            FEW_STEPS,
        )
    ended = bool(level.size) and bool(known[-1])
    ended = ended and bool(np.isfinite(result["cycle_loss"].to_numpy()[-1, -1]))

    def place(result: "xr.Dataset", budget: "xr.Dataset") -> "xr.Dataset":
        """Give cycles their intervals, by their numbers, and the last step the last cycle."""
        values, errors = {}, interval_errors(budget)
        for row, name in enumerate(map(str, budget["quantity"].values)):
            for kind, error in errors.items() if name in IN_CYCLES else ():
                half = np.full(result[name].shape, np.nan)
                half[level, amplitude] = error[row, -level.size :]
                values[f"{name}_{kind}"] = limits(result[name].to_numpy(), half)
        result, at = MACRO_RESULT.assign(result, values), rests[known[rests]]
        columns = [*range(at.size), *([-1] if ended else [])]
        at = np.append(at, known.size - 1) if ended else at
        names = [name for name in map(str, budget["quantity"].values) if name not in IN_CYCLES[2:]]
        own = budget.isel(step=columns).sel(quantity=names)
        own = own.assign_coords(quantity=[AT_END.get(name, name) for name in names])
        return with_intervals(with_budget(result, over_steps(own, at, known.size)))

    return JointAnswers(read, rests, place, cycles)


def load_answers(result: "xr.Dataset", rise: int, few: int) -> JointAnswers:
    """Return the answers of bodies under named loads, then those of the last cycle.

    Parameters
    ----------
    result : Dataset
    rise, few : int
        Load steps from the middle of the cycles to their amplitude, in the result and in the paths
        that are solved for the budget; 0 without cycles.
    """
    name, stiffness = "load_stiffness", result["load_stiffness"].to_numpy()
    loads = {f"{name} {load}": (name, str(load)) for load in result["load"].values}
    rests = np.flatnonzero(np.isfinite(stiffness).all(axis=1))
    known, last = result["known"].to_numpy() == 1, np.array([result.sizes["step"] - 1])
    lost = result["cycle_energy"].to_numpy() if "cycle_energy" in result else np.full(1, np.nan)
    cycles = None
    if rise and known[-1] and np.isfinite(lost[-1]):
        share = result["slipping_load"].to_numpy()[-2:]
        slope = np.full(1, np.nan)
        if rise > 1 and share.min() > 0.0:
            slope[:] = np.log(share[1] / share[0]) / np.log(rise / (rise - 1))
        density = result["dissipation"].to_numpy()[-4 * rise :].sum(axis=0, keepdims=True)
        read = {name: partial(_last, name) for name in AT_END.values()}
        cycles = CycleAnswers(
            read, "slipping_load", "cycle_energy", last, slope, density, rise / few
        )

    def place(result: "xr.Dataset", budget: "xr.Dataset") -> "xr.Dataset":
        """Give every step its column."""
        steps = np.append(rests[known[rests]], () if cycles is None else last).astype(int)
        return with_intervals(with_budget(result, over_steps(budget, steps, known.size)), loads)

    read = {name: partial(_of_load, *one) for name, one in loads.items()}
    return JointAnswers(read, rests, place, cycles)


def _values(name: str, found: "xr.Dataset") -> np.ndarray:
    """Values of an answer; the real pressure stays as it is."""
    if name == "real_pressure":
        return np.ones(found.sizes["step"])
    return np.asarray(found[name].to_numpy())


def _of_cycles(
    name: str, level: np.ndarray, amplitude: np.ndarray, found: "xr.Dataset"
) -> np.ndarray:
    """Values of an answer in the cycles of some preloads and amplitudes, by their numbers."""
    return np.asarray(found[name].to_numpy()[level, amplitude])


def _last(name: str, found: "xr.Dataset") -> np.ndarray:
    """Value at the end of the path."""
    return np.asarray(found[name].to_numpy()[-1:])


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
        Its paths have the rests and the cycles that are asked.
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
        :func:`~multiscale.upscaling.with_intervals`, also those of other cycles.
    """
    known = result["known"].to_numpy() == 1
    rests, cycles = asked.rests[known[asked.rests]], asked.cycles
    if not rests.size:
        return result
    read = dict(asked.read)
    if "area_pressure" not in law:
        read.pop("real_pressure", None)
    in_cycles = {} if cycles is None else cycles.read
    names = (*read, *in_cycles)
    steps = rests if cycles is None else np.append(rests, cycles.steps)
    cycled = np.arange(steps.size) >= rests.size

    def answers(found: "xr.Dataset") -> np.ndarray:
        """Answers at rest, then in the cycles, and one for what stays as it is."""
        rows = np.full((len(names), steps.size), np.nan)
        for row, values in zip(rows, read.values(), strict=False):
            row[: rests.size] = values(found)[rests]
        for row, values in zip(rows[len(read) :], in_cycles.values(), strict=True):
            row[rests.size :] = values(found)
        return rows

    def solved(one: NormalLaw, structure: RoughBodies | Bodies | None = None) -> np.ndarray:
        return answers(solve(one, structure, {}))

    area, normal = result["point_area"].to_numpy(), law_from_dataset(law)
    pressure = np.maximum(-result["traction"].to_numpy()[steps, :, 0], 0.0)
    mean = np.sum(pressure * area, axis=1) / np.sum((pressure > 0.0) * area, axis=1)
    cells = np.ones((len(names), steps.size))
    if {"longest_wave", "cell_size", "sampling_factor"} <= set(law.attrs):
        wave, cell = float(law.attrs["longest_wave"]), float(law.attrs["cell_size"])
        length, extent = _lengths(result, pressure[rests.size - 1])
        scales = compare_scales(wave, cell, length, extent=extent)
        law, result = with_scales(law, scales), with_cautions(result, *scales.cautions)
        cells[:] = effective_cells(pressure, area, cell)
        if cycles is not None:
            own_cells = effective_cells(cycles.density, area, cell)
            cells[names.index(cycles.loss), rests.size :] = own_cells
        law = law.assign_attrs(
            {
                how_attribute(FEW_CELLS): f"scatter of single cells, of which {cells.min():.3g} or "
                f"more share the answers"
            }
        )
        cells *= scales.cell_ratio**2

    value, others, own = answers(result), [], {}
    rows = np.array(names)
    lost = rows[:, None] == ("" if cycles is None else cycles.loss)
    if cycles is not None:
        fine, value = value, solved(normal)
        left = (
            np.abs(value / fine - 1.0) / (cycles.finer**2 - 1.0) if cycles.finer > 1.0 else np.nan
        )
        left = np.where(cycled, left, 0.0) * np.ones(value.shape)
        others.append(Dependence(np.ones(left.shape), {"macro discretisation": left}))
        others.append(_uneven_slip(law, cycles, mean, rows))
        own["friction bed"] = _part_of(loss_term(law), lost)
        if "shear_loss_grid_error" in law:
            told = "the loss ratio on two grids"
            grid = Term(told, law["shear_loss_grid_error"].to_numpy())
            own["micro discretisation"] = _part_of(grid, lost)
        if "shear_loss_ratio" not in law:
            result = with_cautions(result, UNKNOWN_LOSS)
    others.append(contact_dependence(law, mean, rows == "real_pressure"))
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
        coarser={ratio: solved(normal, structure) for ratio, structure in coarser.items()},
        samples=0,
        others=others,
        own=own,
        cells=cells,
    )
    if not coarser:
        why = (
            "not known: elements of twice the size do not fit; give smaller ones, or an even "
            "number of them, in [structure], or the coarser meshes of bodies"
        )
        budget = budget.assign_attrs({how_attribute("macro discretisation"): why})
    return asked.place(result, budget)


def _part_of(term: Term, rows: np.ndarray) -> Term:
    """Return a term of single numbers as one of some rows (answers, 1), zero for the others."""
    half, bias = (
        np.where(rows, np.asarray(one, dtype=float), 0.0) for one in (term.half_width, term.bias)
    )
    return replace(term, half_width=half, bias=bias)


def _slip_slope(result: "xr.Dataset") -> np.ndarray:
    """Logarithmic slope of the slipping share over the amplitude, shape (levels, amplitudes).

    It is from the amplitudes, or from the last steps of the path if there is one amplitude alone.
    """
    share, shear = result["cycle_slip"].to_numpy(), result["cycle_shear"].to_numpy()
    with np.errstate(divide="ignore", invalid="ignore"):  # where nothing slips, nothing is known
        if shear.size > 1:
            return np.asarray(np.gradient(np.log(share), np.log(shear), axis=1))
        at = np.log([result[name].to_numpy()[-2:] for name in ("slipping_load", "shear")])
        return np.full(share.shape, np.ptp(at[0]) / np.ptp(at[1]))


def _uneven_slip(
    law: "xr.Dataset", cycles: CycleAnswers, pressure: np.ndarray, rows: np.ndarray
) -> Dependence:
    """Return how the slip depends on the scatter of stiffness between cells of one joint.

    Where one cell is stiffer than others, it carries more of the shear and slips more; a law that
    is stiffer everywhere has no such effect. The shear of a point rises at most in proportion to
    its stiffness, and its slip by the logarithmic slope of slip over shear times this change.
    """
    one = law["error_half_width"].sel(quantity="stiffness", error_term=FEW_CELLS)
    data = np.log(law["fit_pressure"].to_numpy())
    few = np.interp(np.log(pressure), data, one.to_numpy())
    change = np.zeros((rows.size, pressure.size))
    change[rows == cycles.slip, -cycles.slope.size :] = cycles.slope
    return Dependence(change, {FEW_CELLS: few})


def with_contact(result: "xr.Dataset", law: "xr.Dataset") -> "xr.Dataset":
    """Return the result of rough joints with their real contact, and facts about the cells.

    Parameters are those of :func:`with_joint_budget`. A law without contact area leaves contact
    fraction and real pressure out.
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
