"""The error budget of rough joints, from the error budgets of their laws."""

from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np

from multiscale.executors import run_jobs
from multiscale.fe.faces import plane_axes
from multiscale.laws import InterfaceLaw, NormalLaw, Sliders
from multiscale.macro import substructures
from multiscale.pipeline.assembly_settings import Bodies
from multiscale.pipeline.joint_answers import CycleAnswers, JointAnswers
from multiscale.pipeline.joint_settings import SLABS
from multiscale.pipeline.porous_body import Uncertainty
from multiscale.pipeline.real_contact import contact_dependence
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Job
from multiscale.schema import ERROR_BUDGET, Dataset, with_cautions
from multiscale.upscaling import (
    Dependence,
    add_budgets,
    changed_laws,
    compare_scales,
    effective_cells,
    pressure_length_of_points,
    shear_errors,
    structure_budget,
    with_scales,
)
from multiscale.upscaling.budget import (
    ALWAYS,
    ERROR_TERMS,
    NO_PART,
    NO_STATED,
    assemble_budget,
    has_budget,
    how_attribute,
)
from multiscale.upscaling.budget_terms import FEW_CELLS, STATED, Term
from multiscale.upscaling.resolution import estimate_grid_error
from multiscale.upscaling.shear_budget import loss_term
from multiscale.upscaling.structure_errors import STRETCH

__all__ = [
    "Change",
    "ErrorSources",
    "JointSolve",
    "change_friction",
    "changed_sliders",
    "few_steps",
    "not_solved",
    "with_joint_budget",
]


@dataclass(frozen=True, eq=False)
class Change:
    """What is not as in the structure when it is solved again.

    Attributes
    ----------
    joints : tuple of int, numbers of the joints whose law changes
    normal : NormalLaw, optional, in place of their normal law
    factors : mapping of str to float, factors of the parameters of their friction
    slabs : int, optional, number of slabs of their beds of sliders
    structure : Bodies, optional, the same structure on another mesh
    """

    joints: tuple[int, ...] = ()
    normal: NormalLaw | None = None
    factors: Mapping[str, float] = field(default_factory=dict)
    slabs: int | None = None
    structure: Bodies | None = None


@dataclass(frozen=True, eq=False)
class JointsOfLaw:
    """Joints that share a law with a budget.

    Attributes
    ----------
    law : Dataset, follows ``INTERFACE_LAW`` and carries its budget
    joints : tuple of int, numbers of the joints
    measured : collection of str
        Parameters of their sliders that come from the law, as the case gives none.
    """

    law: Dataset
    joints: tuple[int, ...]
    measured: Collection[str]

    def changes(self, pressure: np.ndarray | None) -> dict[str, Change]:
        """Return what a structure is solved again with, by what changes.

        ``pressure`` of the joints, Pa, is None where they carry nothing, and nothing slips.
        """
        normal = changed_laws(self.law, pressure)
        sliders = [] if pressure is None else [*shear_errors(self.law, pressure)]
        return {key: Change(self.joints, one) for key, one in normal.items()} | {
            key: Change(self.joints, factors={key: 1.0 + STRETCH})
            for key in sliders
            if key in self.measured
        }


JointSolve = Callable[[Change], "Dataset"]
"""From a change to the joints at their preloads and, if they slip, in cycles of few steps; workers
must be able to import it."""

BED = "friction bed"  # a term

UNKNOWN_LOSS = (
    "the error of the loss of a cycle is not known, since no cells of the law went through closed "
    "cycles; shear cells by [micro.shear]"
)


UNKNOWN_LAW = (
    "intervals do not count the error of the law of interface {number}, which is not known: take "
    "the law of a run"
)
NO_BUDGET = (
    f"{UNKNOWN_LAW}, or state law_error of a table, or half-widths of values, as in "
    'friction = "0.2 +- 10 %"'
)


@dataclass(frozen=True, eq=False)
class ErrorSources:
    """What bodies with interfaces know of their errors.

    Attributes
    ----------
    laws : list of JointsOfLaw, whose errors are independent
    stated : list of Uncertainty and structure
        What is unknown of stated values and representative volumes, each with the structure in
        which the parameter is larger by :data:`STRETCH`; independent of each other and of the laws.
    unknown : list of str, the laws of which nothing is known, a sentence each
    """

    laws: list[JointsOfLaw]
    stated: list[tuple[Uncertainty, Bodies]]
    unknown: list[str]

    @classmethod
    def of(cls, bodies: Bodies, case: Case, laws: Sequence[Dataset | None]) -> "ErrorSources":
        """Find them."""
        found, unknown = [], []
        for number, law in enumerate(laws):
            one = bodies.interfaces[number]
            if not has_budget(law):
                if law is not None or not any(one.uncertain(1.0)):  # else what is stated tells
                    unknown.append(NO_BUDGET.format(number=number))
            elif not any(law is other for other in laws[:number]):  # the first interface of its law
                source = one.over(case.interface)
                joints = tuple(k for k, other in enumerate(laws) if other is law)
                measured = {"friction", "stiffness_ratio"} - source.given.keys()
                found.append(JointsOfLaw(law, joints, measured))
        return cls(found, bodies.uncertainties(), unknown)

    def __bool__(self) -> bool:
        """Whether any error is known."""
        return bool(self.laws or self.stated)


def changed_sliders(
    bodies: Bodies,
    case: Case,
    laws: Sequence[Dataset | None],
    change: Change,
    slabs: int | None = None,
) -> list[InterfaceLaw]:
    """Make the laws of all interfaces, as :meth:`Bodies.sliders`, with a change."""
    normal = {} if change.normal is None else dict.fromkeys(change.joints, change.normal)
    return change_friction(bodies.sliders(case, laws, normal, slabs), change)


def few_steps(case: Case) -> int:
    """Return the steps to the amplitude of the cycle that is solved again with changed laws."""
    return max(1, min(substructures.FEW_STEPS, case.cycles.steps // 2)) if case.cycles else 0


def change_friction(laws: Sequence[InterfaceLaw], change: Change) -> list[InterfaceLaw]:
    """Return the laws of all joints, of which beds of sliders that change have other parameters."""

    def changed(law: InterfaceLaw) -> InterfaceLaw:
        bed = cast(Sliders, law)  # a law with a budget is one
        factors = {name: factor * getattr(bed, name) for name, factor in change.factors.items()}
        return replace(bed, slabs=change.slabs or bed.slabs, **factors)

    return [changed(law) if joint in change.joints else law for joint, law in enumerate(laws)]


def with_joint_budget(
    result: Dataset,
    sources: ErrorSources,
    solve: JointSolve,
    asked: JointAnswers,
    coarser: Mapping[float, Bodies],
    job: Job,
) -> Dataset:
    """Return the result of rough joints with error budget and intervals of their answers."""
    result = with_cautions(result, *sources.unknown)
    laws, uncertain, known = sources.laws, sources.stated, result["known"].to_numpy() == 1
    rests, cycles = asked.rests[known[asked.rests]], asked.cycles
    if not rests.size:
        return result
    in_cycles = {} if cycles is None else cycles.read
    names = (*asked.read, *in_cycles)
    steps = rests if cycles is None else np.append(rests, cycles.steps)

    def answers(found: Dataset) -> np.ndarray:
        """Answers at rest, then in the cycles, and one for what stays as it is."""
        rows = np.full((len(names), steps.size), np.nan)
        for row, values in zip(rows, asked.read.values(), strict=False):
            row[: rests.size] = values(found)[rests]
        for row, values in zip(rows[len(asked.read) :], in_cycles.values(), strict=True):
            row[rests.size :] = values(found)
        rows[rows == 0.0] = np.nan  # no error is relative to zero
        return rows

    of_laws = [_OfLaw.measure(one, result, steps, rests.size, asked) for one in laws]
    jobs: dict[Hashable, Change] = {}
    if cycles is not None:
        every = tuple(joint for one in laws for joint in one.joints)
        jobs["fine"] = Change()
        if every:
            jobs["bed"] = Change(every, slabs=SLABS // 2)
    jobs |= {ratio: Change(structure=structure) for ratio, structure in coarser.items()}
    for number, one in enumerate(of_laws):
        jobs |= {(number, key): change for key, change in one.of.changes(one.pressure).items()}
    jobs |= {("other", k): Change(structure=changed) for k, (_, changed) in enumerate(uncertain)}
    solved: dict[Hashable, np.ndarray] = {}
    job.progress(0, len(jobs), "solves for the intervals")

    def finish(key: Hashable, found: Dataset) -> None:
        solved[key] = answers(found)
        job.progress(len(solved), len(jobs), "solves for the intervals")

    run_jobs(solve, ((key, (change,)) for key, change in jobs.items()), job.executor, finish)
    value, mesh = answers(result), {ratio: solved[ratio] for ratio in coarser}
    left, beds = np.zeros((2, len(names), steps.size))
    if cycles is not None:
        fine, value = value, solved["fine"]
        left = (
            np.abs(value / fine - 1.0) / (cycles.finer**2 - 1.0) if cycles.finer > 1.0 else np.nan
        )
        moving = np.arange(steps.size) >= rests.size
        left = np.where(moving, left, 0.0) * np.ones(value.shape)
        # twice the slabs at least halve the error of the beds
        beds = np.where(moving, np.abs(solved.get("bed", fine) / fine - 1.0), 0.0)
    once = [Dependence(np.ones(left.shape), {"macro discretisation": left})]
    budgets = []
    for number, one in enumerate(of_laws):
        changed = {key: solved[number, key] for key in one.of.changes(one.pressure)}
        result = with_cautions(result, *one.cautions)
        # the errors of the mesh and of the beds count once
        own = ([], 0.0 * beds) if number else (once, beds)
        budgets.append(one.budget(names, value, changed, mesh, *own))
    where = [f"interface {', '.join(map(str, one.joints))}" for one in laws]
    changes = []
    for k, (error, _) in enumerate(uncertain):
        changes.append((solved["other", k] / value - 1.0) / STRETCH)
        coarse = {} if budgets else mesh
        budgets.append(_parameter_budget(names, value, changes[-1], error, coarse, left))
        where.append(error.name)
    if not budgets:  # nothing but the mesh is known to err
        unchanged = Uncertainty("the mesh", {}, {})
        budgets.append(_parameter_budget(names, value, 0.0 * value, unchanged, mesh, left))
    budget = add_budgets(budgets, where)
    if changes:
        half = [np.hypot.reduce([*error.half_width.values()]) for error, _ in uncertain]
        passed = np.array([each * change for each, change in zip(half, changes, strict=True)])
        budget = ERROR_BUDGET.assign(budget, {"sensitivity": passed})
        budget = budget.assign_coords(parameter=[error.name for error, _ in uncertain])
    if not coarser:
        why = (
            "not known: nothing was solved with elements of twice the size; give smaller ones, or "
            "an even number of them, in [structure], or a coarser mesh of every body"
        )
        budget = budget.assign_attrs({how_attribute("macro discretisation"): why})
    return asked.place(result, budget)


def _parameter_budget(
    names: tuple[str, ...],
    value: np.ndarray,
    change: np.ndarray,
    error: Uncertainty,
    coarser: Mapping[float, np.ndarray],
    left: np.ndarray,
) -> Dataset:
    """Carry errors of a parameter to answers, by their change over the change of the parameter.

    ``left`` is the error of the steps of a path, which counts beside the error of the mesh.
    """
    nothing = Term("nothing: no law of cells has a part in it", np.zeros(value.shape))
    absent = {STATED: NO_STATED, "macro discretisation": Term("not known")}
    terms = {name: nothing if name in ALWAYS else NO_PART for name in ERROR_TERMS} | absent
    terms |= {
        name: Term(error.how[name], np.abs(change) * half)
        for name, half in error.half_width.items()
    }
    if coarser:
        estimate = estimate_grid_error(value, coarser)
        half_width = np.hypot(estimate.half_width / np.abs(value), left)
        terms["macro discretisation"] = Term(estimate.how, half_width)
    return assemble_budget(terms, names, None, steps=value.shape[1])


@dataclass(frozen=True, eq=False)
class _OfLaw:
    """What a structure tells of one of its laws.

    Attributes
    ----------
    of : JointsOfLaw, whose law has the scales of the joints
    asked : JointAnswers
    pressure : ndarray, shape (columns,), mean pressure of the closed points of the joints, Pa
    cells : ndarray, shape (2, columns)
        As ``cells`` of :func:`~multiscale.upscaling.structure_budget`: of loss, and of the others.
    load, loss : ndarray, shape (columns,)
        Shares of the joints in the load of all, and in the loss of cycles.
    cautions : tuple of str
    """

    of: JointsOfLaw
    asked: JointAnswers
    pressure: np.ndarray
    cells: np.ndarray
    load: np.ndarray
    loss: np.ndarray
    cautions: tuple[str, ...]

    @classmethod
    def measure(
        cls, of: JointsOfLaw, result: Dataset, steps: np.ndarray, n_rests: int, asked: JointAnswers
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
        of = replace(of, law=law)
        return cls(of, asked, mean, cells, load, loss, tuple(said))

    def budget(
        self,
        names: tuple[str, ...],
        value: np.ndarray,
        changed: Mapping[str, np.ndarray],
        coarser: Mapping[float, np.ndarray],
        others: Sequence[Dependence],
        beds: np.ndarray,
    ) -> Dataset:
        """Carry the budget of the law to answers, from those with its changes, mesh and beds."""
        law, mean, cycles = self.of.law, self.pressure, self.asked.cycles
        rows, own = np.array(names), {}
        lost = rows[:, None] == ("" if cycles is None else cycles.loss)
        passed = list(others)
        if cycles is not None:
            passed.append(_uneven_slip(law, cycles, mean, rows, self.load))
            cells = _part_of(loss_term(law), lost * self.loss)
            told = f"{cells.how}; beds of {SLABS} and {SLABS // 2} slabs"
            half_width = np.hypot(np.asarray(cells.half_width), beds)
            own[BED] = replace(cells, how=told, half_width=half_width)
            if "shear_loss_grid_error" in law:
                told = "the loss ratio on two grids"
                grid = Term(told, law["shear_loss_grid_error"].to_numpy())
                own["micro discretisation"] = _part_of(grid, lost * self.loss)
        real = [bool(set(self.asked.real.get(name, ())) & set(self.of.joints)) for name in names]
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
            not_solved,
            answer=value,
            pressure=mean,
            coarser=coarser,
            samples=0,
            others=passed,
            own=own,
            cells=np.where(lost, *self.cells),
            changed=changed,
        )


def not_solved(law: NormalLaw) -> np.ndarray:
    """Refuse to solve with a law whose answers are given."""
    raise AssertionError(f"{law} should be among the changed laws")


def _part_of(term: Term, rows: np.ndarray) -> Term:
    """Return a term of single numbers as one of shares (answers, steps), zero without a share."""
    half, bias = (
        np.where(rows != 0.0, rows * np.asarray(one, dtype=float), 0.0)
        for one in (term.half_width, term.bias)
    )
    return replace(term, half_width=half, bias=bias)


def _uneven_slip(
    law: Dataset, cycles: CycleAnswers, pressure: np.ndarray, rows: np.ndarray, load: np.ndarray
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
