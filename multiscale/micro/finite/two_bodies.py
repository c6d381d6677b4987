r"""Two deformable bodies: the second is upside down above the first and slides.

One vector contains the displacements of both bodies, each in its own frame. In the frame of the
second body z points out of its surface: :math:`u_2 = M v_2` with
:math:`M = \mathrm{diag}(1, 1, -1)`. A node of the first body meets the second at the point
:math:`x(\xi)` above it, with the tangents
:math:`x_\alpha = \partial x / \partial \xi^\alpha`, their duals :math:`a^\alpha` and the normal
:math:`n`. If it moves by :math:`w` relative to that point,

.. math::
    \delta\xi^\alpha = a^\alpha \cdot w, \qquad
    \delta n = -a^\alpha\, n \cdot (x_{\alpha\beta}\, \delta\xi^\beta
        + \textstyle\sum_j W_{j,\alpha}\, \delta u_j).    \tag{1}

A contact force :math:`t` on the node leaves :math:`-W_j t` on the nodes of the second body.

References
----------
.. [1] T. A. Laursen and J. C. Simo, Int. J. Numer. Methods Eng. 36 (1993) 3451-3485,
   doi:10.1002/nme.1620362005: two bodies in the current configuration, and its linearisation.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from multiscale.micro.finite.deformed_surface import DeformedSurface, Projection
from multiscale.micro.finite.finite_body import BodyResponse, FiniteBody, Increment
from multiscale.surfaces.surface import Surface

__all__ = ["MIRROR", "Halves", "PairMeeting", "Underside", "join_bodies"]

MIRROR = np.array([1.0, 1.0, -1.0])[None, :, None]


@dataclass(frozen=True)
class Halves:
    """Places of two bodies in one vector.

    Attributes
    ----------
    shapes : tuple of tuple of int, shapes (nx, layers, 3 or 4, ny) of both displacements
    """

    shapes: tuple[tuple[int, ...], tuple[int, ...]]

    def split(self, vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the fields of both bodies, as views."""
        size = int(np.prod(self.shapes[0]))
        return vector[:size].reshape(self.shapes[0]), vector[size:].reshape(self.shapes[1])

    def join(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Put the fields of both bodies into one vector."""
        return np.concatenate([first.reshape(-1), second.reshape(-1)])

    def surfaces(self, vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the fields at both surfaces, views (nx, 3, ny), each in its own frame."""
        first, second = self.split(vector)
        return first[:, -1, :3], second[:, -1, :3]


def join_bodies(first: FiniteBody, second: FiniteBody) -> FiniteBody:
    """Return two bodies as one, whose state is the pair of their states."""
    halves = Halves((first.shape, second.shape))
    sizes = np.array([np.prod(shape) for shape in halves.shapes], dtype=float)

    def begin(state: Any, time_step: float) -> Increment:
        steps = [body.begin(s, time_step) for body, s in zip((first, second), state, strict=True)]

        def respond(u: np.ndarray) -> BodyResponse:
            one, two = (
                step.respond(np.ascontiguousarray(part))
                for step, part in zip(steps, halves.split(u), strict=True)
            )

            def tangent(x: np.ndarray) -> np.ndarray:
                a, b = halves.split(x)
                return halves.join(one.tangent(a), two.tangent(b))

            return BodyResponse(
                halves.join(one.force, two.force),
                tangent,
                min(one.least_dilatation, two.least_dilatation),
                float(np.average([one.flowing, two.flowing], weights=sizes)),
            )

        def finish(u: np.ndarray) -> Any:
            return tuple(
                step.finish(part) for step, part in zip(steps, halves.split(u), strict=True)
            )

        return Increment(respond, finish)

    return FiniteBody((int(sizes.sum()),), begin, lambda: (first.rest(), second.rest()))


@dataclass(frozen=True, eq=False)
class Underside:
    """Surface of the second body before deformation, seen from below.

    Attributes
    ----------
    body : Surface, surface of the first body, whose nodes carry the contact
    shape : Surface, underside of the second body; its grid may be a different one
    """

    body: Surface
    shape: Surface

    @cached_property
    def places(self) -> np.ndarray:
        """Nodes of the first body in the plane, shape (2, nx, ny), m."""
        (nx, ny), (dx, dy) = self.body.heights.shape, self.body.spacing
        return np.stack(np.meshgrid(np.arange(nx) * dx, np.arange(ny) * dy, indexing="ij"))

    @cached_property
    def distance(self) -> float:
        """Offset of the underside's heights when nodes of the first body touch it first, m."""
        above = self._surface(np.zeros(2), self.shape.heights).above(self.places)
        return float(np.max(self.body.heights - above.field(0)[:, 2]))

    def mean_height(self, approach: float) -> float:
        """Mean height of the underside before deformation, m."""
        return float(self.shape.heights.mean()) + self.distance - approach

    def deformed(self, moved: np.ndarray, approach: float, slide: np.ndarray) -> DeformedSurface:
        """Return the surface at an approach, m, and a slide, (2,), m.

        It has moved by (nx, 3, ny) in the frame of the first body, m.
        """
        height = self.shape.heights + (self.distance - approach) + moved[:, 2]
        return self._surface(slide, height, moved)

    def _surface(
        self, slide: np.ndarray, height: np.ndarray, moved: np.ndarray | None = None
    ) -> DeformedSurface:
        field = np.zeros((height.shape[0], 3, height.shape[1]))
        if moved is not None:
            field[:, :2] = moved[:, :2]
        field[:, :2] += slide[None, :, None]
        field[:, 2] = height
        return DeformedSurface(self.shape.spacing, field)


@dataclass(frozen=True, eq=False)
class PairMeeting:
    """Contact points of the nodes of the first body on the second.

    Attributes
    ----------
    gap : ndarray, shape (nx, ny)
        Distance along the normal, m; negative where one body is inside the other.
    normal : ndarray, shape (nx, 3, ny), unit normals into the second body
    point : Projection, points of the second body above the nodes
    halves : Halves
    """

    gap: np.ndarray
    normal: np.ndarray
    point: Projection
    halves: Halves

    def relative(self, vector: np.ndarray) -> np.ndarray:
        """Motion of the nodes relative to the points they meet, shape (nx, 3, ny), m."""
        first, second = self.halves.surfaces(vector)
        return np.asarray(first - MIRROR * self.point.carry(second))

    def react(self, vector: np.ndarray, force: np.ndarray) -> None:
        """Add the reactions of contact forces on the nodes, N, to the second body, in place."""
        self.halves.surfaces(vector)[1][:] += MIRROR * self.point.spread(force)

    def turn(
        self, x: np.ndarray, shift: float, pressure: np.ndarray, force: np.ndarray, out: np.ndarray
    ) -> np.ndarray:
        """Compute the change of pressure forces, N, as a step turns the normals."""
        moved = self.relative(x)
        moved[:, 2] += shift
        step = np.sum(self._dual * moved, axis=2)  # (1), first
        second = self.halves.surfaces(x)[1]
        bent = [MIRROR * self.point.carry(second, k + 1) for k in range(2)]
        tilt = np.stack([np.sum(self.normal * one, axis=1) for one in bent])
        tilt += np.einsum("klxy,lxy->kxy", self._curvature, step)
        below = self.halves.surfaces(out)[1]
        for k in range(2):
            below += MIRROR * self.point.spread(force * step[k][:, None], k + 1)
        return np.asarray(np.sum(pressure[:, None] * tilt[:, :, None] * self._dual, axis=0))  # (1)

    @cached_property
    def _dual(self) -> np.ndarray:
        """Dual tangents, shape (2, nx, 3, ny), 1/m."""
        tangents = self.point.values[:, 1:3]
        metric = np.einsum("iak,ibk->iab", tangents, tangents)
        dual = np.linalg.solve(metric, tangents).reshape(*self.point.grid, 2, 3)
        return np.ascontiguousarray(np.moveaxis(dual, (2, 3), (0, 2)))

    @cached_property
    def _curvature(self) -> np.ndarray:
        """Second derivatives along the normal, shape (2, 2, nx, ny), m."""
        xx, xy, yy = (np.sum(self.normal * self.point.field(k), axis=1) for k in (3, 4, 5))
        return np.array([[xx, xy], [xy, yy]])
