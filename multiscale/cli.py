"""The command line: the Python interface with arguments and files added."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from multiscale import __version__
from multiscale.bench.commands import bench_command, stability_command
from multiscale.errors import CaseError, ConvergenceError, MultiscaleError
from multiscale.executors import workers
from multiscale.law_commands import export_command, fit_command
from multiscale.options import (
    ANYWAY,
    AnywayOption,
    CaseArgument,
    DaskOption,
    ExplainOption,
    JobsOption,
    LawOption,
    QuickOption,
    QuietOption,
    VerboseOption,
    check_dataset_file,
    load_with,
    out_option,
)
from multiscale.printing import print_lines, report_line, shown_progress, warn_of
from multiscale.units import to_lengths, to_si

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from multiscale.pipeline import Sweep
    from multiscale.pipeline.stage import ShowProgress

app = typer.Typer(
    help="From measured roughness to the stiffness of a joint.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

INTERRUPTED = 130
"""Exit status after Ctrl-C, as of shells."""


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"multiscale {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, help="Print the version, and stop."),
    ] = False,
) -> None:
    """From measured roughness to the stiffness of a joint."""


@app.command("run")
def run_command(
    case: CaseArgument,
    out: Annotated[Path, out_option("Run folder.")] = Path("results"),
    quick: QuickOption = False,
    jobs: JobsOption = 0,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue the run in the folder.")
    ] = False,
    dask: DaskOption = None,
    explain: ExplainOption = False,
    force: Annotated[
        bool, typer.Option("--force", help=f"Compute all stages again, and {ANYWAY}.")
    ] = False,
    keep: Annotated[
        bool, typer.Option("--keep", help="Store the run folders of all points of a large sweep.")
    ] = False,
    until: Annotated[Literal["law", ""], typer.Option(help="Stop after the interface law.")] = "",
    start: Annotated[
        Literal["structure", ""],
        typer.Option("--from", help="Start with the structure, with the law named by its joints."),
    ] = "",
    only: Annotated[
        Literal["rve", ""], typer.Option(help="Compute the representative volume only.")
    ] = "",
    law: LawOption = None,
    details: Annotated[
        bool, typer.Option("--details", help="Print all tables of the page, with time and error.")
    ] = False,
    verbose: VerboseOption = False,
    quiet: QuietOption = False,
) -> None:
    """Run all stages of a case, such as cells, interface law and structure; or a sweep."""
    from multiscale.pipeline import load_sweep

    if resume and not any((out / name).exists() for name in ("log.txt", "micro", "plan", "points")):
        raise CaseError(f"{out} has no run to resume; leave out --resume for a new run")
    if resume and force:
        raise CaseError("--resume keeps results that --force computes again; give one of them")
    selected = [stages for stages in (until, start, only) if stages]
    if len(selected) > 1:
        raise CaseError("--until, --from and --only exclude each other")
    if law and not start:
        raise CaseError("--law is the law of the joints of --from structure; give both")
    sweep = load_sweep(case)
    for stages in selected:
        sweep = sweep.only_part(stages, law)
    _carry_out(
        sweep,
        out,
        quick=quick,
        jobs=jobs,
        explain=explain,
        verbose=verbose,
        quiet=quiet,
        checked=not (force or resume or dask),
        dask=dask,
        force=force,
        keep=keep,
        details=details,
    )


def _carry_out(
    sweep: "Sweep",
    out: Path,
    *,
    quick: bool,
    jobs: int,
    explain: bool,
    verbose: bool,
    quiet: bool,
    checked: bool = False,
    dask: str | None = None,
    force: bool = False,
    keep: bool = False,
    details: bool = False,
) -> None:
    """Explain or run a sweep, or the single case of a sweep without parameters."""
    _refuse_both(verbose, quiet)
    from multiscale.io import make_folder
    from multiscale.io.files import logging_to
    from multiscale.pipeline import refuse_excess, requirements, run, run_sweep
    from multiscale.pipeline.case_needs import prepare
    from multiscale.report import write_reports

    if quick:
        if any(point.accuracy for point in sweep.points):
            report_line("--quick leaves out the target of [accuracy]")
        structure = sweep.points[0].structure
        warn_of([structure.quick_note] if structure and structure.quick_note else [])
        sweep = sweep.quick()
    if explain:
        prepare(sweep.points[0])
        if sweep.parameters:
            typer.echo(f"{len(sweep.points)} points; the largest:")
        needs = max(map(requirements, sweep.points), key=lambda needs: needs.memory)
        typer.echo(needs.explain())
    case = None if sweep.parameters else sweep.points[0]
    if checked:
        refuse_excess(sweep.points, [out] if case else sweep.folders(out), jobs=jobs)
    if explain:
        return
    make_folder(out)
    with logging_to(out / "log.txt"), _working(out, jobs, dask, verbose, quiet) as (pool, progress):
        if case:
            run(case, out, executor=pool, progress=progress, force=force)
        else:
            joined = run_sweep(
                sweep,
                out,
                executor=pool,
                progress=lambda finished: progress(finished, len(sweep.points), "points"),
                force=force,
                keep=keep,
            )
            write_reports(out, joined, executor=pool, progress=progress)
    runs = list((out / "points").glob("*/"))
    _show_finished(out, sweep.title, f"; runs: {out / 'points'}" if runs else "", details)


@app.command("micro")
def micro_command(
    case: CaseArgument,
    out: Annotated[Path, out_option("Response to write.")] = Path("micro_response.nc"),
    quick: QuickOption = False,
    jobs: JobsOption = 0,
    dask: DaskOption = None,
    force: AnywayOption = False,
    verbose: VerboseOption = False,
    quiet: QuietOption = False,
) -> None:
    """Solve the cells of a case."""
    _refuse_both(verbose, quiet)
    from multiscale.pipeline import refuse_excess, run_micro

    check_dataset_file(out)
    settings = load_with("micro", case)
    if quick:
        settings = settings.quick()
    if not (force or dask):
        refuse_excess([settings.without_structure()], [out.parent], jobs=jobs)
    with _working(out.parent / "micro", jobs, dask, verbose, quiet) as (pool, progress):
        response = run_micro(settings, out, executor=pool, progress=progress)
    warn_of(response.attrs["cautions"].splitlines())
    typer.echo(response.attrs["behaviour"])


app.command("fit")(fit_command)
app.command("export")(export_command)


@app.command("macro")
def macro_command(
    case: CaseArgument,
    out: Annotated[Path, out_option("Result to write.")] = Path("macro_result.nc"),
    quick: Annotated[
        bool, typer.Option("--quick", help="At most 4 x 4 modules, or few elements and steps.")
    ] = False,
    law: LawOption = None,
    explain: ExplainOption = False,
    force: AnywayOption = False,
    details: Annotated[
        bool, typer.Option("--details", help="Print all tables, and remarks.")
    ] = False,
) -> None:
    """Solve the structure of a case: bars and cables, bodies with rough joints, or grains.

    Started by ``mpiexec -n N``, N processes share the substructures of a structure that is cut.
    """
    from multiscale.macro.substructures import world
    from multiscale.pipeline import refuse_excess, requirements, run_macro
    from multiscale.pipeline.case_needs import prepare
    from multiscale.pipeline.stages import stages_of
    from multiscale.report.page import brief_lines

    settings, team = load_with("structure", case).from_structure(law), world()
    if quick:
        settings = settings.quick()
    if explain:
        prepare(settings)
        if team.rank == 0:
            typer.echo(requirements(settings, processes=team.size).explain())
    else:
        check_dataset_file(out)
    if not force:
        refuse_excess([settings], [out.parent], jobs=team.size)
    if explain:
        return
    result = run_macro(settings, out, team=team)
    if team.rank:  # the first process speaks for all
        return
    warn_of(result.attrs.get("cautions", "").splitlines())
    stage, *more = stages_of(settings.tables)
    sections = list(stage.sections({stage.name: result}, out.parent))
    if details:
        print_lines(stage.lines(result, sections, details=True))
    else:
        print_lines(brief_lines(settings.title, stage.summary(result), sections))
        typer.echo("Other tables and remarks: --details")
    print_lines(f"{other.name}: {out.with_name(f'{out.stem}-{other.file}')}" for other in more)
    fields = out.parent / "fields" / f"{out.stem}.pvd"
    typer.echo(f"dataset: {out}" + (f"; for ParaView: {fields}" if stage.write_fields else ""))
    if failure := stage.failure(result):
        raise ConvergenceError(f"{settings.title}: {failure}")


@app.command("cases")
def cases_command() -> None:
    """List the shipped cases, and name the page that explains case files."""
    from multiscale.pipeline.case import read_case, shipped_cases

    cases = shipped_cases()
    width = max(map(len, cases))
    for name, path in cases.items():
        typer.echo(f"{name:{width}}  {read_case(path)['title']}")
    typer.echo(f"Case files are explained in {path.with_name('README.md')}")


@app.command("report")
def report_command(
    out: Annotated[Path, typer.Argument(help="Folder of a finished run.")],
    verify: Annotated[
        bool, typer.Option("--verify", help="Also compute the first cell again, and compare it.")
    ] = False,
) -> None:
    """Draw the figures and write the report of a finished run again."""
    from multiscale.report import show_run

    typer.echo(show_run(out).out / "report.html")
    if verify:
        from multiscale.pipeline.verification import verify_run

        typer.echo(verify_run(out))


@app.command("inspect")
def inspect_command(
    surfaces: Annotated[
        list[Path],
        typer.Argument(help="Topography files, maps or line scans, of one face or of both."),
    ],
    out: Annotated[Path, out_option("Folder of dataset and page.")] = Path("inspection"),
    structure: Annotated[
        Literal["blocks", "lap_joint", ""],
        typer.Option(help="Structure of the proposed case, between both faces."),
    ] = "",
    preload: Annotated[
        str,
        typer.Option(help='Preload of the structure, such as "20 kN", for the pressures.'),
    ] = "",
    channel: Annotated[str, typer.Option(help="Number, from 0, or name of a channel.")] = "",
    size: Annotated[
        str,
        typer.Option(
            help='Edge lengths, such as "90 um x 130 um", if they are missing or wrong in the file.'
        ),
    ] = "",
    unit: Annotated[str, typer.Option(help="Unit of the file, such as um, if it is missing.")] = "",
    detrend_order: Annotated[
        int, typer.Option(min=0, max=2, help="0 mean, 1 plane, 2 curvature.")
    ] = 2,
    remove_spikes: Annotated[
        bool, typer.Option("--remove-spikes", help="Fill points far above or below the others.")
    ] = False,
    case: Annotated[Path | None, typer.Option(help="Complete case file to write.")] = None,
) -> None:
    """Describe measured surfaces, and propose a case of cells with the same roughness."""
    edges = to_lengths(size) if size else None
    metres = to_si(unit if unit[0].isdigit() else f"1 {unit}", "m") if unit else None
    if len(surfaces) > 2:
        raise CaseError(f"a joint has two faces, got {len(surfaces)} files; give one or two")
    if bool(structure) != bool(preload):
        raise CaseError("--structure is pressed by --preload; give both, or neither")
    from multiscale.io import try_to_write, write_bytes
    from multiscale.pipeline.inspection import INSPECTION, inspect_surfaces, inspection_lines
    from multiscale.report import write_inspection

    if case is not None:
        try_to_write(case)
    inspections = inspect_surfaces(
        surfaces,
        structure=structure,
        preload=preload,
        channel=channel or None,
        size=edges,
        unit=metres,
        detrend_order=detrend_order,
        spikes="remove" if remove_spikes else "keep",
    )
    places = [out] if len(surfaces) == 1 else [out / "face_1", out / "face_2"]
    pages = [*map(write_inspection, places, inspections)]
    proposal = inspections[-1].attrs["proposal"]
    if case is not None and proposal:  # before a pipe may close
        write_bytes(case, proposal.encode())
    for inspection, page in zip(inspections, pages, strict=True):
        name = inspection.attrs["title"]
        warn_of(f"{name}: {caution}" for caution in INSPECTION.cautions(inspection))
        print_lines([*inspection_lines(inspection), f"page, figures and dataset: {page}", ""])
    if case is None:
        print_lines(proposal.splitlines())
    else:
        if not proposal:
            raise CaseError(f"{surfaces[-1]}: no case is proposed, and {case} is not written")
        typer.echo(f"case: {case}")


@app.command("damage")
def damage_command(
    volume: Annotated[
        str,
        typer.Argument(
            help="A case with a table rve, or a TIFF stack or folder with a binary image."
        ),
    ],
    out: Annotated[Path, out_option("Run folder.")] = Path("damage"),
    youngs_modulus: Annotated[
        str, typer.Option(help='For an image: modulus of its solid, such as "71 GPa".')
    ] = "",
    poissons_ratio: Annotated[float, typer.Option(help="For an image: ratio of its solid.")] = 0.3,
    voxel_size: Annotated[
        str, typer.Option(help='Edge of a voxel, such as "5 um", if it is missing in the image.')
    ] = "",
    void_value: Annotated[float, typer.Option(help="Value of void voxels of the image.")] = 0.0,
    quick: QuickOption = False,
    jobs: JobsOption = 0,
    explain: ExplainOption = False,
    verbose: VerboseOption = False,
    quiet: QuietOption = False,
) -> None:
    """Compute damage of sections and stiffness of a volume with pores and cracks."""
    from multiscale.pipeline import case_of_image, load_case
    from multiscale.pipeline.sweep import Sweep

    path = Path(volume)
    if path.is_dir() or path.suffix.lower() in (".tif", ".tiff"):
        if not youngs_modulus:
            raise CaseError(f"{path}: give --youngs-modulus of the solid, such as 71 GPa")
        settings = case_of_image(path, youngs_modulus, poissons_ratio, voxel_size, void_value)
    else:
        settings = load_case(volume).only_rve()
    sweep = Sweep(settings.title, (), (settings,), ((),))
    _carry_out(sweep, out, quick=quick, jobs=jobs, explain=explain, verbose=verbose, quiet=quiet)


app.command("bench")(bench_command)
app.command("stability")(stability_command)


def _show_finished(out: Path, title: str, more: str = "", details: bool = False) -> None:
    """Write the report of a run and print its answers; a missing answer is an error."""
    from multiscale.report import show_run

    finished = show_run(out)
    warn_of(finished.cautions)
    print_lines(finished.lines(details=details))
    typer.echo(f"report, figures and datasets: {out}{more}")
    if finished.failure:
        raise ConvergenceError(f"{title}: {finished.failure}")


@contextmanager
def _working(
    out: Path, jobs: int, dask: str | None, verbose: bool, quiet: bool
) -> Iterator[tuple["Executor | None", "ShowProgress"]]:
    """Yield workers and a display of progress; after Ctrl-C print how to continue."""
    try:
        with workers(jobs, dask) as executor, shown_progress(verbose, quiet) as progress:
            yield executor, progress
    except KeyboardInterrupt:
        report_line(
            f"multiscale: interrupted; finished jobs remain in {out}, and the same command "
            f"continues with the others"
        )
        raise typer.Exit(INTERRUPTED) from None


def _refuse_both(verbose: bool, quiet: bool) -> None:
    if quiet and verbose:
        raise typer.BadParameter("--quiet and --verbose exclude each other")


def main() -> None:
    """Run the command line; a refused input ends with its message and exit status 1."""
    warnings.formatwarning = lambda warning, *_: f"caution: {warning}\n"
    try:
        app()
        return
    except MultiscaleError as error:
        message = str(error)
    except MemoryError as error:
        message = f"not enough memory ({error}); use fewer points or jobs"
    except OSError as error:  # of standard output, for instance
        message = f"{error}; free some space or check the permissions"
    report_line(f"multiscale: {message}")
    raise SystemExit(1)
