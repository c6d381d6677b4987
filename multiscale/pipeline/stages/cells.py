"""Stage: the cells of two rough bodies, pressed together."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.io import open_dataset
from multiscale.micro.cell_needs import cell_needs
from multiscale.needs import Choice, Needs
from multiscale.pipeline.case_cells import cell_of
from multiscale.pipeline.case_response import run_micro
from multiscale.pipeline.forecast import GRIDS, REALISATIONS, SIZES
from multiscale.pipeline.rough_bodies import InstrumentSurface
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Datasets, Job, Section, Stage, format_table
from multiscale.plotting.figure import on_axes
from multiscale.plotting.surface_figures import plot_contact_map, plot_surface
from multiscale.schema import FIELDS, MICRO_RESPONSE
from multiscale.surfaces.surface import Surface

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["CELLS", "count_cells", "list_cutoffs", "tabulate_roughness"]

HEAD = (
    "measured",
    "rms height (µm)",
    "rms slope",
    "longest wave (µm)",
    "shortest wave (µm)",
    "filled (%)",
)


def _run(case: Case, found: Datasets, job: Job) -> "xr.Dataset":
    return run_micro(case, job.out / CELLS.file, executor=job.executor, progress=job.progress)


def _needs(case: Case) -> Needs:
    cell = cell_of(case, Surface(np.zeros(case.cell.points), case.cell.size))
    needs = cell_needs(cell, keep_fields=True)
    measured = any(isinstance(body.surface, InstrumentSurface) for body in case.bodies)
    reader = ("SurfaceTopography",) if measured else ()
    nx, ny = case.cell.points
    cells = Choice(
        "cells",
        f"{case.micro.realisations} of {nx} x {ny} points, each under "
        f"{len(case.micro.path)} pressures",
    )
    planner = Choice(
        "planner",
        "starts from these cells, whose memory this is, and chooses size, grid and number of "
        f"those of the answer: at most {2 ** SIZES[-1]} times as large, {2 ** GRIDS[-1]} times "
        f"as fine, {REALISATIONS[-1]}",
    )
    return replace(
        needs,
        choices=(cells, *needs.choices, *([planner] if case.accuracy is not None else [])),
        libraries=(*needs.libraries, *reader),
    )


def tabulate_roughness(response: "xr.Dataset") -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return head and rows of text: each measured body as map, windows and cells; none if none.

    Parameters
    ----------
    response : Dataset
        Follows ``MICRO_RESPONSE``.
    """
    rows: list[tuple[str, ...]] = []
    for body in response["body"].values if "body" in response.dims else ():
        one = response.sel(body=body)
        windows = ", ".join(f"{100.0 * share:.2g}" for share in one["filled_share"].values)
        filled = {"map": f"{100.0 * float(one['map_filled_share']):.2g}", "windows": windows}
        for stage in map(str, one["stage"].values):
            at = one.sel(stage=stage)
            rows.append(
                (
                    f"{body} {stage}",
                    f"{1e6 * float(at['body_rms_height']):.3g}",
                    f"{float(at['body_rms_slope']):.3g}",
                    f"{1e6 * float(at['body_longest_wave']):.3g}",
                    f"{1e6 * float(at['body_shortest_wave']):.3g}",
                    filled.get(stage, ""),
                )
            )
    return HEAD, rows


def list_cutoffs(response: "xr.Dataset") -> list[str]:
    """Say of each measured body which waves its cells leave out."""
    return [
        f"The cells of {body} keep the waves down to {response.attrs[f'cutoff_{body}']}."
        for body in (response["body"].values if "body" in response.dims else ())
    ]


def count_cells(found: Datasets) -> list[tuple[str, str]]:
    """Return rows that say how many steps of the cells converged, and in which time."""
    response = found[MICRO_RESPONSE.name]
    converged = response["converged"].values
    return [
        ("cell steps", f"{int((converged == 1).sum())} of {converged.size} converged"),
        ("solver time of the cells", f"{float(response['wall_time'].sum()):.1f} s"),
    ]


def _lines(found: Datasets) -> list[str]:
    response = found[CELLS.name]
    head, rows = tabulate_roughness(response)
    return format_table(" ".join(list_cutoffs(response)), head, rows) if rows else []


def _sections(found: Datasets, out: Path) -> Iterator[Section]:
    response = found[CELLS.name]

    def draw(plot: "Callable[..., Axes]") -> Callable[[Path], Path]:
        return on_axes(lambda ax: plot(open_dataset(out / "fields" / "fields.nc", FIELDS), ax=ax))

    yield Section(
        "Surface",
        list_cutoffs(response),
        *tabulate_roughness(response),
        figures={"surface": draw(plot_surface), "contact_map": draw(plot_contact_map)},
    )


CELLS = Stage(
    schema=MICRO_RESPONSE,
    tables=("micro",),
    run=_run,
    needs=_needs,
    lines=_lines,
    sections=_sections,
    pictures=("surface", "contact_map"),
    work=count_cells,
)
