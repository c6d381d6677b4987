"""What several test folders share."""

import os
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
def run_folder(tmp_path_factory):
    """What the main command leaves, of flat cells on a coarse grid."""
    from multiscale.pipeline import load_case, run
    from multiscale.report import draw_figures

    case = load_case("ground_steel").quick()
    cell = case.cell.model_copy(update={"geometry": "flat"})
    out = tmp_path_factory.mktemp("run") / "results"
    run(case.model_copy(update={"cell": cell}), out)
    draw_figures(out)
    return out


@pytest.fixture(scope="session")
def shipped_run(tmp_path_factory):
    """Return folder, print and cautions of a shipped case, run once for all workers with --quick.

    The folder is read only.
    """
    from tests.support import COMMAND, run_python

    folder = tmp_path_factory.getbasetemp()
    folder = folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder

    def finished(name):
        out, *said = (folder / f"{name}{end}" for end in ("", ".out", ".err"))
        with FileLock(folder / f"{name}.lock"):
            if not said[1].exists():
                arguments = ("run", name, "-o", out, "--quick", "--jobs", "1")
                done = run_python(COMMAND, *arguments, cwd=folder, check=False)
                assert done.returncode == 0, done.stderr
                for file, text in zip(said, (done.stdout, done.stderr), strict=True):
                    file.write_text(text, encoding="utf-8")
        return out, *(file.read_text(encoding="utf-8") for file in said)

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
