"""Shared fixtures and checks of the tests of families."""

import pytest

from multiscale.bench import measure as measured
from multiscale.bench.measure import Measurement
from multiscale.io import open_dataset, write_dataset
from multiscale.plotting import draw_work_precision
from multiscale.schema import WORK_PRECISION


@pytest.fixture
def in_this_process(monkeypatch):
    """Skip the processes."""
    monkeypatch.setattr(
        measured, "measure", lambda task, *_, **__: Measurement(task(), 0.1, 0.2, 1e8)
    )


@pytest.fixture
def stored(tmp_path):
    """Write a dataset, draw the dataset that is read again, and return it."""

    def store(result, least_bytes):
        write_dataset(result, tmp_path / "result.nc", WORK_PRECISION)
        again = open_dataset(tmp_path / "result.nc", WORK_PRECISION)
        picture = draw_work_precision(again, tmp_path / "result.png")
        assert picture.stat().st_size > least_bytes
        return again

    return store
