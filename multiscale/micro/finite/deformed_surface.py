r"""The deformed surface of an opposite body, and its points above the nodes of the first body.

The surface nodes of the opposite body carry Catmull-Rom splines for its current position,

.. math:: x(\xi) = \sum_j W_j(\xi)\, x_j,    \tag{1}

periodic but for the period of the cell, with :math:`\xi` in grid points. A node at :math:`y` meets
it at the point :math:`\xi` above or below it. The splines reproduce linear functions, so that the
nodal forces :math:`W_j t` of a force :math:`t` at :math:`x(\xi)` have the same resultant and the
same moment.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from multiscale.executors import run_ranges
from multiscale.micro.finite.batch import kernel
from multiscale.numerics.compiled import compiled

__all__ = ["DeformedSurface", "Projection", "catmull_rom"]

SEARCHES = 40  # largest number of Newton steps of a search
LEAST = 1000  # searches for a thread
CLOSE = 1e-13  # tolerance of a search, in grid distances


def catmull_rom(t, w):  # type: ignore[no-untyped-def]
    """Write Catmull-Rom weights of four neighbours, and their first and second derivatives."""
    w[0, 0], w[0, 1] = 0.5 * (-t + 2.0 * t**2 - t**3), 0.5 * (2.0 - 5.0 * t**2 + 3.0 * t**3)
    w[0, 2], w[0, 3] = 0.5 * (t + 4.0 * t**2 - 3.0 * t**3), 0.5 * (t**3 - t**2)
    w[1, 0], w[1, 1] = 0.5 * (-1.0 + 4.0 * t - 3.0 * t**2), 0.5 * (9.0 * t**2 - 10.0 * t)
    w[1, 2], w[1, 3] = 0.5 * (1.0 + 8.0 * t - 9.0 * t**2), 0.5 * (3.0 * t**2 - 2.0 * t)
    w[2, 0], w[2, 1], w[2, 2], w[2, 3] = 2.0 - 3.0 * t, 9.0 * t - 5.0, 4.0 - 9.0 * t, 3.0 * t - 1.0


_catmull_rom = kernel(catmull_rom)


@kernel
def _sample(field, dx, dy, x, y, wx, wy, values):  # type: ignore[no-untyped-def]
    """Position, derivatives 1, 2 and 11, 12, 22 at (x, y); return the cell."""
    nx, _, ny = field.shape
    i, j = np.int64(np.floor(x)), np.int64(np.floor(y))
    _catmull_rom(x - i, wx)
    _catmull_rom(y - j, wy)
    values[:] = 0.0
    values[0, 0], values[0, 1] = x * dx, y * dy
    values[1, 0], values[2, 1] = dx, dy
    for a in range(4):
        for b in range(4):
            for k in range(3):
                value = field[(i + a - 1) % nx, k, (j + b - 1) % ny]
                values[0, k] += wx[0, a] * wy[0, b] * value
                values[1, k] += wx[1, a] * wy[0, b] * value
                values[2, k] += wx[0, a] * wy[1, b] * value
                values[3, k] += wx[2, a] * wy[0, b] * value
                values[4, k] += wx[1, a] * wy[1, b] * value
                values[5, k] += wx[0, a] * wy[2, b] * value
    return i, j


@compiled
def _locate(  # type: ignore[no-untyped-def]
    begin, end, field, dx, dy, target, search, place, values, column, weight
):
    """Find the places above the targets if ``search`` is true, and sample the surface there."""
    nx, _, ny = field.shape
    for node in range(begin, end):
        wx, wy = np.empty((3, 4)), np.empty((3, 4))
        x, y, found = place[0, node], place[1, node], values[node]
        i, j = _sample(field, dx, dy, x, y, wx, wy, found)
        off = 0.0
        for _ in range(SEARCHES if search else 0):
            rx, ry = target[0, node] - found[0, 0], target[1, node] - found[0, 1]
            off = max(abs(rx) / dx, abs(ry) / dy)
            if not off > CLOSE * (1.0 + abs(x) + abs(y)):
                off = 0.0
                break
            det = found[1, 0] * found[2, 1] - found[1, 1] * found[2, 0]
            sx = (rx * found[2, 1] - ry * found[2, 0]) / det
            sy = (ry * found[1, 0] - rx * found[1, 1]) / det
            cut = min(1.0, 1.0 / max(abs(sx), abs(sy), 1e-300))
            x, y = x + cut * sx, y + cut * sy
            if not np.isfinite(x + y):
                break
            i, j = _sample(field, dx, dy, x, y, wx, wy, found)
        if not off < 1e-6:  # no place above the target: the surface has folded
            found[:] = np.nan
        place[0, node], place[1, node] = x, y
        for a in range(4):
            for b in range(4):
                entry = 4 * a + b
                column[node, entry] = (i + a - 1) % nx * ny + (j + b - 1) % ny
                weight[0, node, entry] = wx[0, a] * wy[0, b]
                weight[1, node, entry] = wx[1, a] * wy[0, b]
                weight[2, node, entry] = wx[0, a] * wy[1, b]


@dataclass(frozen=True, eq=False)
class Projection:
    r"""Points of the opposite surface.

    Attributes
    ----------
    place : ndarray, shape (2, nx, ny)
        :math:`\xi`, in grid points of the opposite surface; not wrapped.
    values : ndarray, shape (nx * ny, 6, 3)
        Position and its derivatives by :math:`\xi`: 1, 2, 11, 12, 22, m. NaN where no point is
        above a node because the surface has folded.
    column : ndarray of int, shape (nx * ny, 16), nodes of the opposite surface around each point
    weight : ndarray, shape (3, nx * ny, 16)
        Weights (1) of these nodes for the value and its derivatives 1 and 2, dimensionless.
    points : tuple of int, grid of the opposite surface
    """

    place: np.ndarray
    values: np.ndarray
    column: np.ndarray
    weight: np.ndarray
    points: tuple[int, int]

    @property
    def grid(self) -> tuple[int, ...]:
        """Points of the first body."""
        return self.place.shape[1:]

    def field(self, row: int) -> np.ndarray:
        """One row of the values as a field, shape (nx, 3, ny)."""
        return np.moveaxis(self.values[:, row].reshape(*self.grid, 3), -1, 1)

    @cached_property
    def _matrices(self) -> list[csr_array]:
        nodes, entries = self.column.shape
        start = np.arange(nodes + 1) * entries
        shape = (nodes, int(np.prod(self.points)))
        return [
            csr_array((weight.ravel(), self.column.ravel(), start), shape=shape)
            for weight in self.weight
        ]

    def carry(self, field: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Interpolate a nodal field of the opposite surface, or its derivative by place 1 or 2."""
        flat = np.moveaxis(field, 1, -1).reshape(-1, 3)
        found = self._matrices[derivative] @ flat
        return np.moveaxis(found.reshape(*self.grid, 3), -1, 1)

    def spread(self, force: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Distribute forces at the points, N, to the nodes, as the transpose of :meth:`carry`."""
        flat = np.moveaxis(force, 1, -1).reshape(-1, 3)
        found = self._matrices[derivative].T @ flat
        return np.moveaxis(found.reshape(*self.points, 3), -1, 1)


@dataclass(frozen=True, eq=False)
class DeformedSurface:
    """A surface in its current position.

    Attributes
    ----------
    spacing : tuple of float, distances of its nodes before deformation, m
    field : ndarray, shape (nx, 3, ny)
        Lateral displacements of its nodes from their grid, and their heights, m.
    """

    spacing: tuple[float, float]
    field: np.ndarray

    def above(self, place: np.ndarray) -> Projection:
        """Find the points above or below places in the plane, shape (2, nx, ny), m."""
        mean = self.field.mean(axis=(0, 2))
        guess = [(place[k] - mean[k]) / self.spacing[k] for k in range(2)]
        return self._locate(np.stack(guess), place)

    def at(self, place: np.ndarray) -> Projection:
        r"""Sample at given :math:`\xi`, shape (2, nx, ny), in grid points."""
        return self._locate(place.copy(), None)

    def _locate(self, place: np.ndarray, target: np.ndarray | None) -> Projection:
        nodes = place[0].size
        start = np.ascontiguousarray(place.reshape(2, -1))
        values = np.empty((nodes, 6, 3))
        column, weight = np.empty((nodes, 16), dtype=np.int64), np.empty((3, nodes, 16))
        goal = start if target is None else np.ascontiguousarray(target.reshape(2, -1))
        field = np.ascontiguousarray(self.field)
        arguments = field, *self.spacing, goal, target is not None, start, values, column, weight
        run_ranges(_locate, nodes, *arguments, least=LEAST)
        points = self.field.shape[0], self.field.shape[2]
        return Projection(start.reshape(place.shape), values, column, weight, points)
