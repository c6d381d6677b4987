"""Full disks and folders that cannot be written to are one sentence, and cost nothing finished."""

import os
import re
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from multiscale.io import open_dataset
from tests.pipeline.test_killed import SINGLE, cells, check_whole
from tests.support import case_text

GRID = case_text("grid")


@pytest.fixture(autouse=True)
def files(tmp_path):
    """Write input files of the commands."""
    (tmp_path / "case.toml").write_text(SINGLE, encoding="utf-8")
    (tmp_path / "scene.toml").write_text(GRID, encoding="utf-8")


@pytest.fixture
def disk(tmp_path):
    """Yield a file system of 256 KiB, and its commands."""
    folder = tmp_path / "disk"
    folder.mkdir()

    def mount(options):
        return subprocess.run(
            ["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder], capture_output=True
        )

    if sys.platform != "linux" or mount("size=256k").returncode:
        pytest.skip("this user may not mount a file system")
    yield folder, lambda options: mount(f"remount,{options}").check_returncode()
    subprocess.run(["umount", folder], check=True)


def fill(folder):
    """Leave no room on a file system."""
    with (folder / "filling").open("wb", buffering=0) as file, suppress(OSError):
        while file.write(bytes(4096)):
            pass


def refused(answer, message):
    """Whether an answer is one sentence with a message."""
    status, _, text = answer
    assert status == 1, text
    assert "Traceback" not in text
    sentences = [line for line in text.splitlines() if line.startswith("multiscale: ")]
    assert len(sentences) == 1, text
    assert message in sentences[0]


@pytest.mark.slow
def test_a_run_on_a_disk_that_fills_keeps_its_cells_and_goes_on_with_more_room(command, disk):
    folder, change = disk
    out = folder / "out"
    refused(
        command("run", "case.toml", "-o", out, "--jobs", "1"),
        "no space left on device; finished results stay",
    )
    check_whole(out)
    stored = cells(out)
    assert 0 < len(stored) < 8
    change("size=20m")
    status, _, output = command("run", "case.toml", "-o", out, "--jobs", "1", "--resume")
    assert status == 0, output
    after = cells(out)
    assert len(after) == 8
    assert {file: after[file] for file in stored} == stored
    assert (out / "report.html").exists()


DATASETS = [
    pytest.param(("macro", "scene.toml"), id="macro"),
    pytest.param(("micro", "case.toml", "--jobs", "1"), id="micro"),
    pytest.param(("fit", "response.nc"), id="fit"),
    pytest.param(("stability", "wedge", "--jobs", "1"), id="stability", marks=pytest.mark.slow),
]


@pytest.fixture(scope="module")
def response(tmp_path_factory):
    from multiscale.pipeline import load_case
    from multiscale.pipeline.stages.cells import run_micro

    folder = tmp_path_factory.mktemp("response")
    (folder / "case.toml").write_text(SINGLE, encoding="utf-8")
    run_micro(load_case(folder / "case.toml"), folder / "response.nc", fields=False)
    return folder / "response.nc"


@pytest.mark.parametrize("arguments", DATASETS)
def test_a_full_disk_is_a_sentence_and_leaves_no_dataset(
    command, disk, response, tmp_path, arguments
):
    folder, _ = disk
    (tmp_path / "response.nc").write_bytes(response.read_bytes())
    fill(folder)
    refused(command(*arguments, "-o", folder / "out.nc"), "no space left on device")
    assert list(folder.glob("*.nc")) == []
    assert list(folder.glob(".*")) == []


@pytest.mark.parametrize("arguments", [*DATASETS, pytest.param(("run", "case.toml"), id="run")])
@pytest.mark.parametrize("kind", ["read-only", "below a file"])
def test_a_folder_that_cannot_be_written_to_is_a_sentence_before_anything_is_computed(
    command, request, tmp_path, arguments, kind, monkeypatch
):
    if kind == "read-only":
        folder, change = request.getfixturevalue("disk")
        change("ro")
        message = "read-only file system; choose another folder"
    else:
        folder, message = tmp_path / "case.toml" / "folder", "not a directory"
    for solver in ("micro.ensemble.run_realisations", "macro.solve_static"):
        monkeypatch.setattr(f"multiscale.{solver}", lambda *_, **__: pytest.fail("it computed"))
    out = folder / ("out" if arguments[0] == "run" else "out.nc")
    (tmp_path / "response.nc").write_bytes(b"")
    refused(command(*arguments, "-o", out), message)


@pytest.mark.parametrize(
    "arguments",
    [
        ("macro", "scene.toml"),
        ("micro", "case.toml"),
        ("fit", "response.nc"),
        ("stability", "wedge"),
    ],
    ids=lambda arguments: arguments[0],
)
@pytest.mark.parametrize("name", ["name", "name.txt", ".nc/"])
def test_a_dataset_goes_to_a_file_with_its_suffix(command, arguments, name):
    refused(command(*arguments, "-o", name), "the result is a dataset in a file that ends in .nc")
    assert not Path(name).exists()


def test_a_folder_that_has_the_name_of_the_dataset_is_a_sentence(command):
    Path("out.nc").mkdir()
    refused(command("macro", "scene.toml", "-o", "out.nc"), "is a directory")


def test_a_map_that_is_a_link_to_itself_is_a_sentence(command):
    Path("map.npy").symlink_to("map.npy")
    text = Path("case.toml").read_text()
    body = re.sub(r"\[body_1.surface\][^\[]*", '[body_1.surface]\nfile = "map.npy"\n', text)
    Path("link.toml").write_text(body)
    refused(command("run", "link.toml", "-o", "out"), "map.npy: no such file")


@pytest.mark.slow
def test_files_that_grow_too_large_for_the_user_are_a_sentence(tmp_path):
    scene = tmp_path / "scene.toml"
    command = "from multiscale.cli import main; main()"
    # what coverage writes at the end would be too large as well
    unmeasured = {name: text for name, text in os.environ.items() if "COVERAGE" not in name}
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (16384, 16384));"

    def solve_to(folder, program):
        arguments = [sys.executable, "-c", program, "macro", scene, "-o"]
        out = tmp_path / folder / "macro_result.nc"
        return subprocess.run(
            [*arguments, out], capture_output=True, text=True, check=False, env=unmeasured
        )

    solve_to("free", command).check_returncode()  # the cached kernels are larger files
    done = solve_to("limited", limit + command)
    refused((done.returncode, done.stdout, done.stderr), "file too large; choose another folder")
    assert {file.name for file in (tmp_path / "limited").iterdir()} <= {"fields"}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs the device that is always full")
def test_a_full_terminal_ends_in_a_sentence(tmp_path):
    program = "from multiscale.cli import main; main()"
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-c", program, "macro", "scene.toml", "--explain"],
            cwd=tmp_path,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    refused((done.returncode, done.stdout, done.stderr), "No space left on device")


def test_an_earlier_file_stays_when_its_new_version_finds_no_room(command, disk):
    folder, change = disk
    change("size=2m")
    out = folder / "out.nc"
    status, _, output = command("macro", "scene.toml", "-o", out)
    assert status == 0, output
    before = out.read_bytes()
    fill(folder)
    refused(command("macro", "scene.toml", "-o", out), "no space left on device")
    assert out.read_bytes() == before
    open_dataset(out)
