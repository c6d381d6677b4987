"""Ensembles: one file per cell, resumable, any executor, the same numbers."""

import os
import signal
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import xarray as xr

from multiscale.errors import CaseError, MultiscaleError
from multiscale.executors import process_pool, run_jobs
from multiscale.micro import Cell, Path, run_ensemble, self_affine
from multiscale.micro import ensemble as module
from multiscale.micro.topography import rms_slope
from multiscale.schema import MICRO_RESPONSE

PATH = Path(pressure=(0.001, 0.01))


@pytest.fixture(scope="module")
def cells():
    return [
        Cell(
            self_affine(
                (16, 16),
                (1.0, 1.0),
                seed,
                hurst_exponent=0.8,
                long_cutoff=1.0,
                short_cutoff=0.5,
                rms_slope=0.1,
            ),
            1.0,
            6,
            1.0,
            0.3,
        )
        for seed in range(3)
    ]


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
    solve = module.solve_cell
    monkeypatch.setattr(
        module,
        "solve_cell",
        lambda cell, *args, **kw: solved.append(cell) or solve(cell, *args, **kw),
    )
    second = run_ensemble(cells, PATH, folder=tmp_path, identity="a", progress=counts.append)
    assert solved == [cells[1], cells[2]]
    assert counts == [1, 2, 3]
    same(first, second)


def test_realisations_of_another_case_are_refused_and_kept(cells, tmp_path):
    run_ensemble(cells, PATH, folder=tmp_path, identity="a")
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    with pytest.raises(CaseError, match="was computed for another case; choose another folder"):
        run_ensemble(cells, PATH, folder=tmp_path, identity="b")
    assert before == {file: file.read_bytes() for file in tmp_path.iterdir()}


def test_local_fields_are_kept_for_the_first_realisation_only(cells, tmp_path):
    response = run_ensemble(cells, PATH, folder=tmp_path, keep_fields=True)
    assert "pressure" not in response
    with xr.open_dataset(tmp_path / "realisation-0000.nc", engine="h5netcdf") as first:
        assert first["pressure"].mean().item() == pytest.approx(0.0055)
        assert first["gap"].min().item() == pytest.approx(0.0, abs=1e-12)
    with xr.open_dataset(tmp_path / "realisation-0001.nc", engine="h5netcdf") as second:
        assert "pressure" not in second


def _die(*_):
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_killed_worker_is_one_sentence():
    jobs = dict.fromkeys(range(3), ())
    with (
        process_pool(1) as executor,
        pytest.raises(MultiscaleError, match="a worker process died after 0 of 3 jobs"),
    ):
        run_jobs(_die, jobs, executor, lambda key, result: None)
