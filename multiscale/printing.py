"""Printed output of the command line: lines and tables of results, cautions, and progress."""

import logging
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import TYPE_CHECKING

import typer

from multiscale.needs import readable_time

if TYPE_CHECKING:
    from multiscale.pipeline.stage import ShowProgress

LINES = 20  # of progress, for each kind of job


@contextmanager
def shown_progress(verbose: bool, quiet: bool) -> Iterator["ShowProgress"]:
    """Show progress on standard error: a bar on a terminal, lines elsewhere; or the log instead."""
    if verbose:
        logging.basicConfig(format="%(asctime)s %(message)s", datefmt="%H:%M:%S")
        logging.getLogger("multiscale").setLevel(logging.INFO)
    if quiet or verbose:
        yield lambda finished, total, jobs: None
    elif sys.stderr.isatty():
        with _bars() as progress:
            yield progress
    else:
        yield _lines()


def _lines() -> "ShowProgress":
    """Print a line for each job, or for each twentieth of many, with the time left."""
    begin: dict[str, tuple[int, float]] = {}
    shown: dict[str, int] = {}

    def show(finished: int, total: int, jobs: str) -> None:
        first, since = begin.setdefault(jobs, (finished, perf_counter()))
        if finished < total and shown.get(jobs) == LINES * finished // total:
            return
        shown[jobs] = LINES * finished // max(total, 1)
        left = ""
        if first < finished < total:
            each = (perf_counter() - since) / (finished - first)
            left = f", about {readable_time(each * (total - finished))} left"
        report_line(f"{finished} of {total} {jobs}{left}")

    return show


@contextmanager
def _bars() -> Iterator["ShowProgress"]:
    """Show a bar for each kind of job, with the time left."""
    from rich.console import Console
    from rich.progress import Progress as Bars
    from rich.progress import TaskID

    tasks: dict[str, TaskID] = {}
    with Bars(console=Console(stderr=True)) as bars:

        def show(finished: int, total: int, jobs: str) -> None:
            if jobs not in tasks:
                tasks[jobs] = bars.add_task(jobs, total=total)
            bars.update(tasks[jobs], completed=finished, total=total)

        yield show


def report_line(line: str) -> None:
    """Print a line on standard error."""
    typer.echo(line, err=True)


def warn_of(cautions: Iterable[str]) -> None:
    """Print cautions on standard error."""
    for caution in cautions:
        report_line(f"caution: {caution}")


def print_lines(lines: Iterable[str]) -> None:
    """Print lines on standard output."""
    for line in lines:
        typer.echo(line)


def print_table(title: str, head: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Print a table with its title on standard output."""
    from multiscale.pipeline.stage import format_table

    print_lines(format_table(title, head, rows))
