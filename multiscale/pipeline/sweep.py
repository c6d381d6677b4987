"""Many cases in one file: every combination of the values that it lists, each run by itself."""

import logging
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import reduce
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
from multiscale.pipeline.case import find_case, read_case, validate_case
from multiscale.pipeline.point_store import Point, PointStore, open_store
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

__all__ = ["Sweep", "load_sweep", "run_sweep"]

MOST_POINTS = 100_000

MOST_KEPT = 100
"""Largest number of points whose run folders are kept without request."""
MOST_LETTERS = 60  # of the name of a folder, beside its checksum

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class _Cases(Sequence[Case]):
    """Cases that are made when they are asked for: all cases of a sweep would fill the memory."""

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
    title : str
    parameters : tuple of str
        Keys that vary, such as ``"cell.points"``; none in a file without ``[sweep]``.
    points : sequence of Case
        Every combination of the values, the last key fastest; each is made when it is asked for.
    settings : tuple of tuple of str, for each point the values, as the file says them
    content : dict
        What the file says, with ``[sweep]`` where it has one; empty if it is from no file.
    """

    title: str
    parameters: tuple[str, ...]
    points: Sequence[Case]
    settings: tuple[tuple[str, ...], ...]
    content: dict[str, Any] = field(default_factory=dict)

    def quick(self) -> "Sweep":
        """Return the same sweep of quick cases, whose keys are then the content."""
        points = _Cases(methodcaller("quick"), self.points)
        title = f"{self.title} (quick)"
        content = self.content | tomllib.loads(points[0].to_toml()) | {"title": title}
        return replace(self, title=title, points=points, content=content)

    def name(self, k: int) -> str:
        """Name a point by its keys and values."""
        return name_point(self.parameters, self.settings[k])

    def folders(self, out: Path) -> list[Path]:
        """Run folder of each point, named after what it says, so that a sweep may grow."""
        said = (_readable_name(self.parameters, setting) for setting in self.settings)
        sums = (case.checksum()[:8] for case in self.points)
        return [out / "points" / f"{name}-{sum_}" for name, sum_ in zip(said, sums, strict=True)]


def _readable_name(parameters: Sequence[str], setting: Sequence[str]) -> str:
    """Name a folder after the keys of a point and their values, as far as letters go."""
    pairs = (f"{key.split('.')[-1]} {text}" for key, text in zip(parameters, setting, strict=True))
    words = re.split(r"[^\w.+]+", " ".join(pairs), flags=re.ASCII)
    return "-".join(filter(None, words))[:MOST_LETTERS] or "point"


def load_sweep(case: str | Path) -> Sweep:
    """Read a case file that may list values in a table ``[sweep]``.

    Parameters
    ----------
    case : str or Path
        Path of a TOML file, or the name of a shipped case. ``[sweep]`` repeats tables and keys of
        the case, each with a list of values in place of one.

    Raises
    ------
    CaseError
        If there is no such case, or with every fault of the first point that has any.

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
            said = name_point(parameters, map(_say, values))
            point["title"] = f"{content.get('title', '')}: {said}"
        return validate_case(point, path)

    combinations = list(product(*lists.values()))
    cases = _Cases(case_of, combinations)
    first, *_ = [case.title for case in cases]  # every case is checked
    settings = tuple(tuple(map(_say, values)) for values in combinations)
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
    sweep : Sweep
    out : path
        Gets ``sweep.nc``, the results of the points in ``points.sqlite`` and the folder ``points``.
        Finished points and cells found there are kept, also those of another sweep.
    executor : Executor, optional, see :func:`multiscale.executors.run_jobs`; a point is one job
    progress : callable, gets the number of finished points
    force : bool, default False, whether all points are computed anew, also finished ones
    keep : bool, default False
        Whether each point keeps its run folder, as in sweeps of up to :data:`MOST_KEPT` points.
        Other sweeps keep the answers alone, and write what took long until a point is finished.

    Returns
    -------
    Dataset
        Follows ``SWEEP``: every answer of the last stage that has any, with its intervals, and the
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
        raise CaseError(f"{out} holds a single run; choose another folder for a sweep")
    remove(out / POINTS.file)  # of other points
    columns = zip(*sweep.settings, strict=True)
    values = {
        key: [*dict.fromkeys(one)] for key, one in zip(sweep.parameters, columns, strict=True)
    }
    content = {"title": sweep.title, "sweep": values} | sweep.content
    write_bytes(file, tomli_w.dumps(content).encode())
    folders = sweep.folders(out)
    kept = keep or len(folders) <= MOST_KEPT

    def finish(k: int, point: Point) -> None:
        store.keep(folders[k].name, point)
        if point.final and not kept:
            rmtree(folders[k], ignore_errors=True)
        logger.info("%s: %s", sweep.name(k), point.failure or "finished")
        progress(next(finished))

    with open_store(out) as store:
        stored = set() if force else store.finished()
        todo = {
            folder.name: k
            for k, folder in enumerate(folders)
            if folder.name not in stored or (kept and not is_whole(folder, sweep.points[k]))
        }
        finished = count(len(folders) - len(todo))
        progress(next(finished))
        jobs = ((k, (sweep.points[k], folders[k], force, kept)) for k in todo.values())
        run_jobs(_run_point, jobs, executor, finish)
        joined = _join(sweep, [folder.name for folder in folders], store)
    with suppress(OSError):  # of points that are kept, or failed for lack of memory
        (out / "points").rmdir()
    write_dataset(joined, out / POINTS.file, SWEEP)
    return joined


def _say(value: Any) -> str:
    return f"[{', '.join(map(str, value))}]" if isinstance(value, list) else str(value)


def _lists(
    table: Mapping[str, Any], path: Path, above: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], list[Any]]]:
    """Keys of a table, in full, and the lists that stand there."""
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
    """Put a value where a key leads, with the tables on the way."""
    for name in key[:-1]:
        content = content.setdefault(name, {})
        if not isinstance(content, dict):
            raise CaseError(f"{path}: [sweep] {'.'.join(key)} leads through {name}, no table")
    content[key[-1]] = value


def _run_point(case: Case, folder: Path, force: bool, kept: bool) -> Point:
    """Run a point; what is refused is a sentence, not the end."""
    try:
        results = run(case, folder, force=force, sparing=not kept)
    except FileError:  # of the folder of all points
        raise
    except ConvergenceError as error:
        return Point(failure=str(error))
    except MultiscaleError as error:  # a file that is missing may be there the next time
        return Point(failure=str(error), final=False)
    except MemoryError as error:
        return Point(failure=f"not enough memory ({error}); use fewer jobs", final=False)
    found: dict[Shown, Dataset] = {one: results[one.name] for one in stages_of(case.tables)}
    answering = _answering(case)
    values = answering.compared(found[answering]).reset_coords()
    answers = tuple(name for name in answering.answers if name in values)
    kinds = ("", "_mean_law", "_one_part")
    names = [name for one in answers for kind in kinds if (name := f"{one}{kind}") in values]
    failed = (stage.failure(dataset) for stage, dataset in found.items())
    caution = "\n".join(filter(None, dict.fromkeys([*gather_cautions(found), *failed])))
    kept_values = values[names].reset_coords(drop=True).to_dict()["data_vars"]
    missing = ", ".join(unknown_terms(found[answering])) if has_budget(found[answering]) else ""
    return Point(answers, kept_values, caution, missing=missing)


def _answering(case: Case) -> Stage:
    """Return the last stage that answers something."""
    return [stage for stage in stages_of(case.tables) if stage.answers][-1]


def _join(sweep: Sweep, names: Sequence[str], store: PointStore) -> Dataset:
    """Put the points side by side, which are read one by one; what a point has not is NaN."""
    import xarray as xr

    answers: dict[str, str] = {}
    kinds: dict[str, tuple[list[str], dict[str, Any]]] = {}
    shapes: dict[str, np.ndarray] = {}
    failures, cautions, missing = [], [], []
    for k, name in enumerate(names):
        point = store.read(name)
        if not answers.keys() >= set(point.answers):
            answers |= _answering(sweep.points[k]).answers
        for own, one in point.values.items():
            kinds.setdefault(own, (one["dims"], one["attrs"]))
            shapes[own] = np.maximum(shapes.get(own, 0), np.shape(one["data"]))
        failures.append(intern(point.failure))
        cautions.append(intern(point.caution))
        missing.append(intern(point.missing))
    if all(failures):
        raise MultiscaleError(
            f"none of the {len(names)} points of the sweep has a result; at {sweep.name(0)}: "
            f"{failures[0]}"
        )
    answers = {name: label for name, label in answers.items() if name in shapes}
    tables = {own: np.full((len(names), *shape), np.nan) for own, shape in shapes.items()}
    place = np.zeros((len(names), len(answers)), dtype=int)
    for k, name in enumerate(names):
        values = store.read(name).values
        for own, one in values.items():
            data = np.array(one["data"])
            here: Any = (k, *map(slice, data.shape))
            tables[own][here] = data
        for column, answer in enumerate(answers):
            if answer in values and values[answer]["dims"]:
                place[k, column] = np.shape(values[answer]["data"])[-1] - 1
    joined = SWEEP.build(
        answer_columns(answers, tables)
        | {
            "setting": np.array(sweep.settings, dtype=str).reshape(len(names), -1),
            "folder": [f"points/{name}" for name in names],
            "failure": np.array(failures, dtype=object),
            "caution": np.array(cautions, dtype=object),
            "missing_terms": np.array(missing, dtype=object),
            "answer_place": place,
        },
        title=sweep.title,
    )
    labels = {"parameter": list(sweep.parameters), "answer": list(answers)}
    joined = joined.assign_coords(labels | _coordinates(sweep))
    found = {own: (("point", *kinds[own][0]), tables[own], kinds[own][1]) for own in tables}
    return joined.merge(xr.Dataset(found), combine_attrs="override")


def _coordinates(sweep: Sweep) -> dict[str, Any]:
    """Parameters along the points: numbers in SI units, or text."""
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
