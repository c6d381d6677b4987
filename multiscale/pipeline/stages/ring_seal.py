"""Stage: a ring of the two bodies that seals a liquid, and its leak rate."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from multiscale.needs import Choice, Needs
from multiscale.pipeline.showing import Table, View
from multiscale.pipeline.stage import Datasets, Job, Section, Stage
from multiscale.pipeline.stages.fitted_law import FITTED_LAW
from multiscale.pipeline.tables.settings import Case
from multiscale.schema import INTERFACE_LAW, SEAL, Dataset
from multiscale.units import readable
from multiscale.upscaling import area_from_dataset, say_sealing

LIFTING = 0.1  # mean pressure of the liquid over contact pressure from which lifting matters
FEWEST_CELLS = 4.0  # cells over the width of a ring that a patchwork of cells needs

ANSWERS = (
    "nominal_pressure",
    "leak_rate",
    "hydraulic_aperture",
    "percolating_cells",
    "mean_gap",
    "contact_fraction",
)

TABLE = Table((*ANSWERS, "leak_rate:mean_law"), {"leak_rate:mean_law": "leak rate, 95 % ({unit})"})

SENTENCE = (
    "{ring}. At a contact pressure of {nominal_pressure} the leak rate is {leak_rate} (95 % "
    "interval: {leak_rate:mean_law}), and the real contact area is {contact_fraction} of the "
    "nominal area."
)


def _run(case: Case, datasets: Datasets, job: Job) -> Dataset:
    law, seal = datasets[INTERFACE_LAW.name], case.seal
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
        f"the mean pressure of the liquid on the faces, about half of its {liquid}, is more than "
        f"{100.0 * LIFTING:g} % of contact pressures up to {1e-6 * pressure:.4g} MPa; this lifting "
        f"is not included, and the leak rate is larger there"
        for pressure in lifted[-1:]
    ]
    cells = seal.width / max(case.cell.size)
    if cells < FEWEST_CELLS:
        cautions.append(
            f"the ring is {cells:.2g} cells wide, and the mean over cells needs {FEWEST_CELLS:g} "
            f"or more; single leak paths across a narrower ring may leak more"
        )
    low, high = law["hydraulic_aperture_mean_law"].sel(direction=["x", "y"]).to_numpy()
    apart = np.max(low, axis=0) > np.min(high, axis=0)  # the intervals along x and y
    if seal.direction is None and apart.mean() > 0.5:
        cautions.append(
            "hydraulic apertures along x and y differ, and the leak rate uses a common aperture; "
            "give the axis across the ring as direction in [seal]"
        )
    return SEAL.build(
        values,
        title=case.title,
        ring=f"A ring of {readable(f'{seal.diameter:g} m')} diameter and "
        f"{readable(f'{seal.width:g} m')} width seals a pressure difference of {liquid} in a "
        f"liquid with a viscosity of {readable(f'{seal.viscosity:g} Pa*s')}",
        sealing=say_sealing(law, direction),
        intervals=law.attrs["leakage_intervals"],
        cautions="\n".join(cautions),
    )


def _sections(datasets: Datasets, out: Path) -> Iterator[Section]:
    result = datasets[RING_SEAL.name]
    yield Section("Seal", [result.attrs.get("intervals", "")], *TABLE.rows(result))


def _answer(result: Dataset) -> Iterator[str]:
    step = result.isel(step=result.sizes["step"] // 2)
    return View(result).sentences(step, SENTENCE, "{sealing}")


RING_SEAL = Stage(
    schema=SEAL,
    tables=("seal",),
    reads={"title", "seal"},
    takes=(FITTED_LAW,),
    run=_run,
    needs=lambda case: Needs(
        choices=(Choice("seal", "leak rate through the hydraulic apertures of the law"),)
    ),
    question="How does the leak rate through the roughness under a ring depend on its pressure?",
    answer=_answer,
    sections=_sections,
    answers=ANSWERS,
)
