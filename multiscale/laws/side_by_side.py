"""Laws of several interfaces as one law over the points of all."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from multiscale.errors import ConvergenceError
from multiscale.laws.interface_law import InterfaceLaw, Response, Sliding

__all__ = ["SideBySide", "advance_state", "lay_side_by_side"]

GAIN = 1e-12
"""Energy that rounding may win in a step, relative to the largest that a point has stored."""


@dataclass(frozen=True, eq=False)
class SideBySide(InterfaceLaw):
    """Laws of interfaces side by side, each at its points, with as many state rows as any has.

    Attributes
    ----------
    laws : sequence of InterfaceLaw
    points : sequence of slice, points of each law, among the points of all
    spacing : ndarray, shape (points,)
        Initial gap of every point beside the gap of its law, m, from which its normal jump counts.

    Examples
    --------
    >>> from multiscale.laws import Exponential
    >>> exponential = Exponential(1.0e9, 1.0e-6)
    >>> law = SideBySide([exponential], [slice(0, 2)], np.array([0.0, 1.0e-6]))
    >>> law.respond(np.zeros((3, 2)), np.zeros((0, 2))).traction[0] / 1e6
    array([-1000.        ,  -367.87944117])
    """

    laws: Sequence[InterfaceLaw]
    points: Sequence[slice]
    spacing: np.ndarray

    def opened(self, jump: np.ndarray) -> np.ndarray:
        """Jump of the laws, with the initial gap, m."""
        return np.asarray(jump + np.eye(len(jump))[:, :1] * self.spacing)

    @property
    def n_state(self) -> int:  # type: ignore[override]
        """Number of internal variables of a point."""
        return max((law.n_state for law in self.laws), default=0)

    def respond(self, jump: np.ndarray, state: np.ndarray) -> Response:
        """Let every law answer at its points."""
        traction, tangent = np.zeros_like(jump), np.zeros((jump.shape[0], *jump.shape))
        jump = self.opened(jump)
        new = np.zeros_like(state)
        for law, at in zip(self.laws, self.points, strict=True):
            found = law.respond(jump[:, at], state[: law.n_state, at])
            traction[:, at], tangent[..., at] = found.traction, found.tangent
            new[: law.n_state, at] = found.state
        return Response(traction, tangent, new)

    def resolvent(
        self, source: np.ndarray, stiffness: float | np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Let every law find the jump at its points."""
        k = np.broadcast_to(stiffness, source.shape)
        apart = self.opened(np.zeros_like(source))
        moved = source + k * apart  # t(j) + k j = b + k s for the opened jump j
        found = self._each(
            len(source),
            lambda law, at: law.resolvent(moved[:, at], k[:, at], state[: law.n_state, at]),
        )
        return np.asarray(found - apart)

    def at_rest(self, jump: np.ndarray) -> np.ndarray:
        """Let every law rest at its points."""
        jump = self.opened(jump)
        return self._each(self.n_state, lambda law, at: law.at_rest(jump[:, at]))

    def from_here(self, state: np.ndarray) -> np.ndarray:
        """Let every law count tangential jumps from the last."""
        return self._each(self.n_state, lambda law, at: law.from_here(state[: law.n_state, at]))

    def unsheared(self, state: np.ndarray) -> np.ndarray:
        """Let no law have a tangential traction."""
        return self._each(self.n_state, lambda law, at: law.unsheared(state[: law.n_state, at]))

    def shaken_down(self) -> "SideBySide":
        """Let no law flow any more."""
        return replace(self, laws=[law.shaken_down() for law in self.laws])

    def slipping_load(self, jump: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Let every law say what a shear makes slip at its points."""
        jump = self.opened(jump)
        return self._each(
            1, lambda law, at: law.slipping_load(jump[:, at], state[: law.n_state, at])
        ).ravel()

    def friction_limit(self, pressure: np.ndarray) -> np.ndarray:
        """Let every law bound the shear at its points."""
        return self._each(1, lambda law, at: law.friction_limit(pressure[at])).ravel()

    def sliding(self, jump: np.ndarray, state: np.ndarray) -> Sliding:
        """Let every law say what a step does at its points, which may not win energy."""
        shares, new = np.zeros(jump.shape), np.zeros_like(state)
        jump = self.opened(jump)
        for law, at in zip(self.laws, self.points, strict=True):
            own = state[: law.n_state, at]
            new[: law.n_state, at], done = advance_state(law, jump[:, at], own)
            shares[:, at] = done.slipping, done.dissipated, done.stored
        return Sliding(shares[0], shares[1], shares[2], new)

    def _each(self, rows: int, answer: Callable[[InterfaceLaw, slice], np.ndarray]) -> np.ndarray:
        """Put what every law answers at its points side by side, shape (rows, points)."""
        found = np.zeros((rows, self.points[-1].stop if self.points else 0))
        for law, at in zip(self.laws, self.points, strict=True):
            own = np.atleast_2d(answer(law, at))
            found[: len(own), at] = own
        return found


def lay_side_by_side(
    laws: Iterable[InterfaceLaw], counts: Iterable[int], spacing: np.ndarray
) -> SideBySide:
    """Join interfaces with numbers of points; neighbours of one law are evaluated together."""
    joined, points, start = [], [], 0
    pairs = zip(laws, counts, strict=True)
    for _, group in groupby(pairs, key=lambda pair: id(pair[0])):
        own = list(group)
        joined.append(own[0][0])
        points.append(slice(start, start + sum(count for _, count in own)))
        start = points[-1].stop
    return SideBySide(joined, points, spacing)


def advance_state(
    law: InterfaceLaw, jump: np.ndarray, state: np.ndarray
) -> tuple[np.ndarray, Sliding]:
    """State after a step of a joint, and what the step did."""
    account = law.sliding(jump, state)
    won, most = -account.dissipated.min(initial=0.0), account.stored.max(initial=0.0)
    if won > GAIN * most:
        raise ConvergenceError(
            f"a step wins {won:.3g} J/m2 at a point of a joint that stores {most:.3g} J/m2 at "
            f"most: {type(law).__name__} is wrong, as is every answer of the path; report the case"
        )
    return account.state, account
