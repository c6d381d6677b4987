"""Common parts of figures: axes, canvas, colour bars, faces of elements and files."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.io import write_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.axis import Axis
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D
else:  # a name for annotations, without the slow import
    Axes = Any

DOTS_PER_INCH = 150

PROGRAM = "multiscale"  # program in the metadata of figure files
SIZE = (5.2, 4.0)  # default width and height of a figure, inches
WIDE = (8.6, 4.2)  # width and height of a figure as wide as a page, inches

MARGIN = 8  # rows of pixels above and below the drawing

LAYOUT_PASSES, SETTLED = 5, 1e-3
"""Largest number of layout passes, as axes of fixed aspect change in size with their labels, and
motion of the axes, over the size of the figure, below which the passes end."""

TICKS = {
    0.5: (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0),
    1.0: (1.0, 2.0, 3.0, 5.0),
    2.5: (1.0, 2.0, 5.0),
}
"""Labelled multiples in a decade of logarithmic axes, by the largest number of decades."""

DECADES, MOST_TICKS = max(TICKS), 30

SPACE_TICKS, FLATTEST, SPACE_ZOOM = 5, 0.05, 0.9
"""Ticks on the longest edge of a box in space, smallest ratio of its edges, and its size over the
size that matplotlib chooses."""

WIDE_ASPECT = 1.5  # width over height of axes above which a colour bar is below them

BAR_THICKNESS, BAR_BESIDE, BAR_BELOW = 0.12, 0.08, 0.65
"""Thickness of a colour bar, its distance to axes at its left and above it, inches."""


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
    """Add a colour bar as long as the axes, which have limits: at their side, or below if wide."""
    from matplotlib.transforms import ScaledTranslation, blended_transform_factory

    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    wide = right - left > WIDE_ASPECT * (high - low)
    corner = ScaledTranslation(0.0 if wide else 1.0, 0.0, ax.transAxes)  # type: ignore[arg-type]
    inches, along = ax.figure.dpi_scale_trans + corner, ax.transAxes
    if wide:
        below = blended_transform_factory(along, inches)
        place = ax.inset_axes((0.0, -BAR_BELOW, 1.0, BAR_THICKNESS), transform=below)
    else:
        right_of = blended_transform_factory(inches, along)
        place = ax.inset_axes((BAR_BESIDE, 0.0, BAR_THICKNESS, 1.0), transform=right_of)
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
    """Show a box in true proportions, with equal distances of ticks on all edges."""
    from matplotlib.ticker import FixedLocator, MaxNLocator

    lengths = high - low
    for axis, ratio, middle in zip(
        (ax.xaxis, ax.yaxis, ax.zaxis), lengths / lengths.max(), 0.5 * (low + high), strict=True
    ):
        ticks = round(SPACE_TICKS * float(ratio))
        axis.set_major_locator(
            MaxNLocator(ticks) if ticks else FixedLocator([float(f"{middle:.1g}")])
        )
    # keep a flat structure visible, and labels inside the figure
    edges = np.maximum(lengths, FLATTEST * lengths.max())
    wider = 0.5 * (edges - lengths)
    (x, y, z) = np.stack([low - wider, high + wider], axis=1)
    ax.set(xlim=x, ylim=y, zlim=z)
    ax.set_box_aspect(edges, zoom=SPACE_ZOOM)


def _label_logarithms(axis: "Axis") -> None:
    """Write plain numbers at the ticks of a logarithmic axis: 1, 2, 5, 10."""
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
    if ax.get_label() == "<colorbar>":
        return
    if not ax.images:
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(color="0.9", linewidth=0.6)
        ax.set_axisbelow(True)
    # at a fixed height, as the search of matplotlib is slow
    ax.set_title(ax.get_title(), fontsize="medium", y=1.0)
    if (legend := ax.get_legend()) is not None:
        legend.get_frame().set(linewidth=0.0, alpha=0.8)


def save_figure(figure: "Figure", file: Path) -> Path:
    """Write a figure in the style of all figures as a PNG file, complete or not at all."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.image import imsave

    for ax in figure.axes:
        _dress(ax)
        for axis in (ax.xaxis, ax.yaxis):
            if axis.get_scale() == "log":
                _label_logarithms(axis)
    layout = figure.get_layout_engine()
    if layout is not None:
        figure.set_dpi(DOTS_PER_INCH)  # text sizes depend on it
        fixed = any(ax.get_aspect() != "auto" for ax in figure.axes)
        before = np.full((len(figure.axes), 4), np.inf)
        for _ in range(LAYOUT_PASSES if fixed else 1):
            layout.execute(figure)
            places = np.array([ax.get_position().extents for ax in figure.axes]).reshape(-1, 4)
            if np.abs(places - before).max(initial=0.0) < SETTLED:
                break
            before = places
        figure.set_layout_engine("none")  # prevents a second layout in draw()
    figure.set_dpi(DOTS_PER_INCH)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    image = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
    if layout is not None and fixed:  # axes of fixed aspect leave space above and below
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
    """Return ``draw(file)``, which calls ``plot(*shown, ax=..., **options)`` for a PNG file."""

    def draw(file: Path) -> Path:
        figure = new_figure(*size)
        plot(*shown, ax=figure.add_subplot(projection=projection), **options)
        return save_figure(figure, file)

    return draw


in_space = partial(on_axes, projection="3d")  # as on_axes, with axes in space


_CORNERS = {
    4: [*combinations(range(4), 3)],
    8: [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)],
}
"""Corners of the faces of tetrahedra and hexahedra, in the order of VTK."""


@dataclass(frozen=True, eq=False)
class OuterFaces:
    """Faces that belong to a single element."""

    corners: np.ndarray  # (faces, corners of a face), nodes
    element: np.ndarray  # (faces,), in increasing order


def list_faces(corners: np.ndarray) -> np.ndarray:
    """Corners of the faces of every element, shape (elements, faces, corners of a face)."""
    return np.asarray(corners[:, np.array(_CORNERS[corners.shape[1]])])


def outer_faces(corners: np.ndarray) -> OuterFaces:
    """Return the outer faces of elements with ``corners`` of shape (elements, corners)."""
    faces = list_faces(corners)
    every = faces.reshape(-1, faces.shape[2])
    _, first, count = np.unique(
        np.sort(every, axis=1), axis=0, return_index=True, return_counts=True
    )
    outer = np.sort(first[count == 1])
    return OuterFaces(every[outer], outer // faces.shape[1])
