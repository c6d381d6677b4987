"""A finished run as one page that opens anywhere: no script, nothing from elsewhere."""

import base64
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from multiscale.executors import run_jobs
from multiscale.io import (
    make_folder,
    open_dataset,
    read_bytes,
    reading_run,
    write_bytes,
    write_dataset,
)
from multiscale.pipeline.inspection import INSPECTION
from multiscale.pipeline.stage import Section
from multiscale.report.finished_run import FinishedRun, draw_sections, open_finished
from multiscale.schema import SURFACE_STATISTICS
from multiscale.units import readable

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["show_run", "write_inspection", "write_report", "write_reports"]


def show_run(out: str | Path) -> FinishedRun:
    """Draw the figures of a finished run or sweep and write its report; its datasets are read once.

    Returns
    -------
    FinishedRun
    """
    with reading_run(out):
        run = open_finished(Path(out))
        sections = run.sections()
        draw_sections(run.out, sections)
        _write(run, sections)
    return run


def write_report(out: str | Path) -> Path:
    """Write ``report.html`` of a finished run or sweep whose figures are drawn."""
    with reading_run(out):
        run = open_finished(Path(out))
        return _write(run, run.sections())


def write_inspection(out: str | Path, statistics: "xr.Dataset") -> Path:
    """Write dataset, figures and ``report.html`` of an inspected surface into a folder."""
    name, folder = INSPECTION.name, make_folder(Path(out))
    write_dataset(statistics, folder / INSPECTION.file, SURFACE_STATISTICS)
    kept = open_dataset(folder / INSPECTION.file, SURFACE_STATISTICS)
    cautions = list(INSPECTION.cautions(kept))
    run = FinishedRun(folder, (INSPECTION,), {name: kept}, cautions, "", {"surface": kept.title})
    sections = run.sections()
    draw_sections(folder, sections)
    return _write(run, sections)


def write_reports(
    out: str | Path, sweep: "xr.Dataset", *, executor: Executor | None = None
) -> None:
    """Draw the figures and write the reports of the points of a sweep in a folder.

    The points are those that have a result and a folder, and a report older than their datasets.
    """
    solved = [Path(out) / str(name) for name in sweep["folder"].values[sweep["failure"] == ""]]
    jobs = ((folder, (folder,)) for folder in solved if any(folder.glob("*.nc")))
    run_jobs(_report_point, jobs, executor, lambda name, nothing: None)


def _report_point(folder: Path) -> None:
    page, datasets = folder / "report.html", folder.glob("*.nc")
    written = page.stat().st_mtime_ns if page.exists() else 0
    if written < max(file.stat().st_mtime_ns for file in datasets):
        show_run(folder)


def _write(run: FinishedRun, sections: list[Section]) -> Path:
    """Write the page of a run whose figures are drawn."""
    from jinja2 import Environment

    template = resources.files("multiscale.report").joinpath("page.html").read_text()
    text = Environment(autoescape=True).from_string(template).render(_content(run, sections))
    write_bytes(run.out / "report.html", text.encode())
    return run.out / "report.html"


def _content(run: FinishedRun, sections: list[Section]) -> dict[str, Any]:
    drawn = {file.stem: file for file in (run.out / "figures").glob("*.png")}
    sections = [*sections, Section("Inputs", rows=list(_keys(run.case))), _work(run)]
    return vars(run.summary) | {
        "cautions": run.cautions,
        "sections": [
            vars(section)
            | {
                "figures": [
                    (name.replace("_", " "), base64.b64encode(read_bytes(drawn[name])).decode())
                    for name in section.figures
                    if name in drawn
                ]
            }
            for section in sections
        ],
    }


def _keys(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, ...]]:
    """Give the keys of a case with their values, tables flattened."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _keys(value, f"{prefix}{key}.")
        elif isinstance(value, list):
            if value:  # or it stands for nothing
                yield f"{prefix}{key}", ", ".join(readable(item) for item in value)
        elif isinstance(value, bool):
            yield f"{prefix}{key}", str(value).lower()  # as the file says it
        else:
            yield f"{prefix}{key}", readable(value)


def _work(run: FinishedRun) -> Section:
    """Say what was computed, with what, by which command and when."""
    counted = [row for stage in run.stages for row in stage.work(run.found)]
    said = run.found[run.stages[-1].name].attrs
    names = {"source": "program", "environment": "computed with", "history": "command"}
    told = [(name, str(said[key])) for key, name in names.items() if key in said]
    return Section("Work and provenance", rows=[*counted, *told])
