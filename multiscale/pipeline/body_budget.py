"""The error budget of bodies with joints: their answers, and the sources of error."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from time import perf_counter
from typing import Any, cast

import numpy as np

from multiscale import upscaling
from multiscale.fe.faces import plane_axes
from multiscale.laws import InterfaceLaw, NormalLaw
from multiscale.macro import substructures
from multiscale.macro.data_range import LOAD_SHARES, NEGLIGIBLE_LOAD
from multiscale.pipeline.real_contact import contact_source
from multiscale.pipeline.stage import Datasets, Job
from multiscale.pipeline.tables.settings import Case
from multiscale.pipeline.tables.solved_bodies import SolvedBodies, StructureParts, stated_error
from multiscale.schema import MACRO_RESULT, Dataset, with_cautions
from multiscale.upscaling import limits, over_steps, with_budget, with_intervals
from multiscale.upscaling.budget import (
    FEW_CELLS,
    MACRO,
    Term,
    has_budget,
    how_attribute,
    interval_errors,
    known_terms,
)
from multiscale.upscaling.propagation import FEWEST_SAMPLES, FIRST_ORDER, STRETCH
from multiscale.upscaling.sampling import half_range
from multiscale.upscaling.scales import compare_scales, effective_cells, pressure_length_of_points
from multiscale.upscaling.shear_budget import BED, loss_terms, shear_errors

Reader = Callable[["Dataset"], np.ndarray]  # maps a result to the values of an answer

STIFFNESSES = ("joint_stiffness", "interface_stiffness", "solid_stiffness")
"""Stiffnesses of the joint with its bodies, of the interface and of the bodies, with a budget."""

AT_PRELOADS = (*STIFFNESSES, "tangential_stiffness", "real_pressure")
IN_CYCLES = ("cycle_slip", "cycle_loss", "secant_stiffness")
AT_END = {"cycle_slip": "slipping_load", "cycle_loss": "cycle_energy"}
"""Answers that have an error budget: at the preloads, in the cycles of every preload and amplitude,
and names of the answers of the last cycle at the end of the path."""


@dataclass(frozen=True, eq=False)
class CycleAnswers:
    """Answers of closed cycles that have an error budget."""

    read: Mapping[str, Reader]  # by the name of an answer, its values in every cycle
    slip: str  # name of the share of the load that slips
    loss: str  # name of the dissipated energy
    steps: np.ndarray  # (cycles,), steps of the result with the pressure of each cycle
    slope: np.ndarray  # (cycles,), logarithmic, of the slipping share over the amplitude
    density: np.ndarray  # (cycles, points), dissipated energy, J/m²
    finer: float  # load steps of a cycle over the steps of paths that are solved again
    part: np.ndarray | float = 1.0  # (cycles,), of the loss, by the joints


@dataclass(frozen=True, eq=False)
class JointAnswers:
    """Answers of joints that have an error budget, and their steps."""

    read: Mapping[str, Reader]  # by the name of an answer at rest, its values over the steps
    real: Mapping[str, tuple[int, ...]]  # joints of which an answer is the real pressure
    rests: np.ndarray  # steps of these answers
    place: Callable[[Dataset, Dataset], Dataset]  # adds a budget of rests, then cycles, to a result
    cycles: CycleAnswers | None = None
    first_order: "FirstOrder | None" = None


def joint_answers(
    result: Dataset, path: "substructures.LoadPath", first_order: "FirstOrder | None" = None
) -> JointAnswers:
    """Return the answers of joints at their preloads, then in the cycles of every amplitude."""
    known = result["known"].to_numpy() == 1
    rests = np.flatnonzero(np.isfinite(result["joint_stiffness"].to_numpy()))
    names = [name for name in AT_PRELOADS if name in result]  # real pressure may be missing
    read = {name: answer_at(name) for name in names}
    joints = tuple(np.unique(result["point_joint"].to_numpy()).astype(int).tolist())
    real = {"real_pressure": joints} if "real_pressure" in result else {}
    level, amplitude = np.zeros((2, 0), dtype=int)
    if "cycle_loss" in result and result["converged"].to_numpy().all():
        level, amplitude = np.nonzero(result["cycle_loss"].to_numpy() > 0.0)  # others do not slip
    cycles = None
    if level.size:
        cycles = CycleAnswers(
            {name: answer_at(name, level, amplitude) for name in IN_CYCLES},
            "cycle_slip",
            "cycle_loss",
            level,  # a preload is the step of its number
            _slip_slope(result)[level, amplitude],
            result["loss_density"].to_numpy()[level, amplitude],
            path.amplitude_steps,
        )
    ended = bool(level.size) and bool(known[-1])
    ended = ended and bool(result["cycle_loss"].to_numpy()[-1, -1] > 0.0)

    def place(result: Dataset, budget: Dataset) -> Dataset:
        """Add the intervals of every cycle, and of the last cycle at the last step."""
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
        selected = budget.isel(step=columns).sel(quantity=names)
        selected = selected.assign_coords(quantity=[AT_END.get(name, name) for name in names])
        return with_intervals(with_budget(result, over_steps(selected, at, known.size)))

    return JointAnswers(read, real, rests, place, cycles, first_order)


def load_answers(result: Dataset, path: "substructures.LoadPath") -> JointAnswers:
    """Return the answers of bodies under named loads, then of the last cycle of their path."""
    rise = path.cycle_steps if path.cycles and result["converged"].to_numpy().all() else 0
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
    if rise and known[-1] and lost[-1] > 0.0:
        share = result["slipping_load"].to_numpy()[-2:]
        slope = np.full(1, np.nan)
        if rise > 1 and share.min() > 0.0:
            slope[:] = np.log(share[1] / share[0]) / np.log(rise / (rise - 1))
        density = result["dissipation"].to_numpy()[-4 * rise :].sum(axis=0, keepdims=True)
        read = {name: answer_at(name, slice(-1, None)) for name in AT_END.values()}
        cycles = CycleAnswers(
            read, "slipping_load", "cycle_energy", last, slope, density, rise / path.few
        )

    def place(result: Dataset, budget: Dataset) -> Dataset:
        """Add the budget at its steps."""
        steps = np.append(rests[known[rests]], () if cycles is None else last).astype(int)
        budget = over_steps(budget, steps, known.size)
        return with_intervals(with_budget(result, budget), {**loads, **real})

    read = {
        **{key: answer_at(name, slice(None), k) for key, (name, k) in loads.items()},
        **{key: answer_at("real_pressure") for key in real},
    }
    return JointAnswers(read, {key: (k,) for key, (_, k) in real.items()}, rests, place, cycles)


def answer_at(name: str, *place: slice | int | np.ndarray) -> Reader:
    """Return a reader of an answer at a place, or of all values, that workers can import."""
    return partial(_read, name, place)


def _read(name: str, place: tuple[Any, ...], result: Dataset) -> np.ndarray:
    """Values of an answer; the real pressure stays as it is."""
    if name == "real_pressure":
        return np.ones(result.sizes["step"])
    return np.asarray(result[name].to_numpy()[place])


def _slip_slope(result: Dataset) -> np.ndarray:
    """Logarithmic slope of the slipping share over the amplitude, shape (levels, amplitudes)."""
    share, shear = result["cycle_slip"].to_numpy(), result["cycle_shear"].to_numpy()
    with np.errstate(divide="ignore", invalid="ignore"):  # NaN where nothing slips
        if shear.size > 1:
            return np.asarray(np.gradient(np.log(share), np.log(shear), axis=1))
        at = np.log([result[name].to_numpy()[-2:] for name in ("slipping_load", "shear")])
        return np.full(share.shape, np.ptp(at[0]) / np.ptp(at[1]))


@dataclass(frozen=True, eq=False)
class Change:
    """Changes of a structure that is solved again."""

    joints: tuple[int, ...] = ()  # joints with a changed law
    normal: NormalLaw | None = None  # normal law of these joints
    factors: Mapping[str, float] = field(default_factory=dict)  # factors of friction parameters
    coarse_bed: bool = False  # whether the beds of these joints have half of their slabs
    structure: SolvedBodies | None = None  # structure on another mesh, or with another parameter


@dataclass(frozen=True, eq=False)
class BodiesWithLaws:
    """Bodies of a case, and the law of every interface."""

    bodies: SolvedBodies
    case: Case
    laws: Sequence[Dataset | None]

    @classmethod
    def of(
        cls, structure: SolvedBodies, case: Case, datasets: Datasets, job: Job
    ) -> "BodiesWithLaws":
        """Read volumes and laws."""
        bodies = structure.with_volumes(case, datasets, job.read_rve)
        return cls(bodies, case, bodies.read_laws(case, datasets, job.read_law))

    def build(self, laws: Sequence[InterfaceLaw]) -> StructureParts:
        """Build the bodies with some laws of their interfaces."""
        return self.bodies.build(self.case, laws)

    def changed(self, change: Change) -> "BodiesWithLaws":
        """Return the bodies of a change."""
        return replace(self, bodies=change.structure or self.bodies)

    def sliders(
        self,
        change: Change = Change(),  # frozen
        slabs: int | None = None,
    ) -> list[InterfaceLaw]:
        """Return the laws of all interfaces, as :meth:`SolvedBodies.sliders`, with a change."""
        normal = {} if change.normal is None else dict.fromkeys(change.joints, change.normal)
        made = self.bodies.sliders(self.case, self.laws, normal, slabs)
        return change_friction(made, change)


@dataclass(frozen=True, eq=False)
class JointsOfLaw:
    """Joints that share a law with a budget."""

    law: Dataset  # carries its budget
    joints: tuple[int, ...]
    measured: Collection[str]  # parameters of their sliders that come from the law

    @property
    def name(self) -> str:
        """Name of the joints."""
        return f"interface {', '.join(map(str, self.joints))}"

    def sources(
        self,
        pressure: np.ndarray | None,
        without: Mapping[str, np.ndarray] = {},
        drawn: Sequence[np.ndarray] | None = None,
        beyond: tuple[bool, bool] = (False, False),
    ) -> list[upscaling.Source]:
        """Return the errors of normal law and friction at a pressure of the joints, Pa, if any."""

        def change(normal: NormalLaw) -> Change:
            return Change(self.joints, normal)

        listed = upscaling.law_sources(
            self.law, pressure, of=self.name, change=change, drawn=drawn, beyond=beyond
        )
        friction = {} if pressure is None else shear_errors(self.law, pressure)
        known = known_terms(self.law)
        for parameter, widths in friction.items():
            if parameter not in self.measured:
                continue
            half_width = {
                term: np.where(without.get(term, False), 0.0, half)
                for term, half in widths.items()
                if term in known
            }
            larger = Change(self.joints, factors={parameter: 1.0 + STRETCH})
            name = parameter.replace("_", " ")
            listed.append(
                upscaling.Uncertainty(
                    name=name, of=self.name, half_width=half_width, changes=[larger]
                )
            )
        return listed


FirstOrder = Callable[[Sequence[Change]], Mapping[str, np.ndarray]]
"""Maps changes to relative changes of answers at rest, shape (changes, preloads), by the tangents
of the path without changes."""

JointSolve = Callable[[Change], "Dataset"]
"""Maps a change to the result at the preloads and, if joints slip, in cycles of few steps; workers
must be able to import it."""

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
NO_MESH = (
    "not known: nothing was solved with elements of twice the size; give smaller ones, or an even "
    "number of them, in [structure], or a coarser mesh of every body"
)


@dataclass(frozen=True, eq=False)
class ErrorSources:
    """Error sources of bodies with interfaces."""

    laws: list[JointsOfLaw]  # laws with independent errors
    stated: list[upscaling.Uncertainty]  # of stated values and representative volumes
    unknown: list[str]  # laws without an error, a sentence each
    beds: tuple[int, ...]  # joints that have beds of sliders
    meshes: Mapping[float, SolvedBodies]  # coarser structures, by the ratio of the spacings

    @classmethod
    def of(cls, jointed: BodiesWithLaws) -> "ErrorSources":
        """Collect the error sources of bodies and laws."""
        bodies, case, laws = jointed.bodies, jointed.case, jointed.laws
        shared_laws, unknown = [], []
        for number, law in enumerate(laws):
            interface = bodies.interfaces[number]
            if not has_budget(law):
                # a stated law has the half-widths of its parameters
                if law is not None or not any(interface.uncertain(1.0)):
                    unknown.append(NO_BUDGET.format(number=number))
            elif not any(law is other for other in laws[:number]):  # the first interface of its law
                source = interface.over(case.interface)
                joints = tuple(k for k, other in enumerate(laws) if other is law)
                measured = {"friction", "stiffness_ratio"} - source.given.keys()
                shared_laws.append(JointsOfLaw(law, joints, measured))
        stated = [
            replace(error, of=error.name, name="", changes=[Change(structure=changed)])
            for error, changed in bodies.uncertainties()
        ]
        for key, half, _ in case.interface.uncertain(1.0) if case.interface else ():
            shares = [getattr(interface, key) is None for interface in bodies.interfaces]
            joints = tuple(np.flatnonzero(shares).tolist())
            larger = Change(joints, factors={key: 1.0 + STRETCH})
            error = stated_error(key, half)
            stated.append(replace(error, of=error.name, name="", changes=[larger]))
        beds = tuple(
            k for k, interface in enumerate(bodies.interfaces) if interface.asperities is None
        )
        return cls(shared_laws, stated, unknown, beds, bodies.coarser())

    def __bool__(self) -> bool:
        """Whether any error is known."""
        return bool(self.laws or self.stated or self.meshes)


def change_friction(laws: Sequence[InterfaceLaw], change: Change) -> list[InterfaceLaw]:
    """Return the laws of all joints, with the changed parameters and slabs of a change."""

    def changed(law: InterfaceLaw) -> InterfaceLaw:
        bed = cast(Any, law)  # laws are dataclasses
        values = {name: factor * getattr(bed, name) for name, factor in change.factors.items()}
        values |= {"slabs": bed.slabs // 2} if change.coarse_bed else {}
        return cast(InterfaceLaw, replace(bed, **values))

    return [changed(law) if joint in change.joints else law for joint, law in enumerate(laws)]


def with_joint_budget(
    result: Dataset,
    sources: ErrorSources,
    solve: JointSolve,
    asked: JointAnswers,
    job: Job,
) -> Dataset:
    """Return the result of rough joints with error budget and intervals of their answers."""
    begin = perf_counter()
    result = with_cautions(result, *sources.unknown)
    known, cycles = result["known"].to_numpy() == 1, asked.cycles
    rests = asked.rests[known[asked.rests]]
    if not rests.size:
        return result
    in_cycles = {} if cycles is None else cycles.read
    names = (*asked.read, *in_cycles)
    steps = rests if cycles is None else np.append(rests, cycles.steps)

    def answers(dataset: Dataset) -> np.ndarray:
        """Return the answers at rest, then in the cycles, shape (answers, steps); NaN for zeros."""
        rows = np.full((len(names), steps.size), np.nan)
        for row, values in zip(rows, asked.read.values(), strict=False):
            row[: rests.size] = values(dataset)[rests]
        for row, values in zip(rows[len(asked.read) :], in_cycles.values(), strict=True):
            row[rests.size :] = values(dataset)
        rows[rows == 0.0] = np.nan  # no error is relative to zero
        return rows

    listed: list[upscaling.Source] = []
    value = answers(result)
    for joints in sources.laws:
        drawn = _draw(joints, asked, names, value, rests)
        of_law, cautions = _measured(
            joints, result, steps, rests.size, asked, np.array(names), drawn
        )
        listed += of_law
        result = with_cautions(result, *cautions)
    listed += sources.stated
    if sources.meshes:
        changes = [Change(structure=structure) for structure in sources.meshes.values()]
        listed.append(upscaling.Knob(name="mesh", ratios=[*sources.meshes], changes=changes))
    else:
        listed.append(upscaling.Bound(name="mesh", bounds={MACRO: Term(NO_MESH)}))
    if cycles is not None:
        moving = 1.0 * (np.arange(steps.size) >= rests.size)
        if sources.beds:
            fewer, how = Change(sources.beds, coarse_bed=True), "beds of half of the slabs"
            term = MACRO if sources.meshes else BED  # unknown meshes leave their term unknown
            listed.append(
                upscaling.Knob(name="slabs", changes=[fewer], term=term, share=moving, how=how)
            )
        if sources.meshes:
            richardson = 1.0 / (cycles.finer**2 - 1.0) if cycles.finer > 1.0 else np.nan
            share = np.where(moving == 0.0, 0.0, richardson)
            listed.append(upscaling.Knob(name="load steps", answers=[value], share=share))
    budget = upscaling.propagate(
        names,
        listed,
        solve,
        value if cycles is None else None,
        base=Change(),
        read=answers,
        executor=job.executor,
        progress=lambda done, total: job.progress(done, total, "solves for the intervals"),
    )
    return asked.place(result, budget).assign_attrs(interval_seconds=perf_counter() - begin)


def _draw(
    group: JointsOfLaw,
    asked: JointAnswers,
    names: Sequence[str],
    value: np.ndarray,
    rests: np.ndarray,
) -> list[np.ndarray] | None:
    """Return answers by the samples of a law, (samples, answers, steps), NaN if no tangent does."""
    normals = upscaling.fitted_laws(group.law, range(group.law.sizes.get("sample", 0)))
    if len(normals) < FEWEST_SAMPLES:
        return None
    changes: Mapping[str, np.ndarray] = {}
    if asked.first_order is not None:
        changes = asked.first_order([Change(group.joints, normal) for normal in normals])
    drawn = np.full((len(normals), *value.shape), np.nan)
    for row, name in enumerate(names):
        if name in changes:  # a preload is the step of its number
            changed = changes[name][:, rests]
            near = half_range(changed) < FIRST_ORDER
            changed = value[row, : rests.size] * (1.0 + changed)
            drawn[:, row, : rests.size] = np.where(near, changed, np.nan)
    return list(drawn)


def _measured(
    group: JointsOfLaw,
    result: Dataset,
    steps: np.ndarray,
    n_rests: int,
    asked: JointAnswers,
    names: np.ndarray,
    drawn: Sequence[np.ndarray] | None,
) -> tuple[list[upscaling.Source], list[str]]:
    """Return the sources of error of a law at the pressures of its joints, and cautions."""
    law, cycles, cautions = group.law, asked.cycles, list[str]()
    inside = np.isin(result["point_joint"].to_numpy(), group.joints)
    area = result["point_area"].to_numpy()
    closing = np.maximum(-result["traction"].to_numpy()[steps, :, 0], 0.0)
    pressure, joint_area = closing[:, inside], area[inside]
    # mean pressure of the closed points at every step
    closed = np.sum((pressure > 0.0) * joint_area, axis=1)
    mean = np.sum(pressure * joint_area, axis=1) / np.where(closed > 0.0, closed, np.nan)
    # number of cells that share the loss (row 0) and the other answers (row 1)
    cells = np.ones((2, steps.size))
    if {"longest_wave", "cell_size"} <= set(law.attrs) and "cell_scatter" in law:
        wavelength, cell = float(law.attrs["longest_wave"]), float(law.attrs["cell_size"])
        place = result["point_position"].to_numpy()[inside]
        number = result["point_joint"].to_numpy()[inside]
        length, extent = _lengths(place, number, joint_area, pressure[n_rests - 1])
        scales = compare_scales(wavelength, cell, length, extent=extent)
        law, cautions = upscaling.with_scales(law, scales), list(scales.cautions)
        cells[:] = effective_cells(pressure, joint_area, cell)
        if cycles is not None:
            cells[0, n_rests:] = effective_cells(cycles.density[:, inside], joint_area, cell)
        how = f"scatter of single cells, of which {cells.min():.3g} or more share the answers"
        law = law.assign_attrs({how_attribute(FEW_CELLS): how})
        cells *= scales.cell_ratio**2
    # errors of the cycles of the cells
    lost = names[:, None] == ("" if cycles is None else cycles.loss)
    listed: list[upscaling.Source] = []
    bounds: dict[str, Term] = {}
    if cycles is not None:
        cautions += [] if "shear_loss_ratio" in law else [UNKNOWN_LOSS]
        share, total = np.zeros(steps.size), cycles.density @ area
        share[n_rests:] = cycles.density[:, inside] @ joint_area / np.where(total > 0.0, total, 1.0)
        share[n_rests:] *= cycles.part
        bounds |= {name: _part_of(term, lost * share) for name, term in loss_terms(law).items()}
        if "shear_loss_grid_error" in law:
            grid = Term("the loss ratio on two grids", law["shear_loss_grid_error"].to_numpy())
            bounds["micro discretisation"] = _part_of(grid, lost * share)
        listed.append(upscaling.Bound(name="cycles of the cells", of=group.name, bounds=bounds))
        slope = np.zeros((names.size, steps.size))
        slope[names == cycles.slip, -cycles.slope.size :] = cycles.slope
        listed.append(
            _uneven_slip(law, mean, slope * (pressure @ joint_area / (closing @ area)), group.name)
        )
    real = np.array([bool(set(asked.real.get(name, ())) & set(group.joints)) for name in names])
    if any(real):
        listed.append(contact_source(law, mean, real, group.name))
    # the error of the loss by the bed is measured by the cycles of the cells
    below, above = (
        bool((result[name].isel(interface=[*group.joints]) > NEGLIGIBLE_LOAD).any())
        for name in LOAD_SHARES[:2]
    )
    of_bed = dict.fromkeys(bounds.keys() - {"sampling"}, lost)
    listed += replace(group, law=law).sources(mean, of_bed, drawn, (below, above))
    shared = np.where(lost, cells[0], cells[1])
    return [source.averaged(shared) for source in listed], cautions


def _uneven_slip(
    law: Dataset, pressure: np.ndarray, rate: np.ndarray, name: str
) -> upscaling.Source:
    """Return the scatter of stiffness between the cells of one joint as a source of its slip.

    Where one cell is stiffer than others, it carries more of the shear and slips more; a law that
    is stiffer everywhere has no such effect. The shear of a point rises at most in proportion to
    its stiffness, and its slip by the logarithmic slope of slip over shear times this change.
    """
    half_width = {}
    if FEW_CELLS in known_terms(law):
        few = law["error_half_width"].sel(quantity="stiffness", error_term=FEW_CELLS)
        data = np.log(law["fit_pressure"].to_numpy())
        half_width[FEW_CELLS] = np.interp(np.log(pressure), data, few.to_numpy())
    return upscaling.Uncertainty(name="uneven slip", of=name, half_width=half_width, rate=rate)


def _part_of(term: Term, rows: np.ndarray) -> Term:
    """Multiply a term of single numbers by shares, shape (answers, steps); zero without a share."""
    half, bias = (
        np.where(rows != 0.0, rows * np.asarray(value, dtype=float), 0.0)
        for value in (term.half_width, term.bias)
    )
    return replace(term, half_width=half, bias=bias)


def _lengths(
    place: np.ndarray, number: np.ndarray, area: np.ndarray, pressure: np.ndarray
) -> tuple[float, float]:
    """Least length over which the pressure of a joint varies, at most its edge, and edge, m."""
    lengths, extents = [], []
    for joint in np.unique(number):
        inside = number == joint
        extents.append(float(np.sqrt(area[inside].sum())))
        flat = place[inside] @ plane_axes(place[inside])[1:].T
        varies = pressure_length_of_points(flat, pressure[inside], area[inside])
        lengths.append(min(extents[-1], varies))
    return float(min(lengths)), float(min(extents))
