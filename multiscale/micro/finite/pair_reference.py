r"""The flat cells of two bodies, joined at their surfaces, as a preconditioner.

With the compliances :math:`C_1`, :math:`C_2` of both surfaces and the interpolation :math:`W` of
the second at the nodes of the first, forces :math:`l` on the nodes and their reactions move both
against each other by

.. math:: (C_1 + W M C_2 M W^t)\, l.    \tag{1}

On equal grids this operator is close to a product for each wave, for any slid distance.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from multiscale.micro.finite.two_bodies import MIRROR, PairMeeting
from multiscale.micro.flat_reference import Field, Reference
from multiscale.micro.lateral_fft import LateralInverse, SurfaceFilter

__all__ = ["JoinedReference", "PairReference", "add_compliances"]

_MIRRORED = np.array([1.0, 1.0, -1.0, 1.0, -1.0, 1.0])[:, None, None]  # of xx, xy, xz, yy, yz, zz


def add_compliances(first: LateralInverse, second: np.ndarray) -> LateralInverse:
    """Return a layer whose surface compliance is the sum of two, on the grid of the first.

    ``second`` is the symbol of the surface compliance of the second body in its own frame, shape
    (6, nx, ny // 2 + 1), m/N.
    """
    symbol = first.surface_compliance + _MIRRORED * second
    nx, _, ny = first.shape
    layer = np.repeat(np.moveaxis(symbol[:, : nx // 2 + 1], 0, 1)[:, None], 2, axis=3)
    nothing = np.zeros((0, 9)), np.zeros((4, nx)), np.zeros((4, layer.shape[3]))
    return LateralInverse((nx, 1, ny), layer, nothing)


@dataclass(frozen=True, eq=False)
class PairReference:
    """The references of two bodies.

    Attributes
    ----------
    first, second : Reference, flat cells of both bodies, each in its own frame
    both : Reference
        Flat cell with the sum of both surface compliances on the grid of the first body.
    """

    first: Reference
    second: Reference
    both: Reference


@dataclass(frozen=True, eq=False)
class JoinedReference:
    """Two references with forces between them, where the nodes of the first meet the second.

    Attributes
    ----------
    pair : PairReference
    meeting : PairMeeting, contact points between both bodies
    """

    pair: PairReference
    meeting: PairMeeting

    @property
    def convolves(self) -> bool:
        """False: the interpolation varies along the surface, so the operator is no convolution."""
        return False

    @property
    def vertical(self) -> tuple[SurfaceFilter, SurfaceFilter]:
        """Vertical compliance of both and an approximate inverse."""
        return self.pair.both.vertical

    def surface(self, vector: Field) -> Field:
        """Surface of the first body, as a view."""
        return self.meeting.halves.surfaces(vector)[0]

    def relative(self, vector: Field) -> Field:
        """Motion of the nodes of the first body relative to the second, shape (nx, 3, ny), m."""
        return self.meeting.relative(vector)

    def solve(self, force: Field, correct: Callable[[Field], Field]) -> Field:
        """Solve for nodal forces; ``correct`` adds forces between the surfaces."""
        loads = self.meeting.halves.split(force)
        found: list[Field] = []

        def meet(first: Field) -> Field:
            pushes: list[Field] = []

            def push(second: Field) -> Field:
                pushes.append(correct(first - MIRROR * self.meeting.point.carry(second)))
                return np.asarray(-MIRROR * self.meeting.point.spread(pushes[0]))

            found.append(self.pair.second.solve(loads[1], push))
            return pushes[0]

        first = self.pair.first.solve(loads[0], meet)
        return self.meeting.halves.join(first, found[0])

    def compliance(self, force: Field) -> Field:
        """Relative motion (1), m, under forces on the nodes, N, and their reactions."""
        point = self.meeting.point
        reaction = self.pair.second.compliance(MIRROR * point.spread(force))
        return np.asarray(self.pair.first.compliance(force) + MIRROR * point.carry(reaction))

    def stiffness(self, moved: Field) -> Field:
        """Compute the forces, N, of a relative motion, m, as if the nodes of both grids matched."""
        return self.pair.both.stiffness(moved)
