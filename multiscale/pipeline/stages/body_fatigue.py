"""Stage: cycles of bodies until an element has cracked."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from multiscale import macro, schema
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
from multiscale.pipeline.body_sources import BodiesWithLaws, Change, ErrorSources
from multiscale.pipeline.showing import Table
from multiscale.pipeline.stage import Datasets, Job, Section, Stage
from multiscale.pipeline.stages.loaded_bodies import LOADED_BODIES
from multiscale.pipeline.structure_stage import choose_solver, structure_of
from multiscale.pipeline.tables.settings import Case
from multiscale.pipeline.tables.solved_bodies import SolvedBodies
from multiscale.plotting import plot_element_field
from multiscale.plotting.figure import on_axes
from multiscale.upscaling import Bound, propagate
from multiscale.upscaling.budget import (
    MACRO,
    NORMAL,
    Term,
    interval_errors,
    known_terms,
    unknown_terms,
)

SOLVES = 40  # number of solves while the inclusions crack one after the other, about

STATES, CYCLE_SECONDS = 5, 5e-4
"""States of an inclusion in memory at once, and CPU seconds of its life, about; few yield."""

CLOSED = 0.02  # stress between the ends of a closed cycle over its largest range, at most

ELEMENT_MEANS = (
    "the life depends on the mean stress of an element with a high power, and intervals do not "
    "contain the error of the mesh, which is unknown; give every body a coarser mesh, on which "
    "it also cracks"
)

NO_SCATTER = (
    "the life has no intervals of the material: give part_deviation and limit_error of the fatigue "
    "limit in [fatigue]"
)

NO_PART_SCATTER = (
    "the life of one part has no interval: give part_deviation of the fatigue limit in [fatigue]"
)

LACKS = (
    "the intervals of the life are lower bounds, without terms of the error of the law of joints "
    "{joints} that are not known: {terms}"
)


@dataclass(frozen=True, eq=False)
class _Cycled:
    """The structure under its cycles, and the body that is followed."""

    jointed: BodiesWithLaws
    method: "substructures.Method"
    number: int  # of the body that is followed

    @property
    def material(self) -> FatigueMaterial:
        """Material of the body that is followed."""
        moduli = self.jointed.bodies.bodies[self.number].moduli
        return self.jointed.case.fatigue.material(*moduli)

    def solve(self, laws: Sequence[InterfaceLaw], cracked: np.ndarray | None = None) -> np.ndarray:
        """Solve the path anew; return the stress of the last cycle as :meth:`stress`."""
        built = self.jointed.build(laws)
        bodies = list(built.assembly.bodies)
        if cracked is not None:
            bodies[self.number] = replace(bodies[self.number], share=1.0 - cracked)
        whole = substructures.condense_assembly(
            replace(built.assembly, bodies=tuple(bodies)), self.method
        )
        path = replace(built.path, amplitudes=())
        followed = substructures.follow_cut_loads(
            whole.small, path, method=self.method, extrapolate=self.jointed.case.extrapolate
        )
        return self.stress(whole.restore(followed), path, bodies)

    def stress(
        self, result: schema.Dataset, path: "substructures.LoadPath", bodies: "Sequence[macro.Body]"
    ) -> np.ndarray:
        """Effective stress of elements in the last cycle, (corners, elements, 6), Pa."""
        nodes = np.cumsum([0, *(body.basis.N for body in bodies)])[self.number :][:2]
        moved = result["displacement"].to_numpy()[path.closed()[-1], nodes[0] : nodes[1]]
        if not np.isfinite(moved).all():
            raise ConvergenceError(
                f"{self.jointed.case.title}: the life is unknown, as steps of the last cycle have "
                f"no answer; {result.attrs.get('failure') or result.attrs.get('cautions', '')}"
            )
        sound = 1.0 - self.jointed.bodies.bodies[self.number].damage
        return macro.bodies.element_stress(bodies[self.number], moved) / sound


def _follow_cycles(case: Case, datasets: Datasets, job: Job) -> schema.Dataset:
    """Follow the damage of the inclusions of a body over the cycles of the previous stage."""
    structure: SolvedBodies = structure_of(case)
    jointed = BodiesWithLaws.of(structure, case, datasets, job)
    bodies, sliders = jointed.bodies, jointed.sliders()
    table, result = case.fatigue, datasets[schema.MACRO_RESULT.name]
    method = choose_solver(case, structure.joint_size(case), job.team).taken.method
    names = [body.name for body in bodies.bodies]
    number = names.index(table.body or names[0])
    cycled, built = _Cycled(jointed, method, number), jointed.build(sliders)
    body, material = built.assembly.bodies[number], cycled.material
    stress = cycled.stress(result, built.path, built.assembly.bodies)
    if (most := float(von_mises(stress).max())) > table.strength:
        raise CaseError(
            f"an element of {names[number]} has {1e-6 * most:.4g} MPa in the cycle, above the "
            f"strength of {1e-6 * table.strength:.4g} MPa in [fatigue]: that is static failure, "
            f"not fatigue; lower the loads, or correct the strength"
        )

    def stress_of(cracked: np.ndarray) -> np.ndarray:
        return cycled.solve(sliders, cracked) if cracked.any() else stress

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
    life = schema.FATIGUE_LIFE.assign(life, values)
    coarse = _coarser_life(cycled)
    if job.intervals:
        life = _with_intervals(life, stress, material, cycled, result, coarse, job)
    life = schema.with_cautions(life, "" if coarse else ELEMENT_MEANS, *_caution_open_cycle(stress))
    return life.assign_attrs(title=case.title, case=case.to_toml(), body=names[number])


def _with_intervals(
    life: schema.Dataset,
    stress: np.ndarray,
    material: FatigueMaterial,
    cycled: _Cycled,
    result: schema.Dataset,
    coarse: float | None,
    job: Job,
) -> schema.Dataset:
    """Add the intervals of the life of the mean part and of the next part."""
    table, middle = cycled.jointed.case.fatigue, float(life["cycles_to_first"])
    on_mesh = Term("not known: no body has a coarser mesh")
    if coarse is not None:
        mesh = abs(float(np.log(coarse / middle)))
        life = schema.FATIGUE_LIFE.assign(life, {"mesh_error": mesh})
        on_mesh = Term("the life on a coarser mesh", np.array([[mesh]]))
    if not np.isfinite(float(life["cycles_to_crack"])) or table.limit_error is None:
        return schema.with_cautions(life, *([NO_SCATTER] if table.limit_error is None else []))
    first = partial(first_cracks, scatter=table.scatter, max_cycles=1e3 * table.max_cycles)
    places = list[int]()

    def shortest(change: Change) -> np.ndarray:
        """Life of the element that cracks first with a changed law or structure."""
        other = replace(cycled, jointed=cycled.jointed.changed(change))
        lives = first(other.solve(other.jointed.sliders(change)), other.material)
        places.append(int(np.argmin(lives)))
        return np.array([[float(lives.min())]])

    # errors by laws of joints, stated values, volumes and mesh, of logarithms of the life
    sources = ErrorSources.of(cycled.jointed)
    budget = propagate(
        "life",
        [
            *(
                source
                for law in sources.laws
                for source in law.sources(_pressure_on(result, law.joints))
            ),
            *sources.stated,
            Bound(name="mesh", bounds={MACRO: on_mesh}),
        ],
        shortest,
        np.array([[middle]]),
        progress=lambda done, total: job.progress(
            done, total, "solves for the intervals of the life"
        ),
    )
    errors = {kind: np.nan_to_num(error[0, 0]) for kind, error in interval_errors(budget).items()}
    deviations = {"mean_law": table.limit_error}
    deviations["one_part"] = float(np.hypot(table.limit_error, table.part_deviation or np.nan))
    values: dict[str, Any] = {}
    for kind, deviation in deviations.items():
        logs = []
        for sign in (-1.0, 1.0) if np.isfinite(deviation) else ():
            shift = float(np.exp(sign * NORMAL * deviation))
            changed = replace(material, fatigue_limit=shift * material.fatigue_limit)
            lives = first(stress, changed)
            places.append(int(np.argmin(lives)))
            logs.append(sign * np.hypot(np.log(lives.min() / middle), errors[kind]))
        ends = np.exp(logs or [np.nan, np.nan])
        values[f"cycles_to_crack_{kind}"] = float(life["cycles_to_crack"]) * ends
    centre = life["position"].to_numpy()[life["corners"].to_numpy().astype(int)].mean(axis=1)
    start = centre[int(np.argmin(life["first_crack"].to_numpy()))]
    values["crack_distance"] = np.linalg.norm(centre[places] - start, axis=1).max()
    life = schema.FATIGUE_LIFE.assign(life, values)
    return schema.with_cautions(life, *_left_out(cycled, budget, sources))


def _pressure_on(result: schema.Dataset, joints: tuple[int, ...]) -> np.ndarray | None:
    """Mean pressure on the closed points of joints at the end of the path, Pa, if there are any."""
    pressure = -result["traction"].to_numpy()[-1, :, 0]
    of_law = np.isin(result["point_joint"].to_numpy(), joints)
    closed = pressure[of_law & (pressure > 0.0)]
    return np.array([closed.mean()]) if closed.size else None


def _left_out(cycled: _Cycled, budget: schema.Dataset, sources: ErrorSources) -> Iterator[str]:
    """Caution on errors that the intervals of the life do not count."""
    yield from sources.unknown
    laws = sources.laws
    missing = dict[tuple[int, ...], list[str]]()  # by the joints of the laws that lack them
    for term in unknown_terms(budget) if laws else ():
        lacking = [law for law in laws if term not in known_terms(law.law)] or laws
        missing.setdefault(sum((law.joints for law in lacking), ()), []).append(term)
    for joints, terms in missing.items():
        if listed := ", ".join(term for term in terms if term != MACRO):
            yield LACKS.format(joints=", ".join(map(str, joints)), terms=listed)
    if cycled.jointed.case.fatigue.part_deviation is None:
        yield NO_PART_SCATTER


def _caution_open_cycle(stress: np.ndarray) -> Iterator[str]:
    """Caution if the stress at the end of the cycle differs from its start."""
    largest = float(np.ptp(stress, axis=0).max()) or 1.0
    missed = float(np.abs(stress[-1] - stress[0]).max()) / largest
    if missed > CLOSED:
        yield (
            f"the stress at the end of the last cycle differs from its start by "
            f"{100.0 * missed:.2g} % of its largest range, but the cycle is repeated as closed: "
            f"give more cycles in [cycles]"
        )


def _coarser_life(cycled: _Cycled) -> float | None:
    """Return the cycles to the first crack on coarser meshes, if these are given and crack."""
    table = cycled.jointed.case.fatigue
    for bodies in cycled.jointed.bodies.coarser().values():
        coarse = replace(cycled, jointed=replace(cycled.jointed, bodies=bodies))
        stress = coarse.solve(coarse.jointed.sliders())
        first = first_cracks(
            stress, coarse.material, scatter=table.scatter, max_cycles=table.max_cycles
        )
        return float(first.min()) if np.isfinite(first).any() else None
    return None


def _format_cycles(cycles: float) -> str:
    return "no number of cycles" if np.isinf(cycles) else f"{cycles:.3g} cycles"


def _report(life: schema.Dataset) -> str:
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
    life = datasets[schema.FATIGUE_LIFE.name]
    pictures = {
        "fatigue_amplitude": on_axes(plot_element_field, life, "equivalent_amplitude", near=False),
        "fatigue_damage": on_axes(plot_element_field, life, "damage", near=True),
    }
    yield Section("Fatigue", (), *TABLE.rows(life), figures=pictures)


def _needs(case: Case) -> Needs:
    again = SOLVES if case.fatigue.scatter else 0
    bodies: SolvedBodies = structure_of(case)
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
    schema=schema.FATIGUE_LIFE,
    tables=("fatigue",),
    reads={"title", "fatigue"},
    takes=(LOADED_BODIES,),
    run=_follow_cycles,
    write_fields=write_life_fields,
    needs=_needs,
    question="After how many cycles does a crack start, and where?",
    answer=lambda life: [_report(life)],
    sections=_sections,
    answers=("cycles_to_crack", "cycles_to_first"),
    failure=lambda life: "" if int(life["converged"]) else _report(life),
)
