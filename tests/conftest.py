"""What several test folders share."""

import os
from functools import partial
from pathlib import Path

import pytest
from filelock import FileLock


def pytest_configure(config):
    """Let commands in processes of their own share the package and its compiled kernels.

    One process of many takes one thread for kernels and libraries; tests of threads ask for more.
    """
    os.environ["PYTHONPATH"] = str(config.rootpath)
    if hasattr(config, "workerinput"):
        os.environ.setdefault("OMP_NUM_THREADS", "1")


def pytest_addoption(parser):
    parser.addoption(
        "--reference-data",
        metavar="PATH",
        type=Path,
        # the form with "=" keeps pytest from taking the folder for one of tests
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
    """Make a folder by its name once for all workers; nothing is written to it later."""
    base = tmp_path_factory.getbasetemp()
    base = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base

    def made(name, make):
        folder, complete = base / name, base / f"{name}.complete"
        with FileLock(base / f"{name}.lock"):
            if not complete.exists():
                folder.mkdir(exist_ok=True)
                make(folder)
                complete.touch()
        return folder

    return made


@pytest.fixture(scope="session")
def run_folder(once):
    """What the main command leaves, of flat cells on a coarse grid."""
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
        folder = once(name, partial(make, text=text))
        printed, cautions = ((folder / one).read_text("utf-8") for one in ("printed", "cautions"))
        return folder / "out", printed, cautions

    return finished


@pytest.fixture(scope="session")
def text_run(once):
    """Case, folder and datasets of the text of a case, which is run and shown."""
    from multiscale.pipeline import load_case, run
    from multiscale.pipeline.runner import Results
    from multiscale.report import open_finished, show_run
    from tests.support import case_of

    def make(folder, text, write_files):
        write_files(folder)
        run(case_of(folder, text), folder / "out")
        show_run(folder / "out")

    def finished(name, text, write_files=lambda folder: None):
        folder = once(name, partial(make, text=text, write_files=write_files))
        found = open_finished(folder / "out").found
        return load_case(folder / "scene.toml"), folder / "out", Results(found)

    return finished


@pytest.fixture
def without_pages(monkeypatch):
    """Leave figures and report out: for runs of which a test looks at datasets and print only."""
    for name in ("draw_figures", "write_report", "write_reports"):
        monkeypatch.setattr(f"multiscale.report.{name}", lambda *_, **__: None)


@pytest.fixture
def command(monkeypatch, capsys, tmp_path):
    """Call the command line in this process, in a folder of its own.

    Gives exit status, output and errors.
    """
    from multiscale.cli import main

    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        monkeypatch.setattr("sys.argv", ["multiscale", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            main()
        said = capsys.readouterr()
        return end.value.code or 0, said.out, said.err

    return call
