"""Stage: a ring of the two bodies that seals a liquid, and what leaks through its interface."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.needs import Choice, Needs
from multiscale.pipeline.rows import Table
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import (
    Datasets,
    Job,
    Section,
    Stage,
    StageAnswer,
    Summary,
    format_table,
)
from multiscale.pipeline.stages.fitted_law import FITTED_LAW
from multiscale.plotting.figure import on_axes
from multiscale.plotting.leakage_figures import plot_leak_rate
from multiscale.schema import INTERFACE_LAW, SEAL
from multiscale.units import readable
from multiscale.upscaling import area_from_dataset, require_law, say_sealing

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["RING_SEAL"]

PER_HOUR = 3.6e9
"""From m3/s to ml/h."""

LIFTING = 0.1
"""Mean pressure of the liquid over pressure of the ring from which it lifts the ring noticeably."""

FEWEST_CELLS = 4.0
"""Cells over the width of a ring below which it is no patchwork of many."""

HEAD = (
    "pressure (MPa)",
    "leak rate (ml/h)",
    "95 % interval",
    "aperture (µm)",
    "cells with a path (%)",
    "mean gap (µm)",
    "contact (%)",
)


def _run(case: Case, found: Datasets, job: Job) -> "xr.Dataset":
    law, seal = found[INTERFACE_LAW.name], case.seal
    assert seal is not None  # or the stage would not run
    direction = seal.direction or "both"
    across = law.sel(direction=direction)
    pressure, aperture = law["fit_pressure"].to_numpy(), across["hydraulic_aperture"].to_numpy()
    values = {
        "nominal_pressure": pressure,
        "leak_rate": seal.leak_rate(aperture),
        "hydraulic_aperture": aperture,
        "percolating_cells": across["percolating_cells"].to_numpy(),
        "mean_gap": law["fit_mean_gap"].to_numpy(),
        "contact_fraction": area_from_dataset(law).contact_fraction(pressure),
    }
    if law.sizes["sample"]:
        drawn = seal.leak_rate(across["hydraulic_aperture_sample"].to_numpy())
        values["leak_rate_mean_law"] = np.percentile(drawn, [2.5, 97.5], axis=0)
    liquid = readable(f"{seal.pressure_difference:g} Pa")
    lifted = pressure[0.5 * seal.pressure_difference > LIFTING * pressure]
    cells = seal.width / max(case.cell.size)
    cautions = [
        f"the liquid pushes the faces apart by about half of its {liquid}, more than "
        f"{100.0 * LIFTING:g} % of the pressure of the ring up to {1e-6 * pressure:.4g} MPa; this "
        f"is not counted, and the ring leaks more there"
        for pressure in lifted[-1:]
    ]
    if cells < FEWEST_CELLS:
        cautions.append(
            f"the ring is {cells:.2g} cells wide, and {FEWEST_CELLS:g} or more leak as a patchwork "
            f"of cells does; single paths across a narrow ring may leak more"
        )
    return SEAL.build(
        values,
        title=case.title,
        ring=f"A ring of {readable(f'{seal.diameter:g} m')} diameter and "
        f"{readable(f'{seal.width:g} m')} width holds back {liquid} of a liquid of "
        f"{readable(f'{seal.viscosity:g} Pa*s')}",
        sealing=say_sealing(law, direction),
        cautions="\n".join(cautions),
    )


def _needs(case: Case) -> Needs:
    return Needs(choices=(Choice("seal", "what leaks through the apertures of the law"),))


def _tabulate(result: "xr.Dataset") -> Table:
    """Head and rows at every pressure."""
    rows: list[tuple[str, ...]] = []
    for k in range(result.sizes["step"]):
        step = result.isel(step=k)
        rows.append(
            (
                f"{1e-6 * float(step['nominal_pressure']):.4g}",
                *_leak_rate(step),
                f"{1e6 * float(step['hydraulic_aperture']):.3g}",
                f"{100.0 * float(step['percolating_cells']):.3g}",
                f"{1e6 * float(step['mean_gap']):.3g}",
                f"{100.0 * float(step['contact_fraction']):.3g}",
            )
        )
    return HEAD, rows


def _leak_rate(step: "xr.Dataset") -> tuple[str, str]:
    """Leak rate of a step with the digits that its interval leaves, and the interval, ml/h."""
    value = PER_HOUR * float(step["leak_rate"])
    if np.isnan(value):
        return "unknown", ""
    if "leak_rate_mean_law" not in step:
        return f"{value:.3g}", ""
    low, high = PER_HOUR * step["leak_rate_mean_law"].to_numpy()
    return f"{value:.3g}", f"{low:.2g} ... {high:.2g}"


def _lines(found: Datasets) -> Iterator[str]:
    result = found[RING_SEAL.name]
    yield from format_table(result.attrs["title"], *_tabulate(result))
    yield result.attrs["sealing"]


def _summary(found: Datasets) -> Summary:
    """Say the middle one of the pressures, and from which one the ring is tight."""
    result = found[RING_SEAL.name]
    require_law(result, "ring", "sealing")
    step = result.isel(step=result.sizes["step"] // 2)
    rate, interval = _leak_rate(step)
    beside = f" ({interval}, 95 %)" if interval else ""
    answer = (
        f"{result.attrs['ring']}: pressed on by {1e-6 * float(step['nominal_pressure']):.4g} MPa "
        f"it leaks {rate} ml/h{beside}, while {100.0 * float(step['contact_fraction']):.3g} % of "
        f"it touches."
    )
    question = "How much leaks through the roughness under a ring, against its pressure?"
    return Summary(result.attrs["title"], question, [answer, result.attrs["sealing"]])


def _sections(found: Datasets, out: Path) -> Iterator[Section]:
    result = found[RING_SEAL.name]
    yield Section(
        "Seal",
        [
            f"{result.attrs['ring']}. {result.attrs['sealing']}",
            "The intervals count the scatter of the surfaces; the grid of the cells, which has no "
            "channels between its points, is not in them.",
        ],
        *_tabulate(result),
        figures={"leak_rate": on_axes(lambda ax: plot_leak_rate(result, ax=ax))},
    )


RING_SEAL = Stage(
    schema=SEAL,
    tables=("seal",),
    reads={"title", "seal"},
    takes=(FITTED_LAW,),
    run=_run,
    needs=_needs,
    lines=_lines,
    sections=_sections,
    summary=_summary,
    pictures=("leak_rate",),
    answers=(
        StageAnswer("nominal_pressure", "pressure", "MPa", 1e-6, drawn=False),
        StageAnswer("leak_rate", "leak rate", "ml/h", PER_HOUR, over="nominal_pressure"),
        StageAnswer("hydraulic_aperture", "aperture", "µm", 1e6, over="nominal_pressure"),
        StageAnswer("contact_fraction", "contact", "%", 100.0, over="nominal_pressure"),
    ),
)
