"""Fixtures of several test folders."""

import gc
import os
from hashlib import sha256
from pathlib import Path
from shutil import rmtree

import pytest
from filelock import FileLock


def pytest_configure(config):
    """Set the package and the threads of the processes that tests start.

    One process of many takes one thread for kernels and libraries; tests of threads ask for more.
    """
    os.environ["PYTHONPATH"] = str(config.rootpath)
    if hasattr(config, "workerinput"):
        os.environ.setdefault("OMP_NUM_THREADS", "1")
    gc.disable()


def pytest_collection_finish():
    """Leave modules and tests to the end: passes over them take 2 % of the time of all tests."""
    gc.freeze()
    gc.enable()


def pytest_addoption(parser):
    parser.addoption(
        "--reference-data",
        metavar="PATH",
        type=Path,
        # the form with "=" keeps pytest from taking it for a folder of tests
        help="folder with measured and published data, not shipped: --reference-data=PATH",
    )


@pytest.fixture(scope="session")
def reference_data(request):
    path = request.config.getoption("--reference-data")
    if path is None:
        pytest.skip("needs measured data: give their folder with --reference-data=PATH")
    if not path.is_dir():
        pytest.fail(f"--reference-data {path} is not a folder")
    return path.resolve()


@pytest.fixture(scope="session")
def once(tmp_path_factory):
    """Create a folder once for all workers, by its name and text and by its maker.

    Nothing is written to it later. A folder that is not complete is of a process that was killed.
    """
    base = tmp_path_factory.getbasetemp()
    base = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base

    def made(name, make, text=None):
        key = f"{make.__module__}.{make.__qualname__} {text}".encode()
        place = base / f"{name}-{sha256(key).hexdigest()[:8]}"
        folder, complete = place / name, place / "complete"
        with FileLock(f"{place}.lock"):
            if not complete.exists():
                rmtree(place, ignore_errors=True)
                folder.mkdir(parents=True)
                make(folder) if text is None else make(folder, text)
                complete.touch()
        return folder

    return made


@pytest.fixture(scope="session")
def run_folder(once):
    """Output of the main command, of flat cells on a coarse grid."""
    from multiscale.pipeline import load_case, run
    from multiscale.report import draw_figures

    def make(folder):
        case = load_case("ground_steel").quick()
        cell = case.cell.model_copy(update={"geometry": "flat"})
        run(case.model_copy(update={"cell": cell}), folder / "results")
        draw_figures(folder / "results")

    return once("flat_steel", make) / "results"


@pytest.fixture(scope="session")
def shipped_run(once):
    """Folder, print and cautions of a shipped case, or of a text, which is run with --quick."""
    from tests.support import COMMAND, run_python

    def make(folder, text=None):
        case = folder.name
        if text is not None:
            case = folder / "case.toml"
            case.write_text(text, encoding="utf-8")
        arguments = ("run", case, "-o", folder / "out", "--quick", "--jobs", "1")
        done = run_python(COMMAND, *arguments, cwd=folder, check=False)
        assert done.returncode == 0, done.stderr
        (folder / "printed").write_text(done.stdout, encoding="utf-8")
        (folder / "cautions").write_text(done.stderr, encoding="utf-8")

    def finished(name, text=None):
        folder = once(name, make, text)
        printed, cautions = ((folder / file).read_text("utf-8") for file in ("printed", "cautions"))
        return folder / "out", printed, cautions

    return finished


@pytest.fixture(scope="session")
def text_run(once):
    """Case, folder and datasets of the text of a case, which is run and shown."""
    from multiscale.pipeline import load_case, run
    from multiscale.pipeline.runner import Results
    from multiscale.report import open_finished, show_run
    from tests.support import case_of

    def finished(name, text, write_files=lambda folder: None):
        def make(folder, text):
            write_files(folder)
            run(case_of(folder, text), folder / "out")
            show_run(folder / "out")

        folder = once(name, make, text)
        computed = open_finished(folder / "out").datasets
        return load_case(folder / "scene.toml"), folder / "out", Results(computed)

    return finished


@pytest.fixture
def without_pages(monkeypatch):
    """Leave figures and report out: for runs of which a test looks at datasets and print only."""
    from multiscale.report import open_finished

    monkeypatch.setattr("multiscale.report.show_run", lambda out: open_finished(Path(out)))
    monkeypatch.setattr("multiscale.report.write_reports", lambda *_, **__: None)


@pytest.fixture
def command(monkeypatch, capsys, tmp_path):
    """Call the command line in this process, in a new folder.

    Gives exit status, output and errors.
    """
    from multiscale.cli import main

    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        monkeypatch.setattr("sys.argv", ["multiscale", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            main()
        printed = capsys.readouterr()
        return end.value.code or 0, printed.out, printed.err

    return call
