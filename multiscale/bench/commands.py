"""Commands that measure error and run time, and that run stiff and extreme cases."""

import traceback
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from multiscale.bench import FAMILIES, STABILITY_FAMILIES, bench
from multiscale.errors import CaseError, ConvergenceError, MultiscaleError
from multiscale.executors import cores
from multiscale.options import JobsOption, check_dataset_file, out_option
from multiscale.printing import print_table, report_line, warn_of

if TYPE_CHECKING:
    from multiscale.schema import Dataset


def bench_command(
    families: Annotated[
        list[str] | None,
        typer.Argument(help=f"Families: {', '.join(FAMILIES)}; all if not given."),
    ] = None,
    out: Annotated[Path, out_option("Folder to write to.")] = Path("bench"),
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer scenes and grids, a single run of each.")
    ] = False,
) -> None:
    """Measure error, run time and memory, and compare with the other codes that are installed."""
    from multiscale.bench.summary import join_families, tabulate_cheapest
    from multiscale.io import try_to_write, write_dataset
    from multiscale.schema import WORK_PRECISION

    chosen = _choose(families, tuple(FAMILIES))
    try_to_write(out / "work_precision.nc")
    measured, failed = {}, list[str]()
    for name in chosen:
        try:
            measured[name] = _bench_family(name, out / f"{name}.nc", quick)
        except Exception as error:  # the other families are measured all the same
            failed.append(name)
            if not isinstance(error, MultiscaleError):
                traceback.print_exc()
            report_line(f"multiscale: the family {name} failed: {error}")
            continue
        joined = join_families(measured)  # finished families stay if the next is killed
        write_dataset(joined, out / "work_precision.nc", WORK_PRECISION)
    if measured:
        head, rows = tabulate_cheapest(joined)
        if rows:
            print_table("cheapest way to an error of at most", head, rows)
        typer.echo(f"all runs: {out / 'work_precision.nc'}")
    if failed:
        failures = f"{len(failed)} of {len(chosen)} families failed: {', '.join(failed)}"
        raise ConvergenceError(failures)


def _bench_family(name: str, file: Path, quick: bool) -> "Dataset":
    """Measure a family, write its dataset and figure, and print its runs."""
    from multiscale.bench.summary import describe_load, tabulate_runs
    from multiscale.io import write_dataset
    from multiscale.plotting import draw_work_precision
    from multiscale.schema import WORK_PRECISION

    keep = partial(write_dataset, path=file, schema=WORK_PRECISION)  # if it is killed
    runs = bench(name, quick=quick, report=report_line, keep=keep)
    keep(runs)
    figure = draw_work_precision(runs, file.with_suffix(".png"))
    warn_of(runs.attrs["cautions"].splitlines())
    print_table(runs.attrs["title"], *tabulate_runs(runs))
    typer.echo(f"load of the machine: {describe_load(runs)}")
    typer.echo(f"dataset and figure: {file}, {figure}")
    return runs


def stability_command(
    families: Annotated[
        list[str] | None,
        typer.Argument(
            help=f"Families of the table: {', '.join(STABILITY_FAMILIES)}; all if not given."
        ),
    ] = None,
    out: Annotated[Path, out_option("Dataset to write.")] = Path("stability.nc"),
    jobs: JobsOption = 0,
) -> None:
    """Run every stiff and extreme case: each converges, is refused, or fails."""
    from multiscale.bench.stability import check_stability, read_cases, tabulate_stability
    from multiscale.io import write_dataset
    from multiscale.schema import STABILITY

    cases = read_cases()
    chosen = _choose(families, list(STABILITY_FAMILIES))
    check_dataset_file(out)
    outcomes = check_stability(
        [case for case in cases if case.family in chosen],
        jobs=jobs or cores(),
        report=report_line,
        keep=partial(write_dataset, path=out, schema=STABILITY),
    )
    print_table(outcomes.attrs["title"], *tabulate_stability(outcomes))
    typer.echo(f"dataset: {out}")
    failed = int((outcomes["outcome"] == 0).sum())
    if failed:
        raise ConvergenceError(f"{failed} of {outcomes.sizes['case']} cases failed; see {out}")


def _choose(families: list[str] | None, known: Sequence[str]) -> Sequence[str]:
    for name in families or ():
        if name not in known:
            raise CaseError(f"there is no family {name!r}; choose from {', '.join(known)}")
    return families or known
