"""Kernels are compiled once, whatever the number of processes."""

import importlib
import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

import multiscale
from multiscale.errors import MultiscaleError
from multiscale.numerics.compiled import NEWEST_TRIED, compiled, prange
from tests.support import run_python

PROGRAM = """
import sys, time
from pathlib import Path
from kernel import kernel

folder, name = Path(sys.argv[1]), sys.argv[2]
(folder / name).touch()
while len(list(folder.glob("ready*"))) < 2:
    time.sleep(0.001)
kernel(1.0)
print(sum(kernel.stats.cache_misses.values()), sum(kernel.stats.cache_hits.values()))
"""


def test_of_two_processes_one_compiles_a_kernel_and_the_other_loads_it(tmp_path):
    root = Path(multiscale.__file__).parents[1]
    (tmp_path / "kernel.py").write_text(
        "from multiscale.numerics.compiled import compiled\n"
        "@compiled(fastmath={'contract', 'reassoc', 'nnan', 'nsz'})\n"
        "def kernel(x):\n"
        "    return x * x + 1.0\n"
    )
    own = os.environ | {
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        "PYTHONPATH": os.pathsep.join([str(root), str(tmp_path)]),
    }
    both = [
        subprocess.Popen(
            [sys.executable, "-c", PROGRAM, str(tmp_path), f"ready{k}"],
            env=own | {"PYTHONHASHSEED": str(k)},  # sets in another order
            stdout=subprocess.PIPE,
            text=True,
        )
        for k in range(2)
    ]
    assert sorted(process.communicate(timeout=300)[0].split() for process in both) == [
        ["0", "1"],
        ["1", "0"],
    ]


def test_a_kernel_is_compiled_anew_when_a_callee_or_a_constant_in_another_file_changes(
    tmp_path, monkeypatch
):
    (tmp_path / "caller.py").write_text(
        "from multiscale.numerics.compiled import compiled\n"
        "from callee import FACTOR, square\n"
        "@compiled\n"
        "def caller(x):\n"
        "    return FACTOR * square(x)\n"
    )
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.syspath_prepend(tmp_path)

    def answer(factor: str, body: str) -> tuple[float, int]:
        (tmp_path / "callee.py").write_text(
            "from multiscale.numerics.compiled import compiled\n"
            f"FACTOR = {factor}\n"
            "@compiled\n"
            "def square(x):\n"
            f"    return {body}\n"
        )
        for name in ("caller", "callee"):
            sys.modules.pop(name, None)
        caller = importlib.import_module("caller").caller
        return caller(3.0), sum(caller.stats.cache_hits.values())

    assert answer("2.0", "x * x") == (18.0, 0)
    assert answer("2.0", "x * x  # a remark changes nothing") == (18.0, 1)
    assert answer("2.0", "x + x") == (12.0, 0)
    assert answer("5.0", "x + x") == (30.0, 0)


def test_a_cache_that_cannot_be_written_to_is_refused_with_the_setting_that_helps(monkeypatch):
    from numba.core.caching import CacheImpl

    @compiled
    def kernel(x):
        return x

    monkeypatch.setattr(CacheImpl, "_locator_classes", [])
    with pytest.raises(MultiscaleError, match=r"cannot be kept.*set NUMBA_CACHE_DIR"):
        kernel(1.0)


@pytest.mark.skipif(numba.version_info.short > NEWEST_TRIED, reason="numba is newer than tried")
def test_a_parallel_loop_is_translated_as_a_part_of_its_kernel_alone(tmp_path, monkeypatch):
    from numba.core.codegen import JITCPUCodegen

    @compiled(parallel=True)
    def kernel(x):
        total = 0.0
        for k in prange(len(x)):
            total += x[k]
        return total

    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path))
    names, add = [], JITCPUCodegen._add_module

    def note(codegen, module):
        names.append(module.name)
        add(codegen, module)

    monkeypatch.setattr(JITCPUCodegen, "_add_module", note)
    assert kernel(np.arange(4.0)) == 6.0
    assert [name for name in names if "kernel" in name or "gufunc" in name] == [kernel.__qualname__]


def test_universal_functions_of_others_are_translated_as_ever():
    """In a process of their own: one that is not translated ends the process when it is called."""
    program = """
        import numba, numpy as np
        from multiscale.numerics.compiled import thread_count

        thread_count()  # brings numba

        @numba.guvectorize(["void(float64[:], float64[:])"], "(n)->(n)", target="{}")
        def double(x, out):
            for k in range(x.size):
                out[k] = 2.0 * x[k]

        print(double(np.arange(3.0)))
    """
    for target in ("cpu", "parallel"):
        assert "[0. 2. 4.]" in run_python(program.format(target)).stdout


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


def test_a_kept_kernel_is_loaded_without_the_tables_of_the_compiler(tmp_path):
    (tmp_path / "kernel.py").write_text(
        "import numpy as np\n"
        "from multiscale.numerics.compiled import NEWEST_TRIED, compiled, prange\n"
        "@compiled(parallel=True)\n"
        "def kernel(x):\n"
        "    y = np.empty(x.size)\n"
        "    for k in prange(x.size):\n"
        "        y[k] = max(np.exp(x[k]), x[k] ** 2, 2.0)\n"
        "    return y\n"
    )
    root = Path(multiscale.__file__).parents[1]
    own = {
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        "PYTHONPATH": os.pathsep.join([str(root), str(tmp_path)]),
    }
    program = (
        "import sys, numpy\n"
        "from kernel import kernel\n"
        "print(kernel(numpy.array([0.0, 1.0])), 'numba.np.linalg' in sys.modules)\n"
    )
    told = [run_python(program, env=os.environ | own).stdout for _ in range(2)]
    assert told == [f"[2.         2.71828183] {compiles}\n" for compiles in (True, False)]
