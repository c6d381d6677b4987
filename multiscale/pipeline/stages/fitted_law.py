"""Stage: the interface law fitted to the cells of two rough bodies."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.pipeline.case_budget import case_budget
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Datasets, Job, Section, Stage
from multiscale.pipeline.stages.cells import CELLS
from multiscale.plotting.figure import on_axes
from multiscale.plotting.law_figures import plot_area_law, plot_gap_law, plot_unloading
from multiscale.schema import INTERFACE_LAW, MICRO_RESPONSE
from multiscale.upscaling import fit_branches, loading_branch, require_law, with_budget

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["FITTED_LAW"]


def _run(case: Case, found: Datasets, job: Job) -> "xr.Dataset":
    response = found[MICRO_RESPONSE.name]
    law = fit_branches(response, n_terms=case.law.terms, n_samples=case.law.samples)
    return with_budget(law, case_budget(case, loading_branch(response), law))


def _sections(found: Datasets, out: Path) -> Iterator[Section]:
    response, law = found[MICRO_RESPONSE.name], found[FITTED_LAW.name]
    figures = {
        "gap_law": on_axes(lambda ax: plot_gap_law(response, law, ax=ax)),
        "area_law": on_axes(lambda ax: plot_area_law(response, law, ax=ax)),
    }
    unloads = "unloading_stiffness_ratio" in law
    if unloads:
        figures["unloading"] = on_axes(lambda ax: plot_unloading(response, law, ax=ax))
    require_law(
        law,
        "n_realisations",
        "pressure_min",
        "pressure_max",
        "pressures_per_decade",
        "branches",
        "cross_validated_error",
        "cross_validated_stiffness_error",
        "admissibility",
    )
    yield Section(
        "Interface law",
        [
            f"The law stands for the {response.attrs['bodies']}; it rests on "
            f"{law.attrs['n_realisations']} realisations between "
            f"{1e-6 * law.attrs['pressure_min']:.4g} and "
            f"{1e-6 * law.attrs['pressure_max']:.4g} MPa, "
            f"{law.attrs['pressures_per_decade']:.2g} pressures a decade. Branches: "
            f"{law.attrs['branches']}.",
            f"At pressures that were left out of the fit it erred by up to "
            f"{100.0 * law.attrs['cross_validated_error']:.2g} % in pressure and "
            f"{100.0 * law.attrs['cross_validated_stiffness_error']:.2g} % in stiffness.",
            f"Admissibility: {law.attrs['admissibility']}.",
            *(_unloading(law) if unloads else ()),
        ],
        figures=figures,
    )


def _unloading(law: "xr.Dataset") -> list[str]:
    error = float(np.sqrt(np.mean(law["unloading_fit_error"].values ** 2)))
    return [
        f"Unloaded, it is {float(law['unloading_stiffness_ratio']):.3g} times as stiff at first as "
        f"it was under load, and springs back with the exponent "
        f"{float(law['unloading_exponent']):.3g}; at a pressure that the fit has not seen, the "
        f"spring back errs by {100.0 * error:.2g} % of its length."
    ]


FITTED_LAW = Stage(
    schema=INTERFACE_LAW,
    tables=("micro",),
    reads={"law": True, "joint": {"width"}},  # whose scales the budget compares
    takes=(CELLS,),
    run=_run,
    sections=_sections,
    pictures=("gap_law", "area_law", "unloading"),
)
