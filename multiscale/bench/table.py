"""A work-precision dataset as rows of text."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["tabulate_runs"]

COLUMNS: Mapping[str, tuple[str, str, float]] = {
    "points": ("points", "d", 1),
    "realisations": ("realisations", "d", 1),
    "time_step": ("step (ms)", ".3g", 1e3),
    "cables": ("cables", "d", 1),
    "unknowns": ("unknowns", ".0f", 1),
    "wall_time": ("time (s)", ".3g", 1),
    "peak_memory": ("memory (MB)", ".0f", 1e-6),
    "iterations": ("iterations", ".0f", 1),
    "residual": ("residual", ".1e", 1),
    "error": ("error", ".1e", 1),
    "own_error": ("own error", ".1e", 1),
    "over_copy": ("over a copy", ".3g", 1),
    "bytes_moved": ("bytes (MB)", ".3g", 1e-6),
    "operations": ("operations (1e6)", ".3g", 1e-6),
    "effectivity": ("effectivity", ".2g", 1),
}
"""Heading, format and factor of each variable."""


def tabulate_runs(work_precision: "xr.Dataset") -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return the runs as rows of text under a head, without columns that were not measured.

    Parameters
    ----------
    work_precision : Dataset
        Follows ``WORK_PRECISION``, with ``scene`` and ``method``.

    Returns
    -------
    head : tuple of str
    rows : list of tuple of str
        One for each run.
    """
    columns = {name: column for name, column in COLUMNS.items() if name in work_precision}
    head = ("scene", "code", *(heading for heading, _, _ in columns.values()))
    rows: list[tuple[str, ...]] = []
    for k in range(work_precision.sizes["run"]):
        run = work_precision.isel(run=k)
        cells = {
            name: "" if run[name].isnull() else f"{factor * run[name].item():{form}}"
            for name, (_, form, factor) in columns.items()
        }
        if not run["converged"]:
            cells["error"] = f"{cells['error']} not converged".lstrip()
        rows.append((str(run["scene"].item()), str(run["method"].item()), *cells.values()))
    return head, rows
