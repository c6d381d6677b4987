"""Kernels are compiled once, whatever the number of processes."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import multiscale

PROGRAM = """
import sys, time
from pathlib import Path
import numpy as np
from multiscale.macro.mean_tension import mean_tension as kernel

folder, name = Path(sys.argv[1]), sys.argv[2]
(folder / name).touch()
while len(list(folder.glob("ready*"))) < 2:
    time.sleep(0.001)
kernel(*np.ones((4, 3)), 0.5)
print(sum(kernel.stats.cache_misses.values()), sum(kernel.stats.cache_hits.values()))
"""


def test_of_two_processes_one_compiles_a_kernel_and_the_other_loads_it(tmp_path):
    root = Path(multiscale.__file__).parents[1]
    own = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(root)}
    both = [
        subprocess.Popen(
            [sys.executable, "-c", PROGRAM, str(tmp_path), f"ready{k}"],
            env=own,
            stdout=subprocess.PIPE,
            text=True,
        )
        for k in range(2)
    ]
    assert sorted(process.communicate(timeout=300)[0].split() for process in both) == [
        ["0", "1"],
        ["1", "0"],
    ]


@pytest.mark.parametrize(
    ("given", "taken"),
    [
        ({"OMP_NUM_THREADS": "1"}, "1"),
        ({"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "2"}, "2"),
    ],
)
def test_kernels_take_the_threads_that_the_user_leaves_to_them(given, taken):
    others = {name: one for name, one in os.environ.items() if "NUM_THREADS" not in name}
    own = others | given | {"PYTHONPATH": str(Path(multiscale.__file__).parents[1])}
    program = "from multiscale.numerics.compiled import thread_count; print(thread_count())"
    told = subprocess.run(
        [sys.executable, "-c", program], env=own, capture_output=True, text=True, check=True
    )
    assert told.stdout.strip() == taken
