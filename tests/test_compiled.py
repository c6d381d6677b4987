"""Kernels are compiled once, whatever the number of processes, and run on threads of Python."""

import os
import signal
import subprocess
import sys
import time
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

import multiscale
from multiscale.executors import cores, run_ranges, thread_count, threads
from multiscale.numerics.compiled import compiled
from tests.support import run_python

KERNEL = """
from multiscale.numerics.compiled import compiled

@compiled(fastmath={'contract', 'reassoc', 'nnan', 'nsz'})
def kernel(x):
    return x * x + 1.0
"""

PROGRAM = """
import sys, time
from pathlib import Path
from kernel import kernel

folder, name = Path(sys.argv[1]), sys.argv[2]
(folder / name).touch()
while len(list(folder.glob("ready*"))) < 2:
    time.sleep(0.001)
print(kernel(2.0), sum(kernel.stats.cache_misses.values()), sum(kernel.stats.cache_hits.values()))
"""


@pytest.fixture
def environment(tmp_path):
    """Settings of processes that find the module ``kernel`` and share an empty cache."""
    (tmp_path / "kernel.py").write_text(KERNEL)
    root = Path(multiscale.__file__).parents[1]
    return os.environ | {
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        "PYTHONPATH": os.pathsep.join([str(root), str(tmp_path)]),
    }


def test_of_two_processes_one_compiles_a_kernel_and_the_other_loads_it(tmp_path, environment):
    both = [
        subprocess.Popen(
            [sys.executable, "-c", PROGRAM, str(tmp_path), f"ready{k}"],
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        for k in range(2)
    ]
    assert sorted(process.communicate(timeout=300)[0].split() for process in both) == [
        ["5.0", "0", "1"],
        ["5.0", "1", "0"],
    ]


@pytest.mark.slow
def test_a_kernel_that_was_killed_while_it_compiled_is_compiled_by_the_next(tmp_path, environment):
    program = """
        from pathlib import Path
        from numba.extending import overload
        from kernel import compiled

        def stop():
            pass

        @overload(stop)
        def _stop():
            Path("compiling").touch()
            import time; time.sleep({})
            return lambda: 1

        @compiled
        def slow():
            return stop()

        print(slow())
    """
    script = tmp_path / "slow.py"
    script.write_text("\n".join(line[8:] for line in program.format(60).splitlines()))
    first = subprocess.Popen([sys.executable, script], env=environment, cwd=tmp_path)
    while not (tmp_path / "compiling").exists():
        time.sleep(0.01)
    first.kill()
    assert first.wait() == -signal.SIGKILL
    script.write_text(script.read_text().replace("sleep(60)", "sleep(0)"))
    second = subprocess.run(
        [sys.executable, script], env=environment, cwd=tmp_path, capture_output=True, text=True
    )
    assert second.stdout == "1\n"


@pytest.mark.slow
def test_a_cache_that_names_a_class_which_has_gone_is_written_anew(tmp_path, environment):
    text = """
        from typing import NamedTuple
        from multiscale.numerics.compiled import compiled

        class {0}(NamedTuple):
            x: float

        value = {0}
    """
    program = "import values; from kernel import kernel; print(kernel(values.value(2.0)))"
    (tmp_path / "kernel.py").write_text(KERNEL.replace("x * x", "x.x * x.x"))
    for name in ("Pair", "Couple"):
        lines = text.format(name).splitlines()
        (tmp_path / "values.py").write_text("\n".join(line[8:] for line in lines))
        assert run_python(program, env=environment).stdout == "5.0\n"


def test_without_a_folder_that_can_be_written_to_kernels_are_compiled_by_each_process(
    tmp_path, environment
):
    (tmp_path / "file").touch()
    nowhere = environment | {
        "NUMBA_CACHE_DIR": str(tmp_path / "file" / "cache"),
        "HOME": str(tmp_path / "file"),
        "XDG_CACHE_HOME": str(tmp_path / "file"),
        "NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator",
    }
    program = "from kernel import kernel; print(kernel(3.0), kernel.stats.cache_path)"
    assert run_python(program, env=nowhere).stdout == "10.0 None\n"


@compiled
def _double(begin, end, x):
    for k in range(begin, end):
        x[k] *= 2.0


def _doubled():
    x = np.arange(1000.0)
    run_ranges(_double, x.size, x)
    return np.array_equal(x, 2.0 * np.arange(1000.0))


@pytest.mark.parametrize("count", [1, 2, 64])
def test_threads_share_the_items(count):
    with threads(count):
        assert thread_count() == count
        assert _doubled()


def test_few_items_are_left_to_one_thread():
    bounds = []
    with threads(4):
        run_ranges(lambda begin, end: bounds.append((begin, end)), 10, least=4)
        run_ranges(lambda begin, end: bounds.append((begin, end)), 0)
    assert sorted(bounds) == [(0, 0), (0, 5), (5, 10)]


def _call(send):
    with threads(2):
        send.send(_doubled())


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs forks of a process")
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_forked_process_makes_new_threads():
    with threads(2):
        assert _doubled()
    receive, send = get_context("fork").Pipe(duplex=False)
    process = get_context("fork").Process(target=_call, args=(send,))
    process.start()
    assert receive.poll(60)
    assert receive.recv()
    process.join()


@pytest.mark.parametrize(
    ("setting", "expected"),
    [("1", 1), ("64", cores()), ("1,2", 1), ("all", cores()), ("0", 1), (None, cores())],
)
def test_kernels_take_the_threads_that_the_user_leaves_to_them(setting, expected, monkeypatch):
    if setting is None:
        monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    else:
        monkeypatch.setenv("OMP_NUM_THREADS", setting)
    assert thread_count() == expected
