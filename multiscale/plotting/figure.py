"""What every figure needs: axes to draw on, a canvas, and a file."""

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from multiscale.io import write_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["axes_or_current", "new_figure", "save_figure"]

DOTS_PER_INCH = 150


def axes_or_current(ax: "Axes | None") -> "Axes":
    """Return the axes given, or the current ones."""
    if ax is None:
        import matplotlib.pyplot as plt

        ax = plt.gca()
    return ax


def new_figure(width: float = 5.2, height: float = 4.0) -> "Figure":
    """Return an empty figure that no window shows; width and height in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def save_figure(figure: "Figure", file: Path) -> Path:
    """Write a figure as PNG, whole or not at all."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH)
    write_bytes(file, buffer.getvalue())
    return file
