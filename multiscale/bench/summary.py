"""All families in one dataset, and the cheapest way to an answer of a given accuracy."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from multiscale.schema import WORK_PRECISION

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["TARGETS", "join_families", "tabulate_cheapest"]

TARGETS = (0.1, 0.05, 0.02, 0.01)
"""Relative errors of the table of cheapest answers."""

SETTINGS: Mapping[str, str] = {
    "points": "{:.0f} points",
    "realisations": "{:.0f} realisations",
    "time_step": "steps of {:.3g} s",
    "cables": "{:.0f} cables",
    "tolerance": "tolerance {:.2g}",
}
"""Settings of methods, with their format in the table."""


def join_families(families: Mapping[str, "xr.Dataset"]) -> "xr.Dataset":
    """Join the runs of several families, without their histories.

    The dataset follows ``WORK_PRECISION``, with ``family``; NaN where a family did not measure a
    variable.
    """
    import xarray as xr

    parts = []
    for family, measured in families.items():
        runs = measured.drop_dims("sample", errors="ignore").drop_vars("run").reset_coords()
        names = np.full(measured.sizes["run"], family)
        parts.append(WORK_PRECISION.assign(runs, {"family": names}))
    joined = xr.concat(parts, "run", data_vars="all", join="outer", combine_attrs="drop_conflicts")
    return WORK_PRECISION.build(
        {str(name): joined[name].values for name in joined.data_vars},
        title="error against run time",
        cautions="\n".join(
            found.attrs["cautions"] for found in families.values() if found.attrs["cautions"]
        ),
        versions="; ".join(
            f"{family}: {found.attrs['versions']}" for family, found in families.items()
        ),
    )


def tabulate_cheapest(
    work_precision: "xr.Dataset",
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return the cheapest method and setting of every scene for each error that may be asked for.

    Of the dataset of :func:`join_families`, head and one row for each scene; "none" where no run
    reached the error, "unknown" where the reference is less certain.
    """
    head = ("scene", *(f"{100.0 * target:g} %" for target in TARGETS))
    scenes = dict.fromkeys(str(scene) for scene in work_precision["scene"].values)
    return head, [
        (scene, *(_cheapest(work_precision, scene, target) for target in TARGETS))
        for scene in scenes
    ]


def _cheapest(work_precision: "xr.Dataset", scene: str, target: float) -> str:
    """Name the run of least time below an error, with its time."""
    runs = work_precision["scene"].values == scene
    uncertainty = work_precision.get("error_uncertainty")
    if uncertainty is not None and np.any(uncertainty.values[runs] > target):
        return "unknown"
    good = runs & (work_precision["converged"].values == 1)
    good &= work_precision["error"].values <= target
    if not good.any():
        return "none"
    times = np.where(good, work_precision["wall_time"].values, np.inf)
    run = work_precision.isel(run=int(np.argmin(times)))
    settings = [
        form.format(run[name].item())
        for name, form in SETTINGS.items()
        if name in run and not run[name].isnull()
    ]
    return ", ".join((str(run["method"].item()), *settings, f"{float(run['wall_time']):.2g} s"))
