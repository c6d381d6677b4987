"""Law of an interface with an initial gap of its own at every point."""

from dataclasses import dataclass

import numpy as np

from multiscale.laws.interface_law import InterfaceLaw, Response, Sliding

__all__ = ["Spaced"]


@dataclass(frozen=True, eq=False)
class Spaced(InterfaceLaw):
    """A law whose normal jump counts from an initial gap.

    Parameters
    ----------
    law : InterfaceLaw
    spacing : ndarray, shape (points,), initial gap of every point beside the gap of the law, m

    Examples
    --------
    >>> from multiscale.laws import Exponential
    >>> law = Spaced(Exponential(1.0e9, 1.0e-6), np.array([0.0, 1.0e-6]))
    >>> law.respond(np.zeros((3, 2)), np.zeros((0, 2))).traction[0] / 1e6
    array([-1000.        ,  -367.87944117])
    """

    law: InterfaceLaw
    spacing: np.ndarray

    @property
    def n_state(self) -> int:  # type: ignore[override]
        """Number of rows of the state of the law."""
        return self.law.n_state

    @property
    def compliant(self) -> bool:  # type: ignore[override]
        """Whether a jump determines the traction."""
        return self.law.compliant

    @property
    def gap(self) -> np.ndarray:  # type: ignore[override]
        """Initial gap of every point, m."""
        return self.law.gap + self.spacing

    @property
    def damage(self) -> float:  # type: ignore[override]
        """Share of the interface that carries no load."""
        return self.law.damage

    @property
    def pressure_range(self) -> tuple[float, float]:  # type: ignore[override]
        """Pressures of the data of the law, Pa."""
        return self.law.pressure_range

    @property
    def normal_law(self) -> "Spaced":
        """Law of the gap alone."""
        return Spaced(self.law.normal_law, self.spacing)

    def friction_limit(self, pressure: np.ndarray) -> np.ndarray:
        """Return the limit of the law, Pa."""
        return self.law.friction_limit(pressure)

    def at_rest(self, jump: np.ndarray) -> np.ndarray:
        """Return the state of an interface at rest at a jump, m."""
        return self.law.at_rest(self._open(jump, 1.0))

    def unsheared(self, state: np.ndarray) -> np.ndarray:
        """Return a state without tangential traction."""
        return self.law.unsheared(state)

    def shaken_down(self) -> "Spaced":
        """Return the law of further loads that flow no more."""
        return Spaced(self.law.shaken_down(), self.spacing)

    def from_here(self, state: np.ndarray) -> np.ndarray:
        """Return the state for tangential jumps that count from the last one."""
        return self.law.from_here(state)

    def respond(self, jump: np.ndarray, state: np.ndarray) -> Response:
        """Return the response of the law to the opened jump."""
        return self.law.respond(self._open(jump, 1.0), state)

    def sliding(self, jump: np.ndarray, state: np.ndarray) -> Sliding:
        """Return slip and energy of a step."""
        return self.law.sliding(self._open(jump, 1.0), state)

    def slipping_load(self, jump: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Share of the pressure whose contacts slip."""
        return self.law.slipping_load(self._open(jump, 1.0), state)

    def resolvent(
        self, source: np.ndarray, stiffness: float | np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Find the jump on the law and on a search direction; see :class:`InterfaceLaw`."""
        k = np.broadcast_to(stiffness, source.shape)
        moved = source.copy()
        moved[0] += k[0] * self.spacing  # t(j) + k j = b + k s for the opened jump j
        return self._open(self.law.resolvent(moved, stiffness, state), -1.0)

    def _open(self, jump: np.ndarray, sign: float) -> np.ndarray:
        """Add the spacing to the normal jump."""
        opened = np.array(jump, dtype=float)
        opened[0] += sign * self.spacing
        return opened
