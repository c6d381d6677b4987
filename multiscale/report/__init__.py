"""Results of a run, as tables and as a page."""

from multiscale.report.page import (
    FinishedRun,
    draw_figures,
    open_finished,
    show_run,
    write_inspection,
    write_report,
    write_reports,
)

__all__ = [
    "FinishedRun",
    "draw_figures",
    "open_finished",
    "show_run",
    "write_inspection",
    "write_report",
    "write_reports",
]

__dir__ = __all__.copy
