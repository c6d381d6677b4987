"""What every figure needs: axes to draw on, a canvas, and a file."""

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.io import write_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["axes_or_current", "new_figure", "plot_energy_parts", "save_figure"]

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


def plot_energy_parts(time: np.ndarray, parts: dict[str, np.ndarray], ax: "Axes") -> None:
    """Plot energies over time, J and s: those that are not zero throughout, and the sum of all."""
    for label, energy in parts.items():
        if np.nanmax(np.abs(energy)) > 0.0:
            ax.plot(time, energy, label=label)
    ax.plot(time, np.sum(list(parts.values()), axis=0), color="black", linestyle="--", label="sum")
    ax.set_xlabel("time (s)")
    ax.set_ylabel("energy (J)")
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)


def save_figure(figure: "Figure", file: Path) -> Path:
    """Write a figure as PNG, whole or not at all."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH)
    write_bytes(file, buffer.getvalue())
    return file
