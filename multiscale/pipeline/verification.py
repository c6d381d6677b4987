"""Check of a finished run: its first realisation is computed again and compared."""

from pathlib import Path

import numpy as np

from multiscale.errors import CaseError, ConvergenceError
from multiscale.io import open_dataset
from multiscale.micro import Path as LoadPath
from multiscale.micro import run_ensemble
from multiscale.pipeline.case import load_case
from multiscale.pipeline.case_cells import measured_cells
from multiscale.pipeline.tables.toml_model import read_toml
from multiscale.schema import MICRO_RESPONSE

SAME = 1e-6  # largest difference of two solutions of the same cell, over the largest value


def verify_run(out: Path) -> str:
    """Compute the first realisation of a finished run again, and report the largest difference."""
    content = read_toml(out / "case.toml")
    if "sweep" in content:
        raise CaseError(f"{out}: holds a sweep; verify the folder of one of its points")
    case = load_case(out / "case.toml")
    if case.accuracy is not None:
        raise CaseError(
            f"{out}: its case has [accuracy], which plans other cells than the case has; run the "
            f"case in another folder and compare"
        )
    if not case.has_cells:
        raise CaseError(
            f"{out}: its case has no cells, of which a realisation could be computed again; run "
            f"the case in another folder and compare"
        )
    stored = open_dataset(out / f"{MICRO_RESPONSE.name}.nc", MICRO_RESPONSE).isel(realisation=0)
    cells, _ = measured_cells(case, made=1)
    again = run_ensemble(cells[:1], LoadPath(pressure=case.micro.path)).isel(realisation=0)
    differences = {}
    for name in ("traction", "mean_gap", "contact_fraction"):
        old, new = stored[name].to_numpy(), again[name].to_numpy()
        if old.shape != new.shape:
            raise ConvergenceError(f"{out}: {name} has the shape {old.shape}, not {new.shape}")
        change = np.abs(new - old)[np.isfinite(new) | np.isfinite(old)]
        differences[name.replace("_", " ")] = float(
            np.max(change, initial=0.0) / np.nanmax(np.abs(new))
        )
    worst = max(differences, key=lambda name: np.nan_to_num(differences[name], nan=np.inf))
    found = f"{differences[worst]:.1e} of the largest {worst}"
    if not differences[worst] <= SAME:
        raise ConvergenceError(
            f"{out}: the first realisation computed again differs by {found}; its dataset was "
            f"changed, or computed by {stored.attrs.get('environment', 'other libraries')}"
        )
    return f"the first realisation computed again agrees within {found}"
