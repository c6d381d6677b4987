"""Rigid plates on bodies."""

from dataclasses import dataclass

import numpy as np

from multiscale.macro.continuum.body import Body, Value

__all__ = ["Platen"]


@dataclass(frozen=True)
class Platen:
    """A rigid plate on a boundary of a body, which moves along one axis and may tilt.

    Along the other axes the nodes of the boundary are free, or held by the supports of the body. A
    plate that is guided has one unknown, its displacement. One that tilts has three, which are its
    displacements at its middle and at the ends of its half-lengths along the two other axes, so
    that they move with a rigid body as the displacements of nodes do.

    Attributes
    ----------
    body : int
    boundary : str
    force : float or callable, along the axis, N; in the form of the tractions of a body
    point : tuple of float, optional
        Where the force acts, m: the plate tilts freely. It is guided if not given.
    axis : int, default 2, along which it moves
    """

    body: int
    boundary: str
    force: Value
    point: tuple[float, float, float] | None = None
    axis: int = 2

    def positions(self, body: Body) -> np.ndarray:
        """Points of the plate whose displacements along the axis are its unknowns, (3, k), m."""
        nodes = body.basis.doflocs[:, body.nodes(self.boundary)]
        low, high = nodes.min(axis=1), nodes.max(axis=1)
        middle = 0.5 * (low + high)
        if self.point is None:
            return np.asarray(middle[:, None])
        first, second = (axis for axis in range(3) if axis != self.axis)
        ends = np.eye(3)[[first, second]] * (high - middle)
        return np.column_stack([middle, middle + ends[0], middle + ends[1]])

    def motion(self, body: Body, position: np.ndarray) -> np.ndarray:
        """Displacement along the axis that its unknowns give to points (3, m), shape (m, k)."""
        unknowns = self.positions(body)
        if self.point is None:
            return np.ones((position.shape[1], 1))
        across = [axis for axis in range(3) if axis != self.axis]
        half = np.diag(unknowns[across, 1:] - unknowns[across, :1])
        tilts = ((position[across] - unknowns[across, :1]) / half[:, None]).T
        return np.asarray(np.column_stack([1.0 - tilts.sum(axis=1), tilts]))

    def arm(self, body: Body) -> np.ndarray:
        """Displacement of the force that its unknowns give, shape (k,)."""
        at = self.positions(body)[:, 0] if self.point is None else np.array(self.point)
        return np.asarray(self.motion(body, at[:, None])[0])
