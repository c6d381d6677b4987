"""What the page of a sweep says."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from multiscale.pipeline import name_point
from multiscale.report.rows import tabulate_sweep
from multiscale.report.section import Section, provenance

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["list_sweep_cautions", "sweep_answer", "sweep_question", "sweep_sections"]


MOST_NAMED = 3
"""Points that are named for one caution."""


def list_sweep_cautions(result: "xr.Dataset") -> list[str]:
    """Say why points have no result, and what to beware of at others: each once, with its points.

    Parameters
    ----------
    result : Dataset
        Follows ``SWEEP``.
    """
    names, failures = _names(result), [str(one) for one in result["failure"].values]
    # a sweep of an earlier version has none
    cautions = [str(one) for one in result["caution"].values] if "caution" in result else []
    refused = _places((f"no result: {one.rstrip('.')}", k) for k, one in enumerate(failures) if one)
    beware = _places((line, k) for k, one in enumerate(cautions) for line in one.splitlines())
    solved = failures.count("")
    return [
        *(f"at {_list(names, at)}: {text}" for text, at in refused.items()),
        *(
            f"at {'every point with a result' if len(at) == solved else _list(names, at)}: {text}"
            for text, at in beware.items()
        ),
    ]


def _places(found: Iterable[tuple[str, int]]) -> dict[str, list[int]]:
    """Points of every text."""
    places: dict[str, list[int]] = {}
    for text, point in found:
        places.setdefault(text, []).append(point)
    return places


def _names(result: "xr.Dataset") -> list[str]:
    """Name every point by its keys and values."""
    parameters = list(map(str, result["parameter"].values))
    return [name_point(parameters, map(str, setting)) for setting in result["setting"].values]


def _list(names: list[str], at: list[int]) -> str:
    """Name some points."""
    named = "; ".join(names[k] for k in at[:MOST_NAMED])
    return f"{named}; and {len(at) - MOST_NAMED} more" if len(at) > MOST_NAMED else named


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
    runs = list(zip(_names(result), map(str, result["folder"].values), strict=True))
    return [
        Section("Points", ["Each at its largest preload."], head, rows, ("sweep",)),
        Section("Runs", told, rows=runs),
        Section("Work and provenance", [], rows=provenance(result)),
    ]
