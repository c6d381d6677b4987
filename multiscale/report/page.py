"""A finished run as one page that opens anywhere: no script, nothing from elsewhere."""

import base64
import csv
import re
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Executor
from importlib import resources
from io import StringIO
from itertools import count
from pathlib import Path
from struct import unpack
from typing import Any

from multiscale.errors import CaseError
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
from multiscale.pipeline.stage import Section, ShowProgress, unseen
from multiscale.plotting.figure import DOTS_PER_INCH, WIDE
from multiscale.plotting.sweep_figures import say_key
from multiscale.report.finished_run import FinishedRun, draw_run, draw_sections, open_finished
from multiscale.schema import SURFACE_STATISTICS, Dataset

__all__ = ["show_run", "write_inspection", "write_report", "write_reports"]


def show_run(out: str | Path) -> FinishedRun:
    """Draw the figures of a finished run or sweep and write its report from one reading."""
    with reading_run(out):
        run = open_finished(Path(out))
        sections = run.sections()
        draw_run(run.out, sections)
        _write(run, sections)
    return run


def write_report(out: str | Path) -> Path:
    """Write ``report.html`` of a finished run or sweep whose figures are drawn."""
    with reading_run(out):
        run = open_finished(Path(out))
        return _write(run, run.sections())


def write_inspection(out: str | Path, statistics: Dataset) -> Path:
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
    out: str | Path,
    sweep: Dataset,
    *,
    executor: Executor | None = None,
    progress: ShowProgress = unseen,
) -> None:
    """Draw the figures and write the reports of the points of a sweep in a folder.

    The points are those that have a result and a folder, and a report older than their datasets.
    """
    solved = [Path(out) / str(name) for name in sweep["folder"].values[sweep["failure"] == ""]]
    folders = [folder for folder in solved if any(folder.glob("*.nc"))]
    finished = count(1)
    run_jobs(
        _report_point,
        ((folder, (folder,)) for folder in folders),
        executor,
        lambda folder, nothing: progress(next(finished), len(folders), "reports"),
    )


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
    """Arrange what the template shows: head, and sections with their pictures and downloads."""
    drawn = {file.stem: file for file in (run.out / "figures").glob("*.png")}
    sections = [*sections, _inputs(run), *_work(run)]
    head, keys = run.summary, {key.removeprefix("sweep.") for key, _ in _keys(run.case)}

    def in_words(sentence: str) -> str:
        """Write keys of the case and names of bodies in words, for readers who have not seen it."""
        for key in keys:
            sentence = re.sub(rf"\b{re.escape(key)}\b", say_key(key), sentence)
        return re.sub(r"\bbody_(?=\d)(?!\d\.\w)", "body ", sentence)  # not of tables

    return {
        "title": run.title,
        "question": in_words(head.question),
        "answer": map(in_words, head.answer),
        "cautions": map(in_words, run.cautions),
        "sections": [
            vars(section)
            | {
                "pictures": [
                    (
                        name.replace("_", " "),
                        _encoded(image := read_bytes(drawn[name])),
                        _wide(image),
                    )
                    for name in section.figures
                    if name in drawn
                ],
                "downloads": [*_downloads(run, section)],
                "lines": map(in_words, (*section.lines, *section.told)),
                "head": [*map(in_words, section.head)],
            }
            for section in sections
        ],
    }


def _wide(image: bytes) -> bool:
    """Whether a PNG is made for the full width of a page."""
    (pixels,) = unpack(">I", image[16:20])
    return bool(pixels >= WIDE[0] * DOTS_PER_INCH)


def _downloads(run: FinishedRun, section: Section) -> Iterator[tuple[str, str]]:
    """Yield names and content of the table and files of a section, or why a file is refused."""
    if section.head:
        name = section.heading.lower().replace(" ", "_")
        yield f"{name}.csv", _encoded(_comma_separated([section.head, *section.rows]))
    for name, write in section.files.items():
        file = make_folder(run.out / "exports") / name
        try:
            write(file)
        except CaseError as refusal:
            yield f"{name} is not written: {refusal}", ""
        else:
            yield name, _encoded(read_bytes(file))


def _comma_separated(rows: Iterable[tuple[str, ...]]) -> bytes:
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode("utf-8-sig")  # or spreadsheets take µ for two letters


def _encoded(content: bytes) -> str:
    return base64.b64encode(content).decode()


def _inputs(run: FinishedRun) -> Section:
    """List the keys of the case, with its file."""
    case = run.out / "case.toml"
    files = {case.name: lambda file: write_bytes(file, read_bytes(case))}
    return Section("Inputs", rows=list(_keys(run.case)), files=files if case.exists() else {})


def _keys(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, ...]]:
    """Give the keys of a case with their values as the file says them, tables flattened."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _keys(value, f"{prefix}{key}.")
        elif isinstance(value, list):
            if value:  # or it stands for nothing
                yield f"{prefix}{key}", ", ".join(map(str, value))
        elif isinstance(value, bool):
            yield f"{prefix}{key}", str(value).lower()
        else:
            yield f"{prefix}{key}", str(value)


def _work(run: FinishedRun) -> Iterator[Section]:
    """Say what was computed, with what, by which command and when, and how to cite it."""
    counted = [row for stage in run.stages for row in stage.work(run.found)]
    said = run.found[run.stages[-1].name].attrs
    names = {"source": "program", "environment": "computed with", "history": "command"}
    told = [(name, str(said[key])) for key, name in names.items() if key in said]
    yield Section("Work and provenance", rows=[*counted, *told])
    day = str(said.get("history", ""))[:10]
    program = said.get("source", "multiscale")
    yield Section(
        "Citation",
        [
            f"{run.title}, computed with {program}, {day}. The sources of its methods are "
            f"listed in the README of the package."
        ],
    )
