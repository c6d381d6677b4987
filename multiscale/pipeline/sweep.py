"""Sweeps: cases with every combination of listed values, each with a separate run."""

import logging
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import reduce
from io import BytesIO
from itertools import count, product
from math import prod
from operator import getitem, methodcaller
from pathlib import Path
from shutil import rmtree
from sys import intern
from typing import Any

import numpy as np

from multiscale.errors import CaseError, ConvergenceError, FileError, MultiscaleError
from multiscale.executors import run_jobs
from multiscale.io import make_folder, remove, write_bytes, write_dataset
from multiscale.io.files import read_bytes
from multiscale.pipeline.case import find_case, read_case, validate_case
from multiscale.pipeline.run_folder import gather_cautions, is_whole
from multiscale.pipeline.runner import run
from multiscale.pipeline.showing import answer_columns
from multiscale.pipeline.stage import Shown, Stage
from multiscale.pipeline.stages import stages_of
from multiscale.pipeline.sweep_points import POINTS, name_point
from multiscale.pipeline.tables.settings import Case
from multiscale.pipeline.tables.toml_model import read_toml
from multiscale.schema import SWEEP, Dataset
from multiscale.upscaling.budget import has_budget, unknown_terms

MOST_POINTS = 100_000

MOST_KEPT = 100  # largest number of points with run folders that stay without request
MOST_JOINED = 500  # points that are in memory before they are joined
MOST_LETTERS = 60  # of the name of a folder, without its checksum

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class _Cases(Sequence[Case]):
    """Cases that are made on access, to save memory."""

    make: Callable[[Any], Case]
    given: Sequence[Any]

    def __len__(self) -> int:
        return len(self.given)

    def __getitem__(self, k: Any) -> Any:
        return self.make(self.given[k])


@dataclass(frozen=True)
class Sweep:
    """Cases that differ in some values.

    Attributes
    ----------
    parameters : tuple of str
        Keys that vary, such as ``"cell.points"``; none in a file without ``[sweep]``.
    points : sequence of Case
        Every combination of the values, the last key fastest; made on access.
    settings : tuple of tuple of str, the values of each point as in the file
    content : dict
        Content of the file, including ``[sweep]``; empty if there is no file.
    """

    title: str
    parameters: tuple[str, ...]
    points: Sequence[Case]
    settings: tuple[tuple[str, ...], ...]
    content: dict[str, Any] = field(default_factory=dict)

    def quick(self) -> "Sweep":
        """Return the sweep of quick cases, with their keys as its content."""
        points = _Cases(methodcaller("quick"), self.points)
        title = f"{self.title} (quick)"
        content = self.content | tomllib.loads(points[0].to_toml()) | {"title": title}
        return replace(self, title=title, points=points, content=content)

    def only_part(self, part: str, law: Path | None = None) -> "Sweep":
        """Return the sweep until its ``law``, from its ``structure``, or of its ``rve`` only.

        A law is the file for the joints of the structure, in place of the law that the case names.
        """
        parts = {
            "law": methodcaller("without_structure"),
            "structure": methodcaller("from_structure", law),
            "rve": methodcaller("only_rve"),
        }
        return replace(self, points=_Cases(parts[part], self.points))

    def name(self, k: int) -> str:
        """Name a point by its keys and values."""
        return name_point(self.parameters, self.settings[k])

    def folders(self, out: Path) -> list[Path]:
        """Run folder of each point, named after its values, so that a sweep may grow."""
        names = []
        for setting in self.settings:  # the last parts of the keys, and the values
            pairs = (
                f"{key.split('.')[-1]} {text}"
                for key, text in zip(self.parameters, setting, strict=True)
            )
            words = re.split(r"[^\w.+]+", " ".join(pairs), flags=re.ASCII)
            names.append("-".join(filter(None, words))[:MOST_LETTERS] or "point")
        sums = (case.checksum()[:8] for case in self.points)
        return [out / "points" / f"{name}-{sum_}" for name, sum_ in zip(names, sums, strict=True)]


def load_sweep(case: str | Path) -> Sweep:
    """Read a case file that may list values in a table ``[sweep]``.

    Parameters
    ----------
    case : str or Path
        Path of a TOML file, or the name of a shipped case. ``[sweep]`` repeats tables and keys of
        the case, each with a list of values in place of a value.

    Raises
    ------
    CaseError
        If there is no such case, or a point has faults; the message lists all faults of the first.

    Examples
    --------
    >>> load_sweep("ground_steel").parameters
    ()
    """
    path = find_case(case)
    whole = read_case(path)
    content = {name: table for name, table in whole.items() if name != "sweep"}
    table = whole.get("sweep", {})
    lists = dict(_lists(table, path)) if isinstance(table, Mapping) else {}
    if not lists and table != {}:
        raise CaseError(f"{path}: [sweep] should be a table of lists, got {table!r}")
    size = prod(len(values) for values in lists.values())
    if size > MOST_POINTS:
        raise CaseError(
            f"{path}: [sweep] makes {size} points; list fewer values, at most {MOST_POINTS} points"
        )
    parameters = tuple(".".join(key) for key in lists)

    def case_of(values: Sequence[Any]) -> Case:
        point = deepcopy(content)
        for key, value in zip(lists, values, strict=True):
            _set(point, key, value, path)
        if lists:
            label = name_point(parameters, map(_format_value, values))
            point["title"] = f"{content.get('title', '')}: {label}"
        return validate_case(point, path)

    combinations = list(product(*lists.values()))
    cases = _Cases(case_of, combinations)
    first, *_ = [case.title for case in cases]  # every case is checked
    settings = tuple(tuple(map(_format_value, values)) for values in combinations)
    return Sweep(str(content.get("title", first)), parameters, cases, settings, whole)


def run_sweep(
    sweep: Sweep,
    out: str | Path,
    *,
    executor: Executor | None = None,
    progress: Callable[[int], None] = lambda finished: None,
    force: bool = False,
    keep: bool = False,
) -> Dataset:
    """Run every point of a sweep, and join the results.

    Parameters
    ----------
    out : path
        Gets ``sweep.nc``, and in the folder ``points`` the answers of each point in a small file.
        Finished points and cells in it are not computed again, even if another sweep wrote them.
    executor : Executor, optional, see :func:`multiscale.executors.run_jobs`; a point is one job
    progress : callable, gets the number of finished points
    force : bool, default False, whether all points are computed again, even if finished
    keep : bool, default False
        Whether each point keeps its run folder, as in sweeps of up to :data:`MOST_KEPT` points.
        Larger sweeps keep only the answers; slow stages are stored until their point is finished.

    Returns
    -------
    Dataset
        Follows ``SWEEP``: every answer of the last stage with answers, with intervals, and the
        parameters as coordinates of ``point``, in SI units where they are numbers. A point without
        result is NaN, with its failure as text; it is computed again by the next run, unless a
        solver did not converge.

    Raises
    ------
    MultiscaleError
        If the folder holds a single run, a worker process died, a file cannot be written, or no
        point has a result.
    """
    import tomli_w

    out = make_folder(Path(out))
    file = out / "case.toml"
    if file.exists() and any(out.rglob("*.nc")) and "sweep" not in read_toml(file):
        raise CaseError(f"{out} has a single run; choose another folder for a sweep")
    remove(out / POINTS.file)  # of other points
    columns = zip(*sweep.settings, strict=True)
    values = {
        key: [*dict.fromkeys(column)] for key, column in zip(sweep.parameters, columns, strict=True)
    }
    content = {"title": sweep.title, "sweep": values} | sweep.content
    write_bytes(file, tomli_w.dumps(content).encode())
    folders, points = sweep.folders(out), make_folder(out / "points")
    keep_folders = keep or len(folders) <= MOST_KEPT
    stored = set() if force else {file.name for file in points.glob("*.nc")}
    todo = {
        folder.name: k
        for k, folder in enumerate(folders)
        if _file(folder).name not in stored
        or (keep_folders and not is_whole(folder, sweep.points[k]))
    }
    finished, lost = count(len(folders) - len(todo)), dict[str, str]()
    progress(next(finished))

    def finish(k: int, outcome: tuple[str, bool]) -> None:
        failure, final = outcome
        if not final:
            lost[folders[k].name] = failure
        logger.info("%s: %s", sweep.name(k), failure or "finished")
        progress(next(finished))

    jobs = ((k, (sweep.points[k], folders[k], force, keep_folders)) for k in todo.values())
    run_jobs(_run_point, jobs, executor, finish)
    joined = _join(sweep, folders, lost)
    write_dataset(joined, out / POINTS.file, SWEEP)
    return joined


def _file(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}.v{SWEEP.version}.nc")


def _format_value(value: Any) -> str:
    return f"[{', '.join(map(str, value))}]" if isinstance(value, list) else str(value)


def _lists(
    table: Mapping[str, Any], path: Path, above: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], list[Any]]]:
    """Yield the full keys of a table and their lists."""
    for name, value in table.items():
        key = (*above, name)
        if isinstance(value, Mapping):
            yield from _lists(value, path, key)
        elif isinstance(value, list) and value:
            yield key, value
        else:
            raise CaseError(
                f"{path}: [sweep] {'.'.join(key)} should be a list of at least one value, got "
                f"{value!r}"
            )


def _set(content: dict[str, Any], key: tuple[str, ...], value: Any, path: Path) -> None:
    for name in key[:-1]:
        content = content.setdefault(name, {})
        if not isinstance(content, dict):
            raise CaseError(f"{path}: [sweep] {'.'.join(key)}: {name} is not a table")
    content[key[-1]] = value


def _run_point(case: Case, folder: Path, force: bool, keep: bool) -> tuple[str, bool]:
    """Run a point and write its answers; return its failure and whether this is final."""
    import xarray as xr

    remove(_file(folder))
    try:
        point = _answers(case, run(case, folder, force=force, sparing=not keep))
    except FileError:  # of the folder of all points
        raise
    except ConvergenceError as error:
        point = xr.Dataset(attrs={"failure": str(error)})
    except MultiscaleError as error:
        return str(error), False
    except MemoryError as error:
        return f"not enough memory ({error}); use fewer jobs", False
    write_bytes(_file(folder), bytes(point.to_netcdf(engine="scipy")))
    if not keep:
        rmtree(folder, ignore_errors=True)
    return point.attrs["failure"], True


def _answers(case: Case, results: Mapping[str, Dataset]) -> Dataset:
    """Return the answers of a run with their intervals, numbered along their steps."""
    datasets: dict[Shown, Dataset] = {
        stage: results[stage.name] for stage in stages_of(case.tables)
    }
    answering = _answering(case)
    values = answering.compared(datasets[answering]).reset_coords()
    kinds = ("", "_mean_law", "_one_part")
    names = [
        name for answer in answering.answers for kind in kinds if (name := answer + kind) in values
    ]
    point = values[names].reset_coords(drop=True)
    failed = (stage.failure(dataset) for stage, dataset in datasets.items())
    caution = "\n".join(filter(None, dict.fromkeys([*gather_cautions(datasets), *failed])))
    missing = (
        ", ".join(unknown_terms(datasets[answering])) if has_budget(datasets[answering]) else ""
    )
    point.attrs = {"failure": "", "caution": caution, "missing": missing}
    return point.assign_coords({name: np.arange(size) for name, size in point.sizes.items()})


def _answering(case: Case) -> Stage:
    return [stage for stage in stages_of(case.tables) if stage.answers][-1]


def _join(sweep: Sweep, folders: Sequence[Path], lost: Mapping[str, str]) -> Dataset:
    """Concatenate the points, which are read in batches; missing answers are NaN."""
    import xarray as xr

    answers: dict[str, None] = {}
    texts: dict[str, list[str]] = {name: [] for name in ("failure", "caution", "missing")}
    ends: list[dict[Any, int]] = []
    parts, batch = list[Dataset](), list[Dataset]()
    for k, folder in enumerate(folders):
        point = xr.Dataset(attrs={"failure": lost.get(folder.name, "")})
        if folder.name not in lost:
            content = BytesIO(read_bytes(_file(folder)))
            point = xr.load_dataset(content, engine="scipy", decode_cf=False)
        for name, column in texts.items():
            column.append(intern(point.attrs.get(name, "")))
        if not answers.keys() >= point.data_vars.keys():
            answers |= dict.fromkeys(_answering(sweep.points[k]).answers)
        ends.append({name: values.shape[-1] - 1 for name, values in point.items() if values.ndim})
        batch.append(point.expand_dims(point=[k]))
        if len(batch) == MOST_JOINED or k + 1 == len(folders):
            parts.append(_concatenated(batch))
            batch = []
    if all(texts["failure"]):
        raise MultiscaleError(
            f"none of the {len(folders)} points of the sweep has a result; at {sweep.name(0)}: "
            f"{texts['failure'][0]}"
        )
    whole = _concatenated(parts)
    whole = whole.drop_vars(whole.coords)
    names = [name for name in answers if name in whole]
    joined = SWEEP.build(
        answer_columns(names, {name: whole[name].values for name in names})
        | {
            "setting": np.array(sweep.settings, dtype=str).reshape(len(folders), -1),
            "folder": [f"points/{folder.name}" for folder in folders],
            "failure": np.array(texts["failure"], dtype=object),
            "caution": np.array(texts["caution"], dtype=object),
            "missing_terms": np.array(texts["missing"], dtype=object),
            "answer_place": np.array([[last.get(name, 0) for name in names] for last in ends]),
        },
        title=sweep.title,
    )
    labels = {"parameter": list(sweep.parameters), "answer": names}
    joined = joined.assign_coords(labels | _coordinates(sweep))
    return joined.merge(whole, combine_attrs="override")


def _concatenated(points: Sequence[Dataset]) -> Dataset:
    """Concatenate datasets, with NaN for missing variables and steps."""
    import xarray as xr

    return xr.concat(
        points,
        "point",
        data_vars="all",
        coords="minimal",
        compat="override",
        join="outer",
        combine_attrs="drop_conflicts",
    )


def _coordinates(sweep: Sweep) -> dict[str, Any]:
    coordinates: dict[str, Any] = {}
    for column, name in enumerate(sweep.parameters):
        texts = [setting[column] for setting in sweep.settings]
        first = {text: k for k, text in reversed([*enumerate(texts)])}
        values = {
            text: reduce(getitem, name.split("."), sweep.points[k].model_dump())
            for text, k in first.items()
        }
        try:
            numbers = [float(str(values[text])) for text in texts]  # true and false are text
        except ValueError:
            coordinates[name] = ("point", texts, {"long_name": name})
            continue
        unit = getattr(values[texts[0]], "unit", "1")
        coordinates[name] = ("point", numbers, {"units": unit, "long_name": name})
    return coordinates
