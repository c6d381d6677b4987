"""Many cases in one file: every combination of the values that it lists, each run by itself."""

import hashlib
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import product
from math import prod
from operator import getitem
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.errors import CaseError, MultiscaleError, SchemaError
from multiscale.executors import run_jobs
from multiscale.io import make_folder, remove, write_bytes, write_dataset
from multiscale.pipeline.case import AnyCase, find_case, read_case, validate_case
from multiscale.pipeline.run import run
from multiscale.pipeline.run_folder import gather_cautions, open_stages
from multiscale.pipeline.stages.joint import JOINT, STIFFNESSES
from multiscale.pipeline.sweep_points import POINTS, name_point
from multiscale.pipeline.toml_model import read_toml
from multiscale.schema import MACRO_RESULT, SWEEP

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Sweep", "load_sweep", "run_sweep"]

MOST_POINTS = 100_000

RESULT = ("preload", *STIFFNESSES, "mean_gap", "contact_fraction", "real_pressure")
"""Kept of each point; the rest is in its folder."""

logger = logging.getLogger(__name__)


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
        texts = (case.to_toml().encode() for case in self.points)
        return [out / "points" / hashlib.sha256(text).hexdigest()[:12] for text in texts]


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
        said = tuple(str(value) for value in values)
        point = deepcopy(content)
        for key, value in zip(lists, values, strict=True):
            _set(point, key, value, path)
        if lists:
            point["title"] = f"{content.get('title', '')}: {name_point(parameters, said)}"
        points.append(validate_case(point, path))
        if lists and not JOINT.asked_for(points[-1].tables):
            raise CaseError(
                f"{path}: [sweep] varies joints of blocks, and the case has no [structure] of kind "
                f'"blocks"'
            )
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
        Follows ``SWEEP``, with the parameters as coordinates of ``point``: in SI units where they
        are numbers. A point without result is NaN, with its failure as text.

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
    found: dict[int, tuple[xr.Dataset | None, str]] = {}

    def finish(k: int, result: "tuple[xr.Dataset | None, str]") -> None:
        found[k] = result
        logger.info("%s: %s", names[k], result[1] or "finished")
        progress(len(found))

    for k, folder in enumerate(() if force else folders):
        try:
            kept = _read_point(folder)
        except SchemaError:  # missing, damaged or of another version: run again
            continue
        if kept["converged"].values.any():
            found[k] = kept, ""
    progress(len(found))
    jobs = {k: (case, folders[k], force) for k, case in enumerate(sweep.points) if k not in found}
    run_jobs(_run_point, jobs, executor, finish)
    results, failures = zip(*(found[k] for k in range(len(folders))), strict=True)
    if all(failures):
        raise MultiscaleError(
            f"none of the {len(folders)} points of the sweep has a result; at {names[0]}: "
            f"{failures[0]}"
        )
    joined = _join(sweep, results, failures, [path.name for path in folders])
    write_dataset(joined, out / POINTS.file, SWEEP)
    return joined


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


def _run_point(case: AnyCase, folder: Path, force: bool) -> "tuple[xr.Dataset | None, str]":
    """Run a point; what is refused is a sentence, not the end."""
    try:
        run(case, folder, force=force)
        return _read_point(folder), ""
    except MultiscaleError as error:
        return None, str(error)


def _read_point(folder: Path) -> "xr.Dataset":
    """Open the result of a point, with the cautions of its whole run."""
    found = open_stages(folder)
    (result,) = (data for stage, data in found.items() if stage.schema is MACRO_RESULT)
    return result.assign_attrs(cautions="\n".join(gather_cautions(found)))


def _join(
    sweep: Sweep,
    results: "Sequence[xr.Dataset | None]",
    failures: Sequence[str],
    folders: list[str],
) -> "xr.Dataset":
    steps = max(result.sizes["step"] for result in results if result is not None)
    shape = (len(results), steps)
    values: dict[str, Any] = {name: np.full(shape, np.nan) for name in RESULT}
    values["error_total"] = np.full((shape[0], len(STIFFNESSES), steps), np.nan)
    low, high = np.full((2, *shape), np.nan)
    converged = np.zeros(shape, dtype=int)
    for k, result in enumerate(results):
        if result is None:
            continue
        here = (k, slice(result.sizes["step"]))
        converged[here] = result["converged"].values
        for name in RESULT:
            values[name][here] = result[name].values
        if "error_total" in result:
            chosen = result["error_total"].sel(quantity=list(STIFFNESSES))
            values["error_total"][k, :, : result.sizes["step"]] = chosen.values
        if "joint_stiffness_sample" in result:
            known = np.flatnonzero(np.isfinite(result["joint_stiffness"].values))
            drawn = result["joint_stiffness_sample"].values[:, known]
            low[k, known], high[k, known] = np.nanpercentile(drawn, (2.5, 97.5), axis=0)
    joined = SWEEP.build(
        values
        | {
            "setting": np.array(sweep.settings, dtype=str).reshape(len(results), -1),
            "folder": [f"points/{name}" for name in folders],
            "failure": list(failures),
            "caution": ["" if one is None else one.attrs["cautions"] for one in results],
            "converged": converged,
            "joint_stiffness_low": low,
            "joint_stiffness_high": high,
        },
        title=sweep.title,
    )
    labels = {"parameter": list(sweep.parameters), "quantity": list(STIFFNESSES)}
    return joined.assign_coords(labels | _coordinates(sweep))


def _coordinates(sweep: Sweep) -> dict[str, Any]:
    """Parameters along the points: numbers in SI units, or text."""
    dumps = [case.model_dump(mode="json") for case in sweep.points]
    coordinates: dict[str, Any] = {}
    for column, name in enumerate(sweep.parameters):
        values = [reduce(getitem, name.split("."), dump) for dump in dumps]
        parts = [str(value).split(" ", maxsplit=1) for value in values]
        try:
            numbers = [float(part[0]) for part in parts]
        except ValueError:
            texts = [setting[column] for setting in sweep.settings]
            coordinates[name] = ("point", texts, {"long_name": name})
            continue
        unit = parts[0][1] if len(parts[0]) > 1 else "1"
        coordinates[name] = ("point", numbers, {"units": unit, "long_name": name})
    return coordinates
