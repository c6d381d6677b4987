"""What a stage of a case is: it takes earlier datasets, leaves one of its own, and shows it."""

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
from multiscale.upscaling import read_law

if TYPE_CHECKING:
    from multiscale.macro.substructures import ProcessGroup
    from multiscale.pipeline.tables.toml_model import Settings

__all__ = [
    "Datasets",
    "Job",
    "Section",
    "ShowProgress",
    "Shown",
    "Stage",
    "Summary",
    "format_table",
    "list_cautions",
    "unseen",
    "with_sample_band",
]

Datasets: TypeAlias = "Mapping[str, Dataset]"
"""Dataset of every stage, by its name."""

ShowProgress: TypeAlias = Callable[[int, int, str], None]
"""Gets what is finished, of how many, and the name of these parts, such as ``"realisations"``."""


def unseen(finished: int, total: int, parts: str) -> None:
    """Show no progress."""


@dataclass(frozen=True)
class Section:
    """A part of the page of a run."""

    heading: str
    lines: Sequence[str] = ()  # paragraphs
    head: tuple[str, ...] = ()
    rows: Sequence[tuple[str, ...]] = ()
    figures: Mapping[str, Callable[[Path], Path]] = field(default_factory=dict)
    """Functions that draw them into the file that they are given."""
    links: Mapping[str, str] = field(default_factory=dict)
    """From the text of a first cell of the table to the page of a run, relative to this one."""
    files: Mapping[str, Callable[[Path], object]] = field(default_factory=dict)
    """Functions that write downloads into the file that they are given."""
    notes: bool = False  # whether the last column of the table is text
    small: bool = False  # whether three figures stand side by side, or else two
    printed: bool = True  # whether the command line prints the table
    remarks: Sequence[str] = ()  # further paragraphs, which the command line prints, too


@dataclass(frozen=True)
class Summary:
    """What a run was for: question, and the answer in a few sentences."""

    question: str
    answer: Sequence[str]


@dataclass(frozen=True)
class Job:
    """Where and with what the stages of a case are run."""

    out: Path  # run folder, which exists
    executor: Executor | None = None
    progress: ShowProgress = unseen  # called after every part of a stage that takes long
    team: "ProcessGroup | None" = None  # processes that share the substructures of a structure
    sparing: bool = False  # whether only what took long is written
    read_law: Callable[[Path, bool], Dataset] = lambda file, quick: read_law(file)
    """Read the law of a dataset, or of a case that may be quick and is run in its folder."""
    read_rve: Callable[[Path, bool], Dataset] = lambda file, quick: open_dataset(file, RVE)
    """Read a representative volume likewise."""

    def ensemble(
        self, folder: str, identity: str, count: int, parts: str, *, each: int = 1
    ) -> dict[str, Any]:
        """Return how an ensemble is run, as keywords of :func:`multiscale.micro.run_ensemble`.

        Its jobs, so many in number, have ``each`` so many parts, which the progress counts.
        """
        return {
            "executor": self.executor,
            "folder": self.out / folder,
            "sparing": self.sparing,
            "identity": identity,
            "progress": lambda finished: self.progress(each * finished, each * count, parts),
        }


def list_cautions(dataset: Dataset) -> list[str]:
    """Return the cautions that a dataset carries as an attribute, one sentence each."""
    return str(dataset.attrs.get("cautions", "")).splitlines()


def _nothing(*_: object) -> tuple[()]:
    """Return nothing to show, and nothing to refuse."""
    return ()


@dataclass(frozen=True, eq=False, kw_only=True)
class Shown:
    """A dataset of a run or a sweep, in a file named after its schema, and how it is shown."""

    schema: Schema
    cautions: Callable[[Dataset], Iterable[str]] = list_cautions
    """What a user should know before trusting it, one sentence each."""
    sections: Callable[[Datasets, Path], Iterable[Section]] = _nothing
    """Parts of the page, with their figures, in a run folder."""
    work: Callable[[Datasets], Iterable[tuple[str, str]]] = _nothing
    """Rows that report how much was computed."""
    question: str | Callable[[Dataset], str] = ""  # what a run is for; empty if it is not
    answer: Callable[[Dataset], Iterable[str]] = _nothing
    """In sentences; the last stage with a question heads the page."""
    failure: Callable[[Dataset], str] = lambda dataset: ""
    """Why some of its steps have no answer; such a command ends with 1."""

    @property
    def name(self) -> str:
        """Name of the dataset."""
        return self.schema.name

    @property
    def file(self) -> str:
        """Name of the file in the run folder."""
        return f"{self.name}.nc"

    def summary(self, dataset: Dataset) -> Summary:
        """Return the question, which the dataset may have changed, and its answer."""
        asked = self.question(dataset) if callable(self.question) else self.question
        return Summary(str(dataset.attrs.get("question", asked)), list(self.answer(dataset)))

    def draw(self, dataset: Dataset, folder: Path) -> list[Path]:
        """Draw all figures of a dataset into PNG files of a folder, and return them."""
        sections = self.sections({self.name: dataset}, folder)
        figures = [one for section in sections for one in section.figures.items()]
        return [draw(make_folder(folder) / f"{name}.png") for name, draw in figures]

    def lines(self, dataset: Dataset, sections: Iterable[Section] | None = None) -> list[str]:
        """Return what the command line prints: tables, the answer below the first one, and remarks.

        The sections are those of this dataset if not given.
        """
        if sections is None:
            sections = self.sections({self.name: dataset}, Path())
        printed: list[str] = []
        for section in sections:
            if section.head and section.printed:
                title = section.heading if printed else dataset.attrs.get("title", section.heading)
                table = format_table(title, section.head, section.rows, notes=section.notes)
                printed += [*table, *(self.answer(dataset) if not printed else ())]
            printed += [line for line in section.remarks if line not in printed]
        return printed


@dataclass(frozen=True, eq=False, kw_only=True)
class Stage(Shown):
    """A stage of a case."""

    tables: tuple[str, ...]  # of a case file that together ask for the stage
    reads: set[str] | dict[str, Any] | None = None
    """Tables and keys on which its dataset depends, beside those of the stages that it takes from,
    as ``include`` of pydantic; all if not given."""
    takes: "tuple[Stage, ...]" = ()  # stages whose datasets it takes
    run: Callable[[Any, Datasets, Job], Dataset]
    """From the case, the datasets of earlier stages and the job."""
    write_fields: Callable[..., object] | None = None
    """Write the dataset for ParaView into a folder, under a name."""
    needs: Callable[[Any], Needs] = lambda case: Needs()
    prepare: Callable[[Any], object] = _nothing
    """Refuse from the case what it can before any stage is run."""
    check: Callable[[Dataset], object] = _nothing
    """Refuse a dataset that has been written but answers nothing."""
    kept: str = ""  # what ``--quick`` leaves as it is, in a sentence
    folders: tuple[str, ...] = ()
    """Folders of a run where the stage finds what it need not compute again."""
    answers: Mapping[str, str] = field(default_factory=dict)
    """Variables by which runs are compared at the end of their steps or cycles, with labels in
    place of those of ``SHOWN``; those of the last stage that has any, as far as a run has them."""
    compared: Callable[[Dataset], Dataset] = lambda dataset: dataset
    """Return a dataset that has the answers under their names."""

    def asked_for(self, tables: Container[str]) -> bool:
        """Whether the tables of a case file ask for the stage."""
        return all(table in tables for table in self.tables)

    def identity(self, case: "Settings") -> str:
        """Checksum of all that the dataset depends on; another one is out of date."""
        taken = [stage.identity(case) for stage in self.takes if stage.asked_for(case.tables)]
        own = case.checksum(include=self.reads)
        return sha256(" ".join([__version__, self.name, own, *taken]).encode()).hexdigest()


def with_sample_band(dataset: Dataset, name: str) -> Dataset:
    """Add the 95 % interval of an answer from its samples, where no error budget has given one."""
    drawn, band = f"{name}_sample", f"{name}_mean_law"
    if band in dataset or drawn not in dataset or not dataset[drawn].size:
        return dataset
    ends = dataset[drawn].quantile([0.025, 0.975], "sample").drop_vars("quantile")
    return dataset.assign({band: ends.rename(quantile="limit")})


def format_table(
    title: str, head: tuple[str, ...], rows: Sequence[tuple[str, ...]], *, notes: bool = False
) -> list[str]:
    """Return a title, a head and rows as lines with aligned columns, the last one text if notes.

    A name that is longer than all below it stands in two lines, cut at a space.
    """
    heads = []
    for name, *cells in zip(head, *rows, strict=True):
        words = name.split(" ")
        halves = [(" ".join(words[:k]), " ".join(words[k:])) for k in range(len(words))]
        least = max(map(len, cells), default=len(name))
        heads.append(min(halves, key=lambda pair: max(least, *map(len, pair))))
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
