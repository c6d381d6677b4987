"""The matrix of stiff and extreme cases: its table, its outcomes, and a few of its cases."""

import os
from dataclasses import replace
from pkgutil import resolve_name

import numpy as np
import pytest
import xarray as xr

from multiscale.bench import STABILITY_FAMILIES, stability, stability_grains
from multiscale.bench.stability import (
    Outcome,
    StabilityCase,
    check_stability,
    read_cases,
    solve_case,
    tabulate_stability,
)
from multiscale.errors import CaseError
from multiscale.executors import thread_count
from multiscale.io import open_dataset, write_dataset
from multiscale.schema import STABILITY


def case(family, tolerance=1e-6, **parameters):
    return StabilityCase(family, tuple(parameters.items()), tolerance)


def test_the_table_names_705_different_cases_of_families_that_exist():
    cases = read_cases()
    assert len({(case.family, case.parameters) for case in cases}) == len(cases) == 705
    assert tuple(dict.fromkeys(case.family for case in cases)) == tuple(STABILITY_FAMILIES)
    for family, module in STABILITY_FAMILIES.items():
        assert callable(resolve_name(f"multiscale.bench.{module}:{family}"))


def refuse():
    raise CaseError("zero is too small; take more")


def hang():
    while True:
        pass


@pytest.fixture
def families(monkeypatch):
    """Families with the behaviour of their names, in this process."""

    def raise_error():
        raise ZeroDivisionError("by zero")

    answers = {
        "right": lambda: 1e-9,
        "wrong": lambda: 1e-3,
        "lost": lambda: np.nan,
        "refuse": refuse,
        "error": raise_error,
        "hang": hang,
    }
    for name, answer in answers.items():
        monkeypatch.setitem(STABILITY_FAMILIES, name, "stability_grains")
        monkeypatch.setattr(stability_grains, name, answer, raising=False)
    monkeypatch.setattr(stability, "LONGEST", 1)


@pytest.mark.usefixtures("families")
@pytest.mark.parametrize(
    ("family", "outcome", "sentence"),
    [
        ("right", "converged", ""),
        ("wrong", "failed", "residual 1.0e-03 above 1e-06"),
        ("lost", "failed", "residual nan above 1e-06"),
        ("refuse", "refused", "zero is too small; take more"),
        ("error", "failed", "ZeroDivisionError: by zero"),
        ("hang", "failed", "TimeoutError: no answer in 1 s"),
    ],
)
def test_only_a_verified_answer_has_converged_and_only_a_sentence_refuses(
    family, outcome, sentence
):
    entry = solve_case(case(family))
    assert stability.OUTCOMES[entry.outcome] == outcome
    assert entry.sentence == sentence


@pytest.mark.slow
def test_a_process_that_dies_fails_only_its_case(monkeypatch):
    cases = [case("wedge", coefficient=mu) for mu in (0.3, "no number", 1.5)]
    monkeypatch.setattr(stability, "solve_case", _die_without_number)
    result = check_stability(cases, jobs=1)
    STABILITY.check(result)
    np.testing.assert_array_equal(result["outcome"], [2, 0, 2])
    assert result["sentence"].values[1] == "its process died"
    head, rows = tabulate_stability(result)
    assert head == ("family", "cases", "converged", "refused", "failed", "largest residual")
    assert rows[-1][:5] == ("all", "3", "2", "0", "1")


def test_results_are_stored_after_every_case(monkeypatch, tmp_path):
    cases = [case("wedge", coefficient=mu) for mu in (0.3, 0.6, 1.5)]
    monkeypatch.setattr(stability, "solve_case", _die_without_number)

    def keep(result):
        write_dataset(result, tmp_path / "stability.nc", STABILITY)
        if result.sizes["case"] == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        check_stability(cases, keep=keep)
    dataset = open_dataset(tmp_path / "stability.nc", STABILITY)
    assert list(dataset["parameters"].values) == ["coefficient = 0.3", "coefficient = 0.6"]
    assert dataset.attrs["cases"] == 3


@pytest.mark.slow
def test_every_case_runs_on_one_thread_since_others_run_at_the_same_time(monkeypatch):
    monkeypatch.setattr(stability, "solve_case", _count_threads)
    result = check_stability([case("wedge", coefficient=mu) for mu in (0.3, 0.6)], jobs=2)
    np.testing.assert_array_equal(result["residual"], 1.0)


def _count_threads(_one):
    return Outcome(2, float(thread_count()), 0.1)


def _die_without_number(item):
    if isinstance(dict(item.parameters)["coefficient"], str):
        os._exit(1)
    return Outcome(2, 1e-9, 0.1)


@pytest.mark.parametrize(
    "entry",
    [
        case("structure", 1e-8, bar_over_cable=1e6, prestress=1e-6, load_factor=1000.0),
        case("motion", 1e-8, bar_over_cable=1e6, prestress=1.0, step=0.1),
        case("friction", 1e-8, mass_ratio=1e6, coefficient=1.5, boxes=2),
        case("wedge", 1e-8, coefficient=1.5),
        case("complementarity", 1e-10, contrast=1e8, points=8),
        pytest.param(
            case("joint", law_over_block=1e12, friction=0.2, parts=2),
            marks=pytest.mark.slow,
            id="joint",
        ),
        case("joint", law_over_block=1e6, friction=1.5, parts=1, method="whole"),
        case("joint", law_over_block=1e12, friction=1.5, parts=1, method="whole"),
        case("joint_path", scene="slides away", law_over_block=1e6, friction=1.5, method="Schur"),
        case("joint_path", scene="opens", law_over_block=1e12, friction=0.2, method="Schur"),
        case("bolts", pull=2.0, law_over_block=1e12, method="whole"),
        case("limit_load", 1e-7, rise=0.01, bars=6),
        case("near_limit", 1e-7, share=1.001, rise=0.01),
        case("loose_links", scene="flat square", load=1e-6, solver="exact"),
        case("impact", 1e-10, speed=1e3, friction=0.5, restitution=0.9),
        case("large_bodies", law_over_block=1e12, friction=0.2, matching="no"),
        *(
            case("joint_path", scene="does not match", method="whole", **values)
            for values in (
                {"law_over_block": 1e12, "friction": 1.5},
                {"law_over_block": 1e6, "friction": 0.2},  # a reversal that is brought up in parts
            )
        ),
        pytest.param(
            case("rough_cell", slope=0.5, relative_pressure=1e-4, poissons_ratio=0.4999),
            marks=pytest.mark.slow,
            id="rough_cell",
        ),
        pytest.param(
            case("rough_cell", slope=0.5, relative_pressure=0.1, poissons_ratio=0.4999),
            marks=pytest.mark.slow,
            id="rough_cell, pressed",
        ),
        case("voids", 1e-4, modulus=1e-6, porosity=0.3),
        case("grains", 1e-4, friction=1.5, step=1e-2, density_ratio=1e6),
        case("pile", 1e-8, spheres=8, mass_ratio=1e4, coefficient=0.5),
        case("bounce", 1e-12, friction=0.0, restitution=1.0, step=4e-3),
    ],
    ids=lambda item: item.family,
)
def test_an_extreme_case_of_a_family_converges(entry):
    outcome = solve_case(entry)
    assert outcome.outcome == 2, outcome.sentence


def change(place, name, factor):
    """Multiply the later entries of a result, as a fault in a solver would."""
    solve = resolve_name(place)

    def wrong(*arguments, **options):
        result = solve(*arguments, **options)
        if isinstance(result, xr.Dataset):
            result = result.copy(deep=True)
            value = result[name].values
            value[len(value) // 3 :] *= factor
            return result
        value = np.array(getattr(result, name), dtype=float)
        value[len(value) // 3 :] *= factor
        return replace(result, **{name: value})

    return wrong


SCENES = {
    "structure": {"bar_over_cable": 1.0, "prestress": 1.0, "load_factor": 4.0},
    "motion": {"bar_over_cable": 1.0, "prestress": 1.0, "step": 1e-3},
    "cut_structure": {"bar_over_cable": 1.0, "load_factor": 4.0, "parts": 2, "method": "Schur"},
    "joint": {"law_over_block": 1.0, "friction": 0.2, "parts": 1},
    "stiff joint": {"law_over_block": 1e12, "friction": 1.5, "parts": 1},
    "friction": {"mass_ratio": 1.0, "coefficient": 0.3, "boxes": 2},
    "wedge": {"coefficient": 0.3},
    "near_limit": {"share": 0.999, "rise": 0.1},
    "loose_links": {"scene": "slack cables", "load": 1.0, "solver": "motion"},
    "impact": {"speed": 1e3, "friction": 0.5, "restitution": 0.9},
    "complementarity": {"contrast": 1.0, "points": 8},
    "grains": {"friction": 0.5, "step": 1e-3, "density_ratio": 1.0},
    "bounce": {"friction": 0.0, "restitution": 1.0, "step": 4e-3},
    "voids": {"modulus": 1e-6, "porosity": 0.3},
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "solver", "name", "factor"),
    [
        ("structure", "bench.structures.solve_grid", "tension", 1.01),
        ("structure", "bench.structures.solve_grid", "displacement", 1.01),
        ("motion", "macro.simulate", "displacement", 1.01),
        ("motion", "macro.simulate", "velocity", 1.01),
        ("motion", "macro.simulate", "tension", 1.01),
        ("motion", "macro.simulate", "elastic_energy", 1.01),
        ("cut_structure", "macro.NewtonSchur.solve", "tension", 1.01),
        ("joint", "macro.substructures.load_joint", "traction", -7.0),
        ("joint", "macro.substructures.load_joint", "traction", 1.0001),
        ("joint", "macro.substructures.load_joint", "jump", 1.0001),
        ("stiff joint", "macro.substructures.load_joint", "traction", -7.0),
        ("stiff joint", "macro.substructures.load_joint", "traction", 1.00001),
        ("stiff joint", "macro.substructures.load_joint", "jump", 1.00001),
        ("friction", "nonsmooth.solve_friction", "value", 1.01),
        ("wedge", "nonsmooth.solve_friction", "value", 1.01),
        ("complementarity", "nonsmooth.solve_lcp", "value", 1.01),
        ("near_limit", "macro.solve_static", "displacement", 1.01),
        ("loose_links", "macro.simulate", "velocity", 1.01),
        ("impact", "macro.granulate.simulate_grains", "velocity", 1.01),
        ("grains", "macro.granulate.simulate_grains", "velocity", 1.1),
        ("grains", "macro.granulate.simulate_grains", "position", 0.9),
        ("grains", "macro.granulate.simulate_grains", "contact_force", 2.0),
        ("bounce", "macro.granulate.simulate_grains", "kinetic_energy", 1.00001),
        ("voids", "micro.damage.effective_stiffness", "value", 0.1),
        ("voids", "micro.damage.effective_stiffness", "value", 1.001),
    ],
)
def test_a_wrong_answer_of_any_step_fails(monkeypatch, scene, solver, name, factor):
    family = scene.split()[-1]
    monkeypatch.setattr(f"multiscale.{solver}", change(f"multiscale.{solver}", name, factor))
    tolerance = next(entry.tolerance for entry in read_cases() if entry.family == family)
    outcome = solve_case(case(family, tolerance, **SCENES[scene]))
    assert stability.OUTCOMES[outcome.outcome] == "failed"


@pytest.mark.slow
def test_the_command_leaves_the_matrix_and_fails_with_its_cases(command, tmp_path):
    file = tmp_path / "matrix.nc"
    status, output, _ = command("stability", "wedge", "-o", file)
    assert status == 0
    assert {"largest", "residual"} <= set(output.split())
    assert open_dataset(file, STABILITY).sizes["case"] == 4
