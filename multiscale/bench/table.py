"""A work-precision dataset as rows of text."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["HEAD", "tabulate"]

HEAD = ("scene", "code", "points", "time (s)", "memory (MB)", "iterations", "error", "own error")


def tabulate(work_precision: "xr.Dataset") -> list[tuple[str, ...]]:
    """Return the runs as rows of text, in the order of ``HEAD``.

    Parameters
    ----------
    work_precision : Dataset
        Follows ``WORK_PRECISION``, with all that ``HEAD`` names.
    """
    rows: list[tuple[str, ...]] = []
    for k in range(work_precision.sizes["run"]):
        run = work_precision.isel(run=k)
        solved = bool(run["converged"])
        rows.append(
            (
                str(run["scene"].item()),
                str(run["method"].item()),
                str(int(run["points"])),
                f"{float(run['wall_time']):.3g}",
                f"{1e-6 * float(run['peak_memory']):.0f}",
                f"{int(run['iterations'])}" if solved else "",
                f"{float(run['error']):.1e}" if solved else "not converged",
                f"{float(run['own_error']):.1e}" if solved else "",
            )
        )
    return rows
