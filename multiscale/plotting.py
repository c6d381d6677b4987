"""One function per figure: takes a dataset and axes, returns the axes, neither shows nor saves.

Labels and conversion to um and MPa happen here and nowhere else.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.io import make_folder, open_dataset, open_run, write_bytes
from multiscale.schema import FIELDS
from multiscale.upscaling import area_from_dataset, law_from_dataset

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "draw_figures",
    "draw_work_precision",
    "plot_area_law",
    "plot_contact_map",
    "plot_gap_law",
    "plot_history",
    "plot_joint_stiffness",
    "plot_surface",
    "plot_work_precision",
]

BAND = (2.5, 97.5)  # percentiles of the bands
SMALLEST_ERROR = 1e-17  # where an error of zero is drawn


def plot_surface(fields: "xr.Dataset", *, ax: "Axes | None" = None) -> "Axes":
    """Plot the heights of the composite surface.

    Parameters
    ----------
    fields : Dataset
        Follows ``FIELDS``.
    ax : Axes, optional
        Where to draw. The current axes if not given.
    """
    ax = _axes(ax)
    height = 1e6 * fields["height"].values
    largest = np.abs(height - height.mean()).max()
    image = ax.imshow(
        height - height.mean(),
        origin="lower",
        extent=_extent(fields),
        cmap="RdBu_r",
        vmin=-largest,
        vmax=largest,
    )
    ax.figure.colorbar(image, ax=ax, label="height (µm)")
    ax.set_xlabel("x (µm)")
    ax.set_ylabel("y (µm)")
    ax.set_title("composite surface, realisation 0")
    return ax


def plot_contact_map(
    fields: "xr.Dataset", *, step: int | None = None, ax: "Axes | None" = None
) -> "Axes":
    """Plot the local contact pressure; white where there is no contact.

    Parameters
    ----------
    fields : Dataset
        Follows ``FIELDS``.
    step : int, optional
        Load step; the middle one if not given.
    ax : Axes, optional
        Where to draw. The current axes if not given.
    """
    ax = _axes(ax)
    step = fields.sizes["step"] // 2 if step is None else step
    pressure = 1e-6 * fields["pressure"].values[step]
    image = ax.imshow(
        np.where(pressure > 0.0, pressure, np.nan),
        origin="lower",
        extent=_extent(fields),
        cmap="viridis",
        vmin=0.0,
        interpolation="none",
    )
    ax.figure.colorbar(image, ax=ax, label="local pressure (MPa)")
    ax.set_xlabel("x (µm)")
    ax.set_ylabel("y (µm)")
    nominal = 1e-6 * float(fields["nominal_pressure"].values[step])
    ax.set_title(f"contact at {nominal:.3g} MPa mean pressure")
    return ax


def plot_gap_law(response: "xr.Dataset", law: "xr.Dataset", *, ax: "Axes | None" = None) -> "Axes":
    """Plot pressure against mean gap: realisations as markers, the law with its band as a line.

    Parameters
    ----------
    response : Dataset
        Follows ``MICRO_RESPONSE``.
    law : Dataset
        Follows ``INTERFACE_LAW``.
    ax : Axes, optional
        Where to draw. The current axes if not given.
    """
    ax = _axes(ax)
    pressure = 1e-6 * response["nominal_pressure"].values
    for gap in 1e6 * response["mean_gap"].values:
        ax.plot(gap, pressure, ".", color="0.6", markersize=4)
    along = np.geomspace(pressure.min(), pressure.max(), 200)
    band = [
        law_from_dataset(law, sample).gap_at(1e6 * along) for sample in range(law.sizes["sample"])
    ]
    if band:
        low, high = 1e6 * np.percentile(band, BAND, axis=0)
        ax.fill_betweenx(along, low, high, color="C0", alpha=0.3, linewidth=0, label="95 % band")
    ax.plot(1e6 * law_from_dataset(law).gap_at(1e6 * along), along, color="C0", label="law")
    ax.set_yscale("log")
    ax.set_xlabel("mean gap (µm)")
    ax.set_ylabel("mean pressure (MPa)")
    ax.set_title("normal law and realisations")
    ax.legend()
    return ax


def plot_area_law(response: "xr.Dataset", law: "xr.Dataset", *, ax: "Axes | None" = None) -> "Axes":
    """Plot the contact fraction against the mean pressure.

    Parameters
    ----------
    response : Dataset
        Follows ``MICRO_RESPONSE``.
    law : Dataset
        Follows ``INTERFACE_LAW``.
    ax : Axes, optional
        Where to draw. The current axes if not given.
    """
    ax = _axes(ax)
    pressure = 1e-6 * response["nominal_pressure"].values
    for fraction in 100.0 * response["contact_fraction"].values:
        ax.plot(pressure, fraction, ".", color="0.6", markersize=4)
    along = np.linspace(0.0, pressure.max(), 200)
    band = [
        area_from_dataset(law, sample).contact_fraction(1e6 * along)
        for sample in range(law.sizes["sample"])
    ]
    if band:
        low, high = 100.0 * np.percentile(band, BAND, axis=0)
        ax.fill_between(along, low, high, color="C0", alpha=0.3, linewidth=0, label="95 % band")
    ax.plot(
        along, 100.0 * area_from_dataset(law).contact_fraction(1e6 * along), color="C0", label="law"
    )
    ax.set_xlabel("mean pressure (MPa)")
    ax.set_ylabel("real over nominal contact area (%)")
    ax.set_title("area law and realisations")
    ax.legend()
    return ax


def plot_joint_stiffness(result: "xr.Dataset", *, ax: "Axes | None" = None) -> "Axes":
    """Plot the joint's stiffness against its preload, with the band of the law's samples.

    Parameters
    ----------
    result : Dataset
        Follows ``MACRO_RESULT``.
    ax : Axes, optional
        Where to draw. The current axes if not given.
    """
    ax = _axes(ax)
    preload = 1e-6 * result["preload"].values
    to_plot = 1e-12  # Pa/m to MPa/um
    if "joint_stiffness_sample" in result:
        samples = result["joint_stiffness_sample"].values
        low, high = to_plot * np.nanpercentile(samples, BAND, axis=0)
        ax.fill_between(preload, low, high, color="C0", alpha=0.3, linewidth=0, label="95 % band")
    ax.plot(preload, to_plot * result["joint_stiffness"].values, "o-", color="C0", label="joint")
    interface = to_plot * result["interface_stiffness"].values
    ax.plot(preload, interface, "--", color="C1", label="interface alone")
    solid = to_plot * float(result["solid_stiffness"])
    ax.axhline(solid, color="0.4", linestyle=":", label="blocks without interface")
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlabel("preload (MPa)")
    ax.set_ylabel("normal stiffness (MPa/µm)")
    ax.set_title("joint stiffness")
    ax.legend()
    return ax


def plot_work_precision(
    work_precision: "xr.Dataset",
    *,
    scene: str | None = None,
    error: str = "error",
    ax: "Axes | None" = None,
) -> "Axes":
    """Plot error against run time, one line per method; dashed against the method's own limit.

    Below the uncertainty of the reference, drawn as a band, differences mean nothing. Points are
    labelled with the grid if it is known; what did not converge is left out.

    Parameters
    ----------
    work_precision : Dataset
        Follows ``WORK_PRECISION``.
    scene : str, optional
        Whose runs to plot; all if not given.
    error : str
        The variable to plot. ``own_`` and ``_uncertainty`` around it name those that go with it.
    ax : Axes, optional
        Where to draw. The current axes if not given.
    """
    ax = _axes(ax)
    runs = work_precision
    if scene is not None:
        runs = runs.isel(run=np.flatnonzero(runs["scene"].values == scene))
        ax.set_title(scene)
    for k, method in enumerate(dict.fromkeys(runs["method"].values)):
        of = runs.isel(run=np.flatnonzero(runs["method"].values == method))
        time = of["wall_time"].values
        ax.plot(time, of[error].values, "o-", color=f"C{k}", label=method)
        if f"own_{error}" in of:
            own = of[f"own_{error}"].values
            ax.plot(time, own, "--", color=f"C{k}", linewidth=0.8)
        for run in range(of.sizes["run"] if "points" in of else 0):
            ax.annotate(
                f"{int(of['points'][run])}",
                (time[run], float(of[error][run])),
                xytext=(3, 3),
                textcoords="offset points",
                fontsize=6,
                color=f"C{k}",
            )
    ax.set_xscale("log")
    ax.set_yscale("log")
    if f"{error}_uncertainty" in runs and np.isfinite(runs[f"{error}_uncertainty"]).any():
        low, high = ax.get_ylim()
        uncertainty = float(runs[f"{error}_uncertainty"].max())
        low = min(low, 0.5 * uncertainty)
        ax.axhspan(0.1 * low, uncertainty, color="0.9", linewidth=0)
        ax.set_ylim(low, high)
    ax.set_xlabel("wall time (s)")
    ax.set_ylabel(runs[error].attrs["long_name"])
    return ax


def plot_history(work_precision: "xr.Dataset", *, scene: str, ax: "Axes | None" = None) -> "Axes":
    """Plot the smallest error so far against time, one line per method.

    Each line ends in a marker at the error and the time of the whole run, open if the run did not
    converge; the dotted line is the error asked for. A colour means the same method in all scenes.

    Parameters
    ----------
    work_precision : Dataset
        Follows ``WORK_PRECISION``, with the histories and tolerances.
    scene : str
        Whose runs to plot.
    ax : Axes, optional
        Where to draw. The current axes if not given.
    """
    ax = _axes(ax)
    methods = list(dict.fromkeys(work_precision["method"].values))
    for k in np.flatnonzero(work_precision["scene"].values == scene):
        run = work_precision.isel(run=k)
        rank = methods.index(run["method"].item())
        color = "black" if rank == 0 else f"C{rank - 1}"
        mine = work_precision["history_run"].values == k
        error = np.fmin.accumulate(work_precision["history_error"].values[mine])
        time = [*work_precision["history_seconds"].values[mine], float(run["wall_time"])]
        error = np.maximum([*error, float(run["error"])], SMALLEST_ERROR)
        ax.plot(time, error, color=color, label=methods[rank])
        face = color if run["converged"] else "white"
        ax.plot(time[-1], error[-1], "o", color=color, markerfacecolor=face)
        ax.axhline(float(run["tolerance"]), color="0.6", linestyle=":", linewidth=0.8)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_title(scene, fontsize="medium")
    ax.set_xlabel("time since the start (s)")
    ax.set_ylabel("relative residual (1)")
    return ax


def draw_work_precision(work_precision: "xr.Dataset", file: Path) -> Path:
    """Draw a panel for each scene, and for each of its errors, into a PNG file.

    If the dataset has histories, they are drawn.

    Parameters
    ----------
    work_precision : Dataset
        Follows ``WORK_PRECISION``.
    file : Path
        To write.
    """
    with_history = "history_error" in work_precision
    figure = (_history_panels if with_history else _error_panels)(work_precision)
    write_bytes(file, _png(figure))
    return file


def _error_panels(work_precision: "xr.Dataset") -> "Figure":
    """Scenes side by side, errors below each other."""
    from matplotlib.figure import Figure

    scenes = list(dict.fromkeys(work_precision["scene"].values))
    errors = [name for name in ("error", "contact_error") if name in work_precision]
    figure = Figure(figsize=(4.6 * len(scenes), 3.6 * len(errors)), layout="constrained")
    panels = figure.subplots(len(errors), len(scenes), squeeze=False)
    for row, error in zip(panels, errors, strict=True):
        for ax, scene in zip(row, scenes, strict=True):
            plot_work_precision(work_precision, scene=scene, error=error, ax=ax)
    panels[0, 0].legend(fontsize=7)
    return figure


def _history_panels(work_precision: "xr.Dataset") -> "Figure":
    """Scenes in rows of three, and one legend for all."""
    from matplotlib.figure import Figure

    scenes = list(dict.fromkeys(work_precision["scene"].values))
    rows = -(-len(scenes) // 3)
    figure = Figure(figsize=(13.8, 3.4 * rows + 0.6), layout="constrained")
    panels = figure.subplots(rows, 3, squeeze=False).ravel()
    lines: dict[str, Artist] = {}
    for ax, scene in zip(panels, scenes, strict=False):
        plot_history(work_precision, scene=scene, ax=ax)
        handles, labels = ax.get_legend_handles_labels()
        lines |= dict(zip(labels, handles, strict=True))
    for ax in panels[len(scenes) :]:
        ax.set_axis_off()
    figure.legend(
        list(lines.values()),
        list(lines),
        loc="outside lower center",
        ncols=6,
        title="filled: converged; open: not converged; dotted: residual asked for",
    )
    return figure


def draw_figures(out: str | Path) -> list[Path]:
    """Draw the figures of a finished run into its folder ``figures``.

    Parameters
    ----------
    out : path
        Run folder.

    Returns
    -------
    list of Path
        The PNG files, in the order of the chain.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    out = Path(out)
    tree = open_run(out, finished=True)
    response, law, result = (
        tree[name].to_dataset() for name in ("micro_response", "interface_law", "macro_result")
    )
    fields = open_dataset(out / "fields" / "fields.nc", FIELDS)
    figures = {
        "surface": lambda ax: plot_surface(fields, ax=ax),
        "contact_map": lambda ax: plot_contact_map(fields, ax=ax),
        "gap_law": lambda ax: plot_gap_law(response, law, ax=ax),
        "area_law": lambda ax: plot_area_law(response, law, ax=ax),
        "joint_stiffness": lambda ax: plot_joint_stiffness(result, ax=ax),
    }
    folder = make_folder(out / "figures")
    files = []
    with mpl.rc_context({"font.size": 10, "savefig.dpi": 150}):
        for name, draw in figures.items():
            figure = Figure(figsize=(5.2, 4.0), layout="constrained")
            draw(figure.add_subplot())  # type: ignore[no-untyped-call]
            files.append(folder / f"{name}.png")
            write_bytes(files[-1], _png(figure))
    return files


def _png(figure: "Figure") -> bytes:
    from io import BytesIO

    buffer = BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def _axes(ax: "Axes | None") -> "Axes":
    if ax is None:
        import matplotlib.pyplot as plt

        ax = plt.gca()
    return ax


def _extent(fields: "xr.Dataset") -> tuple[float, float, float, float]:
    return (0.0, 1e6 * fields.attrs["size_x"], 0.0, 1e6 * fields.attrs["size_y"])
