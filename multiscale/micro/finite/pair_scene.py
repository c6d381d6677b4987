"""The scene with two deformable bodies for the Newton iteration."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from multiscale.micro.finite.pair_reference import JoinedReference, PairReference
from multiscale.micro.finite.scene import CellScene, CellState, touch_flat
from multiscale.micro.finite.two_bodies import MIRROR, Halves, PairMeeting, Underside

__all__ = ["PairScene"]


@dataclass(frozen=True, eq=False)
class PairScene(CellScene):
    """A scene with two deformable bodies.

    Attributes
    ----------
    body : FiniteBody, both bodies, joined
    obstacle : Underside, surfaces of both bodies before deformation
    reference : PairReference, flat cells of both bodies for the preconditioner
    halves : Halves
    """

    obstacle: Underside
    reference: PairReference
    halves: Halves

    def first_touch(
        self, gap: np.ndarray, closing: np.ndarray, load: float
    ) -> tuple[np.ndarray, float]:
        """Press the flat cells of both bodies."""
        return touch_flat(self.reference.both.vertical[0], gap, closing, load)

    def surface(self, vector: np.ndarray) -> np.ndarray:
        """Surface of the first body, a view of shape (nx, 3, ny)."""
        return self.halves.surfaces(vector)[0]

    def opposite_surface(self, vector: np.ndarray) -> np.ndarray:
        """Surface of the second body in the frame of the first, shape (nx, 3, ny)."""
        return np.asarray(MIRROR * self.halves.surfaces(vector)[1])

    def meet(self, u: np.ndarray, approach: float, slide: np.ndarray) -> PairMeeting:
        """Find where the nodes of the first body meet the second."""
        surface = self.obstacle.deformed(self.opposite_surface(u), approach, slide)
        moved = self.surface(u)
        point = surface.above(self.obstacle.places + np.moveaxis(moved[:, :2], 1, 0))
        normal = np.cross(point.field(1), point.field(2), axis=1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        below = point.field(0)[:, 2] - self.obstacle.body.heights - moved[:, 2]
        return PairMeeting(below * normal[:, 2], normal, point, self.halves)

    def slip_since(self, start: CellState) -> Callable[..., np.ndarray]:
        """Return ``slip(u, approach, slide)``, the motion past the points met at the start, m."""
        place = self.meet(start.displacement, start.approach, start.slide).point.place

        def slip(u: np.ndarray, approach: float, slide: np.ndarray) -> np.ndarray:
            surface = self.obstacle.deformed(self.opposite_surface(u), approach, slide)
            position = self.surface(u).copy()
            position[:, :2] += np.moveaxis(self.obstacle.places, 0, 1)
            position[:, 2] += self.obstacle.body.heights
            return np.asarray(position - surface.at(place).field(0))

        return slip

    def reference_at(self, meeting: PairMeeting) -> JoinedReference:
        """Return both references, joined at the contact points."""
        return JoinedReference(self.reference, meeting)
