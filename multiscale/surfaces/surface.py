"""A rough surface: heights on a regular grid."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.units import html_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class Surface:
    """Heights of a surface on a regular grid of a rectangular cell.

    Parameters
    ----------
    heights : ndarray, shape (nx, ny)
        Height at the nodes ``x_i = i dx``, ``y_j = j dy``, m; positive out of the body. The array
        is copied.
    size : tuple of float
        Edge lengths (Lx, Ly) of the cell, m, with ``dx = Lx / nx``: in a periodic surface node
        ``nx`` is node 0 again. ``nx`` and ``ny``, ``dx`` and ``dy`` may differ. A profile has
        ``ny = 1``: its cell is in plane strain, and its width is arbitrary.
    filled : ndarray of bool, shape (nx, ny), optional
        Whether a point of a map was filled instead of measured; no point if not given. Detrended
        and cropped maps keep it.

    Examples
    --------
    >>> surface = Surface(np.zeros((4, 2)), size=(8.0e-6, 2.0e-6))
    >>> surface.spacing
    (2e-06, 1e-06)
    """

    heights: np.ndarray
    size: tuple[float, float]
    filled: np.ndarray | None = None

    def __post_init__(self) -> None:
        heights: np.ndarray = np.ma.filled(
            np.ma.array(self.heights, dtype=float, copy=True), np.nan
        )
        size = tuple(float(length) for length in self.size)
        if heights.ndim != 2 or min(heights.shape) < 1 or heights.size < 2:
            raise CaseError(
                f"heights must be a map (nx, ny) of at least 2 x 1 points, got an array of shape "
                f"{heights.shape}"
            )
        undefined = np.count_nonzero(~np.isfinite(heights))
        if undefined:
            raise CaseError(
                f"{undefined} of {heights.size} heights are undefined (NaN or infinite); fill them "
                f"or crop the map"
            )
        if len(size) != 2 or not all(0.0 < length < np.inf for length in size):
            raise CaseError(f"size must be two positive lengths (m), got {size}")
        if self.filled is not None and self.filled.shape != heights.shape:
            raise CaseError(
                f"filled must mark each of {heights.shape[0]} x {heights.shape[1]} heights, got an "
                f"array of shape {self.filled.shape}"
            )
        object.__setattr__(self, "heights", heights)
        object.__setattr__(self, "size", size)

    @property
    def spacing(self) -> tuple[float, float]:
        """Distances (dx, dy) of neighbouring nodes, m."""
        return self.size[0] / self.heights.shape[0], self.size[1] / self.heights.shape[1]

    @property
    def filled_share(self) -> float:
        """Filled points over all points, dimensionless."""
        return 0.0 if self.filled is None else float(np.mean(self.filled))

    def plot(self, *, ax: "Axes | None" = None) -> "Axes":
        """Plot the heights in colours, in the current axes if none are given."""
        import matplotlib.pyplot as plt

        ax = ax or plt.gca()
        extent = (0.0, 1e6 * self.size[0], 0.0, 1e6 * self.size[1])
        image = ax.imshow(1e6 * self.heights.T, origin="lower", extent=extent, cmap="RdBu_r")
        ax.figure.colorbar(image, ax=ax, label="height (µm)")
        ax.set(xlabel="x (µm)", ylabel="y (µm)")
        return ax

    def _repr_html_(self) -> str:
        nx, ny = self.heights.shape
        rows = {
            "points": f"{nx} x {ny}",
            "length": f"{self.size[0]} m",
            "width": f"{self.size[1]} m",
            "rms height": f"{float(np.std(self.heights))} m",
            "filled": f"{100.0 * self.filled_share:.3g} %",
        }
        return html_table("Surface", rows)


def remove_trend(heights: np.ndarray, order: int) -> np.ndarray:
    r"""Subtract the least-squares polynomial of a total degree."""
    if order not in (0, 1, 2):
        raise CaseError(
            f"the detrending order must be 0 (mean), 1 (plane) or 2 (curvature), got {order!r}"
        )
    powers = [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]
    x, y = (np.vander(np.linspace(-1.0, 1.0, n), 2 * order + 1, True) for n in heights.shape)
    defined = np.isfinite(heights)
    heights = heights - np.mean(heights[defined])  # a large offset would cost digits of the fit
    moments = x.T @ (defined.astype(float) @ y)  # sums of x^i y^j over the defined points
    matrix = np.array([[moments[i + k, j + m] for k, m in powers] for i, j in powers])
    for _ in range(2):  # the second pass removes the round-off of the first
        weighted = x.T @ np.where(defined, heights, 0.0) @ y
        sums = np.array([weighted[power] for power in powers])
        fitted = np.zeros((order + 1, order + 1))
        fitted[tuple(zip(*powers, strict=True))] = np.linalg.lstsq(matrix, sums, rcond=1e-12)[0]
        # contiguous arrays: six times faster
        along_y = np.ascontiguousarray(fitted @ y[:, : order + 1].T)
        heights = heights - np.ascontiguousarray(x[:, : order + 1]) @ along_y
    detrended: np.ndarray = heights
    return detrended
