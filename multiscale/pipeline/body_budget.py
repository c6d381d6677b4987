"""The error budget of rough joints, from the error budgets of their laws."""

from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from multiscale.executors import run_jobs
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
    add_budgets,
    area_from_dataset,
    cell_share,
    changed_laws,
    compare_scales,
    effective_cells,
    interval_errors,
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
    "Change",
    "CycleAnswers",
    "JointAnswers",
    "JointSolve",
    "JointsOfLaw",
    "change_friction",
    "few_steps",
    "joint_answers",
    "load_answers",
    "with_contact",
    "with_interface_contact",
    "with_joint_budget",
]


@dataclass(frozen=True, eq=False)
class Change:
    """What is not as in the structure when it is solved again.

    Attributes
    ----------
    joints : tuple of int
        Numbers of the joints whose law changes.
    normal : NormalLaw, optional
        In place of their normal law.
    factors : mapping of str to float
        Of the parameters of their friction.
    structure : RoughBodies or Bodies, optional
        The same structure on another mesh.
    """

    joints: tuple[int, ...] = ()
    normal: NormalLaw | None = None
    factors: Mapping[str, float] = field(default_factory=dict)
    structure: RoughBodies | Bodies | None = None


@dataclass(frozen=True, eq=False)
class JointsOfLaw:
    """Joints that share a law with a budget.

    Attributes
    ----------
    law : Dataset
        Follows ``INTERFACE_LAW`` and carries its budget.
    joints : tuple of int
        Numbers of the joints.
    measured : collection of str
        Parameters of their sliders, of :data:`PARAMETERS`, that come from the law, and not given.
    """

    law: "xr.Dataset"
    joints: tuple[int, ...]
    measured: Collection[str]


JointSolve = Callable[[Change], "xr.Dataset"]
"""From a change to the joints at their preloads and, if they slip, in cycles of few steps; workers
must be able to import it."""

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


def change_friction(
    assembly: Assembly, factors: Mapping[str, float], joints: Collection[int] | None = None
) -> Assembly:
    """Return an assembly whose sliders have some parameters times their factors.

    These are the sliders of some joints, by their numbers, or of all.
    """

    def changed(law: Sliders) -> Sliders:
        return replace(
            law, **{name: factor * getattr(law, name) for name, factor in factors.items()}
        )

    return replace(
        assembly,
        interfaces=tuple(
            replace(one, law=changed(one.law))  # type: ignore[arg-type]  # rough joints have sliders
            if joints is None or number in joints
            else one
            for number, one in enumerate(assembly.interfaces)
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
    real : mapping of str to tuple of int
        Numbers of the joints of which some of these answers are the real pressure.
    rests : ndarray of int
        Steps at which these are wanted, the same in every path that is solved.
    cycles : CycleAnswers, optional
    place : callable
        From the result and a budget whose columns are the known rests, then the cycles, to the
        result with budget and intervals.
    """

    read: Mapping[str, Reader]
    real: Mapping[str, tuple[int, ...]]
    rests: np.ndarray
    place: Callable[["xr.Dataset", "xr.Dataset"], "xr.Dataset"]
    cycles: CycleAnswers | None = None


def joint_answers(result: "xr.Dataset") -> JointAnswers:
    """Return the answers of joints at their preloads, then in the cycles of every amplitude."""
    known = result["known"].to_numpy() == 1
    rests = np.flatnonzero(np.isfinite(result["joint_stiffness"].to_numpy()))
    names = [name for name in AT_PRELOADS if name in result]  # real pressure may not be known
    read = {name: partial(_values, name) for name in names}
    joints = tuple(np.unique(result["point_joint"].to_numpy()).astype(int).tolist())
    real = {"real_pressure": joints} if "real_pressure" in result else {}
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

    return JointAnswers(read, real, rests, place, cycles)


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
    loads = {f"{name} {load}": (name, k) for k, load in enumerate(map(str, result["load"].values))}
    real = {}
    if "interface_real_pressure" in result:
        known_area = np.isfinite(result["interface_real_pressure"].to_numpy()).any(axis=0)
        real = {
            f"real pressure of interface {k}": ("interface_real_pressure", int(k))
            for k in np.flatnonzero(known_area)
        }
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
        budget = over_steps(budget, steps, known.size)
        return with_intervals(with_budget(result, budget), {**loads, **real})

    read = {
        **{key: partial(_of_load, *one) for key, one in loads.items()},
        **{key: partial(_values, "real_pressure") for key in real},
    }
    return JointAnswers(read, {key: (k,) for key, (_, k) in real.items()}, rests, place, cycles)


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


def _of_load(name: str, load: int, found: "xr.Dataset") -> np.ndarray:
    """Values of an answer of one load, by its number."""
    return np.asarray(found[name].to_numpy()[:, load])


def with_joint_budget(
    result: "xr.Dataset",
    laws: Sequence[JointsOfLaw],
    solve: JointSolve,
    asked: JointAnswers,
    coarser: Mapping[float, RoughBodies | Bodies],
    executor: Executor | None = None,
) -> "xr.Dataset":
    """Return the result of rough joints with error budget and intervals of their answers.

    Parameters
    ----------
    result : Dataset
        Follows ``MACRO_RESULT``; joints at their preloads, then in cycles, with their contact.
    laws : sequence of JointsOfLaw
        Their errors are independent.
    solve : callable
        Its paths have the rests and the cycles that are asked.
    asked : JointAnswers
    coarser : mapping of float to structure
        The structure on larger elements, if it has them, by the ratio of their sizes.
    executor : Executor, optional
        Solves all changes; see :func:`~multiscale.executors.run_jobs`.

    Returns
    -------
    Dataset
        With the budget of the answers at rest, and of the slip and the loss of the last cycle at
        its end, NaN elsewhere and where a law knows nothing; and with the intervals of
        :func:`~multiscale.upscaling.with_intervals`, also those of other cycles.
    """
    known = result["known"].to_numpy() == 1
    rests, cycles = asked.rests[known[asked.rests]], asked.cycles
    if not rests.size:
        return result
    in_cycles = {} if cycles is None else cycles.read
    names = (*asked.read, *in_cycles)
    steps = rests if cycles is None else np.append(rests, cycles.steps)

    def answers(found: "xr.Dataset") -> np.ndarray:
        """Answers at rest, then in the cycles, and one for what stays as it is."""
        rows = np.full((len(names), steps.size), np.nan)
        for row, values in zip(rows, asked.read.values(), strict=False):
            row[: rests.size] = values(found)[rests]
        for row, values in zip(rows[len(asked.read) :], in_cycles.values(), strict=True):
            row[rests.size :] = values(found)
        return rows

    of_laws = [_OfLaw.measure(one, result, steps, rests.size, asked) for one in laws]
    jobs: dict[Hashable, Change] = {} if cycles is None else {"fine": Change()}
    jobs |= {ratio: Change(structure=structure) for ratio, structure in coarser.items()}
    for number, one in enumerate(of_laws):
        jobs |= {(number, key): change for key, change in one.changes().items()}
    solved: dict[Hashable, np.ndarray] = {}
    run_jobs(
        solve,
        {key: (change,) for key, change in jobs.items()},
        executor,
        lambda key, found: solved.update({key: answers(found)}),
    )
    value, mesh = answers(result), {ratio: solved[ratio] for ratio in coarser}
    once = []
    if cycles is not None:
        fine, value = value, solved["fine"]
        left = (
            np.abs(value / fine - 1.0) / (cycles.finer**2 - 1.0) if cycles.finer > 1.0 else np.nan
        )
        left = np.where(np.arange(steps.size) >= rests.size, left, 0.0) * np.ones(value.shape)
        once.append(Dependence(np.ones(left.shape), {"macro discretisation": left}))
    budgets = []
    for number, one in enumerate(of_laws):
        changed = {key: solved[number, key] for key in one.changes()}
        result = with_cautions(result, *one.cautions)
        # the error of the mesh counts once
        budgets.append(one.budget(names, value, changed, mesh, [] if number else once))
    where = [f"interface {', '.join(map(str, one.joints))}" for one in laws]
    budget = add_budgets(budgets, where)
    if not coarser:
        why = (
            "not known: elements of twice the size do not fit; give smaller ones, or an even "
            "number of them, in [structure], or the coarser meshes of bodies"
        )
        budget = budget.assign_attrs({how_attribute("macro discretisation"): why})
    return asked.place(result, budget)


@dataclass(frozen=True, eq=False)
class _OfLaw:
    """What a structure tells of one of its laws.

    Attributes
    ----------
    law : Dataset
        With the scales of the joints.
    joints, measured
        See :class:`JointsOfLaw`.
    asked : JointAnswers
    pressure : ndarray, shape (columns,)
        Mean pressure of the closed points of the joints, Pa.
    cells : ndarray, shape (2, columns)
        As ``cells`` of :func:`~multiscale.upscaling.structure_budget`: of loss, and of the others.
    load, loss : ndarray, shape (columns,)
        Shares of the joints in the load of all, and in the loss of cycles.
    cautions : tuple of str
    """

    law: "xr.Dataset"
    joints: tuple[int, ...]
    measured: Collection[str]
    asked: JointAnswers
    pressure: np.ndarray
    cells: np.ndarray
    load: np.ndarray
    loss: np.ndarray
    cautions: tuple[str, ...]

    @classmethod
    def measure(
        cls,
        of: JointsOfLaw,
        result: "xr.Dataset",
        steps: np.ndarray,
        n_rests: int,
        asked: JointAnswers,
    ) -> "_OfLaw":
        """Measure the joints at some steps, of which the first ones are at rest."""
        law, cycles, said = of.law, asked.cycles, list[str]()
        mine = np.isin(result["point_joint"].to_numpy(), of.joints)
        area = result["point_area"].to_numpy()
        whole = np.maximum(-result["traction"].to_numpy()[steps, :, 0], 0.0)
        pressure, own = whole[:, mine], area[mine]
        closed = np.sum((pressure > 0.0) * own, axis=1)
        mean = np.sum(pressure * own, axis=1) / np.where(closed > 0.0, closed, np.nan)
        loss = np.zeros(steps.size)
        if cycles is not None:
            lost = cycles.density @ area
            loss[n_rests:] = cycles.density[:, mine] @ own / np.where(lost > 0.0, lost, 1.0)
        cells = np.ones((2, steps.size))
        if {"longest_wave", "cell_size"} <= set(law.attrs) and "cell_scatter" in law:
            wave, cell = float(law.attrs["longest_wave"]), float(law.attrs["cell_size"])
            place = result["point_position"].to_numpy()[mine]
            number = result["point_joint"].to_numpy()[mine]
            length, extent = _lengths(place, number, own, pressure[n_rests - 1])
            scales = compare_scales(wave, cell, length, extent=extent)
            law, said = with_scales(law, scales), list(scales.cautions)
            cells[:] = effective_cells(pressure, own, cell)
            if cycles is not None:
                cells[0, n_rests:] = effective_cells(cycles.density[:, mine], own, cell)
            told = f"scatter of single cells, of which {cells.min():.3g} or more share the answers"
            law = law.assign_attrs({how_attribute(FEW_CELLS): told})
            cells *= scales.cell_ratio**2
        if cycles is not None and "shear_loss_ratio" not in law:
            said.append(UNKNOWN_LOSS)
        load = pressure @ own / (whole @ area)
        return cls(law, of.joints, of.measured, asked, mean, cells, load, loss, tuple(said))

    def changes(self) -> dict[str, Change]:
        """Return what the structure is solved again with, by what changes."""
        normal = changed_laws(self.law, self.pressure)
        sliders = [name for name in shear_errors(self.law, self.pressure) if name in self.measured]
        return {
            **{key: Change(self.joints, one) for key, one in normal.items()},
            **{key: Change(self.joints, factors={key: 1.0 + STRETCH}) for key in sliders},
        }

    def budget(
        self,
        names: tuple[str, ...],
        value: np.ndarray,
        changed: Mapping[str, np.ndarray],
        coarser: Mapping[float, np.ndarray],
        others: Sequence[Dependence],
    ) -> "xr.Dataset":
        """Carry the budget of the law to answers, from those with its changes, and by the mesh."""
        law, mean, cycles = self.law, self.pressure, self.asked.cycles
        rows, own = np.array(names), {}
        lost = rows[:, None] == ("" if cycles is None else cycles.loss)
        passed = list(others)
        if cycles is not None:
            passed.append(_uneven_slip(law, cycles, mean, rows, self.load))
            own["friction bed"] = _part_of(loss_term(law), lost * self.loss)
            if "shear_loss_grid_error" in law:
                told = "the loss ratio on two grids"
                grid = Term(told, law["shear_loss_grid_error"].to_numpy())
                own["micro discretisation"] = _part_of(grid, lost * self.loss)
        real = [bool(set(self.asked.real.get(name, ())) & set(self.joints)) for name in names]
        if any(real):
            passed.append(contact_dependence(law, mean, np.array(real)))
        for name, half_width in shear_errors(law, mean).items():
            if name in changed:
                # cycles of the cells tell all that the loss has of the bed
                half_width |= {
                    k: np.where(lost, 0.0, half_width[k]) for k in own if k in half_width
                }
                change = np.abs(changed[name] / value - 1.0) / STRETCH
                passed.append(Dependence(change, half_width))
        return structure_budget(
            names,
            law,
            _not_solved,
            answer=value,
            pressure=mean,
            coarser=coarser,
            samples=0,
            others=passed,
            own=own,
            cells=np.where(lost, *self.cells),
            changed=changed,
        )


def _not_solved(law: NormalLaw) -> np.ndarray:
    """Refuse to solve with a law whose answers are given."""
    raise AssertionError(f"{law} should be among the changed laws")


def _part_of(term: Term, rows: np.ndarray) -> Term:
    """Return a term of single numbers as one of shares (answers, steps), zero without a share."""
    half, bias = (
        np.where(rows != 0.0, rows * np.asarray(one, dtype=float), 0.0)
        for one in (term.half_width, term.bias)
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
    law: "xr.Dataset",
    cycles: CycleAnswers,
    pressure: np.ndarray,
    rows: np.ndarray,
    load: np.ndarray,
) -> Dependence:
    """Return how the slip depends on the scatter of stiffness between cells of one joint.

    Where one cell is stiffer than others, it carries more of the shear and slips more; a law that
    is stiffer everywhere has no such effect. The shear of a point rises at most in proportion to
    its stiffness, and its slip by the logarithmic slope of slip over shear times this change. The
    law has a share in the load of all joints.
    """
    one = law["error_half_width"].sel(quantity="stiffness", error_term=FEW_CELLS)
    data = np.log(law["fit_pressure"].to_numpy())
    few = np.interp(np.log(pressure), data, one.to_numpy())
    change = np.zeros((rows.size, pressure.size))
    change[rows == cycles.slip, -cycles.slope.size :] = cycles.slope
    change *= load
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
        carried, touching = _carried(result, law, np.full(area.size, True))
        values = {
            "contact_fraction": touching / area.sum(),
            "real_pressure": real_pressure(carried, touching),
        }
        result = MACRO_RESULT.assign(result, values)
    return result.assign_attrs(facts="\n".join(facts))


def with_interface_contact(
    result: "xr.Dataset", laws: "Sequence[xr.Dataset | None]"
) -> "xr.Dataset":
    """Return the result of bodies with the mean real pressure of every interface.

    Those whose law has no contact area, or is stated (None), have NaN.
    """
    number = result["point_joint"].to_numpy()
    real = np.full((result.sizes["step"], len(laws)), np.nan)
    for joint, law in enumerate(laws):
        if law is not None and "area_pressure" in law:
            real[:, joint] = real_pressure(*_carried(result, law, number == joint))
    if np.isnan(real).all():
        return result
    return MACRO_RESULT.assign(result, {"interface_real_pressure": real})


def _carried(
    result: "xr.Dataset", law: "xr.Dataset", mine: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Load, N, and real contact area, m², of some points at every step."""
    area, pressure = result["point_area"].to_numpy()[mine], -result["traction"].to_numpy()[..., 0]
    pressure = np.maximum(pressure[:, mine], 0.0)
    sound, known = 1.0 - result["point_damage"].to_numpy()[mine], np.isfinite(pressure)
    local = area_from_dataset(law).contact_fraction(np.where(known, pressure, 0.0) / sound)
    return pressure @ area, np.where(known, sound * local, np.nan) @ area


def _lengths(
    place: np.ndarray, number: np.ndarray, area: np.ndarray, pressure: np.ndarray
) -> tuple[float, float]:
    """Length over which the pressure of a joint varies, at most its edge, and that edge, m.

    The least ones of the joints, from the places of their points and the number of its joint.
    """
    lengths, extents = [], []
    for joint in np.unique(number):
        mine = number == joint
        extents.append(float(np.sqrt(area[mine].sum())))
        flat = place[mine] @ plane_axes(place[mine])[1:].T
        varies = pressure_length_of_points(flat, pressure[mine], area[mine])
        lengths.append(min(extents[-1], varies))
    return float(min(lengths)), float(min(extents))
