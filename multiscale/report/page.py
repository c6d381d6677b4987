"""A finished run or sweep: its printed lines, its figures, and its page without scripts."""

import base64
import csv
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from importlib import resources
from io import StringIO
from itertools import count
from multiprocessing import get_context
from pathlib import Path
from struct import unpack
from threading import active_count
from typing import TYPE_CHECKING, Any, TypeAlias
from warnings import catch_warnings

from multiscale.errors import CaseError
from multiscale.executors import cores, run_jobs
from multiscale.io import make_folder, open_dataset, remove, write_bytes, write_dataset
from multiscale.io.datasets import reading_run
from multiscale.io.files import read_bytes
from multiscale.pipeline.case import load_case
from multiscale.pipeline.costs import run_costs
from multiscale.pipeline.inspection import INSPECTION
from multiscale.pipeline.showing import LOWER_BOUND
from multiscale.pipeline.stage import (
    Section,
    Shown,
    ShowProgress,
    Summary,
    fit_columns,
    format_table,
    unseen,
)
from multiscale.plotting.figure import DOTS_PER_INCH, WIDE, is_drawn
from multiscale.plotting.sweep_figures import key_in_words
from multiscale.schema import ACCURACY, SURFACE_STATISTICS, Dataset

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess

SENTENCES = 2  # of the answer on the command line

Figures: TypeAlias = Sequence[tuple[Path, Callable[[Path], Path]]]


def brief_lines(title: str, summary: Summary, sections: Iterable[Section]) -> Iterator[str]:
    """Yield title, question, answer in two sentences, and one table for a terminal."""
    yield from (title, summary.question, *summary.answer[:SENTENCES])
    tables = [section for section in sections if section.head and section.printed]
    for table in tables[:1]:
        narrow = fit_columns(table.head, table.rows)
        yield from format_table(table.heading, *narrow, notes=table.notes)
        if any(LOWER_BOUND in cell for row in narrow[1] for cell in row):
            yield f"{LOWER_BOUND.strip()} marks errors with terms that are not known."


@dataclass(frozen=True)
class FinishedRun:
    """Content of the folder of a finished run or sweep."""

    out: Path
    stages: tuple[Shown, ...]  # in the order in which they were run, or the points of a sweep
    datasets: dict[str, Dataset]  # datasets of the stages, by name
    cautions: list[str]  # one sentence each
    failure: str  # why steps have no answer, if the command ends with status 1; or empty
    case: dict[str, Any]  # content of the case file

    def sections(self) -> list[Section]:
        """Return the sections of the page, the last stage first."""
        of_stages = [
            section
            for stage in self.stages[::-1]
            for section in stage.sections(self.datasets, self.out)
        ]
        return [*of_stages, *self.costs()]

    def lines(self, *, details: bool = False) -> Iterator[str]:
        """Yield the lines of the command line.

        These are question, answer in two sentences and one table. With details the answers,
        tables and remarks of all stages are printed, the last stage first.
        """
        if not details:
            sections = self.answering.sections(self.datasets, self.out)
            yield from brief_lines(self.title, self.summary, sections)
            yield "Other tables, terms of the error and remarks: --details, or report.html"
            return
        for stage in self.stages[::-1]:
            sections = stage.sections(self.datasets, self.out)
            lines = stage.lines(self.datasets[stage.name], sections, details=True)
            yield from lines or (self.summary.answer if stage is self.answering else ())
        for section in self.costs():
            yield from format_table(section.heading, section.head, section.rows)

    def costs(self) -> list[Section]:
        """Return the section on time and error of a run of a case; plans have another section."""
        file = self.out / "case.toml"
        if "sweep" in self.case or not file.exists() or ACCURACY.name in self.datasets:
            return []
        return run_costs(load_case(file), self.stages, self.datasets)

    @property
    def answering(self) -> Shown:
        """The last stage with a summary."""
        return [stage for stage in self.stages if stage.question][-1]

    @property
    def summary(self) -> Summary:
        """Question and answer of the run."""
        return self.answering.summary(self.datasets[self.answering.name])

    @property
    def title(self) -> str:
        """Title of the case."""
        return str(self.datasets[self.answering.name].attrs["title"])


def open_finished(out: Path) -> FinishedRun:
    """Open the folder of a finished run or sweep."""
    from multiscale.pipeline.run_folder import gather_cautions, open_stages
    from multiscale.pipeline.tables.toml_model import read_toml

    opened = open_stages(out)
    results = {stage.name: dataset for stage, dataset in opened.items()}
    failures = (stage.failure(dataset) for stage, dataset in opened.items())
    case = read_toml(out / "case.toml")
    return FinishedRun(
        out,
        tuple(opened),
        results,
        gather_cautions(opened),
        "; ".join(filter(None, failures)),
        case,
    )


def draw_figures(out: str | Path) -> list[Path]:
    """Draw the figures of a finished run or sweep into its folder ``figures``.

    Figures that the stages of another case have left there are removed.
    """
    with reading_run(out):
        return draw_run(Path(out), open_finished(Path(out)).sections())


def draw_run(out: Path, sections: Iterable[Section]) -> list[Path]:
    """Draw the figures of the sections of a run; see :func:`draw_figures`."""
    files = draw_sections(out, sections)
    for file in set((out / "figures").glob("*.png")) - set(files):
        if is_drawn(file):
            remove(file)
    return files


def draw_sections(out: Path, sections: Iterable[Section]) -> list[Path]:
    """Draw the figures of sections into PNG files in the folder ``figures``."""
    folder = make_folder(out / "figures")
    figures = [
        (folder / f"{name}.png", draw)
        for section in sections
        for name, draw in section.figures.items()
    ]
    here, forked = figures[::2], figures[1::2]
    other = _fork(forked)
    _draw(here)
    if other is not None:
        other.join()
    if other is None or other.exitcode != 0:  # draw again here, to raise the error
        _draw(forked)
    return [file for file, _ in figures]


def _draw(figures: Figures) -> None:
    for file, draw in figures:
        draw(file)


def _fork(figures: Figures) -> "BaseProcess | None":
    """Begin to draw figures in a copy of this process, where that is safe: without threads."""
    solved = "numba" in sys.modules  # its libraries may have threads unknown to Python
    if sys.platform != "linux" or solved or active_count() > 1 or cores() < 2 or not figures:
        return None
    import matplotlib.figure  # noqa: F401 (once for both)

    def draw() -> None:
        try:
            _draw(figures)
        except BaseException:
            sys.exit(1)

    process = get_context("fork").Process(target=draw, daemon=True)
    with catch_warnings(category=DeprecationWarning, action="ignore"):  # idle threads of BLAS
        process.start()
    return process


def show_run(out: str | Path) -> FinishedRun:
    """Draw the figures of a finished run or sweep and write its report from one reading."""
    with reading_run(out):
        run = open_finished(Path(out))
        sections = run.sections()
        draw_run(run.out, sections)
        _write(run, sections)
    return run


def write_report(out: str | Path) -> Path:
    """Write ``report.html`` of a finished run or sweep with its figures."""
    with reading_run(out):
        run = open_finished(Path(out))
        return _write(run, run.sections())


def write_inspection(out: str | Path, statistics: Dataset) -> Path:
    """Write dataset, figures and ``report.html`` of an inspected surface into a folder."""
    name, folder = INSPECTION.name, make_folder(Path(out))
    write_dataset(statistics, folder / INSPECTION.file, SURFACE_STATISTICS)
    written = open_dataset(folder / INSPECTION.file, SURFACE_STATISTICS)
    cautions = list(INSPECTION.cautions(written))
    run = FinishedRun(
        folder, (INSPECTION,), {name: written}, cautions, "", {"surface": written.title}
    )
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

    Points without a result or a folder, or with a report newer than their datasets, are skipped.
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
    from jinja2 import Environment

    template = resources.files("multiscale.report").joinpath("page.html").read_text()
    text = Environment(autoescape=True).from_string(template).render(_content(run, sections))
    write_bytes(run.out / "report.html", text.encode())
    return run.out / "report.html"


def _content(run: FinishedRun, sections: list[Section]) -> dict[str, Any]:
    """Return the variables of the template: head, and sections with pictures and downloads."""
    drawn = {file.stem: file for file in (run.out / "figures").glob("*.png")}
    sections = [*sections, _inputs(run), *_work(run)]
    head, keys = run.summary, {key.removeprefix("sweep.") for key, _ in _keys(run.case)}

    def in_words(sentence: str) -> str:
        """Write keys of the case and names of bodies in words, for readers without the case."""
        for key in keys:
            sentence = re.sub(rf"\b{re.escape(key)}\b", key_in_words(key), sentence)
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
                "lines": map(in_words, section.lines),
                "remarks": [*map(in_words, section.remarks)],
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
    case = run.out / "case.toml"
    files = {case.name: lambda file: write_bytes(file, read_bytes(case))}
    return Section("Inputs", rows=list(_keys(run.case)), files=files if case.exists() else {})


def _keys(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, ...]]:
    """Yield the keys of a case with their values as in the file, tables flattened."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _keys(value, f"{prefix}{key}.")
        elif isinstance(value, list):
            if value:  # an empty list is a default
                yield f"{prefix}{key}", ", ".join(map(str, value))
        elif isinstance(value, bool):
            yield f"{prefix}{key}", str(value).lower()
        else:
            yield f"{prefix}{key}", str(value)


def _work(run: FinishedRun) -> Iterator[Section]:
    counted = [row for stage in run.stages for row in stage.work(run.datasets)]
    attributes = run.datasets[run.stages[-1].name].attrs
    names = {"source": "program", "environment": "computed with", "history": "command"}
    provenance = [(name, str(attributes[key])) for key, name in names.items() if key in attributes]
    yield Section("Work and provenance", rows=[*counted, *provenance])
    day = str(attributes.get("history", ""))[:10]
    program = attributes.get("source", "multiscale")
    yield Section(
        "Citation",
        [
            f"{run.title}, computed with {program}, {day}. The sources of its methods are "
            f"listed in the documentation of the package, under theory."
        ],
    )
