"""Mutated case files, scenes, datasets and surface files: an answer or a sentence, nothing else."""

from pathlib import Path
from time import perf_counter

import numpy as np
import pytest

from multiscale.errors import MultiscaleError
from multiscale.io import open_dataset, read_surface, write_dataset
from multiscale.pipeline import load_scene, load_sweep
from multiscale.pipeline.case import shipped_cases
from multiscale.schema import WORK_PRECISION

SCENES = sorted((Path(__file__).parents[2] / "workflows" / "scenes").glob("*.toml"))
CASES = list(shipped_cases().values())

NUMBERS = "0 -1 1e400 nan -inf true [] {} [[1]] 0x7fffffffffffffff 1979-05-27 [1,[2]]"
TEXTS = "|1e400 m|-1 Pa|nan m|1 furlong|1 m m m|1 m^99|10 %|../../etc/passwd|\\u0000|<script>|%s%n"
VALUES = (*NUMBERS.split(), *(f'"{text}"' for text in TEXTS.split("|")))
SLOWEST = 5.0
"""Seconds after which reading a file hangs."""


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
    """Overwrite, cut or repeat a few bytes."""
    data = bytearray(data)
    for _ in range(rng.integers(1, 8)):
        at = int(rng.integers(len(data)))
        kind = rng.integers(4)
        if kind <= 1:
            data[at] = rng.integers(256)
        elif kind == 2:
            del data[at : at + int(rng.integers(1, 1 + len(data) // 4))]
        else:
            data[at:at] = data[at : at + 16]
        if not data:
            return b""
    return bytes(data)


def read_all(read, files, mutate, count, folder, seed):
    """Read mutants of files; say which were neither read nor refused in a sentence."""
    rng, faults = np.random.default_rng(seed), []
    sources = [(file, file.read_bytes()) for file in files]
    read(files[0])  # imports take their time once
    for k in range(count):
        file, data = sources[k % len(sources)]
        mutant = folder / f"mutant{file.suffix}"
        source = data.decode() if mutate is mutate_lines else data
        mutant.write_bytes(mutate(source, rng))
        begin = perf_counter()
        try:
            read(mutant)
        except MultiscaleError as error:
            if not str(error).strip():
                faults.append(f"{k}: refused without a sentence")
        except Exception as error:  # anything else is the finding
            faults.append(f"{k} of {file.name}: {type(error).__name__}: {error}")
        if perf_counter() - begin > SLOWEST:
            faults.append(f"{k} of {file.name}: took {perf_counter() - begin:.0f} s")
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


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_mutants_of_cases_and_scenes_are_read_or_refused_in_a_sentence(tmp_path, seed):
    count = 200 if seed == 1 else 3000
    assert read_all(load_sweep, CASES, mutate_lines, count, tmp_path, seed) == []
    assert read_all(load_scene, SCENES, mutate_lines, count, tmp_path, seed) == []


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_mutants_of_datasets_are_read_or_refused_in_a_sentence(dataset, tmp_path, seed):
    def read(file):
        close(open_dataset(file, WORK_PRECISION))

    count = 200 if seed == 1 else 2000
    assert read_all(read, [dataset], mutate_bytes, count, tmp_path, seed) == []


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_mutants_of_surface_files_are_read_or_refused_in_a_sentence(scans, tmp_path, seed):
    count = 100 if seed == 1 else 2000
    assert read_all(read_surface, scans, mutate_bytes, count, tmp_path, seed) == []
