"""Check of a finished run by computing its first realisation again."""

from pathlib import Path

import numpy as np

from multiscale.errors import CaseError, ConvergenceError
from multiscale.io import open_dataset
from multiscale.pipeline.case import load_case
from multiscale.pipeline.stage import Job
from multiscale.pipeline.stages import ACCURACY_STAGE, COMPUTED, stages_of
from multiscale.pipeline.stages.accuracy import planned_case
from multiscale.pipeline.tables.toml_model import read_toml

SAME = 1e-6  # largest difference of two solutions of the same cell, over the largest value


def verify_run(out: Path) -> str:
    """Compute the first realisation of a finished run again, and report the largest difference."""
    content = read_toml(out / "case.toml")
    if "sweep" in content:
        raise CaseError(f"{out}: contains a sweep; verify the folder of one of its points")
    case = load_case(out / "case.toml")
    if case.accuracy is not None:
        plan = open_dataset(out / ACCURACY_STAGE.file, ACCURACY_STAGE.schema)
        _, case = planned_case(case, plan, COMPUTED, Job(out))
    again = [(stage, stage.again) for stage in stages_of(case.tables) if stage.again]
    if not again:
        raise CaseError(
            f"{out}: its case has no cells for a second computation; run "
            f"the case in another folder and compare"
        )
    ((stage, compute),) = again
    stored = open_dataset(out / stage.file, stage.schema).isel(realisation=0)
    computed = compute(case).isel(realisation=0)
    differences = {}
    for name in ("traction", "mean_gap", "contact_fraction"):
        old, new = stored[name].to_numpy(), computed[name].to_numpy()
        if old.shape != new.shape:
            raise ConvergenceError(f"{out}: {name} has the shape {old.shape}, not {new.shape}")
        change = np.abs(new - old)[np.isfinite(new) | np.isfinite(old)]
        largest = np.max(np.abs(new[np.isfinite(new)]), initial=0.0)
        scale = largest or 1.0  # zero without any contact
        differences[name.replace("_", " ")] = float(np.max(change, initial=0.0) / scale)
    worst = max(differences, key=lambda name: np.nan_to_num(differences[name], nan=np.inf))
    distance = f"{differences[worst]:.1e} of the largest {worst}"
    if not differences[worst] <= SAME:
        raise ConvergenceError(
            f"{out}: the first realisation computed again differs by {distance}; its dataset was "
            f"changed, or computed by {stored.attrs.get('environment', 'other libraries')}"
        )
    return f"the first realisation computed again agrees within {distance}"
