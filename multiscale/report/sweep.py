"""What the page of a sweep says."""

from typing import TYPE_CHECKING

import numpy as np

from multiscale.report.section import Section
from multiscale.report.tables import tabulate_sweep

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["sweep_answer", "sweep_question", "sweep_sections"]


def sweep_question(result: "xr.Dataset") -> str:
    """Say what is varied."""
    names = ", ".join(map(str, result["parameter"].values))
    return f"How does the stiffness of the joint depend on {names}?"


def sweep_answer(result: "xr.Dataset") -> list[str]:
    """Say the range of the stiffnesses at the largest preload of each point."""
    rows = 1e-12 * result["joint_stiffness"].values
    last = [row[np.isfinite(row)][-1] for row in rows if np.isfinite(row).any()]
    return [
        f"From {min(last):.4g} to {max(last):.4g} MPa/µm at the largest preload, over {len(last)} "
        f"of {len(rows)} points with a result."
    ]


def sweep_sections(result: "xr.Dataset") -> list[Section]:
    """Return table and figure, and where the runs are."""
    head, rows = tabulate_sweep(result)
    told = ["multiscale report FOLDER writes the page of a point from its run folder."]
    settings, folders = result["setting"].values, result["folder"].values
    runs = [(", ".join(map(str, one)), str(at)) for one, at in zip(settings, folders, strict=True)]
    work = [("program", str(result.attrs["source"])), ("command", str(result.attrs["history"]))]
    return [
        Section("Points", ["Each at its largest preload."], head, rows, ("sweep",)),
        Section("Runs", told, rows=runs),
        Section("Work and provenance", [], rows=work),
    ]
