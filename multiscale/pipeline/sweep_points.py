"""How the points of a sweep are shown, each a run in a folder of its own."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.pipeline.rows import tabulate_sweep
from multiscale.pipeline.stage import Datasets, Section, Shown, Summary, format_table
from multiscale.plotting.figure import on_axes
from multiscale.plotting.sweep_figures import plot_sweep
from multiscale.schema import SWEEP

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["POINTS", "name_point"]


MOST_NAMED = 3
"""Points that are named for one caution."""


def name_point(parameters: Iterable[str], setting: Iterable[str]) -> str:
    """Say which point of a sweep is meant: its keys in full, with their values."""
    return ", ".join(f"{key} = {text}" for key, text in zip(parameters, setting, strict=True))


def _list_cautions(result: "xr.Dataset") -> list[str]:
    """Say why points have no result, and what to beware of at others: each with its points."""
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
    places: dict[str, list[int]] = {}
    for text, point in found:
        places.setdefault(text, []).append(point)
    return places


def _names(result: "xr.Dataset") -> list[str]:
    parameters = list(map(str, result["parameter"].values))
    return [name_point(parameters, map(str, setting)) for setting in result["setting"].values]


def _list(names: list[str], at: list[int]) -> str:
    named = "; ".join(names[k] for k in at[:MOST_NAMED])
    return f"{named}; and {len(at) - MOST_NAMED} more" if len(at) > MOST_NAMED else named


def _summary(found: Datasets) -> Summary:
    """Say what is varied, and the range of the stiffnesses at the largest preload of each point."""
    result = found[POINTS.name]
    names = ", ".join(map(str, result["parameter"].values))
    rows = 1e-12 * result["joint_stiffness"].values
    last = [row[np.isfinite(row)][-1] for row in rows if np.isfinite(row).any()]
    return Summary(
        result.attrs["title"],
        f"How does the stiffness of the joint depend on {names}?",
        [
            f"From {min(last):.4g} to {max(last):.4g} MPa/µm at the largest preload, over "
            f"{len(last)} of {len(rows)} points with a result."
        ],
    )


def _lines(found: Datasets) -> list[str]:
    result = found[POINTS.name]
    return format_table(result.attrs["title"], *tabulate_sweep(result))


def _sections(found: Datasets, out: Path) -> Iterator[Section]:
    result = found[POINTS.name]
    told = ["multiscale report FOLDER writes the page of a point from its run folder."]
    runs = list(zip(_names(result), map(str, result["folder"].values), strict=True))
    figure = on_axes(lambda ax: plot_sweep(result, ax=ax))
    yield Section(
        "Points", ["Each at its largest preload."], *tabulate_sweep(result), {"sweep": figure}
    )
    yield Section("Runs", told, rows=runs)


POINTS = Shown(
    schema=SWEEP,
    cautions=_list_cautions,
    lines=_lines,
    sections=_sections,
    summary=_summary,
)
