"""Ensembles: one file per cell, resumable, any executor, the same numbers."""

import os
import signal
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from threading import Event

import numpy as np
import pytest
import xarray as xr

from multiscale import executors
from multiscale.convergence import Status
from multiscale.errors import CaseError, MultiscaleError, SchemaError
from multiscale.executors import process_pool, run_jobs, thread_count
from multiscale.micro import Cell, FlatCell, GraphCell, Path, run_ensemble
from multiscale.micro import cell as steps_module
from multiscale.micro import ensemble as module
from multiscale.micro.cell import Checkpoint
from multiscale.micro.elastic import active_set
from multiscale.micro.path import ContactState
from multiscale.schema import MICRO_RESPONSE, PlainDataset
from multiscale.surfaces import rms_slope
from tests.support import rough_square

PATH = Path(pressure=(0.001, 0.01))


@pytest.fixture(scope="module")
def cells():
    return [Cell(rough_square(16, 1.0, 0.5, 0.1, seed=seed), 1.0, 6, 1.0, 0.3) for seed in range(3)]


def same(first, second):
    timed = ["wall_time"]
    xr.testing.assert_allclose(first.drop_vars(timed), second.drop_vars(timed), rtol=1e-10)


def test_realisations_are_joined_with_labels_units_and_statistics(cells):
    response = run_ensemble(cells, PATH)
    MICRO_RESPONSE.check(response)
    assert list(response["realisation"].values) == [0, 1, 2]
    np.testing.assert_allclose(
        response["rms_slope"].values, [rms_slope(cell.surface) for cell in cells]
    )
    assert np.ptp(response["mean_gap"].values[:, 0]) > 0.0


def test_missing_values_are_nan_and_common_values_are_stored_once():
    first = PlainDataset({"mean_gap": np.ones((2, 3)), "branch": np.zeros(3, int)})
    second = PlainDataset({"mean_gap": np.ones((1, 3)), "slip_fraction": np.full((1, 3), 0.5)})
    joined = MICRO_RESPONSE.join([first, second], "realisation").values
    assert joined["mean_gap"].shape == (3, 3)
    assert joined["branch"].shape == (3,)
    np.testing.assert_array_equal(joined["slip_fraction"][:, 0], [np.nan, np.nan, 0.5])
    longer = PlainDataset({"mean_gap": np.ones((1, 4))})
    with pytest.raises(ValueError, match="dimension"):
        MICRO_RESPONSE.join([first, longer], "realisation")


@pytest.mark.parametrize("pressures", [(0.002, 0.02), (0.001, 0.01, 0.02)])
def test_realisations_of_another_path_in_the_folder_are_not_joined(cells, tmp_path, pressures):
    run_ensemble(cells[:1], PATH, folder=tmp_path)
    with pytest.raises(SchemaError, match=r"(branch|nominal_pressure) is not the same in all"):
        run_ensemble(cells[:2], Path(pressure=pressures), folder=tmp_path)


@pytest.mark.slow
def test_executors_give_the_same_response(cells, tmp_path):
    serial = run_ensemble(cells, PATH)
    with ThreadPoolExecutor(1) as executor:
        same(serial, run_ensemble(cells, PATH, executor=executor))
    with process_pool(2) as executor:
        same(serial, run_ensemble(cells, PATH, executor=executor, folder=tmp_path))
    assert len(list(tmp_path.glob("realisation-*.nc"))) == 3


def test_finished_realisations_are_not_computed_again(cells, tmp_path, monkeypatch):
    counts = []
    first = run_ensemble(cells, PATH, folder=tmp_path, identity="a")
    (tmp_path / "realisation-0001.nc").unlink()
    damaged = tmp_path / "realisation-0002.nc"
    damaged.write_bytes(damaged.read_bytes()[:1000])
    solved = []
    solve = module.record_cell
    monkeypatch.setattr(
        module,
        "record_cell",
        lambda cell, *args, **kw: solved.append(cell) or solve(cell, *args, **kw),
    )
    second = run_ensemble(cells, PATH, folder=tmp_path, identity="a", progress=counts.append)
    assert solved == [cells[1], cells[2]]
    assert counts == [1, 2, 3]
    same(first, second)


def test_realisations_of_another_case_are_refused_and_not_removed(cells, tmp_path):
    run_ensemble(cells, PATH, folder=tmp_path, identity="a")
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    with pytest.raises(CaseError, match="was computed for another case; choose another folder"):
        run_ensemble(cells, PATH, folder=tmp_path, identity="b")
    assert before == {file: file.read_bytes() for file in tmp_path.iterdir()}


def test_local_fields_are_stored_for_the_first_realisation_only(cells, tmp_path):
    response = run_ensemble(cells, PATH, folder=tmp_path, keep_fields=True)
    assert "pressure" not in response
    with xr.open_dataset(tmp_path / "realisation-0000.nc", engine="h5netcdf") as first:
        assert first["pressure"].mean().item() == pytest.approx(0.0055)
        assert first["gap"].min().item() == pytest.approx(0.0, abs=1e-12)
    with xr.open_dataset(tmp_path / "realisation-0001.nc", engine="h5netcdf") as second:
        assert "pressure" not in second


def test_jobs_are_taken_as_others_finish_and_a_slow_one_delays_none(monkeypatch):
    monkeypatch.setattr(executors, "IN_FLIGHT", 4)
    taken, finished, slow = [], [], Event()

    def jobs():
        for k in range(20):
            taken.append(k)
            yield k, (slow.wait if k == 0 else bool,)

    def finish(key, result):
        finished.append(key)
        assert len(taken) - len(finished) < 4
        if len(finished) == 19:
            slow.set()

    with ThreadPoolExecutor(2) as executor:
        run_jobs(call, jobs(), executor, finish)
    assert finished[-1] == 0
    assert sorted(finished) == taken == list(range(20))


def call(function):
    return function()


def _threads():
    return thread_count()


@pytest.mark.slow
@pytest.mark.parametrize(("setting", "expected"), [(None, 1), ("2", 2)])
def test_workers_of_others_have_one_thread_unless_their_user_set_a_number(
    setting, expected, monkeypatch
):
    if setting is None:
        monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    else:
        monkeypatch.setenv("OMP_NUM_THREADS", setting)
    results = []
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        run_jobs(_threads, [(0, ())], executor, lambda key, threads: results.append(threads))
    assert results == [expected]


def _die(*_):
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_killed_worker_is_one_sentence():
    jobs = [(k, ()) for k in range(3)]
    with (
        process_pool(1) as executor,
        pytest.raises(MultiscaleError, match="a worker process died after 0 finished jobs"),
    ):
        run_jobs(_die, jobs, executor, lambda key, result: None)


@pytest.mark.parametrize("geometry", ["flat", "conforming"])
def test_a_realisation_that_is_killed_goes_on_after_its_last_step(
    cells, geometry, tmp_path, monkeypatch
):
    path = Path(pressure=(0.001, 0.002, 0.004, 0.008))
    flat = cells[0]
    kind = {"flat": FlatCell, "conforming": GraphCell}[geometry]
    first = [kind(flat.surface, flat.depth, flat.layers, flat.law)]
    whole = run_ensemble(first, path)
    monkeypatch.setattr(steps_module, "WORTH", 0.0)
    average, solved = steps_module.average_surface, []

    def killed(surface, *kept):
        if len(solved) == 3:
            raise KeyboardInterrupt
        solved.append(surface)
        return average(surface, *kept)

    monkeypatch.setattr(steps_module, "average_surface", killed)
    with pytest.raises(KeyboardInterrupt):
        run_ensemble(first, path, folder=tmp_path, identity="a")
    monkeypatch.setattr(
        steps_module,
        "average_surface",
        lambda *given: solved.append(0) or average(*given),
    )
    timed = ["wall_time"]
    other = run_ensemble(first, path, folder=tmp_path / "other", identity="b")
    assert len(solved) == 3 + 4
    response = run_ensemble(first, path, folder=tmp_path, identity="a")
    assert len(solved) == 3 + 4 + 1
    for answer in (response, other):
        xr.testing.assert_identical(answer.drop_vars(timed), whole.drop_vars(timed))
    assert [file.name for file in tmp_path.iterdir() if file.is_file()] == ["realisation-0000.nc"]


@pytest.mark.parametrize("content", [b"", b"PK no archive", None])
def test_steps_of_another_case_or_a_damaged_file_are_not_taken(content, tmp_path, monkeypatch):
    monkeypatch.setattr(steps_module, "WORTH", 0.0)
    stored = Checkpoint(tmp_path / "steps.npz", "a")
    state = ContactState(np.ones(3), np.ones(2), 1.0, np.array([True, False]), np.zeros(2))
    stored.write([{"wall_time": 1.0, "ended": "step 0"}], state)
    rest = replace(state, displacement=np.zeros(3), force=np.zeros(2))
    steps, computed = stored.read(rest)
    assert steps == [{"wall_time": 1.0, "ended": "step 0"}]
    np.testing.assert_array_equal(computed.displacement, np.ones(3))
    assert computed.status is Status.CONVERGED
    steps, computed = stored.read(replace(rest, displacement=np.zeros(4)))
    assert (steps, computed.displacement.size) == ([], 4)
    if content is not None:
        stored.file.write_bytes(content)
    steps, computed = replace(stored, identity="b").read(rest)
    assert not steps
    assert computed is rest


def test_a_realisation_reports_why_it_lacks_steps(cells, tmp_path, monkeypatch):
    monkeypatch.setattr(active_set, "_LINEAR_LIMIT", 1)
    response = run_ensemble(cells[:2], PATH)
    assert not response["converged"].values.any()
    lines = response.attrs["ended"].splitlines()
    assert [line[:33] for line in lines] == [f"realisation {k}: step 0 ended after" for k in (0, 1)]
