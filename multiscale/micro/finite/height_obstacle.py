"""The rigid obstacle in the current configuration: gap, normal and curvature at the nodes."""

from dataclasses import dataclass

import numpy as np

from multiscale.micro.contact_state import at_first_touch, obstacle_normal
from multiscale.micro.finite.deformed_surface import catmull_rom
from multiscale.surfaces.surface import Surface

__all__ = ["HeightObstacle", "RigidMeeting"]


@dataclass(frozen=True)
class RigidMeeting:
    r"""Contact points of the nodes of the body on the obstacle.

    Attributes
    ----------
    gap : ndarray, shape (nx, ny), distance along the normal, m; negative where the body is inside
    normal : ndarray, shape (nx, 3, ny), unit normals into the obstacle
    curvature : ndarray, shape (3, nx, ny), optional
        Second derivatives xx, xy, yy of the obstacle's height, 1/m; None for a flat obstacle.
    """

    gap: np.ndarray
    normal: np.ndarray
    curvature: np.ndarray | None

    def relative(self, vector: np.ndarray) -> np.ndarray:
        """Motion of the nodes relative to the fixed obstacle, shape (nx, 3, ny), m."""
        return np.asarray(vector[:, -1, :3])

    def react(self, vector: np.ndarray, force: np.ndarray) -> None:
        """Leave the internal forces unchanged: a rigid obstacle has none."""

    def turn(
        self, x: np.ndarray, shift: float, pressure: np.ndarray, force: np.ndarray, out: np.ndarray
    ) -> np.ndarray | float:
        """Compute the change of pressure forces, N, as a step turns the normals."""
        if self.curvature is None:
            return 0.0
        xx, xy, yy = self.curvature
        step, factor = self.relative(x), pressure * self.normal[:, 2]
        change = np.zeros_like(step)
        change[:, 0] = factor * (xx * step[:, 0] + xy * step[:, 1])
        change[:, 1] = factor * (xy * step[:, 0] + yy * step[:, 1])
        return np.asarray(change - np.sum(change * self.normal, axis=1)[:, None] * self.normal)


@dataclass(frozen=True, eq=False)
class HeightObstacle:
    r"""Periodic underside of a rigid body, which approaches and slides.

    Attributes
    ----------
    body : Surface, surface of the deformable body before deformation, with the grid of the nodes
    shape : Surface or None, heights of the obstacle on the same grid, m; flat if None
    follows : bool
        Whether nodes meet the obstacle at their current places (large strain) or at their
        undeformed places.

    Notes
    -----
    Between its points the obstacle is a product of Catmull-Rom splines: its normal is continuous,
    so that sliding nodes meet no kinks. The approach counts from the first touch of the
    points of both grids before any sliding.
    """

    body: Surface
    shape: Surface | None
    follows: bool

    @property
    def distance(self) -> float:
        """Offset of the obstacle's heights at first touch, m."""
        heights = 0.0 if self.shape is None else self.shape.heights
        return at_first_touch(self.body.heights, heights)[1]

    def mean_height(self, approach: float) -> float:
        """Mean height of the obstacle, m."""
        mean = 0.0 if self.shape is None else float(self.shape.heights.mean())
        return mean + self.distance - approach

    def meet(self, moved: np.ndarray, approach: float, slide: np.ndarray) -> RigidMeeting:
        """Project nodes, moved by (nx, 3, ny), m, at an approach, m, and a slide, (2,), m."""
        below = self.distance - approach - self.body.heights - moved[:, 2]
        if self.shape is None:
            normal = np.zeros_like(moved)
            normal[:, 2] = 1.0
            return RigidMeeting(below, normal, None)
        height, slope, curvature = self._sample(moved, slide)
        normal = obstacle_normal(slope[0], slope[1])
        return RigidMeeting((below + height) * normal[:, 2], normal, curvature)

    def _sample(
        self, moved: np.ndarray, slide: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Height, slopes and second derivatives of the obstacle below the nodes."""
        assert self.shape is not None
        heights, spacing = self.shape.heights, self.shape.spacing
        nx, ny = heights.shape
        grids = np.meshgrid(np.arange(nx, dtype=float), np.arange(ny, dtype=float), indexing="ij")
        first, weights = [], []
        for k in range(2):
            shift = moved[:, k] - slide[k] if self.follows else -slide[k]
            place = grids[k] + shift / spacing[k]
            cell = np.floor(place)
            first.append(cell.astype(int) - 1)
            weight = np.empty((3, 4, nx, ny))
            catmull_rom(place - cell, weight)  # type: ignore[no-untyped-call]
            weights.append(
                weight / np.array([1.0, spacing[k], spacing[k] ** 2])[:, None, None, None]
            )
        sums = np.zeros((6, nx, ny))
        for a in range(4):
            for b in range(4):
                value = heights[(first[0] + a) % nx, (first[1] + b) % ny]
                for row, (m, n) in enumerate(((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))):
                    sums[row] += value * weights[0][m][a] * weights[1][n][b]
        return sums[0], sums[1:3], sums[3:]
