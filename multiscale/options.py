"""Options that several commands share, and checks of files that they name."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from multiscale.errors import CaseError

if TYPE_CHECKING:
    from multiscale.pipeline import Case

CaseArgument = Annotated[str, typer.Argument(help="A case file, or the name of a shipped case.")]
JobsOption = Annotated[
    int, typer.Option(min=0, help="Worker processes; 0 for the number of cores.")
]
DaskOption = Annotated[
    str | None, typer.Option(help="Address of a dask scheduler, for workers on other machines.")
]
ExplainOption = Annotated[
    bool, typer.Option("--explain", help="Print the needs of the case, and stop.")
]
QuickOption = Annotated[bool, typer.Option("--quick", help="Coarser grid, fewer realisations.")]
LawOption = Annotated[Path | None, typer.Option("--law", help="Interface law of rough joints.")]
VerboseOption = Annotated[
    bool, typer.Option("-v", "--verbose", help="Print the events of the log as they come.")
]
QuietOption = Annotated[
    bool, typer.Option("-q", "--quiet", help="Print answers, cautions and errors, no progress.")
]


def out_option(help_text: str) -> Any:
    """Return the option -o of a command."""
    return typer.Option("-o", "--out", help=help_text)


ANYWAY = "also stages that need more than a day or more than the memory"
AnywayOption = Annotated[bool, typer.Option("--force", help=f"Solve {ANYWAY}.")]


def check_dataset_file(out: Path) -> None:
    """Refuse a file for a dataset before anything is computed."""
    from multiscale.io import try_to_write

    if out.suffix != ".nc":
        raise CaseError(
            f"-o {out}: the result is a dataset in a file that ends in .nc; write it to "
            f"{out.name or 'result'}.nc, for instance"
        )
    try_to_write(out)


def load_with(table: str, case: str) -> "Case":
    """Read a case with the table at which a command begins."""
    from multiscale.pipeline import load_case

    settings = load_case(case)
    if table in settings.tables:
        return settings
    raise CaseError(f"{case}: has no [{table}], at which the command begins; use multiscale run")
