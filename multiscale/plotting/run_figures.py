"""The figures of a finished run."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from multiscale.io import open_dataset, open_run, reading_run, remove
from multiscale.pipeline import read_sliding
from multiscale.plotting.budget_figures import plot_error_budget
from multiscale.plotting.figure import save_figures
from multiscale.plotting.law_figures import (
    plot_area_law,
    plot_gap_law,
    plot_joint_stiffness,
    plot_unloading,
)
from multiscale.plotting.sliding_figures import draw_sliding
from multiscale.plotting.surface_figures import plot_contact_map, plot_surface
from multiscale.plotting.sweep_figures import plot_sweep
from multiscale.plotting.tyre_figures import draw_tyre_figures
from multiscale.schema import FIELDS, SWEEP

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_figures"]


def draw_figures(out: str | Path) -> list[Path]:
    """Draw the figures of a finished run or sweep into its folder ``figures``.

    Parameters
    ----------
    out : path
        Run folder.

    Returns
    -------
    list of Path
        The PNG files, in the order of the chain.
    """
    with reading_run(out):
        return _draw_all(Path(out))


def _draw_all(out: Path) -> list[Path]:
    """Draw what the folder holds."""
    if (out / "sweep.nc").exists():
        sweep = open_dataset(out / "sweep.nc", SWEEP)
        return save_figures({"sweep": lambda ax: plot_sweep(sweep, ax=ax)}, out / "figures")
    tree = open_run(out, finished=True)
    response, law, result = (
        tree[name].to_dataset() for name in ("micro_response", "interface_law", "macro_result")
    )
    if "braking_force" in result:
        return draw_tyre_figures(out)
    fields = open_dataset(out / "fields" / "fields.nc", FIELDS)
    figures: dict[str, Callable[[Axes], Axes]] = {
        "surface": lambda ax: plot_surface(fields, ax=ax),
        "contact_map": lambda ax: plot_contact_map(fields, ax=ax),
        "gap_law": lambda ax: plot_gap_law(response, law, ax=ax),
        "area_law": lambda ax: plot_area_law(response, law, ax=ax),
        "joint_stiffness": lambda ax: plot_joint_stiffness(result, ax=ax),
    }
    if "unloading_stiffness_ratio" in law:
        figures["unloading"] = lambda ax: plot_unloading(response, law, ax=ax)
    if "error_total" in result:
        figures["error_budget"] = lambda ax: plot_error_budget(result, ax=ax)
    files = save_figures(figures, out / "figures")
    sliding, picture = read_sliding(out), out / "figures" / "sliding.png"
    if sliding is not None:
        files.append(draw_sliding(sliding, picture))
    else:
        remove(picture)  # of a case that slid
    return files
