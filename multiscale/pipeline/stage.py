"""A stage of a case: it takes the datasets of earlier stages, computes a dataset, and shows it."""

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from multiscale import __version__
from multiscale.io import make_folder, open_dataset
from multiscale.needs import Needs
from multiscale.schema import RVE, Dataset, Schema
from multiscale.upscaling.tables import read_law

if TYPE_CHECKING:
    from multiscale.macro.substructures import ProcessGroup
    from multiscale.pipeline.plans.knobs import CaseKnob
    from multiscale.pipeline.tables.toml_model import Settings

Datasets: TypeAlias = "Mapping[str, Dataset]"  # dataset of every stage, by its name

ShowProgress: TypeAlias = Callable[[int, int, str], None]
"""Called with the number of finished items, their total, and their name, as ``"realisations"``."""


def unseen(finished: int, total: int, items: str) -> None:
    """Show no progress."""


@dataclass(frozen=True)
class Section:
    """A section of the page of a run: text, table, figures and downloads."""

    heading: str
    lines: Sequence[str] = ()  # paragraphs
    head: tuple[str, ...] = ()
    rows: Sequence[tuple[str, ...]] = ()
    figures: Mapping[str, Callable[[Path], Path]] = field(default_factory=dict)
    """Functions that draw a figure into a file, by name."""
    links: Mapping[str, str] = field(default_factory=dict)
    """Relative path of the page of a run, by the text in the first column of the table."""
    files: Mapping[str, Callable[[Path], object]] = field(default_factory=dict)
    """Functions that write a download into a file, by name."""
    notes: bool = False  # whether the last column of the table is text
    small: bool = False  # whether rows have three figures instead of two
    printed: bool = True  # whether the command line prints the table
    remarks: Sequence[str] = ()  # further paragraphs, which the command line prints, too


@dataclass(frozen=True)
class Summary:
    """Question of a run, and its answer in a few sentences."""

    question: str
    answer: Sequence[str]


@dataclass(frozen=True)
class Job:
    """Folder and resources with which the stages of a case are run."""

    out: Path  # run folder, which exists
    executor: Executor | None = None
    progress: ShowProgress = unseen  # called after every item of a long stage
    team: "ProcessGroup | None" = None  # processes that share the substructures of a structure
    sparing: bool = False  # whether only expensive results are written
    intervals: bool = True  # whether structures are solved again for the intervals of answers
    read_law: Callable[[Path, bool], Dataset] = lambda file, quick: read_law(file)
    """Read the law of a dataset, or of a case (maybe quick), which is run in its folder."""
    read_rve: Callable[[Path, bool], Dataset] = lambda file, quick: open_dataset(file, RVE)
    """Read a representative volume likewise."""
    open_cells: Callable[[Path, bool], tuple[Any, Datasets]] = lambda file, quick: (None, {})
    """Run the cells of a case likewise, and return it with its datasets."""
    notes: tuple[str, ...] = ()  # on the inputs of the stages, which become cautions
    solve: Callable[[Path, Any, bool], Datasets] = lambda place, case, whole: {}
    """Run a case in a folder of the run; without its intervals, if it is not whole, and only
    ensembles are stored."""

    def ensemble(
        self, folder: str, identity: str, count: int, items: str, *, each: int = 1
    ) -> dict[str, Any]:
        """Return keywords of :func:`multiscale.micro.run_ensemble`, for jobs of ``each`` items."""
        return {
            "executor": self.executor,
            "folder": self.out / folder,
            "sparing": self.sparing,
            "identity": identity,
            "progress": lambda finished: self.progress(each * finished, each * count, items),
        }


def list_cautions(dataset: Dataset) -> list[str]:
    """Return the cautions of a dataset, from its attribute, as sentences."""
    return str(dataset.attrs.get("cautions", "")).splitlines()


def _nothing(*_: object) -> tuple[()]:
    return ()


@dataclass(frozen=True, eq=False, kw_only=True)
class Shown:
    """A dataset of a run or a sweep, in a file named after its schema, with its presentation."""

    schema: Schema
    cautions: Callable[[Dataset], Iterable[str]] = list_cautions
    """Cautions to a user, as sentences."""
    sections: Callable[[Datasets, Path], Iterable[Section]] = _nothing
    """Sections of the page, with their figures, in a run folder."""
    work: Callable[[Datasets], Iterable[tuple[str, str]]] = _nothing
    """Rows that report how much was computed."""
    question: str | Callable[[Dataset], str] = ""  # empty if the stage does not head the page
    answer: Callable[[Dataset], Iterable[str]] = _nothing
    """Answer in sentences; the last stage with a question heads the page."""
    failure: Callable[[Dataset], str] = lambda dataset: ""
    """Reason why steps have no answer, with which the command ends with status 1; or empty."""

    @property
    def name(self) -> str:
        """Name of the dataset."""
        return self.schema.name

    @property
    def file(self) -> str:
        """Name of the file in the run folder."""
        return f"{self.name}.nc"

    def summary(self, dataset: Dataset) -> Summary:
        """Return the question, which an attribute of the dataset may replace, and the answer."""
        question = self.question(dataset) if callable(self.question) else self.question
        return Summary(str(dataset.attrs.get("question", question)), list(self.answer(dataset)))

    def draw(self, dataset: Dataset, folder: Path) -> list[Path]:
        """Draw all figures of a dataset into PNG files of a folder, and return them."""
        sections = self.sections({self.name: dataset}, folder)
        figures = [item for section in sections for item in section.figures.items()]
        return [draw(make_folder(folder) / f"{name}.png") for name, draw in figures]

    def lines(
        self,
        dataset: Dataset,
        sections: Iterable[Section] | None = None,
        *,
        details: bool = False,
    ) -> list[str]:
        """Return the lines of the command line: tables, the answer below the first, and remarks."""
        if sections is None:
            sections = self.sections({self.name: dataset}, Path())
        printed: list[str] = []
        for section in sections:
            if section.head and (section.printed or details):
                title = section.heading if printed else dataset.attrs.get("title", section.heading)
                table = format_table(title, section.head, section.rows, notes=section.notes)
                printed += [*table, *(self.answer(dataset) if not printed else ())]
            printed += [line for line in section.remarks if line not in printed]
        return printed


@dataclass(frozen=True, eq=False, kw_only=True)
class Stage(Shown):
    """A stage of a case."""

    tables: tuple[str, ...]  # of a case file that together request the stage
    reads: set[str] | dict[str, Any] | None = None
    """Tables and keys on which the dataset depends, in addition to the keys of the stages in
    ``takes``, as ``include`` of pydantic; all keys if not given."""
    takes: "tuple[Stage, ...]" = ()  # stages of the input datasets
    run: Callable[[Any, Datasets, Job], Dataset]
    """Compute the dataset from the case, the datasets of earlier stages and the job."""
    write_fields: Callable[..., object] | None = None
    """Write the dataset for ParaView into a folder, under a name."""
    needs: Callable[[Any], Needs] = lambda case: Needs()
    prepare: Callable[[Any], object] = _nothing
    """Refuse invalid cases before any stage is run."""
    again: Callable[[Any], Dataset] | None = None
    """Compute the first realisation of an ensemble of cells again, to compare it."""
    check: Callable[[Dataset], object] = _nothing
    """Refuse a written dataset without any answer."""
    knobs: "Callable[[Any], Iterable[CaseKnob]]" = _nothing
    """Settings of accuracy of the stage."""
    folders: tuple[str, ...] = ()
    """Folders of a run with results that the stage reuses."""
    answers: Sequence[str] = ()
    """Variables by which runs are compared at the end of their steps or cycles; the last stage with
    answers counts."""
    compared: Callable[[Dataset], Dataset] = lambda dataset: dataset
    """Return a dataset with the answers under their names."""

    def asked_for(self, tables: Container[str]) -> bool:
        """Whether the tables of a case file request the stage."""
        return all(table in tables for table in self.tables)

    def identity(self, case: "Settings") -> str:
        """Checksum of all inputs of the dataset; a dataset with another checksum is out of date."""
        taken = [stage.identity(case) for stage in self.takes if stage.asked_for(case.tables)]
        if "accuracy" in case.tables:  # a target changes the settings of all stages
            taken.append(case.checksum(include={"accuracy"}))
        keys = case.checksum(include=self.reads)
        return sha256(" ".join([__version__, self.name, keys, *taken]).encode()).hexdigest()


def with_sample_band(dataset: Dataset, name: str) -> Dataset:
    """Add the 95 % interval of an answer from its samples, unless an error budget gave it."""
    drawn, band = f"{name}_sample", f"{name}_mean_law"
    if band in dataset or drawn not in dataset or not dataset[drawn].size:
        return dataset
    ends = dataset[drawn].quantile([0.025, 0.975], "sample").drop_vars("quantile")
    return dataset.assign({band: ends.rename(quantile="limit")})


def format_table(
    title: str, head: tuple[str, ...], rows: Sequence[tuple[str, ...]], *, notes: bool = False
) -> list[str]:
    """Return a title, a head and rows as lines with aligned columns; notes are left."""
    heads = [_two_lines(*column) for column in zip(head, *rows, strict=True)]
    lines = [line for line in (*zip(*heads, strict=True), *rows) if any(line)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    widths[-1] *= not notes
    return [
        title,
        *(
            "  ".join(f"{cell:>{width}}" for cell, width in zip(line, widths, strict=True)).rstrip()
            for line in lines
        ),
    ]


def _two_lines(name: str, *cells: str) -> tuple[str, str]:
    """Break the head of a column where it is narrowest."""
    words = name.split(" ")
    halves = [(" ".join(words[:k]), " ".join(words[k:])) for k in range(len(words))]
    least = max(map(len, cells), default=len(name))
    return min(halves, key=lambda pair: max(least, *map(len, pair)))


WIDTH = 100  # columns of a terminal


def fit_columns(
    head: tuple[str, ...], rows: Sequence[tuple[str, ...]]
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return the columns of a table that fit into a terminal; earlier columns come first."""
    fitting: list[int] = []
    room = WIDTH + 2
    for k, (name, *cells) in enumerate(zip(head, *rows, strict=True)):
        width = 2 + max(map(len, (*_two_lines(name, *cells), *cells)))
        if width <= room or not fitting:
            fitting.append(k)
            room -= width
    return tuple(head[k] for k in fitting), [tuple(row[k] for k in fitting) for row in rows]
