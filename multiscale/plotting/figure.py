"""Common parts of figures: axes, canvas, colour bars and files."""

from collections.abc import Callable
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.io import write_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D
else:  # a name for annotations, without what takes long to load
    Axes = Any

__all__ = [
    "DOTS_PER_INCH",
    "WIDE",
    "Axes",
    "add_colour_bar",
    "axes_or_current",
    "colour_faces",
    "in_space",
    "is_drawn",
    "new_figure",
    "on_axes",
    "save_figure",
    "set_box",
]

DOTS_PER_INCH = 150

PROGRAM = "multiscale"
"""What the files of figures name as their program."""

SIZE = (5.2, 4.0)
"""Width and height of a figure, if nothing else is asked for, inches."""

WIDE = (8.6, 4.2)
"""Width and height of a figure that stands alone in the width of a page, inches."""

MARGIN = 8  # rows of pixels above and below what is drawn

LAYOUT_PASSES, SETTLED = 5, 1e-3
"""Most layout passes, as axes of fixed aspect change in size with the room for their labels, and
motion of all axes, over the size of the figure, below which there are no more."""

TICKS = {
    0.5: (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0),
    1.0: (1.0, 2.0, 3.0, 5.0),
    2.5: (1.0, 2.0, 5.0),
}
"""Labelled parts of a decade on logarithmic axes, by the number of decades below which they are."""

DECADES, MOST_TICKS = max(TICKS), 30

SPACE_TICKS, FLATTEST, SPACE_ZOOM = 5, 0.05, 0.9
"""Ticks on the longest edge of a box in space, least ratio of its edges, and its size over the size
that matplotlib chooses."""

WIDE_ASPECT = 1.5
"""Width over height of axes above which a colour bar stands below them."""

BAR_THICKNESS, BAR_BESIDE, BAR_BELOW = 0.12, 0.08, 0.65
"""Thickness of a colour bar, its distance beside axes, and below axes with labels, inches."""


def axes_or_current(ax: Axes | None) -> Axes:
    """Return the given axes, or the current axes for None."""
    if ax is None:
        import matplotlib.pyplot as plt

        ax = plt.gca()
    return ax


def new_figure(width: float = SIZE[0], height: float = SIZE[1]) -> "Figure":
    """Return an empty figure without a window; width and height in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def add_colour_bar(mappable: "ScalarMappable", ax: Axes, label: str) -> None:
    """Put a colour bar beside axes whose limits and equal aspect are set, below wide ones.

    Axes of fixed aspect may be far smaller than their room in the layout, at whose edge a bar
    would stand apart from them. This bar is as long as the axes.
    """
    from matplotlib.transforms import ScaledTranslation, blended_transform_factory

    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    wide = right - left > WIDE_ASPECT * (high - low)
    corner = ScaledTranslation(0.0 if wide else 1.0, 0.0, ax.transAxes)  # type: ignore[arg-type]
    inches, along = ax.figure.dpi_scale_trans + corner, ax.transAxes
    if wide:
        below = blended_transform_factory(along, inches)
        place = ax.inset_axes((0.0, -BAR_BELOW, 1.0, BAR_THICKNESS), transform=below)
    else:
        beside = blended_transform_factory(inches, along)
        place = ax.inset_axes((BAR_BESIDE, 0.0, BAR_THICKNESS, 1.0), transform=beside)
    orientation = "horizontal" if wide else "vertical"
    ax.figure.colorbar(mappable, cax=place, label=label, orientation=orientation)


def colour_faces(
    ax: "Axes3D",
    faces: np.ndarray,
    values: np.ndarray,
    label: str,
    limits: tuple[float, float],
    **style: Any,
) -> None:
    """Draw faces in space, (faces, corners, 3), coloured by values, and a colour bar."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    scale, colours = Normalize(*limits), colormaps["viridis"]
    ax.add_collection3d(Poly3DCollection(faces, facecolors=colours(scale(values)), **style))
    ax.figure.colorbar(ScalarMappable(scale, colours), ax=ax, label=label, shrink=0.6, pad=0.1)


def set_box(ax: "Axes3D", low: np.ndarray, high: np.ndarray) -> None:
    """Show a box in true proportions, with ticks as far apart on short edges as on long ones."""
    from matplotlib.ticker import FixedLocator, MaxNLocator

    lengths = high - low
    for axis, ratio, middle in zip(
        (ax.xaxis, ax.yaxis, ax.zaxis), lengths / lengths.max(), 0.5 * (low + high), strict=True
    ):
        ticks = round(SPACE_TICKS * float(ratio))
        axis.set_major_locator(
            MaxNLocator(ticks) if ticks else FixedLocator([float(f"{middle:.1g}")])
        )
    # a flat structure stays visible, and labels inside the figure
    edges = np.maximum(lengths, FLATTEST * lengths.max())
    wider = 0.5 * (edges - lengths)
    (x, y, z) = np.stack([low - wider, high + wider], axis=1)
    ax.set(xlim=x, ylim=y, zlim=z)
    ax.set_box_aspect(edges, zoom=SPACE_ZOOM)


def _label_logarithms(axis: "Axis") -> None:
    """Write numbers as an engineer does at the ticks of a logarithmic axis: 1, 2, 5, 10."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = sorted(axis.get_view_interval())  # an inverted axis falls
    decades = np.log10(high / low)
    if not decades < DECADES:
        return
    each = next(subs for width, subs in TICKS.items() if decades < width)
    axis.set_major_locator(LogLocator(subs=each, numticks=MOST_TICKS))
    axis.set_minor_formatter(NullFormatter())
    if low >= 1e-3 and high <= 2e4:
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _dress(ax: Axes) -> None:
    """Give axes the style of all figures: open frame, quiet title, legend without a box."""
    if ax.get_label() == "<colorbar>":
        return
    if not ax.images:
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(color="0.9", linewidth=0.6)
        ax.set_axisbelow(True)
    # at a height of its own, for which matplotlib would search slowly
    ax.set_title(ax.get_title(), fontsize="medium", y=1.0)
    if (legend := ax.get_legend()) is not None:
        legend.get_frame().set(linewidth=0.0, alpha=0.8)


def save_figure(figure: "Figure", file: Path) -> Path:
    """Write a figure in the style of all figures as a complete PNG file, or no file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.image import imsave

    for ax in figure.axes:
        _dress(ax)
        for axis in (ax.xaxis, ax.yaxis):
            if axis.get_scale() == "log":
                _label_logarithms(axis)
    layout = figure.get_layout_engine()
    if layout is not None:
        figure.set_dpi(DOTS_PER_INCH)  # sizes of letters depend on it
        fixed = any(ax.get_aspect() != "auto" for ax in figure.axes)
        before = np.full((len(figure.axes), 4), np.inf)
        for _ in range(LAYOUT_PASSES if fixed else 1):
            layout.execute(figure)
            places = np.array([ax.get_position().extents for ax in figure.axes]).reshape(-1, 4)
            if np.abs(places - before).max(initial=0.0) < SETTLED:
                break
            before = places
        figure.set_layout_engine("none")  # or it would be drawn twice
    figure.set_dpi(DOTS_PER_INCH)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    image = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
    if layout is not None and fixed:  # axes of fixed aspect leave room above and below them
        drawn = np.flatnonzero(image.min(axis=(1, 2)) < image.max())
        image = image[max(drawn[0] - MARGIN, 0) : drawn[-1] + MARGIN]
    buffer = BytesIO()
    imsave(buffer, image, format="png", dpi=DOTS_PER_INCH, metadata={"Software": PROGRAM})
    write_bytes(file, buffer.getvalue())
    return file


def is_drawn(file: Path) -> bool:
    """Whether a file is a figure of :func:`save_figure`."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(file) as image:
            return bool(image.info.get("Software") == PROGRAM)
    except UnidentifiedImageError:
        return False


def on_axes(
    plot: Callable[..., object],
    *shown: object,
    size: tuple[float, float] = SIZE,
    projection: str | None = None,
    **options: object,
) -> Callable[[Path], Path]:
    """Return ``draw(file)``, which calls ``plot(*shown, ax=..., **options)`` for a PNG file.

    The axes are new, of a size in inches.
    """

    def draw(file: Path) -> Path:
        figure = new_figure(*size)
        plot(*shown, ax=figure.add_subplot(projection=projection), **options)
        return save_figure(figure, file)

    return draw


in_space = partial(on_axes, projection="3d")
"""The same with axes in space."""
