"""Stage: frequency and damping of elastic bodies with joints against the amplitude."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from multiscale import macro
from multiscale.errors import CaseError, ConvergenceError
from multiscale.io.fields import write_mode_fields
from multiscale.laws import HystereticLaw, InterfaceLaw, NormalLaw, Sliders
from multiscale.macro import substructures
from multiscale.needs import Choice, Needs
from multiscale.pipeline import body_budget, body_sources
from multiscale.pipeline.plans.case_knobs import body_knobs
from multiscale.pipeline.showing import ROUNDING, Rows, Table, View
from multiscale.pipeline.stage import Datasets, Job, Section
from multiscale.pipeline.stages.fitted_law import FITTED_LAW
from multiscale.pipeline.stages.joint import budget_sections
from multiscale.pipeline.stages.third_body import THIRD_BODY_LAW
from multiscale.pipeline.stages.volumes import REPRESENTATIVE_VOLUME
from multiscale.pipeline.structure_stage import structure_of, structure_stage, with_cautions_of
from multiscale.pipeline.tables.cycled_settings import COARSENING
from multiscale.pipeline.tables.settings import Case
from multiscale.pipeline.tables.solved_bodies import SolvedBodies
from multiscale.plotting import MOST_DRAWN, vibration_pictures
from multiscale.plotting.figure import SIZE, WIDE, on_axes
from multiscale.schema import VIBRATION, Dataset, with_cautions
from multiscale.upscaling import (
    MeasuredJoint,
    by_differences,
    over_steps,
    tangential_values,
    with_budget,
    with_intervals,
)
from multiscale.upscaling.fit import branch_origins
from multiscale.upscaling.measured.joints import Answer, BedCurve
from multiscale.upscaling.posterior_law import normal_law
from multiscale.upscaling.propagation import STRETCH

if TYPE_CHECKING:
    from scipy.sparse import csr_array

TABLE = Table(
    (
        "step_mode",
        "largest_displacement",
        "frequency",
        "frequency:both",
        "damping",
        "damping:both",
        "slipping_load",
        "opens",
        "modal_amplitude",
        "fall:()",
    ),
    {
        "largest_displacement": "largest",
        "modal_amplitude": "modal",
        "slipping_load": "sliding force",
    },
    at=2,
    missing="slides away",
)

SMOOTH = 1e-4  # friction of a smooth preload: without it, rounding moves free bodies

BUDGETED = ("frequency", "fall", "damping")


@dataclass(frozen=True, eq=False)
class _Vibrating:
    bodies: "Sequence[macro.Body]"
    rest: "macro.vibration.Preloaded"
    modes: "macro.vibration.TangentModes"
    mass: "csr_array"

    @property
    def largest(self) -> np.ndarray:
        """Largest displacement of a node in the shape of every mode, kg^-1/2."""
        nodal = self.modes.nodal(self.rest.free)
        return np.asarray(np.linalg.norm(nodal, axis=2).max(axis=1))

    def portable(self) -> "_Vibrating":
        """Return the case without factorisations and dense matrices, for workers."""
        free = substructures.CondensedProblem(self.rest.free, self.rest.free)
        followed = replace(self.rest.followed, problem=self.rest.free)
        return replace(self, rest=replace(self.rest, condensed=free, followed=followed))

    def vibrate(
        self, reached: "dict[int, macro.vibration.Amplitudes]", damping: float, **options: Any
    ) -> Dataset:
        """Follow modes over their amplitudes, with a share of critical damping by the bodies."""
        momentum = self.mass @ self.modes.shape
        return macro.vibration.vibrate(
            self.rest, self.modes, momentum, reached, material_damping=damping, **options
        )


def _press(
    jointed: body_sources.BodiesWithLaws,
    laws: Sequence[InterfaceLaw],
    near: "macro.vibration.Preloaded | None" = None,
) -> tuple[_Vibrating, list[str]]:
    """Preload bodies, from a state ``near``, and compute their modes; also return facts."""
    asked, parts = jointed.case.vibration, jointed.build(laws)
    smooth = [replace(cast(Sliders, law), friction=SMOOTH) for law in laws]  # all have friction
    try:
        rest = macro.vibration.press_structure(
            parts.assembly,
            parts.path.factors(),
            preload_laws=None if asked.preload_friction else smooth,
            extrapolate=jointed.case.extrapolate,
            near=near,
        )
    except ConvergenceError as error:
        if asked.preload_friction:
            raise
        raise ConvergenceError(
            f"{error}; preload_friction = false in [vibration] applies the preload without "
            f"friction: leave it out, or fix the bodies by supports or bolts"
        ) from error
    densities = [float(body.density or 0.0) for body in jointed.bodies.bodies]
    mass = macro.vibration.structure_mass(rest.free, parts.assembly.bodies, densities)
    modes = macro.vibration.tangent_modes(rest.free, rest.tangent(), mass, max(asked.modes))
    return _Vibrating(parts.assembly.bodies, rest, modes, mass), list(parts.facts)


def _laws(jointed: body_sources.BodiesWithLaws, change: body_sources.Change) -> list[InterfaceLaw]:
    """Build slider beds, on the unloading curve of the cells if it was measured."""
    made = jointed.sliders(change, jointed.case.vibration.slabs)
    for number, law in enumerate(jointed.laws):
        if law is not None and branch_origins(law).get("unloading", "").startswith("measured"):
            bed = cast(Sliders, made[number])  # the law of cells is a bed
            ratio, exponent = (
                float(law[f"unloading_{name}"]) for name in ("stiffness_ratio", "exponent")
            )
            unloading = HystereticLaw(cast(NormalLaw, bed.normal), ratio, exponent)
            made[number] = replace(bed, normal=unloading)
    return made


def _solve(structure: SolvedBodies, case: Case, datasets: Datasets, job: Job) -> Dataset:
    asked = case.vibration
    jointed = body_sources.BodiesWithLaws.of(structure, case, datasets, job)
    still, facts = _press(jointed, _laws(jointed, body_sources.Change()))
    modes, damping = still.modes, asked.material_damping
    result = still.vibrate(
        asked.reach(still.largest),
        damping,
        progress=lambda done, total: job.progress(done, total, "amplitudes"),
    )
    values = macro.bodies.list_elements(still.bodies)
    if still.rest.free.bolts:
        values["bolt_force"] = still.rest.path["bolt_force"].values[-1]
    result = VIBRATION.assign(result, values)
    result = with_cautions_of(result, jointed, datasets)
    result = _with_budget(result, jointed, still, job)
    rigid = f"Rigid motions {', '.join(modes.rigid)} are left out." if modes.rigid else ""
    friction = "with friction" if asked.preload_friction else "without friction"
    frequencies = ", ".join(f"{frequency:.5g}" for frequency in modes.frequency)
    facts += [
        f"The frequencies of small vibration, without slip, are {frequencies} Hz.",
        asked.left_out(),
        rigid,
        f"The preload was applied {friction}; shapes and amplitudes are relative to that state.",
    ]
    return result.assign_attrs(facts="\n".join(filter(None, facts)))


def _with_budget(
    result: Dataset, jointed: body_sources.BodiesWithLaws, still: _Vibrating, job: Job
) -> Dataset:
    """Propagate the budgets of all laws to frequency and damping at every amplitude."""
    solved = np.flatnonzero(result["converged"].values)
    if not solved.size:
        return result
    sources = body_sources.ErrorSources.of(jointed)
    result = with_cautions(result, "" if sources.meshes else jointed.bodies.no_coarser)
    if not (sources and job.intervals):
        return result

    def place(solved_again: Dataset, budget: Dataset) -> Dataset:
        """Assign the columns of the budget, which follow the preload, to the amplitudes."""
        count = result.sizes["step"]
        whole = over_steps(budget.isel(step=slice(1, None)), solved, count)
        whole = whole.assign_coords(step=result["step"])
        placed = with_intervals(with_budget(result, whole), schema=VIBRATION)
        return placed.assign_attrs(cautions=str(solved_again.attrs.get("cautions", "")))

    rest = still.rest.path.isel(step=[-1])
    if jointed.laws:
        slip = result["slipping"].values.max(axis=0)[solved] * result["pressure"].values[0, solved]
    else:  # without laws every converged step is known
        slip, rest = np.zeros((solved.size, 0)), rest.assign(known=rest["converged"])
    read = {name: body_budget.answer_at(name, solved) for name in BUDGETED}
    damping = result["damping"].values[solved]
    cycles = body_budget.CycleAnswers(
        read,
        "",
        "damping",
        np.zeros(solved.size, dtype=int),
        np.full(solved.size, np.nan),
        np.maximum(slip, 0.0),
        COARSENING,
        1.0 - jointed.case.vibration.material_damping / np.where(damping > 0.0, damping, 1.0),
    )
    asked = body_budget.JointAnswers({}, {}, np.zeros(1, dtype=int), place, cycles)
    rest = rest.assign({name: result[name].rename(step="amplitude") for name in BUDGETED})
    rest = rest.assign_attrs(cautions=str(result.attrs.get("cautions", "")))
    if job.executor is not None:
        still = still.portable()
    solve = partial(_solve_changed, jointed, still)
    return body_budget.with_joint_budget(rest, sources, solve, asked, job)


def _solve_changed(
    jointed: body_sources.BodiesWithLaws, near: _Vibrating, change: body_sources.Change
) -> Dataset:
    """Follow the modes again with a change, in fewer steps, over the same modal amplitudes."""
    asked, other = jointed.case.vibration, jointed.changed(change)
    alike = other.bodies.bodies is jointed.bodies.bodies
    rest = near.rest if alike else None
    still, _ = _press(other, _laws(other, change), rest)
    if alike:
        still = _in_order_of(still, near)
    return still.vibrate(asked.reach(near.largest, coarse=True), asked.material_damping)


def _in_order_of(still: _Vibrating, near: _Vibrating) -> _Vibrating:
    """Order modes of the same mesh like other modes, by the products of their shapes."""
    alike = np.abs(near.modes.shape.T @ (near.mass @ still.modes.shape))
    order = np.argmax(alike, axis=1)
    if np.unique(order).size < order.size:
        return still
    modes = replace(
        still.modes, square=still.modes.square[order], shape=still.modes.shape[:, order]
    )
    return replace(still, modes=modes)


def _vibrate_measured(
    jointed: body_sources.BodiesWithLaws, beds: Sequence[InterfaceLaw], near: _Vibrating
) -> np.ndarray:
    """Return frequencies, s-1, and damping ratios with laws of the interfaces."""
    asked = jointed.case.vibration
    still = _in_order_of(_press(jointed, beds, near.rest)[0], near)
    result = still.vibrate(asked.reach(near.largest), asked.material_damping)
    if not result["converged"].values.all():
        raise ConvergenceError(str(result.attrs["failure"]))
    return np.append(result["frequency"].values, result["damping"].values)


def _solve_law(
    jointed: body_sources.BodiesWithLaws,
    near: _Vibrating,
    table: MeasuredJoint,
    interface: BedCurve,
    nuisances: Mapping[str, float],
) -> np.ndarray:
    """Return frequencies, s-1, and damping ratios with a law of all interfaces."""
    laws = jointed.laws
    normal = normal_law(cast(Dataset, laws[0]), interface.curve)
    change = body_sources.Change(tuple(range(len(laws))), normal)
    made = [cast(Sliders, bed) for bed in _laws(jointed, change)]
    mu, kappa = interface.friction, interface.ratio
    beds = [replace(bed, friction=mu, stiffness_ratio=kappa) for bed in made]
    return _vibrate_measured(jointed, beds, near)


def require_modes(case: Case) -> SolvedBodies:
    """Return the bodies of a case with measured vibrations; refuse others."""
    bodies = structure_of(case) if VIBRATING_BODIES.asked_for(case.tables) else None
    if bodies is None or not bodies.interfaces:
        raise CaseError(
            f"{case.title}: a structure with measured vibrations needs bodies with interfaces and "
            f"[vibration]; give the case both, or mass in [[measured]]"
        )
    return cast(SolvedBodies, bodies)


def modes_of_law(
    case: Case, law: Dataset, datasets: Datasets, job: Job, amplitudes: np.ndarray
) -> tuple[float, np.ndarray, Answer]:
    """Return mean pressure, half-widths by half of the slabs and first mode of a law."""
    asked, bodies = case.vibration, require_modes(case)
    rising, rows = np.unique(amplitudes, return_inverse=True)
    given = {"modes": asked.modes[:1], "amplitudes": tuple(rising), "modal_amplitudes": ()}
    case = case.model_copy(update={"vibration": asked.model_copy(update=given)})
    bodies = bodies.with_volumes(case, datasets, job.read_rve)
    jointed = body_sources.BodiesWithLaws(bodies, case, [law] * len(bodies.interfaces))
    near, _ = _press(jointed, _laws(jointed, body_sources.Change()))
    pressure, area = near.rest.state.pressure, near.rest.path["point_area"].values
    mean = float(pressure @ area / area[pressure > 0.0].sum())
    # difference by half of the slabs, with the friction of the law in all interfaces
    known = tangential_values(law)
    beds = [replace(cast(Any, bed), **known) for bed in _laws(jointed, body_sources.Change())]
    halved = body_sources.Change(tuple(range(len(beds))), coarse_bed=True)
    fine, coarse = (
        _vibrate_measured(jointed, made, near)
        for made in (beds, body_sources.change_friction(beds, halved))
    )
    near = near if job.executor is None else near.portable()
    solve = partial(_solve_law, jointed, near)
    differences = by_differences(solve, STRETCH, job.executor)  # slabs that slip or not are noise

    places = np.append(rows, rising.size + rows)  # of the rows of the table

    def answer(*at: Any) -> tuple[np.ndarray, np.ndarray]:
        value, gradient = differences(*at)
        return value[places], gradient[places]

    return mean, np.abs(coarse - fine)[places], answer


def _needs(bodies: SolvedBodies, case: Case) -> Needs:
    asked = case.vibration
    reached = asked.reach(np.ones(max(asked.modes)))
    grid = sum(amplitudes.curve()[0].size for amplitudes in reached.values())
    cycles = 4 * asked.steps * len(asked.modes) * len(asked.modal_amplitudes or asked.amplitudes)
    steps = 2 * grid + (cycles if asked.cycle == "full" or asked.preload_friction else 0)
    size = replace(bodies.joint_size(case), steps=steps)
    needs = substructures.cut_needs(
        size.unknowns, joint_points=size.joint_points, coarse=False, slabs=asked.slabs
    )
    vibration = Choice(
        "vibration",
        f"modes by shift and invert on {size.unknowns} unknowns; then bodies are condensed onto "
        f"{size.joint_points} points of interfaces and followed over {len(asked.modes)} modes in "
        f"{steps} steps",
    )
    memory = (needs.memory or 0) + 8 * (2 * 6 * size.joint_points) ** 2
    memory += 8 * 3 * asked.slabs * size.joint_points * 4
    others = [choice for choice in needs.choices if choice.part != "mass"]
    seconds = substructures.choose_method(size).taken.seconds
    return replace(needs, memory=memory, seconds=seconds, choices=(vibration, *others))


def _sections(result: Dataset) -> Iterator[Section]:
    caption = [
        "Pressure and slip of interfaces are shown at the largest amplitude with an answer of the "
        "first mode, in one direction of the motion."
    ]
    drawn = vibration_pictures(result, MOST_DRAWN)
    figures = {
        name: on_axes(plot, size=WIDE if name.startswith("mode_shape") else SIZE)
        for name, plot in drawn.items()
    }
    yield Section("Modes, frequency and damping", caption, figures=figures)
    yield from budget_sections(result, "fall", "damping")


def _answer(result: Dataset) -> Iterator[str]:
    known = np.flatnonzero(
        (result["converged"].values == 1)
        & (result["step_mode"].values == result["step_mode"].values[0])
    )
    if not known.size:
        yield "No amplitude has an answer."
    for k in dict.fromkeys((*known[:1], *known[-1:])):
        yield from View(result).sentences(
            result.isel(step=k),
            "Mode {step_mode} has a frequency of {frequency:()} and {damping:()} of critical "
            "damping "
            "at a largest displacement of {largest_displacement}.",
        )


def _tabulate(result: Dataset) -> Rows:
    """Head and rows of the amplitudes of all modes; a fall of the size of rounding is zero."""
    falls = np.abs(result["fall"]) > ROUNDING * result["frequency"]
    return TABLE.rows(result.assign(fall=result["fall"].where(falls, 0.0)))


def _compared(result: Dataset) -> Dataset:
    """Return the answers at the largest amplitude of the first mode."""
    first = np.flatnonzero(result["step_mode"].values == result["step_mode"].values[0])
    return result.isel(step=first)


VIBRATING_BODIES = structure_stage(
    "vibration",
    _solve,
    _needs,
    _tabulate,
    write_mode_fields,
    reads={"strict", "structure", "interface", "statics", "vibration"},
    takes=(FITTED_LAW, THIRD_BODY_LAW, REPRESENTATIVE_VOLUME),
    knobs=body_knobs,
    schema=VIBRATION,
    question="Which frequency and damping do the bodies have, and how do both change with the "
    "amplitude?",
    prepare=lambda bodies, case: bodies.try_to_build(case, macro.vibration.require_joined),
    more=_sections,
    answer=_answer,
    answers=("frequency", "damping"),
    compared=_compared,
)
