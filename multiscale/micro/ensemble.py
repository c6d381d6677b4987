"""Ensembles of cells along a path, each realisation in a file that a later run takes up."""

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from pathlib import Path as FilePath
from time import perf_counter
from typing import Any

import numpy as np

from multiscale.errors import CaseError, NewerSchemaError, SchemaError
from multiscale.executors import run_jobs
from multiscale.io import make_folder, open_dataset, remove, write_dataset
from multiscale.micro.averages import SPOTS, Keep, pad_spots
from multiscale.micro.cell import WORTH, AnyCell, Checkpoint, record_cell
from multiscale.micro.path import Path
from multiscale.schema import MICRO_RESPONSE, Dataset, PlainDataset, Schema

logger = logging.getLogger(__name__)

LOCAL = frozenset({"height", "pressure", "gap"})
"""Fields that stay in the files of single realisations."""


def run_ensemble(
    cells: Sequence[AnyCell],
    path: Path,
    *,
    executor: Executor | None = None,
    folder: FilePath | None = None,
    sparing: bool = False,
    identity: str = "",
    keep_fields: bool = False,
    keep_spots: bool = False,
    keep_flow: bool = False,
    progress: Callable[[int], None] = lambda finished: None,
) -> Dataset:
    """Solve many cells along the same path.

    Parameters
    ----------
    cells : sequence of cells of any kind
    path : Path, the same for all, so that realisations can be averaged at each pressure
    executor : Executor, optional, see :func:`multiscale.executors.run_jobs`
    folder : Path, optional
        Folder of ``realisation-0000.nc`` and so on, each written when it is finished. Existing
        realisations are not computed again, nor slow finished steps of a killed realisation.
    sparing : bool
        Whether only realisations that took longer than :data:`WORTH` are stored, to resume a
        killed run.
    identity : str, origin of the cells, for instance the checksum of a case
    keep_fields : bool, keep the heights and the local fields of realisation 0, in its file
    keep_spots, keep_flow : bool
        Keep the contact spots, and the flow through the gap, of all realisations, as
        :func:`solve_cell` does.
    progress : callable, called with the number of finished realisations

    Returns
    -------
    Dataset, follows ``MICRO_RESPONSE``

    Raises
    ------
    CaseError
        If the folder contains realisations with another identity.
    MultiscaleError
        If a worker process died; finished cells remain.
    """
    response = run_realisations(
        record_realisation,
        [
            (
                cell,
                path,
                Keep(keep_fields and k == 0, keep_spots, keep_flow),
                folder and Checkpoint(_steps_of(_file_of(folder, k)), identity),
            )
            for k, cell in enumerate(cells)
        ],
        executor=executor,
        folder=folder,
        sparing=sparing,
        identity=identity,
        progress=progress,
    )
    if any(cell.small_slopes for cell in cells):
        return response
    nothing = np.zeros(response.sizes["step"])
    errors = {f"{name}_slope_error": nothing for name in ("mean_gap", "contact_fraction")}
    reason = "nothing: the mesh follows the surface"
    return MICRO_RESPONSE.assign(response, errors).assign_attrs(small_slopes=reason)


def run_realisations(
    function: Callable[..., PlainDataset],
    arguments: Sequence[tuple[Any, ...]],
    *,
    executor: Executor | None,
    folder: FilePath | None,
    sparing: bool = False,
    identity: str,
    progress: Callable[[int], None],
    name: str = "realisation",
    schema: Schema = MICRO_RESPONSE,
) -> Dataset:
    """Compute realisations, each in a separate file, and join their responses."""
    numbers = range(len(arguments))
    files = [_file_of(folder, k, name) if folder else None for k in numbers]
    results = {
        k: finished
        for k, file in enumerate(files)
        if (finished := _finished(file, identity, schema)) is not None
    }

    def finish(k: int, response: PlainDataset) -> None:
        results[k] = response
        logger.info("%s %d: %d of %d are finished", name, k, len(results), len(numbers))
        progress(len(results))

    todo = [k for k in numbers if k not in results]
    progress(len(results))
    jobs = ((k, (function, arguments[k], files[k], identity, sparing, schema)) for k in todo)
    run_jobs(_compute_and_keep, jobs, executor, finish)
    records = [results[k] for k in numbers]
    ended = "\n".join(
        f"{name} {k}: {record.attributes['ended']}"
        for k, record in enumerate(records)
        if "ended" in record.attributes
    )
    # provenance and identity stay with the files of realisations
    joined = schema.join(_without_fields(records), "realisation")
    return schema.build(joined.values, **({"ended": ended} if ended else {}))


def _without_fields(records: list[PlainDataset]) -> list[PlainDataset]:
    """Remove local fields, and pad spots of all realisations to the same number with NaN."""
    values = [
        {name: array for name, array in record.values.items() if name not in LOCAL}
        for record in records
    ]
    for name in SPOTS:
        if all(name in record for record in values):
            spots = pad_spots([record[name] for record in values], axis=2)
            values = [record | {name: rows} for record, rows in zip(values, spots, strict=True)]
    return [PlainDataset(record) for record in values]


def _compute_and_keep(
    function: Callable[..., PlainDataset],
    arguments: tuple[Any, ...],
    file: FilePath | None,
    identity: str,
    sparing: bool,
    schema: Schema,
) -> PlainDataset:
    """Compute a realisation and write its file, in sparing runs only if it took long."""
    begun = perf_counter()
    record = function(*arguments)
    if file is not None and not (sparing and perf_counter() - begun < WORTH):
        make_folder(file.parent)
        response = schema.build(record.values, **record.attributes)
        write_dataset(response, file, schema, identity=identity)
        remove(_steps_of(file))
    return record


def _finished(file: FilePath | None, identity: str, schema: Schema) -> PlainDataset | None:
    """Return the response of a realisation computed before, if its file is valid."""
    if file is None or not file.exists():
        return None
    try:
        response = open_dataset(file, schema)
    except NewerSchemaError:
        raise
    except SchemaError:  # damaged or of an earlier version: computed again
        return None
    if response.attrs.get("identity") != identity:
        raise CaseError(
            f"{file} was computed for another case; choose another folder, or delete "
            f"{file.parent} to compute it again"
        )
    return schema.plain(response)


def _file_of(folder: FilePath, k: int, name: str = "realisation") -> FilePath:
    return folder / f"{name}-{k:04d}.nc"


def _steps_of(file: FilePath) -> FilePath:
    return file.with_name(f".{file.stem}.npz")


def record_realisation(
    cell: AnyCell,
    path: Path,
    keep: Keep,
    checkpoint: Checkpoint | None = None,
    *,
    tolerance: float = 1e-8,
) -> PlainDataset:
    """Solve a cell and add the statistics of its surface."""
    record = record_cell(cell, path, keep, tolerance=tolerance, checkpoint=checkpoint)
    statistics = cell.surface_record(heights=keep.fields)
    return PlainDataset({**record.values, **statistics}, record.attributes)
