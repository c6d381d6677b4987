"""Several interfaces as a single law over all their points, and the step of their state."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from multiscale.errors import ConvergenceError
from multiscale.laws.interface_law import InterfaceLaw, Response, Sliding

GAIN = 1e-12  # energy gained by rounding in a step, relative to the largest that a point has stored


@dataclass(frozen=True, eq=False)
class SideBySide(InterfaceLaw):
    """Laws of interfaces side by side, each at its points, with the most state rows of all."""

    laws: Sequence[InterfaceLaw]
    points: Sequence[slice]  # of each law, among the points of all
    spacing: np.ndarray  # (points,), initial gap in addition to the gap of the law, m

    def opened(self, jump: np.ndarray) -> np.ndarray:
        """Jump of the laws, with the initial gap, m."""
        return np.asarray(jump + np.eye(len(jump))[:, :1] * self.spacing)

    @property
    def n_state(self) -> int:  # type: ignore[override]
        """Number of internal variables of a point."""
        return max((law.n_state for law in self.laws), default=0)

    def respond(self, jump: np.ndarray, state: np.ndarray) -> Response:
        """Evaluate every law at its points."""
        traction, tangent = np.zeros_like(jump), np.zeros((jump.shape[0], *jump.shape))
        jump = self.opened(jump)
        new = np.zeros_like(state)
        for law, at in zip(self.laws, self.points, strict=True):
            response = law.respond(jump[:, at], state[: law.n_state, at])
            traction[:, at], tangent[..., at] = response.traction, response.tangent
            new[: law.n_state, at] = response.state
        return Response(traction, tangent, new)

    def resolvent(
        self, source: np.ndarray, stiffness: float | np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Return the jump of every law at its points."""
        k = np.broadcast_to(stiffness, source.shape)
        apart = self.opened(np.zeros_like(source))
        moved = source + k * apart  # t(j) + k j = b + k s for the opened jump j
        opened = self._each(
            len(source),
            lambda law, at: law.resolvent(moved[:, at], k[:, at], state[: law.n_state, at]),
        )
        return np.asarray(opened - apart)

    def at_rest(self, jump: np.ndarray) -> np.ndarray:
        """Return the state at rest of every law at its points."""
        jump = self.opened(jump)
        return self._each(self.n_state, lambda law, at: law.at_rest(jump[:, at]))

    def from_here(self, state: np.ndarray) -> np.ndarray:
        """Return the state for tangential jumps relative to the last jump."""
        return self._each(self.n_state, lambda law, at: law.from_here(state[: law.n_state, at]))

    def unsheared(self, state: np.ndarray) -> np.ndarray:
        """Return the state without tangential traction."""
        return self._each(self.n_state, lambda law, at: law.unsheared(state[: law.n_state, at]))

    def shaken_down(self) -> "SideBySide":
        """Return the laws without plastic flow."""
        return replace(self, laws=[law.shaken_down() for law in self.laws])

    def slipping_load(self, jump: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Share of the pressure that slips, of every law at its points."""
        jump = self.opened(jump)
        return self._each(
            1, lambda law, at: law.slipping_load(jump[:, at], state[: law.n_state, at])
        ).ravel()

    def friction_limit(self, pressure: np.ndarray) -> np.ndarray:
        """Friction limit of every law at its points, Pa."""
        return self._each(1, lambda law, at: law.friction_limit(pressure[at])).ravel()

    def sliding(self, jump: np.ndarray, state: np.ndarray) -> Sliding:
        """Slip and energy of every law at its points; no point may gain energy."""
        shares, new = np.zeros(jump.shape), np.zeros_like(state)
        jump = self.opened(jump)
        for law, at in zip(self.laws, self.points, strict=True):
            new[: law.n_state, at], step = advance_state(law, jump[:, at], state[: law.n_state, at])
            shares[:, at] = step.slipping, step.dissipated, step.stored
        return Sliding(shares[0], shares[1], shares[2], new)

    def _each(self, rows: int, evaluate: Callable[[InterfaceLaw, slice], np.ndarray]) -> np.ndarray:
        """Evaluate every law at its points, shape (rows, points)."""
        values = np.zeros((rows, self.points[-1].stop if self.points else 0))
        for law, at in zip(self.laws, self.points, strict=True):
            result = np.atleast_2d(evaluate(law, at))
            values[: len(result), at] = result
        return values


def lay_side_by_side(
    laws: Iterable[InterfaceLaw], counts: Iterable[int], spacing: np.ndarray
) -> SideBySide:
    """Join interfaces with numbers of points; neighbours with the same law become one block."""
    joined, points, start = [], [], 0
    pairs = zip(laws, counts, strict=True)
    for _, group in groupby(pairs, key=lambda pair: id(pair[0])):
        neighbours = list(group)
        joined.append(neighbours[0][0])
        points.append(slice(start, start + sum(count for _, count in neighbours)))
        start = points[-1].stop
    return SideBySide(joined, points, spacing)


def advance_state(
    law: InterfaceLaw, jump: np.ndarray, state: np.ndarray
) -> tuple[np.ndarray, Sliding]:
    """State after a step of a joint, and its slip and energy; a step may not gain energy."""
    account = law.sliding(jump, state)
    gain, most = -account.dissipated.min(initial=0.0), account.stored.max(initial=0.0)
    if gain > GAIN * most:
        raise ConvergenceError(
            f"a step gains {gain:.3g} J/m2 at a point of a joint that stores {most:.3g} J/m2 at "
            f"most: {type(law).__name__} is wrong, as is every answer of the path; report the case"
        )
    return account.state, account
