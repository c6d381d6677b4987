"""Stage: a ring of the two bodies that seals a liquid, and what leaks through its interface."""

from collections.abc import Iterator
from pathlib import Path

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
from multiscale.schema import INTERFACE_LAW, SEAL, Dataset
from multiscale.units import readable
from multiscale.upscaling import area_from_dataset, say_sealing

__all__ = ["RING_SEAL"]

PER_HOUR = 3.6e9  # from m3/s to ml/h

LIFTING = 0.1
"""Mean pressure of the liquid over pressure of the ring from which it lifts the ring noticeably."""

FEWEST_CELLS = 4.0
"""Cells over the width of a ring below which it is no patchwork of many."""

LEAK_RATE = StageAnswer("leak_rate", "leak rate", "ml/h", PER_HOUR, over="nominal_pressure")

ANSWERS = (
    StageAnswer("nominal_pressure", "pressure", "MPa", 1e-6, drawn=False),
    LEAK_RATE,
    StageAnswer("hydraulic_aperture", "aperture", "µm", 1e6, over="nominal_pressure"),
    StageAnswer("percolating_cells", "cells with a path", "%", 100.0, over="nominal_pressure"),
    StageAnswer("mean_gap", "mean gap", "µm", 1e6, over="nominal_pressure"),
    StageAnswer("contact_fraction", "contact", "%", 100.0, over="nominal_pressure"),
)


def _run(case: Case, found: Datasets, job: Job) -> Dataset:
    law, seal = found[INTERFACE_LAW.name], case.seal
    pressure, direction = law["fit_pressure"].to_numpy(), seal.direction or "both"
    across = law.sel(direction=direction)
    values = {
        "nominal_pressure": pressure,
        "leak_rate": seal.leak_rate(across["hydraulic_aperture"].to_numpy()),
        "leak_rate_mean_law": seal.leak_rate(across["hydraulic_aperture_mean_law"].to_numpy()),
        "hydraulic_aperture": across["hydraulic_aperture"].to_numpy(),
        "percolating_cells": across["percolating_cells"].to_numpy(),
        "mean_gap": law["fit_mean_gap"].to_numpy(),
        "contact_fraction": area_from_dataset(law).contact_fraction(pressure),
    }
    liquid = readable(f"{seal.pressure_difference:g} Pa")
    lifted = pressure[0.5 * seal.pressure_difference > LIFTING * pressure]
    cautions = [
        f"the liquid pushes the faces apart by about half of its {liquid}, more than "
        f"{100.0 * LIFTING:g} % of the pressure of the ring up to {1e-6 * pressure:.4g} MPa; this "
        f"is not counted, and the ring leaks more there"
        for pressure in lifted[-1:]
    ]
    cells = seal.width / max(case.cell.size)
    if cells < FEWEST_CELLS:
        cautions.append(
            f"the ring is {cells:.2g} cells wide, and {FEWEST_CELLS:g} or more leak as a patchwork "
            f"of cells does; single paths across a narrow ring may leak more"
        )
    low, high = law["hydraulic_aperture_mean_law"].sel(direction=["x", "y"]).to_numpy()
    apart = np.max(low, axis=0) > np.min(high, axis=0)  # the intervals along x and y
    if seal.direction is None and apart.mean() > 0.5:
        cautions.append(
            "the interface lets through another aperture along x than along y, and both are taken "
            "as alike; name the axis across the ring by direction in [seal]"
        )
    return SEAL.build(
        values,
        title=case.title,
        ring=f"A ring of {readable(f'{seal.diameter:g} m')} diameter and "
        f"{readable(f'{seal.width:g} m')} width holds back {liquid} of a liquid of "
        f"{readable(f'{seal.viscosity:g} Pa*s')}",
        sealing=say_sealing(law, direction),
        intervals=law.attrs["leakage_intervals"],
        cautions="\n".join(cautions),
    )


def _tabulate(result: Dataset) -> Table:
    """Head and rows of the answers at every pressure, and the interval of the leak rate."""
    head = (*(f"{one.label} ({one.unit})" for one in ANSWERS), "leak rate, 95 % (ml/h)")
    steps = [result.isel(step=k) for k in range(result.sizes["step"])]
    return head, [(*(_say(step, one) for one in ANSWERS), _interval(step)) for step in steps]


def _say(step: Dataset, answer: StageAnswer) -> str:
    """Write an answer; the digits of a leak rate are those of its interval."""
    value, digits = answer.scale * float(step[answer.name]), 2 if answer is LEAK_RATE else 3
    return "unknown" if np.isnan(value) else f"{value:.{digits}g}"


def _interval(step: Dataset) -> str:
    low, high = PER_HOUR * step["leak_rate_mean_law"].to_numpy()
    return f"{low:.2g} ... {high:.2g}" if np.isfinite(low) else "unknown"


def _lines(result: Dataset) -> Iterator[str]:
    yield from format_table(result.attrs["title"], *_tabulate(result))
    yield result.attrs["sealing"]


def _summary(result: Dataset) -> Summary:
    """Say the middle one of the pressures, and from which one the ring is tight."""
    told, step = result.attrs, result.isel(step=result.sizes["step"] // 2)
    leak = _say(step, LEAK_RATE)
    answer = (
        f"{told['ring']}: pressed on by {1e-6 * float(step['nominal_pressure']):.4g} MPa it leaks "
        f"{leak} ml/h (95 % interval: {_interval(step)}), while "
        f"{100.0 * float(step['contact_fraction']):.3g} % of it touches."
    )
    question = "How much leaks through the roughness under a ring, against its pressure?"
    return Summary(question, [answer, told["sealing"]])


def _sections(found: Datasets, out: Path) -> Iterator[Section]:
    result = found[RING_SEAL.name]
    yield Section("Seal", [result.attrs.get("intervals", "")], *_tabulate(result))


RING_SEAL = Stage(
    schema=SEAL,
    tables=("seal",),
    reads={"title", "seal"},
    takes=(FITTED_LAW,),
    run=_run,
    needs=lambda case: Needs(choices=(Choice("seal", "what leaks through apertures of the law"),)),
    lines=_lines,
    sections=_sections,
    summary=_summary,
    answers=ANSWERS,
)
