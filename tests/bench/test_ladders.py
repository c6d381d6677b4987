"""Ladders of fidelities against their truths, and the cheapest way to an error."""

from importlib.util import find_spec

import numpy as np
import pytest

from multiscale.bench import FAMILIES, limit_family
from multiscale.bench.grains_family import BOUNCE, COMPLIANCES, EXACT, ROLL, STEPS, answer
from multiscale.bench.limit_family import LIMIT_SCENES
from multiscale.bench.peers import CODES
from multiscale.bench.structures_family import GRID_METHODS
from multiscale.bench.substructures_family import CUT_METHODS, RIGHT
from multiscale.bench.summary import join_families, tabulate_cheapest, tabulate_runs
from multiscale.bench.trials import BenchFamily, Trial, judge_by, measure_family
from multiscale.errors import CaseError
from multiscale.io import open_dataset
from multiscale.schema import WORK_PRECISION


def climb_one(task, exact=2.0):
    trials = [Trial("a", "b", task, lambda: None, {"points": 4})]
    family = BenchFamily(trials, judge_by(lambda *_: (exact, 0.5)), title="c")
    return measure_family(family, print).isel(run=0)


@pytest.mark.usefixtures("in_this_process")
def test_the_error_of_samples_is_their_root_mean_square_and_their_time_that_of_one():
    run = climb_one(lambda: np.array([1.0, 3.0]))
    assert run["error"] == 0.5
    assert run["wall_time"] == 0.05
    assert (run["points"], run["error_uncertainty"], run["converged"]) == (4, 0.5, 1)


@pytest.mark.usefixtures("in_this_process")
def test_an_answer_that_is_not_there_has_no_error():
    run = climb_one(lambda: np.nan)
    assert run["converged"] == 0
    assert np.isnan(run["error"])


@pytest.mark.usefixtures("in_this_process")
def test_a_family_that_is_killed_leaves_its_finished_scenes():
    def fail():
        raise KeyboardInterrupt

    tasks = {"a": lambda: 2.0, "b": lambda: 3.0, "c": fail}
    trials = [Trial(scene, "d", task, lambda: None) for scene, task in tasks.items()]
    family = BenchFamily(trials, judge_by(lambda *_: (2.0, 0.5)), title="c")
    kept = []
    with pytest.raises(KeyboardInterrupt):
        measure_family(family, print, kept.append)
    assert [list(found["scene"].values) for found in kept] == [["a"], ["a", "b"]]
    np.testing.assert_array_equal(kept[-1]["error"], [0.0, 0.5])


@pytest.mark.usefixtures("in_this_process")
def test_a_judge_gives_a_trial_any_number_of_rows_and_a_lost_one_has_no_values():
    one, other = (Trial("a", name, lambda: 2.0, lambda: None, {"points": 4}) for name in "bc")
    left = Trial("a", "d", lambda: 1.0, lambda: None, left_out="because it is not installed")

    def judge(scene, runs):
        for step in (1, 2):
            error = {"error": step * runs[other].value, "history": np.full((step, 2), step)}
            yield other, {"scene": f"{scene}{step}", "converged": 1} | error

    found = measure_family(BenchFamily([one, other, left, left], judge, title="c"), print)
    assert list(found["scene"].values) == ["a", "a1", "a2"]
    np.testing.assert_array_equal(found["error"], [np.nan, 2.0, 4.0])
    np.testing.assert_array_equal(found["converged"], [0, 1, 1])
    np.testing.assert_array_equal(found["history_run"], [1, 2, 2])
    np.testing.assert_array_equal(found["history_error"], [1.0, 2.0, 2.0])
    assert found.attrs["cautions"] == "d is left out because it is not installed"


EXPECTED = {
    "micro": ({name for name, code in CODES.items() if find_spec(code.module)}, 0.03),
    "structures": (
        {n for n, m in GRID_METHODS.items() if not m.pardiso or find_spec("pypardiso")},
        1e-9,
    ),
    "substructures": (set(CUT_METHODS), RIGHT),
}
"""Methods of families, and the largest of their errors."""
OPEN = ("micro", "nonsmooth")
"""Families with methods that may not converge, or codes that may not start."""


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_the_smallest_form_of_a_family_leaves_a_dataset_and_a_figure(command, tmp_path, family):
    status, said, _ = command("bench", family, "-o", tmp_path, "--quick")
    assert status == 0
    found = open_dataset(tmp_path / f"{family}.nc", WORK_PRECISION)
    methods, largest = EXPECTED.get(family, (set(found["method"].values), 2.0))
    assert set(found["method"].values) == methods
    assert family in OPEN or found["converged"].values.all()
    own = found["method"].str.startswith("multiscale")
    assert found["converged"].values[own].all()
    assert np.all(found["error"].values[np.isfinite(found["error"])] < largest)
    assert "peak_memory" not in found or np.all(found["peak_memory"].dropna("run") > 1e7)
    assert found.attrs["title"] in said
    assert "load of the machine" in said
    assert (tmp_path / f"{family}.png").stat().st_size > 1000


def test_a_family_that_fails_does_not_take_the_others_with_it(command, tmp_path, monkeypatch):
    def fail(name, **_):
        if name != "laws":
            raise CaseError("no points") if name == "chain" else ValueError("no grains")
        return family_of([0.04], [1.0])

    monkeypatch.setattr("multiscale.bench.bench", fail)
    status, said, told = command("bench", "chain", "grains", "laws", "-o", tmp_path)
    assert status == 1
    assert "the family chain failed: no points" in told
    assert "ValueError: no grains" in told
    assert told.endswith("2 of 3 families failed: chain, grains\n")
    assert "load of the machine: 1.5 processes before and 0.25 after, on 2 cores" in said
    assert (tmp_path / "laws.png").exists()
    joined = open_dataset(tmp_path / "work_precision.nc", WORK_PRECISION)
    assert list(joined["family"].values) == ["laws"]
    assert joined.attrs["load"].startswith("laws: 1.5 processes before")


def test_a_family_that_does_not_exist_is_refused(command, tmp_path):
    status, _, told = command("bench", "macro", "-o", tmp_path)
    assert status == 1
    assert "there is no family 'macro'; choose from chain, damage" in told


@pytest.mark.slow
@pytest.mark.parametrize("scene", [BOUNCE, ROLL])
@pytest.mark.parametrize("compliance", COMPLIANCES.values())
def test_grains_follow_their_closed_forms_to_first_order_of_the_step(scene, compliance):
    errors = np.array([answer(scene, compliance, step) - EXACT[scene] for step in STEPS])
    order = np.log2(errors[:-1] / errors[1:])
    np.testing.assert_allclose(order, 1.0, atol=0.3)


LOAD = {"load_before": 1.5, "load_after": 0.25, "cores": 2}


def family_of(errors, times, converged=None):
    n = len(errors)
    return WORK_PRECISION.build(
        {
            "scene": ["wave"] * n,
            "method": [f"m{k}" for k in range(n)],
            "error": np.array(errors),
            "wall_time": np.array(times),
            "converged": np.array(converged or [1] * n),
        },
        cautions="",
        versions="one 1.0",
        title="waves",
        **LOAD,
    )


def test_the_cheapest_run_below_the_error_is_named():
    def scene(name):
        return "run", [name], {"units": "1", "long_name": "scene"}

    joined = join_families(
        {
            "one": family_of([0.5, 0.04, 0.03, 0.004], [1.0, 3.0, 2.0, 9.0]),
            "two": family_of([0.04], [0.1], converged=[0]).assign(scene=scene("other")),
            "three": family_of([np.nan], [0.1]).assign(scene=scene("without errors")),
        }
    )
    WORK_PRECISION.check(joined)
    assert list(joined["family"].values) == ["one"] * 4 + ["two", "three"]
    head, rows = tabulate_cheapest(joined)
    assert head == ("scene", "10 %", "5 %", "2 %", "1 %")
    assert rows[0] == ("wave", "m2, 2 s", "m2, 2 s", "m3, 9 s", "m3, 9 s")
    assert rows[1:] == [("other", *["none"] * 4)]


def test_an_error_below_the_uncertainty_of_the_reference_is_unknown():
    family = family_of([0.001, 0.001], [1.0, 2.0])
    family["error_uncertainty"] = ("run", [0.03, 0.03])
    _, rows = tabulate_cheapest(family)
    assert rows[0] == ("wave", "m0, 1 s", "m0, 1 s", "unknown", "unknown")
    assert [row[-1] for row in tabulate_runs(family)[1]] == ["< 3.0e-02"] * 2


def test_every_family_is_a_module_with_a_plan():
    from importlib import import_module

    for family in FAMILIES:
        assert callable(
            getattr(import_module(f"multiscale.bench.{family}_family"), f"plan_{family}")
        )


@pytest.mark.parametrize("scene", LIMIT_SCENES)
def test_a_kernel_is_told_beside_a_copy_of_its_bytes(scene, monkeypatch):
    monkeypatch.setattr(limit_family, "LEAST", 1e-3)
    ratio, time, moved, operations = limit_family.measure_limit(scene, 34)
    assert min(ratio, time, operations) > 0.0
    arrays = 1 if scene == "compliance of a flat cell" else 3 * limit_family.LAYERS
    precision = 4 if scene.endswith("single precision") else 8
    assert moved >= 2 * precision * 34 * 34 * arrays  # in and out
