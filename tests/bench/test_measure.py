"""Measurements in processes of their own."""

import os
from functools import partial

import numpy as np

from multiscale.bench.measure import measure


def fill(megabytes):
    return float(np.ones(megabytes * 2**17).sum()), os.getpid()


def die():
    os._exit(1)


def test_each_measurement_has_its_own_process_and_memory():
    small, large = (
        measure(partial(fill, n), warm_up=partial(fill, 1), repeats=1) for n in (1, 200)
    )
    assert small.value[0] == 2**17
    assert len({small.value[1], large.value[1], os.getpid()}) == 3
    assert min(small.wall_time, large.wall_time) > 0.0
    difference = (large.peak_memory - small.peak_memory) / 2**20
    assert 190.0 < difference < 215.0


def test_a_process_that_dies_is_told_and_not_raised():
    lost = measure(die, warm_up=partial(fill, 1))
    assert lost.value is None
    assert np.isnan(lost.wall_time)
    assert np.isnan(lost.peak_memory)
