r"""The opposite side in the current configuration: contact points, gaps, normals, forces.

The surface nodes of the opposite side define Catmull-Rom splines of its current position,

.. math:: x(\xi) = \sum_j W_j(\xi)\, x_j,    \tag{1}

with :math:`\xi` in grid points. With the tangents :math:`x_\alpha = \partial x / \partial
\xi^\alpha` of a contact point, their duals :math:`a^\alpha` and the normal :math:`n`, a node that
moves by :math:`w` relative to the point changes [1]_

.. math::
    \delta\xi^\alpha = a^\alpha \cdot w, \qquad
    \delta n = -a^\alpha\, n \cdot (x_{\alpha\beta}\, \delta\xi^\beta
        + \textstyle\sum_j W_{j,\alpha}\, \delta u_j),    \tag{2}

with :math:`u_j = 0` on a rigid side, and :math:`u_2 = \mathrm{diag}(1, 1, -1)\, v_2` with
:math:`v_2` in the local frame of a second body, on which a force :math:`t` has the reactions
:math:`-W_j t`.

.. [1] T. A. Laursen and J. C. Simo, Int. J. Numer. Methods Eng. 36 (1993) 3451-3485,
   doi:10.1002/nme.1620362005.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from multiscale.executors import run_ranges
from multiscale.micro.finite.strain import kernel
from multiscale.micro.layer import at_first_touch
from multiscale.numerics.compiled import compiled
from multiscale.surfaces.surface import Surface

MIRROR = np.array([1.0, 1.0, -1.0])[None, :, None]
SEARCHES = 40  # largest number of Newton steps of a search
LEAST = 1000  # fewest searches for a thread
CLOSE = 1e-13  # tolerance of a search, in grid distances

Surfaces = Callable[[np.ndarray], Sequence[np.ndarray]]


@kernel
def _catmull_rom(t, w):  # type: ignore[no-untyped-def]
    """Write Catmull-Rom weights of four neighbours, and their first and second derivatives."""
    w[0, 0], w[0, 1] = 0.5 * (-t + 2.0 * t**2 - t**3), 0.5 * (2.0 - 5.0 * t**2 + 3.0 * t**3)
    w[0, 2], w[0, 3] = 0.5 * (t + 4.0 * t**2 - 3.0 * t**3), 0.5 * (t**3 - t**2)
    w[1, 0], w[1, 1] = 0.5 * (-1.0 + 4.0 * t - 3.0 * t**2), 0.5 * (9.0 * t**2 - 10.0 * t)
    w[1, 2], w[1, 3] = 0.5 * (1.0 + 8.0 * t - 9.0 * t**2), 0.5 * (3.0 * t**2 - 2.0 * t)
    w[2, 0], w[2, 1], w[2, 2], w[2, 3] = 2.0 - 3.0 * t, 9.0 * t - 5.0, 4.0 - 9.0 * t, 3.0 * t - 1.0


@kernel
def _sample(field, dx, dy, x, y, wx, wy, values):  # type: ignore[no-untyped-def]
    """Write position and derivatives 1, 2 and 11, 12, 22 at (x, y); return the grid cell."""
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
    """Search the places above the targets if ``search`` is true, and sample the surface there."""
    nx, _, ny = field.shape
    for node in range(begin, end):
        wx, wy = np.empty((3, 4)), np.empty((3, 4))
        x, y, here = place[0, node], place[1, node], values[node]
        i, j = _sample(field, dx, dy, x, y, wx, wy, here)
        off = 0.0
        for _ in range(SEARCHES if search else 0):
            rx, ry = target[0, node] - here[0, 0], target[1, node] - here[0, 1]
            off = max(abs(rx) / dx, abs(ry) / dy)
            if not off > CLOSE * (1.0 + abs(x) + abs(y)):
                off = 0.0
                break
            det = here[1, 0] * here[2, 1] - here[1, 1] * here[2, 0]
            sx = (rx * here[2, 1] - ry * here[2, 0]) / det
            sy = (ry * here[1, 0] - rx * here[1, 1]) / det
            cut = min(1.0, 1.0 / max(abs(sx), abs(sy), 1e-300))
            x, y = x + cut * sx, y + cut * sy
            if not np.isfinite(x + y):
                break
            i, j = _sample(field, dx, dy, x, y, wx, wy, here)
        if not off < 1e-6:  # no place above the target: the surface has folded
            here[:] = np.nan
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
    """Points of the opposite surface."""

    place: np.ndarray  # (2, nx, ny), xi in grid points of the opposite surface, not wrapped
    values: np.ndarray  # (nx * ny, 6, 3), place and derivatives 1, 2, 11, 12, 22, m; NaN in folds
    column: np.ndarray  # (nx * ny, 16), nodes of the opposite surface around each point
    weight: np.ndarray  # (3, nx * ny, 16), weights (1) of the value and its derivatives 1 and 2
    points: tuple[int, int]  # grid of the opposite surface

    @property
    def grid(self) -> tuple[int, ...]:
        """Points of the first body."""
        return self.place.shape[1:]

    def field(self, row: int) -> np.ndarray:
        """Return a row of the values as a field, shape (nx, 3, ny)."""
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
        return np.moveaxis((self._matrices[derivative] @ flat).reshape(*self.grid, 3), -1, 1)

    def spread(self, force: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Distribute forces at the points, N, to the nodes, as the transpose of :meth:`carry`."""
        flat = np.moveaxis(force, 1, -1).reshape(-1, 3)
        return np.moveaxis((self._matrices[derivative].T @ flat).reshape(*self.points, 3), -1, 1)


@dataclass(frozen=True, eq=False)
class DeformedSurface:
    """A surface in its current position."""

    spacing: tuple[float, float]  # distances of nodes before deformation, m
    field: np.ndarray  # (nx, 3, ny), lateral displacements and heights of nodes, m

    def above(self, place: np.ndarray) -> Projection:
        """Search the points above or below places in the plane, shape (2, nx, ny), m."""
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


@dataclass(frozen=True, eq=False)
class Meeting:
    """Contact points of the nodes of the first body on the opposite side."""

    gap: np.ndarray  # (nx, ny), gap along the normal, m; negative in penetration
    normal: np.ndarray  # (nx, 3, ny), unit normals into the opposite side
    point: Projection | None  # points of the opposite side; None if normals are constant
    surfaces: Surfaces  # of each body, views of a vector, (nx, 3, ny)

    def relative(self, vector: np.ndarray) -> np.ndarray:
        """Motion of the nodes relative to their contact points, shape (nx, 3, ny), m."""
        first, *second = self.surfaces(vector)
        return first - MIRROR * self.point.carry(second[0]) if second and self.point else first

    def react(self, vector: np.ndarray, force: np.ndarray) -> None:
        """Add the reactions of contact forces on the nodes, N, to the second body, in place."""
        for second in self.surfaces(vector)[1:]:
            assert self.point is not None
            second += MIRROR * self.point.spread(force)

    def turn(
        self, x: np.ndarray, shift: float, pressure: np.ndarray, force: np.ndarray, out: np.ndarray
    ) -> np.ndarray | float:
        """Change of pressure forces, N, as a step turns normals, (2); add reactions to ``out``."""
        if self.point is None:
            return 0.0
        moved = self.relative(x).copy()
        moved[:, 2] += shift
        step = np.sum(self._dual * moved, axis=2)
        tilt = np.einsum("klxy,lxy->kxy", self._curvature, step)
        changes = zip(self.surfaces(x)[1:], self.surfaces(out)[1:], strict=True)
        for second, below in changes:
            for k in range(2):
                bent = MIRROR * self.point.carry(second, k + 1)
                tilt[k] += np.sum(self.normal * bent, axis=1)
                below += MIRROR * self.point.spread(force * step[k][:, None], k + 1)
        return np.asarray(np.sum(pressure[:, None] * tilt[:, :, None] * self._dual, axis=0))

    @cached_property
    def _dual(self) -> np.ndarray:
        """Dual tangents, shape (2, nx, 3, ny), 1/m."""
        assert self.point is not None
        tangents = self.point.values[:, 1:3]
        metric = np.einsum("iak,ibk->iab", tangents, tangents)
        dual = np.linalg.solve(metric, tangents).reshape(*self.point.grid, 2, 3)
        return np.ascontiguousarray(np.moveaxis(dual, (2, 3), (0, 2)))

    @cached_property
    def _curvature(self) -> np.ndarray:
        """Second derivatives along the normal, shape (2, 2, nx, ny), m."""
        assert self.point is not None
        xx, xy, yy = (np.sum(self.normal * self.point.field(k), axis=1) for k in (3, 4, 5))
        return np.array([[xx, xy], [xy, yy]])


@dataclass(frozen=True, eq=False)
class OppositeSide:
    """Rigid obstacle, or underside of the second body; the approach counts from the first touch."""

    body: Surface  # surface of the first body before deformation, with the grid of the nodes
    shape: Surface | None  # heights of the opposite side, m; None if it is flat
    follows: bool = True  # whether nodes meet it at their current places (large strain)

    @cached_property
    def places(self) -> np.ndarray:
        """Nodes of the first body in the plane, shape (2, nx, ny), m."""
        (nx, ny), (dx, dy) = self.body.heights.shape, self.body.spacing
        return np.stack(np.meshgrid(np.arange(nx) * dx, np.arange(ny) * dy, indexing="ij"))

    @cached_property
    def distance(self) -> float:
        """Offset of the heights of the opposite side at first touch, m."""
        heights: np.ndarray | float = 0.0
        if self.shape is not None:
            heights = self.shape.heights
            if heights.shape != self.body.heights.shape:
                above = self._surface(heights, np.zeros(2)).above(self.places)
                heights = above.field(0)[:, 2]
        return at_first_touch(self.body.heights, heights)[1]

    def mean_height(self, approach: float) -> float:
        """Mean height of the opposite side before deformation, m."""
        mean = 0.0 if self.shape is None else float(self.shape.heights.mean())
        return mean + self.distance - approach

    def meet(
        self, surfaces: Surfaces, u: np.ndarray, approach: float, slide: np.ndarray
    ) -> Meeting:
        """Locate the contact points at a displacement, m, an approach, m, and a slide, (2,), m."""
        moved = surfaces(u)
        heights = self.body.heights + moved[0][:, 2]
        if self.shape is None:
            normal = np.zeros_like(moved[0])
            normal[:, 2] = 1.0
            return Meeting(self.distance - approach - heights, normal, None, surfaces)
        place = self.places
        if self.follows:
            place = place + np.moveaxis(moved[0][:, :2], 1, 0)
        point = self._at(moved, approach, slide).above(place)
        normal = np.cross(point.field(1), point.field(2), axis=1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        gap = (point.field(0)[:, 2] - heights) * normal[:, 2]
        return Meeting(gap, normal, point if self.follows else None, surfaces)

    def slip_since(
        self, surfaces: Surfaces, u: np.ndarray, approach: float, slide: np.ndarray
    ) -> Callable[[np.ndarray, float, np.ndarray], np.ndarray]:
        """Return ``slip(u, approach, slide)``: motion since then along the contact points, m."""
        before, point = surfaces(u), None
        if len(before) > 1:
            point = self.meet(surfaces, u, approach, slide).point

        def slip(u_now: np.ndarray, approach_now: float, slide_now: np.ndarray) -> np.ndarray:
            moved = surfaces(u_now)
            if point is None:  # a rigid side moves as a whole
                motion = moved[0] - before[0]
                motion[:, :2] -= (slide_now - slide)[None, :, None]
                motion[:, 2] += approach_now - approach
                return np.asarray(motion)
            position = moved[0].copy()
            position[:, :2] += np.moveaxis(self.places, 0, 1)
            position[:, 2] += self.body.heights
            opposite = self._at(moved, approach_now, slide_now).at(point.place)
            return np.asarray(position - opposite.field(0))

        return slip

    def _at(
        self, moved: Sequence[np.ndarray], approach: float, slide: np.ndarray
    ) -> DeformedSurface:
        assert self.shape is not None
        height = self.shape.heights + (self.distance - approach)
        return self._surface(height, slide, *moved[1:])

    def _surface(
        self, height: np.ndarray, slide: np.ndarray, moved: np.ndarray | float = 0.0
    ) -> DeformedSurface:
        assert self.shape is not None
        field = np.zeros((height.shape[0], 3, height.shape[1])) + MIRROR * moved
        field[:, :2] += slide[None, :, None]
        field[:, 2] += height
        return DeformedSurface(self.shape.spacing, field)
