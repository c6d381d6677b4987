"""Stage: cycles of loaded bodies until an element of one of them has cracked."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from multiscale import macro
from multiscale.errors import CaseError, ConvergenceError
from multiscale.io.fields import write_life_fields
from multiscale.laws import InterfaceLaw
from multiscale.macro import substructures
from multiscale.micro.damage.element_fatigue import (
    first_cracks,
    limit_factors,
    local_fatigue,
    von_mises,
)
from multiscale.micro.damage.fatigue import STATE_SIZE, FatigueMaterial
from multiscale.needs import Choice, Needs
from multiscale.pipeline.body_budget import Change, ErrorSources, changed_sliders
from multiscale.pipeline.showing import Table
from multiscale.pipeline.stage import Datasets, Job, Section, Stage
from multiscale.pipeline.stages.loaded_bodies import LOADED_BODIES, ROUGH_JOINTS
from multiscale.pipeline.structure_stage import choose_solver
from multiscale.pipeline.tables.assembly_settings import Bodies
from multiscale.pipeline.tables.fatigue_settings import FatigueSettings
from multiscale.pipeline.tables.made_bodies import RoughBodies
from multiscale.pipeline.tables.settings import Case
from multiscale.plotting import plot_element_field
from multiscale.plotting.figure import on_axes
from multiscale.schema import FATIGUE_LIFE, MACRO_RESULT, Dataset, with_cautions
from multiscale.upscaling import interval_errors, propagate
from multiscale.upscaling.budget import MACRO, NORMAL, has_budget, unknown_terms

SOLVES = 40  # number of solves while the inclusions crack one after the other, about

STATES, CYCLE_SECONDS = 5, 5e-4
"""States of an inclusion in memory at once, and CPU seconds of its life, about; few yield."""

CLOSED = 0.02
"""Stress between both ends of a cycle over its largest range, up to which the cycle is closed."""

ELEMENT_MEANS = (
    "the stress of an element is its mean, and the life depends on it by a high power: intervals "
    "do not count the error of the mesh, which is not known; give every body a coarser mesh, on "
    "which it cracks too"
)

NO_SCATTER = (
    "the life has no intervals of the material: give part_deviation and limit_error of the fatigue "
    "limit in [fatigue]"
)

NO_PART_SCATTER = (
    "the life of one part has no interval: give part_deviation of the fatigue limit in [fatigue]"
)

NO_VOLUME_ERRORS = (
    "the intervals of the life do not count the errors of the representative volumes of other "
    "bodies"
)

NO_LAW_BUDGET = (
    "the intervals of the life do not count the error of the law of interface {number}, which is "
    "not known: take the law of a run"
)

LACKS = (
    "the intervals of the life are lower bounds, without terms of the error of the law of joints "
    "{joints} that are not known: {terms}"
)


@dataclass(frozen=True, eq=False)
class _Cycled:
    """The structure under its cycles, and the body that is followed."""

    bodies: Bodies
    case: Case
    laws: Sequence[Dataset | None]  # of every interface
    method: "substructures.Method"
    number: int  # of the body that is followed

    @property
    def sliders(self) -> list[InterfaceLaw]:
        """Laws of all interfaces."""
        return self.bodies.sliders(self.case, self.laws)

    def solve(self, laws: Sequence[InterfaceLaw], cracked: np.ndarray | None = None) -> np.ndarray:
        """Solve the path anew; return the stress of the last cycle as :meth:`stress`."""
        built = self.bodies.build(self.case, laws)
        bodies = list(built.assembly.bodies)
        if cracked is not None:
            bodies[self.number] = replace(bodies[self.number], share=1.0 - cracked)
        whole = substructures.condense_assembly(
            replace(built.assembly, bodies=tuple(bodies)), self.method
        )
        follow = partial(
            substructures.follow_cut_loads, method=self.method, extrapolate=self.case.extrapolate
        )
        return self.stress(whole.restore(follow(whole.small, built.path)), built.path, bodies)

    def stress(
        self, result: Dataset, path: "substructures.LoadPath", bodies: "Sequence[macro.Body]"
    ) -> np.ndarray:
        """Stress of the elements of the body in the last cycle, (corners, elements, 6), Pa.

        In a damaged body it is the effective stress: force over the remaining section.
        """
        nodes = np.cumsum([0, *(body.basis.N for body in bodies)])[self.number :][:2]
        moved = result["displacement"].to_numpy()[path.closed()[-1], nodes[0] : nodes[1]]
        if not np.isfinite(moved).all():
            raise ConvergenceError(
                f"{self.case.title}: the life is unknown, as steps of the last cycle have no "
                f"answer; {result.attrs.get('failure') or result.attrs.get('cautions', '')}"
            )
        sound = 1.0 - self.bodies.bodies[self.number].damage
        return macro.bodies.element_stress(bodies[self.number], moved) / sound


def _run(case: Case, datasets: Datasets, job: Job) -> Dataset:
    """Follow the damage of the inclusions of a body over the cycles of the previous stage."""
    structure = cast(Bodies | RoughBodies, case.structure)  # as the case has checked
    bodies = structure.with_volumes(case, datasets, job.read_rve)
    table, result = case.fatigue, datasets[MACRO_RESULT.name]
    laws = bodies.read_laws(case, datasets, job.read_law)
    method = choose_solver(case, structure.joint_size(case), job.team).taken.method
    names = [body.name for body in bodies.bodies]
    number = names.index(table.body or names[0])
    cycled = _Cycled(bodies, case, laws, method, number)
    built = bodies.build(case, cycled.sliders)
    body, settings = built.assembly.bodies[number], bodies.bodies[number]
    stress = cycled.stress(result, built.path, built.assembly.bodies)
    _refuse_static(stress, table, names[number])
    material = table.material(*settings.moduli)

    def stress_of(cracked: np.ndarray) -> np.ndarray:
        return cycled.solve(cycled.sliders, cracked) if cracked.any() else stress

    life = local_fatigue(
        stress_of,
        body.mesh.t.shape[1],
        material,
        scatter=table.scatter,
        tolerance=table.tolerance,
        max_cycles=table.max_cycles,
    )
    corners, crack = macro.bodies.element_corners(body), int(life["crack_element"])
    position = body.basis.doflocs.T
    values: dict[str, Any] = {"position": position, "corners": corners}
    if crack >= 0:
        values["crack_position"] = position[corners[crack]].mean(axis=0)
    life = FATIGUE_LIFE.assign(life, values)
    coarse = _coarser_life(cycled)
    life = _with_intervals(life, stress, material, cycled, result, coarse, job)
    life = with_cautions(life, "" if coarse else ELEMENT_MEANS, *_caution_open_cycle(stress))
    return life.assign_attrs(title=case.title, case=case.to_toml(), body=names[number])


def _refuse_static(stress: np.ndarray, table: FatigueSettings, name: str) -> None:
    """Refuse a stress above the static strength."""
    if (most := float(von_mises(stress).max())) > table.strength:
        raise CaseError(
            f"an element of {name} bears {1e-6 * most:.4g} MPa in the cycle, above the strength of "
            f"{1e-6 * table.strength:.4g} MPa in [fatigue]: that is static failure, not fatigue; "
            f"lower the loads, or correct the strength"
        )


def _with_intervals(
    life: Dataset,
    stress: np.ndarray,
    material: FatigueMaterial,
    cycled: _Cycled,
    result: Dataset,
    coarse: float | None,
    job: Job,
) -> Dataset:
    """Add the intervals of the life of the mean part and of the next part.

    They are changes of the logarithm of the life of the weakest inclusion at the stress of the
    sound structure: at the ends of the interval of the fatigue limit, by the laws, and on a mesh
    of elements twice as large, which bounds an error that falls at least linearly. The place
    has the distance from the first crack of the structure to the first cracks of all these.
    """
    table, middle = cycled.case.fatigue, float(life["cycles_to_first"])
    mesh = 0.0 if coarse is None else abs(float(np.log(coarse / middle)))
    if coarse is not None:
        life = FATIGUE_LIFE.assign(life, {"mesh_error": mesh})
    if not np.isfinite(float(life["cycles_to_crack"])) or table.limit_error is None:
        return with_cautions(life, *([NO_SCATTER] if table.limit_error is None else []))
    first = partial(first_cracks, scatter=table.scatter, max_cycles=1e3 * table.max_cycles)
    law_errors, places, cautions = _law_errors(cycled, result, material, middle, first, job)
    if table.part_deviation is None:
        cautions.append(NO_PART_SCATTER)
    if any(body.porous for body in cycled.bodies.bodies):
        cautions.append(NO_VOLUME_ERRORS)
    deviations = {"mean_law": table.limit_error}
    deviations["one_part"] = float(np.hypot(table.limit_error, table.part_deviation or np.nan))
    values: dict[str, Any] = {}
    for kind, deviation in deviations.items():
        logs = []
        for sign in (-1.0, 1.0):
            shift = np.exp(sign * NORMAL * deviation) if np.isfinite(deviation) else np.nan
            if np.isnan(shift):
                logs.append(np.nan)
                continue
            changed = replace(material, fatigue_limit=float(shift) * material.fatigue_limit)
            lives = first(stress, changed)
            places.append(int(np.argmin(lives)))
            limit = np.log(lives.min() / middle)
            logs.append(sign * np.sqrt(limit**2 + law_errors[kind] ** 2 + mesh**2))
        values[f"cycles_to_crack_{kind}"] = float(life["cycles_to_crack"]) * np.exp(logs)
    centre = life["position"].to_numpy()[life["corners"].to_numpy().astype(int)].mean(axis=1)
    start = centre[int(np.argmin(life["first_crack"].to_numpy()))]
    values["crack_distance"] = np.linalg.norm(centre[places] - start, axis=1).max()
    return with_cautions(FATIGUE_LIFE.assign(life, values), *cautions)


def _law_errors(
    cycled: _Cycled,
    result: Dataset,
    material: FatigueMaterial,
    middle: float,
    first: Callable[..., np.ndarray],
    job: Job,
) -> tuple[Mapping[str, float], list[int], list[str]]:
    """Relative half-widths of the life by the budgets of all laws.

    Also returns the elements that crack first with changed laws, and cautions for terms of the
    error that are not known.
    """
    squares, places, cautions = {"mean_law": 0.0, "one_part": 0.0}, list[int](), list[str]()
    cautions += [
        NO_LAW_BUDGET.format(number=k) for k, law in enumerate(cycled.laws) if not has_budget(law)
    ]

    def shortest(change: Change) -> np.ndarray:
        """Life of the element that cracks first with a changed law."""
        laws = changed_sliders(cycled.bodies, cycled.case, cycled.laws, change)
        lives = first(cycled.solve(laws), material)
        places.append(int(np.argmin(lives)))
        return np.array([[float(lives.min())]])

    for law_errors in ErrorSources.of(cycled.bodies, cycled.case, cycled.laws).laws:
        traction = -result["traction"].to_numpy()[-1, :, 0]
        # mean pressure on the closed points of the joints of this law
        of_law = np.isin(result["point_joint"].to_numpy(), law_errors.joints)
        closed = traction[of_law & (traction > 0.0)]
        pressure = np.array([closed.mean()]) if closed.size else None
        budget = propagate(
            "life",
            law_errors.sources(pressure),
            shortest,
            np.array([[middle]]),
            progress=lambda done, total: job.progress(
                done, total, "solves for the intervals of the life"
            ),
        )
        for kind, error in interval_errors(budget).items():
            squares[kind] += float(error[0, 0]) ** 2
        # the error of the mesh enters the life separately
        if missing := [term for term in unknown_terms(budget) if term != MACRO]:
            cautions.append(LACKS.format(joints=law_errors.joints, terms=", ".join(missing)))
    errors = {kind: float(np.sqrt(square)) for kind, square in squares.items()}
    return errors, places, cautions


def _caution_open_cycle(stress: np.ndarray) -> Iterator[str]:
    """Caution if the stress at the end of the cycle differs from its start."""
    largest = float(np.ptp(stress, axis=0).max()) or 1.0
    missed = float(np.abs(stress[-1] - stress[0]).max()) / largest
    if missed > CLOSED:
        yield (
            f"the last cycle ends {100.0 * missed:.2g} % of its largest range of stress away from "
            f"its start, and is repeated as if it were closed: give more cycles in [cycles]"
        )


def _coarser_life(cycled: _Cycled) -> float | None:
    """Return the cycles to the first crack on coarser meshes, if these are given and crack."""
    table = cycled.case.fatigue
    for bodies in cycled.bodies.coarser().values():
        coarse = replace(cycled, bodies=bodies)
        material = table.material(*bodies.bodies[cycled.number].moduli)
        stress = coarse.solve(coarse.sliders)
        first = first_cracks(stress, material, scatter=table.scatter, max_cycles=table.max_cycles)
        return float(first.min()) if np.isfinite(first).any() else None
    return None


def _format_cycles(cycles: float) -> str:
    return "no number of cycles" if np.isinf(cycles) else f"{cycles:.3g} cycles"


def _answer(life: Dataset) -> str:
    """Report the life and the place of the first crack."""
    body = life.attrs["body"]
    if int(life["run_out"]):
        share = 100.0 * float(life["cracked_share"].max())
        inclusions = "all inclusions"
        if share:
            inclusions = (
                f"up to {share:.3g} % of the inclusions of an element crack, and the others"
            )
        return f"No element of {body} cracks through: {inclusions} stay elastic."
    cycles = float(life["cycles_to_crack"])
    if np.isnan(cycles):
        done = float(life["cycles"][-1])
        return (
            f"The life of {body} is unknown: after {_format_cycles(done)} and "
            f"{int(life['solves'])} solves no element has cracked; raise max_cycles, or "
            f"tolerance, in [fatigue]."
        )
    place = ", ".join(f"{1e3 * x:.4g}" for x in life["crack_position"].to_numpy())
    sentence = f"A crack starts in {body} at ({place}) mm after {_format_cycles(cycles)}"
    for kind, words in (("mean_law", "mean part"), ("one_part", "one part")):
        if (name := f"cycles_to_crack_{kind}") in life and np.isfinite(life[name]).any():
            low, high = life[name].to_numpy()
            sentence += f"; {words}, 95 %: {low:.3g} ... {high:.3g}"
    if "crack_distance" in life:
        away = 1e3 * float(life["crack_distance"])
        moves = f"moves by up to {away:.3g} mm" if away else "stays"
        sentence += f"; within these intervals the place {moves}"
    if "mesh_error" in life:
        change = np.expm1(float(life["mesh_error"]))
        sentence += f"; on the coarser mesh the first life differs by {100.0 * change:.2g} %"
    first = _format_cycles(float(life["cycles_to_first"]))
    return f"{sentence}. The first inclusion cracks after {first}."


TABLE = Table(
    ("cycles", "largest_damage", "largest_share"),
    {
        "largest_damage": "largest damage of an inclusion",
        "largest_share": "largest cracked share of an element",
    },
    along=("record",),
    most=12,
)


def _sections(datasets: Datasets, out: Path) -> Iterator[Section]:
    life = datasets[FATIGUE_LIFE.name]
    pictures = {
        "fatigue_amplitude": on_axes(plot_element_field, life, "equivalent_amplitude", near=False),
        "fatigue_damage": on_axes(plot_element_field, life, "damage", near=True),
    }
    yield Section("Fatigue", (), *TABLE.rows(life), figures=pictures)


def _needs(case: Case) -> Needs:
    again = SOLVES if case.fatigue.scatter else 0
    bodies = cast(Bodies | RoughBodies, case.structure)  # as the case has checked
    names = [body.name for body in bodies.bodies]
    body = bodies.bodies[names.index(case.fatigue.body or names[0])]
    inclusions = body.load().t.shape[1] * limit_factors(case.fatigue.scatter).size
    seconds = again * choose_solver(case, bodies.joint_size(case)).taken.seconds
    work = f"{inclusions} inclusions, and about {again} solves as they crack"
    return Needs(
        memory=8 * STATES * STATE_SIZE * inclusions,
        seconds=seconds + CYCLE_SECONDS * inclusions,
        choices=(Choice("fatigue", work),),
    )


BODY_FATIGUE = Stage(
    schema=FATIGUE_LIFE,
    tables=("fatigue",),
    reads={"title", "fatigue"},
    takes=(ROUGH_JOINTS, LOADED_BODIES),
    run=_run,
    write_fields=write_life_fields,
    needs=_needs,
    question="After how many cycles does a crack start, and where?",
    answer=lambda life: [_answer(life)],
    sections=_sections,
    answers={"cycles_to_crack": "", "cycles_to_first": ""},
    failure=lambda life: "" if int(life["converged"]) else _answer(life),
)
