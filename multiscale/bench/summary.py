"""Tables of the runs of a family, and of the cheapest answers of given accuracy in all families."""

from collections.abc import Mapping

import numpy as np

from multiscale.schema import WORK_PRECISION, Dataset

TARGETS = (0.1, 0.05, 0.02, 0.01)  # relative errors of the table of cheapest answers

SETTINGS: Mapping[str, str] = {
    "points": "{:.0f} points",
    "realisations": "{:.0f} realisations",
    "time_step": "steps of {:.3g} s",
    "cables": "{:.0f} cables",
    "tolerance": "tolerance {:.2g}",
}
"""Settings of methods, with their format in the table of cheapest answers."""

COLUMNS: Mapping[str, tuple[str, str, float]] = {
    "points": ("points", ".0f", 1),
    "realisations": ("realisations", ".0f", 1),
    "time_step": ("step (ms)", ".3g", 1e3),
    "cables": ("cables", ".0f", 1),
    "unknowns": ("unknowns", ".0f", 1),
    "wall_time": ("time (s)", ".3g", 1),
    "cpu_time": ("CPU (s)", ".3g", 1),
    "peak_memory": ("memory (MB)", ".0f", 1e-6),
    "iterations": ("iterations", ".0f", 1),
    "krylov_iterations": ("linear", ".0f", 1),
    "condition_number": ("condition", ".2g", 1),
    "residual": ("residual", ".1e", 1),
    "error": ("error", ".1e", 1),
    "own_error": ("own error", ".1e", 1),
    "over_copy": ("over a copy", ".3g", 1),
    "bytes_moved": ("bytes (MB)", ".3g", 1e-6),
    "operations": ("operations (1e6)", ".3g", 1e-6),
}
"""Heading, format and factor of each variable."""


def tabulate_runs(work_precision: Dataset) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return head and rows of the runs of ``WORK_PRECISION``, without columns not measured."""
    columns = {name: column for name, column in COLUMNS.items() if name in work_precision}
    head = ("scene", "code", *(heading for heading, _, _ in columns.values()))
    rows: list[tuple[str, ...]] = []
    for k in range(work_precision.sizes["run"]):
        run = work_precision.isel(run=k)
        cells = {
            name: "" if run[name].isnull() else f"{factor * run[name].item():{form}}"
            for name, (_, form, factor) in columns.items()
        }
        if "error_uncertainty" in run and run["error"] < run["error_uncertainty"]:
            cells["error"] = f"< {run['error_uncertainty'].item():.1e}"  # of its reference
        if not run["converged"]:
            cells["error"] = f"{cells['error']} not converged".lstrip()
        rows.append((str(run["scene"].item()), str(run["method"].item()), *cells.values()))
    return head, rows


def describe_load(work_precision: Dataset) -> str:
    """Describe the load of the machine before and after the runs, which affects their times."""
    before, after = (work_precision.attrs[f"load_{when}"] for when in ("before", "after"))
    return (
        f"{before:.3g} processes before and {after:.3g} after, on {work_precision.attrs['cores']} "
        f"cores (running and queued, mean of a minute)"
    )


def join_families(families: Mapping[str, Dataset]) -> Dataset:
    """Join the runs of families, without histories; variables that were not measured are NaN."""
    import xarray as xr

    tables = []
    for family, measured in families.items():
        runs = measured.drop_dims("sample", errors="ignore").drop_vars("run").reset_coords()
        names = np.full(measured.sizes["run"], family)
        tables.append(WORK_PRECISION.assign(runs, {"family": names}))
    joined = xr.concat(tables, "run", data_vars="all", join="outer", combine_attrs="drop_conflicts")
    return WORK_PRECISION.build(
        {str(name): joined[name].values for name in joined.data_vars},
        title="error against run time",
        cautions="\n".join(filter(None, (runs.attrs["cautions"] for runs in families.values()))),
        versions="; ".join(f"{name}: {runs.attrs['versions']}" for name, runs in families.items()),
        load="; ".join(f"{name}: {describe_load(runs)}" for name, runs in families.items()),
    )


def tabulate_cheapest(
    work_precision: Dataset,
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return the cheapest method and setting of every scene for each of the ``TARGETS``."""
    head = ("scene", *(f"{100.0 * target:g} %" for target in TARGETS))
    timed_only = work_precision["error"].isnull() & (work_precision["converged"] == 1)
    scenes = dict.fromkeys(str(scene) for scene in work_precision["scene"].values[~timed_only])
    return head, [
        (scene, *(_cheapest(work_precision, scene, target) for target in TARGETS))
        for scene in scenes
    ]


def _cheapest(work_precision: Dataset, scene: str, target: float) -> str:
    """Return the name of the run of least time below an error, with its time."""
    runs = work_precision.isel(run=work_precision["scene"].values == scene)
    if "error_uncertainty" in runs and np.any(runs["error_uncertainty"] > target):
        return "unknown"
    good = runs.isel(run=((runs["converged"] == 1) & (runs["error"] <= target)).values)
    if not good.sizes["run"]:
        return "none"
    run = good.isel(run=int(np.argmin(good["wall_time"].values)))
    settings = [
        form.format(run[name].item())
        for name, form in SETTINGS.items()
        if name in run and not run[name].isnull()
    ]
    return ", ".join((str(run["method"].item()), *settings, f"{float(run['wall_time']):.2g} s"))
