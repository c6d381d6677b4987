"""Lines of variables, with the bands of their intervals, with the labels of ``SHOWN``."""

from collections.abc import Iterator

import numpy as np

from multiscale.plotting.figure import Axes, axes_or_current
from multiscale.schema import SHOWN, Dataset, unit_in

BANDS = {"one_part": 0.2, "mean_law": 0.45}
"""Both intervals of an answer, and the opacity of their bands."""

STYLES = ("o-", "s--", "--", ":")  # line styles of several variables

MOST_COLOURS, LARGEST_LEGEND = 10, 10
"""Largest numbers of lines with different colours, and with a legend."""


def plot_lines(
    data: Dataset,
    *names: str,
    by: str = "",
    over: str = "",
    ax: Axes | None = None,
    **settings: object,
) -> Axes:
    """Plot variables over another variable; a single variable has the bands of its intervals.

    Parameters
    ----------
    *names : str, variables of :data:`multiscale.schema.SHOWN`; missing variables are left out
    by : str
        Dimension or variable; each of its labels or values has a line.
    over : str, variable on the horizontal axis; by default as in ``SHOWN``, or the step number
    ax : Axes, optional
    **settings
        Settings of the axes, such as ``xscale="log"``.
    """
    ax, names = axes_or_current(ax), tuple(name for name in names if name in data)
    over = over or next((axis for axis in SHOWN[names[0]].over if axis in data), "")
    count = 0
    for name, style in zip(names, STYLES * len(names), strict=False):
        unit = unit_in(data, name)
        (along,) = data[over].dims if over else ("step",)
        for line, label in _lines(data, by, str(along)):
            x = line[over].to_numpy() if over else np.arange(line.sizes[along])
            if over:
                x = unit_in(data, over).shown(x)
            y, colour = unit.shown(line[name].to_numpy()), f"C{count % MOST_COLOURS}"
            if len(names) == 1:
                draw_bands(line, name, x, ax, unit.scale, colour, labelled=not by)
            ax.plot(x, y, style, color=colour, markersize=4, label=label or SHOWN[name].label)
            count += 1
    ax.set(xlabel=_axis(data, over) if over else "step")
    family, unit = SHOWN[names[0]].unit, unit_in(data, names[0])
    several = unit.name if unit.name == family else f"{family} ({unit.name})"
    ax.set(ylabel=_axis(data, names[0]) if len(names) == 1 else several)
    ax.set(**settings)
    if 1 < count <= LARGEST_LEGEND or len(ax.collections):
        ax.legend(fontsize="small")
    return ax


def draw_bands(
    line: Dataset,
    name: str,
    x: np.ndarray,
    ax: Axes,
    scale: float = 1.0,
    colour: str = "C0",
    *,
    labelled: bool = True,
) -> None:
    """Draw the intervals of a variable, if it has any, as bands."""
    for kind, alpha in BANDS.items():
        if f"{name}_{kind}" in line:
            ends = scale * line[f"{name}_{kind}"].to_numpy()
            label = f"{kind.replace('_', ' ')}, 95 %" if labelled else None
            draw_band(ax, x, ends, colour, alpha=alpha, label=label)


def draw_band(
    ax: Axes,
    x: np.ndarray,
    ends: np.ndarray,
    colour: str = "C0",
    *,
    alpha: float = 0.3,
    label: str | None = "95 % band",
    sideways: bool = False,
) -> None:
    """Fill between two ends, (2, points), over the horizontal or, sideways, the vertical axis."""
    fill = ax.fill_betweenx if sideways else ax.fill_between
    fill(x, *ends, color=colour, alpha=alpha, linewidth=0, label=label)


def _lines(data: Dataset, by: str, along: str) -> Iterator[tuple[Dataset, str]]:
    if not by:
        yield data, ""
        return
    values = data[by].to_numpy()
    (dim,) = data[by].dims
    for k, value in enumerate(np.unique(values) if dim == along else values):
        at = np.flatnonzero(values == value) if dim == along else k
        label = f"{by} {value}"
        if by in SHOWN:
            unit = unit_in(data, by)
            label = f"{unit.shown(value):.4g} {unit.name}"
        yield data.isel({dim: at}), label


def _axis(data: Dataset, name: str) -> str:
    unit = unit_in(data, name).name
    return SHOWN[name].label if unit == "1" else f"{SHOWN[name].label} ({unit})"
