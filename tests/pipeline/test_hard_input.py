"""Mutated case files, scenes, datasets and surface files: an answer or a sentence, nothing else."""

import faulthandler
import os
import signal
import xml.etree.ElementTree as ET
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from multiscale.errors import CaseError, MultiscaleError
from multiscale.io import open_dataset, read_surface, write_dataset
from multiscale.pipeline import load_case, load_sweep, run, run_macro
from multiscale.pipeline.case import shipped_cases
from multiscale.schema import WORK_PRECISION
from tests.support import small_steel

SCENES = sorted((Path(__file__).parents[2] / "workflows" / "scenes").glob("*.toml"))
CASES = list(shipped_cases().values())

NUMBERS = "0 -1 1e400 nan -inf true [] {} [[1]] 0x7fffffffffffffff 1979-05-27 [1,[2]]"
TEXTS = "|1e400 m|-1 Pa|nan m|1 furlong|1 m m m|1 m^99|10 %|../../etc/passwd|\\u0000|<script>|%s%n"
VALUES = (*NUMBERS.split(), *(f'"{text}"' for text in TEXTS.split("|")))
SLOWEST = 5.0
"""Seconds of computing after which reading a file hangs, however busy the machine is."""
STUCK = 300
"""Seconds after which a reader that no signal reaches ends the tests, with its traceback."""


def mutate_lines(text, rng):
    """Change a few lines of a TOML file: values, keys, order, and what makes them lines."""
    lines = text.splitlines()
    for _ in range(rng.integers(1, 4)):
        k = int(rng.integers(len(lines)))
        key, equals, _ = lines[k].partition("=")
        kind = rng.integers(7)
        if kind <= 2 and equals:
            lines[k] = f"{key}= {VALUES[rng.integers(len(VALUES))]}"
        elif kind == 3:
            lines.insert(k, lines[rng.integers(len(lines))])
        elif kind == 4 and len(lines) > 1:
            del lines[k]
        elif kind == 5:
            lines[k] = lines[k][: rng.integers(len(lines[k]) + 1)]
        else:
            at = int(rng.integers(len(lines[k]) + 1))
            lines[k] = lines[k][:at] + chr(rng.integers(1, 0x2FF)) + lines[k][at:]
    return "\n".join(lines).encode()


def mutate_bytes(data, rng):
    """Overwrite a few bytes, in half of the mutants also cut or repeat some."""
    data = bytearray(data)
    kinds = (1, 4)[rng.integers(2)]
    for _ in range(rng.integers(1, 8)):
        at = int(rng.integers(len(data)))
        kind = rng.integers(kinds)
        if kind <= 1:
            data[at] = rng.integers(256)
        elif kind == 2:
            del data[at : at + int(rng.integers(1, 1 + len(data) // 4))]
        else:
            data[at:at] = data[at : at + 16]
        if not data:
            return b""
    return bytes(data)


class HangError(BaseException):
    """Errors that no reader catches."""


@contextmanager
def boxed():
    """Interrupt what computes for too long."""

    def give_up(*_):
        raise HangError

    before = signal.signal(signal.SIGPROF, give_up)
    faulthandler.dump_traceback_later(STUCK, exit=True)
    signal.setitimer(signal.ITIMER_PROF, SLOWEST)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        faulthandler.cancel_dump_traceback_later()
        signal.signal(signal.SIGPROF, before)


def read_all(read, files, mutate, count, folder, seed):
    """Read mutants of files; return which were neither read nor refused in a sentence."""
    rng, faults = np.random.default_rng(seed), []
    sources = [(file, file.read_bytes()) for file in files]
    read(files[0])  # imports take their time once
    for k in range(count):
        file, data = sources[k % len(sources)]
        mutant = folder / f"mutant{file.suffix}"
        source = data.decode() if mutate is mutate_lines else data
        mutant.write_bytes(mutate(source, rng))
        try:
            with boxed():
                read(mutant)
        except HangError:
            faults.append(f"{k} of {file.name}: no answer in {SLOWEST:g} s")
        except MultiscaleError as error:
            if not str(error).strip():
                faults.append(f"{k}: refused without a sentence")
        except Exception as error:  # anything else is the finding
            faults.append(f"{k} of {file.name}: {type(error).__name__}: {error}")
        assert sorted(folder.glob(".*")) == []  # no reader writes
    return faults


def close(dataset):
    dataset.load().close()


@pytest.fixture
def dataset(tmp_path):
    values = {"error": [0.1], "wall_time": [1.0], "converged": [1], "scene": ["wave"]}
    file = tmp_path / "work_precision.nc"
    write_dataset(WORK_PRECISION.build(values, title="one run"), file, WORK_PRECISION)
    return file


@pytest.fixture
def scans(tmp_path):
    heights = 1e-6 * np.random.default_rng(1).standard_normal((8, 8))
    x, y = np.meshgrid(np.arange(8.0), np.arange(8.0))
    header = "Width: 8 um\nHeight: 8 um\nValue units: m"
    np.savetxt(tmp_path / "matrix.txt", heights, header=header)
    np.savetxt(tmp_path / "points.xyz", np.stack([x, y, heights], axis=-1).reshape(-1, 3))
    return [tmp_path / "matrix.txt", tmp_path / "points.xyz"]


SEEDS = [
    (1, 200),
    pytest.param(2, 800, marks=pytest.mark.slow),
    pytest.param(2, 2000, marks=pytest.mark.long),
]
"""Seeds and numbers of mutants."""


@pytest.mark.parametrize(("seed", "count"), SEEDS)
def test_mutants_of_cases_and_scenes_are_read_or_refused_in_a_sentence(tmp_path, seed, count):
    assert read_all(load_sweep, CASES, mutate_lines, count, tmp_path, seed) == []
    assert read_all(load_case, SCENES, mutate_lines, count, tmp_path, seed) == []


def test_mutants_of_datasets_are_read_or_refused_in_a_sentence(dataset, tmp_path):
    """HDF5 itself reads about 1 in 1000 files without end."""

    def read(file):
        close(open_dataset(file, WORK_PRECISION))

    assert read_all(read, [dataset], mutate_bytes, 200, tmp_path, seed=1) == []


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("seed", "count"), SEEDS)
def test_mutants_of_surface_files_are_read_or_refused_in_a_sentence(scans, tmp_path, seed, count):
    assert read_all(read_surface, scans, mutate_bytes, count, tmp_path, seed) == []


def test_a_reader_that_hangs_is_detected(tmp_path):
    original = CASES[0].read_bytes()

    def read(file):
        content = file.read_bytes()
        while content != original:
            pass

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(f"{__name__}.SLOWEST", 0.05)
        (fault,) = read_all(read, CASES[:1], mutate_lines, 1, tmp_path, 1)
    assert "no answer in 0.05 s" in fault


NASTY = '<script>alert(1)</script> & "x" $\\\\frac{ {{ 7*7 }} </title>'

SMALL = small_steel(2)


@pytest.mark.slow
def test_a_report_shows_text_of_a_user_without_running_it(tmp_path, monkeypatch):
    from multiscale.report import draw_figures, write_report

    title = SMALL.index("title = ")
    text = SMALL[:title] + f"title = {NASTY!r}" + SMALL[SMALL.index("\n", title) :]
    (tmp_path / "case.toml").write_text(text, encoding="utf-8")
    monkeypatch.setattr("sys.argv", ["multiscale", "run", "<img src=x onerror=alert(1)>"])
    out = tmp_path / "<b>out"
    run(load_case(tmp_path / "case.toml"), out)
    draw_figures(out)
    page = write_report(out).read_text(encoding="utf-8")
    assert "<script" not in page
    assert "<img src=x" not in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt; &amp;" in page
    assert "{{ 7*7 }}" in page


def test_a_series_for_paraview_is_xml_whatever_its_name(tmp_path):
    (tmp_path / "scene.toml").write_text(
        'title = "grid"\n[structure]\nkind = "tensegrity_grid"\nn = 2\nprestress = "40 N"\n'
        "[statics]\nload_factors = [1.0]\n"
    )
    name = """a"b<c>&'d"""
    run_macro(load_case(tmp_path / "scene.toml"), tmp_path / f"{name}.nc")
    (entry,) = ET.parse(tmp_path / "fields" / f"{name}.pvd").iter("DataSet")
    ET.parse(tmp_path / "fields" / entry.attrib["file"])


@pytest.mark.parametrize("place", ["../../../../../../../../../etc/passwd", "/dev/zero", "pipe"])
def test_a_path_leads_to_data_or_to_a_sentence(tmp_path, place):
    os.mkfifo(tmp_path / "pipe")
    scene = tmp_path / "scene.toml"
    scene.write_text(
        f'title = "links"\n[structure]\nkind = "table"\nnodes = "{place}"\nlinks = "{place}"\n'
        '[structure.laws.a]\nkind = "bar"\nrigidity = "1 MN"\n[statics]\nload_factors = [1.0]\n'
    )
    with pytest.raises(CaseError, match=r"passwd|is a device or a pipe"):
        run_macro(load_case(scene), tmp_path / "out.nc")
    with pytest.raises(CaseError, match=r"passwd|is a device or a pipe"):
        read_surface(tmp_path / place)
    assert not (tmp_path / "out.nc").exists()
