"""A run killed at any moment repeats at most the cells in flight, and ends with the same data."""

import json
import logging
import os
import signal
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from time import sleep

import numpy as np
import pytest
import xarray as xr
from matplotlib.image import imread

from multiscale import executors
from multiscale.errors import MultiscaleError
from multiscale.executors import threads
from multiscale.io import open_dataset
from multiscale.pipeline import load_sweep, run_sweep
from tests.support import COMMAND, small_steel

pytestmark = pytest.mark.skipif(
    not Path("/proc/self").exists(), reason="looks for processes in /proc"
)

CASE = small_steel(12, "\n[law]\nsamples = 4\n").replace(
    '["5 MPa", "10 MPa", "20 MPa", "40 MPa", "80 MPa", "160 MPa"]', '["10 MPa"]'
)
SWEEP = CASE.replace("realisations = 12", "realisations = 3") + (
    '[sweep]\nbody_1.youngs_modulus = ["70 GPa", "210 GPa"]\n'
)
SINGLE = CASE.replace("realisations = 12", "realisations = 8")

ONE_THREAD = dict(os.environ, OMP_NUM_THREADS="1")
KILLS_OF_ONE = 4
"""Times that a run is killed before it may end, all but the first while it goes on."""
TIMED = ("wall_time",)
"""Variables that differ from run to run."""
DATED = ("history",)
"""Attributes that do: the time of writing and the command."""


def begin(folder, *arguments):
    """Start the command in a separate group."""
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND, *arguments],
        cwd=folder,
        env=ONE_THREAD,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def finish(folder, *more):
    """Run the case of a folder to its end."""
    output = begin(folder, "run", "case.toml", "-o", "out", "--jobs", "1", *more)
    errors = output.communicate()[1]
    assert output.returncode == 0, errors


def with_case(folder, text=SWEEP):
    """Create a folder with a case."""
    folder.mkdir(exist_ok=True)
    (folder / "case.toml").write_text(text, encoding="utf-8")
    return folder


def workers_of(parent):
    """Children of a process, without the process that tracks resources."""
    results = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            stat, line = (folder / "stat").read_text(), (folder / "cmdline").read_bytes()
        except OSError:  # it has just ended
            continue
        if int(stat.rpartition(")")[2].split()[1]) == parent and b"resource_tracker" not in line:
            results.append(int(folder.name))
    return results


def kill(group, what, rng):
    """Kill a group, or one worker in it; whether there was any."""
    try:
        if what == "run":
            os.killpg(group, signal.SIGKILL)
            return True
        workers = workers_of(group)
        if workers:
            os.kill(workers[rng.integers(len(workers))], signal.SIGKILL)
        return bool(workers)
    except ProcessLookupError:
        return False


def files(out):
    """Files under their final names."""
    return [file for file in out.rglob("*") if file.is_file() and not file.name.startswith(".")]


def wait_for(count, out, process):
    """Poll until a run has left so many files; a random number is a moment on any machine."""
    while len(files(out)) < count and process.poll() is None:
        sleep(0.002)


def check_whole(out):
    """Every file under a final name is whole."""
    for file in files(out):
        if file.parent.name == "points":  # answers of a point
            xr.load_dataset(file, engine="scipy")
        elif file.suffix == ".nc":
            open_dataset(file)
        elif file.suffix in (".vtu", ".pvd"):
            ET.parse(file)
        elif file.suffix == ".png":
            imread(file)
        elif file.suffix == ".html":
            assert file.read_text(encoding="utf-8").rstrip().endswith("</html>")
        elif file.parent.name == "exports":  # compared with those of the reference at the end
            assert file.read_text(encoding="utf-8").endswith("\n")
        else:
            assert file.name in ("case.toml", "log.txt"), file


def cells(out):
    """Finished cells of the response, and when they were written."""
    return {file: file.stat().st_mtime_ns for file in out.rglob("micro/realisation-*.nc")}


def contents(out):
    """Everything that a run leaves in datasets, without times."""
    results = {}
    for file in sorted(out.rglob("*.nc")):
        if file.parent.name == "points":  # answers of a point, which the sweep has
            continue
        dataset = open_dataset(file).drop_vars(TIMED, errors="ignore")
        for name in DATED:
            del dataset.attrs[name]
        results[str(file.relative_to(out))] = dataset
    return results


def exports(out):
    """Return laws and meshes for other codes, by their names."""
    return {
        str(file.relative_to(out)): file.read_text(encoding="utf-8")
        for file in out.rglob("exports/*")
    }


def assert_identical(out, reference):
    files = contents(out)
    assert list(files) == list(reference)
    for name, dataset in reference.items():
        for attributes in (files[name].attrs, dataset.attrs):
            attributes.pop("seconds", None)  # the time of a stage
        xr.testing.assert_identical(files[name], dataset)


def begun(out):
    return ["--resume"] if (out / "log.txt").exists() else []


def go_on(folder, stored):
    """End a run; stored results are not computed again."""
    out = folder / "out"
    finish(folder, *begun(out))
    after = cells(out)
    assert {file: after[file] for file in stored} == stored


def check_after_kill(out, what, status, sentence):
    """Conditions after a kill, before anything goes on; gives the finished cells."""
    assert "Traceback" not in sentence, sentence
    if what == "run":
        assert status == -signal.SIGKILL
    else:
        assert status == 1
        assert sentence.count("multiscale: a worker process died after") == 1, sentence
    check_whole(out)
    return cells(out)


@pytest.mark.long
@pytest.mark.parametrize(
    ("text", "count"), [pytest.param(SWEEP, 6, id="sweep"), pytest.param(SINGLE, 8, id="run")]
)
def test_a_run_killed_at_20_random_moments_ends_with_the_same_datasets(tmp_path, text, count):
    rng = np.random.default_rng(seed=5)
    reference = with_case(tmp_path / "reference", text)
    finish(reference)
    total, expected = len(files(reference / "out")), contents(reference / "out")
    assert len(cells(reference / "out")) == count

    kills, runs, lost = {"run": 0, "worker": 0}, 0, []
    while sum(kills.values()) < 20:
        runs += 1
        assert runs <= 50, kills
        folder = with_case(tmp_path / str(runs), text)
        stored, out = {}, folder / "out"
        for _ in range(KILLS_OF_ONE):
            done = len(files(out))
            if done == total:
                break
            early = done < count and rng.random() < 0.8  # while there are workers
            what = ("run", "worker", "worker")[rng.integers(3)] if early else "run"
            process = begin(folder, "run", "case.toml", "-o", "out", "--jobs", "2", *begun(out))
            wait_for(rng.integers(done, count if early else total), out, process)
            sleep(rng.uniform(0.0, 0.2))
            hit = kill(process.pid, what, rng)
            output = process.communicate()[1]
            if not hit or process.returncode == 0:  # it had ended, or did not need the worker
                break
            kills[what] += 1
            outcome = check_after_kill(out, what, process.returncode, output)
            assert {file: outcome[file] for file in stored} == stored
            stored = outcome
            lost.append(count - len(stored))
        go_on(folder, stored)
        assert_identical(out, expected)
        assert exports(out) == exports(reference / "out")
    logging.getLogger(__name__).info("%s; cells left to compute: %s", kills, lost)


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """Yield the datasets of a sweep that nobody killed."""
    folder = with_case(tmp_path_factory.mktemp("swept"))
    with threads(1):
        run_sweep(load_sweep(folder / "case.toml"), folder / "out")
    return contents(folder / "out")


def start(folder, *arguments):
    """Start a sweep, and poll until its first cell."""
    process = begin(with_case(folder), "run", "case.toml", "-o", "out", *arguments)
    while not cells(folder / "out"):
        assert process.poll() is None, process.communicate()
        sleep(0.05)
    return process


@pytest.mark.slow
def test_workers_leave_a_killed_parent_and_its_cells_stay(swept, tmp_path):
    begun = start(tmp_path, "--jobs", "2")
    workers = workers_of(begun.pid)
    assert len(workers) == 2
    begun.kill()
    output = begun.communicate()[1]
    wait_for_the_end_of(workers)
    outcome = check_after_kill(tmp_path / "out", "run", begun.returncode, output)
    assert outcome
    go_on(tmp_path, outcome)
    assert_identical(tmp_path / "out", swept)


def wait_for_the_end_of(processes):
    """Workers leave soon after their parent."""
    for _ in range(600):
        if not any(Path(f"/proc/{number}").exists() for number in processes):
            return
        sleep(0.1)
    raise AssertionError("a worker has outlived its parent")


@pytest.fixture
def dask(tmp_path):
    """Yield a scheduler with two worker processes, and its address."""
    program, file = str(Path(sys.executable).with_name("dask")), tmp_path / "scheduler.json"
    environment = ONE_THREAD | {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"}
    options = {"env": environment, "stderr": subprocess.DEVNULL}
    where = ["--host", "127.0.0.1", "--no-dashboard"]
    started = [
        subprocess.Popen(
            [program, "scheduler", *where, "--port", "0", "--scheduler-file", file], **options
        )
    ]
    while not file.exists() or not file.read_text():
        assert started[0].poll() is None
        sleep(0.1)
    address = json.loads(file.read_text())["address"]
    worker = [program, "worker", address, "--no-nanny", "--nthreads", "1", *where]
    started += [subprocess.Popen(worker, cwd=tmp_path, **options) for _ in range(2)]
    yield address, started
    for process in started:
        process.kill()
        process.wait()


@pytest.mark.slow
def test_a_worker_of_dask_that_is_killed_is_replaced_by_another(dask, swept, tmp_path):
    address, (_, worker, _) = dask
    begun = start(tmp_path, "--dask", address)
    worker.kill()
    output = begun.communicate()[1]
    assert begun.returncode == 0, output
    assert "Traceback" not in output
    assert_identical(tmp_path / "out", swept)


@pytest.mark.slow
def test_jobs_end_in_one_sentence_when_all_workers_of_dask_are_gone(dask, monkeypatch):
    address, (_, *processes) = dask
    monkeypatch.setattr(executors, "LOST", 1.0)
    finished = []

    def finish(key, result):
        finished.append(key)
        for process in processes:
            process.kill()

    with (
        pytest.raises(MultiscaleError, match="the workers disappeared after 1 finished jobs"),
        executors.workers(1, address) as executor,
    ):
        executors.run_jobs(sleep, ((k, (20.0 * k,)) for k in range(5)), executor, finish)
    assert finished == [0]


@pytest.mark.slow
def test_a_job_that_kills_workers_of_dask_is_one_sentence(dask):
    address, _ = dask
    with (
        pytest.raises(MultiscaleError, match="several workers of dask died of the same job"),
        executors.workers(1, address) as executor,
    ):
        executors.run_jobs(os._exit, [(0, (1,))], executor, lambda key, result: None)


@pytest.mark.long
def test_a_scheduler_of_dask_that_is_killed_is_one_sentence(dask, swept, tmp_path):
    address, (scheduler, *_) = dask
    begun = start(tmp_path, "--dask", address)
    scheduler.kill()
    output = begun.communicate()[1]
    assert begun.returncode == 1
    assert "Traceback" not in output, output
    assert output.count("multiscale: the workers disappeared after") == 1
    check_whole(tmp_path / "out")
    stored = cells(tmp_path / "out")
    assert stored
    go_on(tmp_path, stored)
    assert_identical(tmp_path / "out", swept)


PROGRAM = """
from mpi4py.futures import MPIPoolExecutor
from multiscale.pipeline import load_sweep, run_sweep

if __name__ == "__main__":
    with MPIPoolExecutor() as executor:
        run_sweep(load_sweep("case.toml"), "out", executor=executor)
"""


@pytest.mark.slow
def test_workers_of_mpi_give_the_same_datasets(swept, tmp_path):
    pytest.importorskip("mpi4py")
    launcher = Path(sys.executable).with_name("mpiexec")
    if not launcher.exists():
        pytest.skip("mpiexec is not beside the interpreter")
    (with_case(tmp_path) / "program.py").write_text(PROGRAM, encoding="utf-8")
    command = [launcher, "-n", "3", sys.executable, "-m", "mpi4py.futures", "program.py"]
    done = subprocess.run(
        command,
        cwd=tmp_path,
        env=ONE_THREAD,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert_identical(tmp_path / "out", swept)
