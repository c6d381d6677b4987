"""The runner of families: processes, rows, judges, references, tables and the command."""

import os

import numpy as np
import pytest

from multiscale.bench.measure import (
    BenchFamily,
    extrapolate,
    judge,
    limit_of,
    measure,
    measure_family,
)
from multiscale.bench.rough_contact import common_reference
from multiscale.bench.summary import join_families, tabulate_cheapest, tabulate_runs
from multiscale.errors import CaseError
from multiscale.io import open_dataset
from multiscale.schema import WORK_PRECISION


def fill(megabytes):
    return float(np.ones(megabytes * 2**17).sum()), os.getpid()


def fill_small():
    return fill(1)


def fill_large():
    return fill(200)


def die():
    os._exit(1)


def test_each_measurement_has_times_and_memory_of_one_process():
    small, large = (measure(task, fill_small) for task in (fill_small, fill_large))
    assert small.value[0] == 2**17
    assert len({small.value[1], large.value[1], os.getpid()}) == 3
    assert min(small.wall_time, large.wall_time, large.cpu_time) > 0.0
    difference = (large.peak_memory - small.peak_memory) / 2**20
    assert 190.0 < difference < 215.0


def test_a_process_that_dies_has_no_answer_and_raises_nothing():
    lost = measure(die, fill_small)
    assert lost.value is None
    assert np.isnan(lost[1:]).all()


def measured(scenes, **options):
    return measure_family(BenchFamily("c", scenes), quick=True, **options)


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize(
    ("answer", "error", "time", "converged"),
    [(np.array([1.0, 3.0]), 0.5, 0.05, 1), (2.0, 0.0, 0.1, 1), (np.nan, np.nan, 0.1, 0)],
)
def test_the_error_of_samples_is_their_root_mean_square_and_their_time_is_of_one_run(
    answer, error, time, converged
):
    def scenes(run, quick):
        yield judge([run("a", "b", lambda: answer, points=4)], 2.0, 0.5)

    run = measured(scenes).isel(run=0)
    np.testing.assert_equal(float(run["error"]), error)
    assert (run["wall_time"], run["cpu_time"]) == (time, 2.0 * time)
    assert (run["points"], run["error_uncertainty"], run["converged"]) == (4, 0.5, converged)


@pytest.mark.usefixtures("in_this_process")
def test_a_family_that_is_killed_leaves_its_finished_scenes():
    def scenes(run, quick):
        for scene, answer in {"a": 2.0, "b": 3.0}.items():
            yield judge([run(scene, "d", float, answer, warm=(answer,))], 2.0, 0.5)
        raise KeyboardInterrupt

    stored = []
    with pytest.raises(KeyboardInterrupt):
        measured(scenes, keep=stored.append)
    assert [list(item["scene"].values) for item in stored] == [["a"], ["a", "b"]]
    np.testing.assert_array_equal(stored[-1]["error"], [0.0, 0.5])


@pytest.mark.usefixtures("in_this_process")
def test_rows_without_a_variable_stay_empty_and_methods_that_are_left_out_are_named_once():
    def scenes(run, quick):
        run.leave_out("d", "because it is not installed")
        run.leave_out("d", "because it is not installed")
        rows = [run("a", name, float, 2.0, warm=(1.0,)) for name in "bc"]
        rows[1] |= {"error": 4.0, "converged": 1, "history": np.full((2, 2), 2.0)}
        yield rows

    quantity = measured(scenes)
    np.testing.assert_array_equal(quantity["error"], [np.nan, 4.0])
    np.testing.assert_array_equal(quantity["converged"], [0, 1])
    np.testing.assert_array_equal(quantity["history_run"], [1, 1])
    assert quantity.attrs["cautions"] == "d is left out because it is not installed"


@pytest.mark.parametrize("order", [1.0, 1.5, 2.0])
def test_the_limit_of_a_power_of_the_spacing_is_exact(order):
    spacing = 0.5 ** np.arange(4.0)
    assert extrapolate(3.0 - 0.7 * spacing**order) == pytest.approx(3.0, rel=1e-12)
    assert extrapolate(3.0 - 0.7 * spacing**order, order=order) == pytest.approx(3.0, rel=1e-12)


@pytest.mark.parametrize(
    ("values", "limit"),
    [
        ([0.0, 0.5, 0.99], 0.99 + 0.49),  # the order is at least 1
        ([0.0, 0.9, 0.93], 0.93 + 0.03 / 3.0),  # and at most two
        ([1.0, 0.9, 0.93], 0.93 + 0.03 / 3.0),
        ([1.0, 0.5, 0.5], 0.5),
        ([1.0, 2.0, np.nan], np.nan),
    ],
)
def test_the_observed_order_is_limited_to_the_range_from_1_to_2(values, limit):
    assert extrapolate(np.array(values)) == pytest.approx(limit, nan_ok=True)


def test_the_distance_of_the_finest_grid_is_relative_to_the_limit():
    limit, distance = limit_of([{"value": 8.0 - 4.0 * 0.5**level} for level in range(4)])
    assert limit == pytest.approx(8.0)
    assert distance == pytest.approx(0.5 / 8.0)


def test_a_code_without_a_limit_is_not_a_reference():
    reference = common_reference(np.array([np.nan, 2.0]), np.array([np.nan, 2.1]))
    np.testing.assert_array_equal(reference, [2.0, np.nan])
    assert np.isnan(common_reference(np.array([np.nan]), np.array([np.nan]))).all()


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
        load_before=1.5,
        load_after=0.25,
        cores=2,
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


def test_a_family_that_fails_does_not_take_the_others_with_it(command, tmp_path, monkeypatch):
    def fail(name, **_):
        if name != "laws":
            raise CaseError("no points") if name == "chain" else ValueError("no grains")
        return family_of([0.04], [1.0])

    monkeypatch.setattr("multiscale.bench.commands.bench", fail)
    status, output, printed = command("bench", "chain", "grains", "laws", "-o", tmp_path)
    assert status == 1
    assert "the family chain failed: no points" in printed
    assert "ValueError: no grains" in printed
    assert printed.endswith("2 of 3 families failed: chain, grains\n")
    assert "load of the machine: 1.5 processes before and 0.25 after, on 2 cores" in output
    assert (tmp_path / "laws.png").exists()
    joined = open_dataset(tmp_path / "work_precision.nc", WORK_PRECISION)
    assert list(joined["family"].values) == ["laws"]
    assert joined.attrs["load"].startswith("laws: 1.5 processes before")
