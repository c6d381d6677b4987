"""A finished run or sweep: its datasets, and what its stages show of them."""

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from threading import active_count
from typing import TYPE_CHECKING, Any, TypeAlias
from warnings import catch_warnings

from multiscale.executors import cores
from multiscale.io import make_folder, reading_run, remove
from multiscale.pipeline.stage import Section, Shown, Summary
from multiscale.schema import Dataset

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess

__all__ = ["FinishedRun", "draw_figures", "draw_run", "draw_sections", "open_finished"]


Figures: TypeAlias = Sequence[tuple[Path, Callable[[Path], Path]]]


@dataclass(frozen=True)
class FinishedRun:
    """What the folder of a finished run or sweep holds.

    Attributes
    ----------
    out : Path, run folder
    stages : tuple of Shown
        Stages of a run in the order in which they were run, or the points of a sweep.
    found : dict of str to Dataset, datasets of the stages, by name
    cautions : list of str, what a user should know before trusting the results, one sentence each
    failure : str, why steps have no answer, where that makes a command end with 1
    case : dict, content of the case file
    """

    out: Path
    stages: tuple[Shown, ...]
    found: dict[str, Dataset]
    cautions: list[str]
    failure: str
    case: dict[str, Any]

    def sections(self) -> list[Section]:
        """Return what the stages show on the page, the last stage first."""
        return [
            part for stage in self.stages[::-1] for part in stage.sections(self.found, self.out)
        ]

    def lines(self) -> Iterator[str]:
        """Yield what the stages tell on the command line, the last stage first.

        The stage of the summary tells its answer if it prints nothing else.
        """
        for stage in self.stages[::-1]:
            sections = stage.sections(self.found, self.out)
            lines = stage.lines(self.found[stage.name], sections)
            yield from lines or (self.summary.answer if stage is self.answering else ())

    @property
    def answering(self) -> Shown:
        """The last stage with a summary."""
        return [stage for stage in self.stages if stage.question][-1]

    @property
    def summary(self) -> Summary:
        """What the run was for, and its answer."""
        return self.answering.summary(self.found[self.answering.name])

    @property
    def title(self) -> str:
        """Title of the case."""
        return str(self.found[self.answering.name].attrs["title"])


def open_finished(out: Path) -> FinishedRun:
    """Open what a finished run or sweep has left."""
    from multiscale.pipeline.run_folder import gather_cautions, open_stages
    from multiscale.pipeline.toml_model import read_toml

    opened = open_stages(out)
    found = {stage.name: dataset for stage, dataset in opened.items()}
    failures = (stage.failure(dataset) for stage, dataset in opened.items())
    case = read_toml(out / "case.toml")
    return FinishedRun(
        out, tuple(opened), found, gather_cautions(opened), "; ".join(filter(None, failures)), case
    )


def draw_figures(out: str | Path) -> list[Path]:
    """Draw the figures of a finished run or sweep into its folder ``figures``.

    Figures that the stages of another case have left there are removed.
    """
    with reading_run(out):
        return draw_run(Path(out), open_finished(Path(out)).sections())


def draw_run(out: Path, sections: Iterable[Section]) -> list[Path]:
    """Draw the figures of the sections of a run; see :func:`draw_figures`."""
    from multiscale.pipeline.stages import STAGES

    files = draw_sections(out, sections)
    for stage in STAGES:
        for name in stage.pictures:
            if (file := out / "figures" / f"{name}.png") not in files:
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
    here, beside = figures[::2], figures[1::2]
    other = _fork(beside)
    _draw(here)
    if other is not None:
        other.join()
    if other is None or other.exitcode != 0:  # here what has failed there says why
        _draw(beside)
    return [file for file, _ in figures]


def _draw(figures: Figures) -> None:
    for file, draw in figures:
        draw(file)


def _fork(figures: Figures) -> "BaseProcess | None":
    """Begin to draw figures in a copy of this process, where that is safe: without threads."""
    solved = "numba" in sys.modules  # libraries may have threads that Python does not count
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
