"""Many cases in one file: every combination of the values that it lists, each run by itself."""

import logging
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import product
from math import prod
from operator import getitem
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.errors import CaseError, MultiscaleError
from multiscale.executors import run_jobs
from multiscale.io import make_folder, open_dataset, remove, write_bytes, write_dataset
from multiscale.pipeline.case import AnyCase, find_case, read_case, validate_case
from multiscale.pipeline.run import run
from multiscale.pipeline.run_folder import gather_cautions
from multiscale.pipeline.stage import Shown, StageAnswer
from multiscale.pipeline.stages import stages_of
from multiscale.pipeline.sweep_points import POINTS, name_point
from multiscale.pipeline.toml_model import read_toml
from multiscale.schema import SWEEP

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Sweep", "load_sweep", "run_sweep"]

MOST_POINTS = 100_000

MOST_LETTERS = 60  # of the name of a folder, beside its checksum

NUMBERS = ((), ("limit",))
"""Last dimensions of an answer that is one number, and of its intervals."""

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class _Point:
    """What a point has left: its answers with their values, or why it has none."""

    answers: tuple[StageAnswer, ...] = ()
    values: "xr.Dataset | None" = None
    caution: str = ""
    failure: str = ""


@dataclass(frozen=True)
class Sweep:
    """Cases that differ in some values.

    Attributes
    ----------
    title : str
    parameters : tuple of str
        Keys that vary, such as ``"cell.points"``; none in a file without ``[sweep]``.
    points : tuple of Case or TyreCase
        Every combination of the values, the last key fastest.
    settings : tuple of tuple of str, for each point the values, as the file says them
    content : dict
        What the file says, with ``[sweep]`` where it has one; empty if it is from no file.
    """

    title: str
    parameters: tuple[str, ...]
    points: tuple[AnyCase, ...]
    settings: tuple[tuple[str, ...], ...]
    content: dict[str, Any] = field(default_factory=dict)

    def quick(self) -> "Sweep":
        """Return the same sweep of quick cases."""
        title = f"{self.title} (quick)"
        points = tuple(case.quick() for case in self.points)
        return replace(self, title=title, points=points, content=self.content | {"title": title})

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
    count = prod(len(values) for values in lists.values())
    if count > MOST_POINTS:
        raise CaseError(
            f"{path}: [sweep] makes {count} points; list fewer values, at most {MOST_POINTS} points"
        )
    parameters = tuple(".".join(key) for key in lists)
    points, settings = [], []
    for values in product(*lists.values()):
        said = tuple(map(_say, values))
        point = deepcopy(content)
        for key, value in zip(lists, values, strict=True):
            _set(point, key, value, path)
        if lists:
            point["title"] = f"{content.get('title', '')}: {name_point(parameters, said)}"
        points.append(validate_case(point, path))
        settings.append(said)
    return Sweep(
        str(content.get("title", points[0].title)),
        parameters,
        tuple(points),
        tuple(settings),
        whole,
    )


def run_sweep(
    sweep: Sweep,
    out: str | Path,
    *,
    executor: Executor | None = None,
    progress: Callable[[int], None] = lambda finished: None,
    force: bool = False,
) -> "xr.Dataset":
    """Run every point of a sweep in its own folder, and join the results.

    Parameters
    ----------
    sweep : Sweep
    out : path
        Gets ``sweep.nc`` and the folder ``points``. Finished points and cells found there are
        kept, also those of another sweep.
    executor : Executor, optional
        See :func:`multiscale.executors.run_jobs`; a point is one job.
    progress : callable
        Gets the number of finished points.
    force : bool, default False
        Whether all points are computed anew, also finished ones.

    Returns
    -------
    Dataset
        Follows ``SWEEP``: every answer of the last stage that has any, with its intervals, and the
        parameters as coordinates of ``point``, in SI units where they are numbers. A point without
        result is NaN, with its failure as text.

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
    write_bytes(file, tomli_w.dumps({"title": sweep.title, "sweep": {}} | sweep.content).encode())
    folders = sweep.folders(out)
    names = [name_point(sweep.parameters, setting) for setting in sweep.settings]
    found: dict[int, _Point] = {}

    def finish(k: int, point: _Point) -> None:
        found[k] = point
        logger.info("%s: %s", names[k], point.failure or "finished")
        progress(len(found))

    for k, folder in enumerate(() if force else folders):
        with suppress(MultiscaleError):  # missing, damaged or of another version: run again
            found[k] = _read_point(sweep.points[k], folder)
    progress(len(found))
    jobs = {k: (case, folders[k], force) for k, case in enumerate(sweep.points) if k not in found}
    run_jobs(_run_point, jobs, executor, finish)
    points = [found[k] for k in range(len(folders))]
    if all(point.failure for point in points):
        raise MultiscaleError(
            f"none of the {len(folders)} points of the sweep has a result; at {names[0]}: "
            f"{points[0].failure}"
        )
    joined = _join(sweep, points, [path.name for path in folders])
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


def _run_point(case: AnyCase, folder: Path, force: bool) -> _Point:
    """Run a point; what is refused is a sentence, not the end."""
    try:
        run(case, folder, force=force)
        return _read_point(case, folder)
    except MultiscaleError as error:
        return _Point(failure=str(error))
    except MemoryError as error:
        return _Point(failure=f"not enough memory ({error}); use fewer points or jobs")


def _read_point(case: AnyCase, folder: Path) -> _Point:
    """Open the answers of a finished point, with the cautions of its whole run.

    Raises
    ------
    MultiscaleError
        If a dataset is missing or refused, or answers nothing.
    """
    stages = stages_of(case.tables)
    found: dict[Shown, xr.Dataset] = {}
    for stage in stages:
        found[stage] = open_dataset(folder / stage.file, stage.schema)
        stage.check(found[stage])
    answering = [stage for stage in stages if stage.answers][-1]
    values = answering.compared(found[answering])
    answers = tuple(one for one in answering.answers if one.name in values.variables)
    kept = [name for one in answers for name in _with_intervals(one.name) if name in values]
    failed = (stage.failure(dataset) for stage, dataset in found.items())
    caution = "\n".join(filter(None, dict.fromkeys([*gather_cautions(found), *failed])))
    return _Point(answers, values.reset_coords()[kept], caution)


def _with_intervals(name: str) -> tuple[str, str, str]:
    return name, f"{name}_mean_law", f"{name}_one_part"


def _join(sweep: Sweep, points: Sequence[_Point], folders: list[str]) -> "xr.Dataset":
    """Put the points side by side; what a point has not is NaN."""
    import xarray as xr

    answers = {one.name: one for point in points for one in point.answers}
    place = np.zeros((len(points), len(answers)), dtype=int)
    values = {}
    for column, name in enumerate(answers):
        for own in _with_intervals(name):
            found = [None if one.values is None else one.values.get(own) for one in points]
            first = next((one for one in found if one is not None), None)
            if first is None:
                continue
            shape = np.max([one.shape for one in found if one is not None], axis=0).astype(int)
            table = np.full((len(points), *shape), np.nan)
            for k, one in enumerate(found):
                if one is not None:
                    here: Any = (k, *map(slice, one.shape))
                    table[here] = one.to_numpy()
                    place[k, column] = one.shape[-1] - 1 if one.dims[-1:] not in NUMBERS else 0
            values[own] = (("point", *first.dims), table, first.attrs)
    shown = {name: one.shown(values[name][1]) for name, one in answers.items()}
    columns = {
        column: [getattr(one, column) for one in answers.values()]
        for column in ("label", "over", "drawn")
    }
    columns |= {"unit": [one.name for one in shown.values()]}
    columns |= {"scale": [one.scale for one in shown.values()]}
    joined = SWEEP.build(
        {
            "setting": np.array(sweep.settings, dtype=str).reshape(len(points), -1),
            "folder": [f"points/{name}" for name in folders],
            "failure": [one.failure for one in points],
            "caution": [one.caution for one in points],
            "answer_place": place,
        }
        | {f"answer_{column}": said for column, said in columns.items()},
        title=sweep.title,
    )
    labels = {"parameter": list(sweep.parameters), "answer": list(answers)}
    joined = joined.assign_coords(labels | _coordinates(sweep))
    return joined.merge(xr.Dataset(values), combine_attrs="override")


def _coordinates(sweep: Sweep) -> dict[str, Any]:
    """Parameters along the points: numbers in SI units, or text."""
    dumps = [case.model_dump() for case in sweep.points]
    coordinates: dict[str, Any] = {}
    for column, name in enumerate(sweep.parameters):
        values = [reduce(getitem, name.split("."), dump) for dump in dumps]
        try:
            numbers = [float(str(value)) for value in values]  # true and false are text
        except ValueError:
            texts = [setting[column] for setting in sweep.settings]
            coordinates[name] = ("point", texts, {"long_name": name})
            continue
        unit = getattr(values[0], "unit", "1")
        coordinates[name] = ("point", numbers, {"units": unit, "long_name": name})
    return coordinates
