"""What an interface law is: a jump goes in, a traction comes out."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from multiscale.errors import ConvergenceError

__all__ = ["InterfaceLaw", "NormalLaw", "Response", "Sliding", "climb"]


@dataclass(frozen=True)
class Response:
    """What a law answers to a jump.

    Attributes
    ----------
    traction : ndarray, shape (d, ...)
        Traction, Pa; tension positive, contact negative.
    tangent : ndarray, shape (d, d, ...)
        Derivative of the traction with respect to the jump, Pa/m.
    state : ndarray, shape (n_state, ...)
        New internal variables.
    """

    traction: np.ndarray
    tangent: np.ndarray
    state: np.ndarray


@dataclass(frozen=True)
class Sliding:
    """What a step along the interface does, at every point.

    Attributes
    ----------
    slipping : ndarray
        Share of the pressure on what slips in the step, 0 to 1.
    dissipated : ndarray
        Work of the traction along the interface at the end of the step less the change of the
        energy stored, J/m²: never negative, and what slip takes to first order in the step.
    stored : ndarray
        Energy that the tangential traction has stored at the end of the step, J/m².
    """

    slipping: np.ndarray
    dissipated: np.ndarray
    stored: np.ndarray


class InterfaceLaw(ABC):
    """Maps a displacement jump to a traction, pointwise.

    Every array has its component axis first, row 0 normal; any axes may follow (elements,
    points, quadrature points). A law never changes its arguments and keeps nothing between
    calls: the state goes in and comes out.

    Attributes
    ----------
    n_state : int
        Number of internal variables of a point.
    gap : float
        Initial gap between the mean planes, m.
    damage : float
        Share of the interface that carries nothing, dimensionless.
    pressure_range : tuple of float
        Lowest and highest pressure of the data that the law was fitted to, Pa; all pressures for a
        law that was not fitted.
    compliant : bool
        Whether a jump tells the traction; of rigid contact only the resolvent does.
    """

    n_state: int = 0
    compliant: bool = True
    gap: float = 0.0
    damage: float = 0.0
    pressure_range: tuple[float, float] = (0.0, np.inf)

    @abstractmethod
    def respond(self, jump: np.ndarray, state: np.ndarray) -> Response:
        """Traction, tangent and new state for a jump of shape (d, ...), m."""

    @property
    def normal_law(self) -> "InterfaceLaw":
        """The law of the gap alone, which is all of a law without tangential traction."""
        return self

    def friction_limit(self, pressure: np.ndarray) -> np.ndarray:
        """Largest traction along the interface at a pressure, Pa; none without friction."""
        return 0.0 * pressure

    def at_rest(self, jump: np.ndarray) -> np.ndarray:
        """State of an interface that rests at a jump without tangential traction."""
        return np.zeros((self.n_state, *jump.shape[1:]))

    def sliding(self, jump: np.ndarray, state: np.ndarray) -> Sliding:
        """Slip and energy of the step from a state to a jump; without resistance all slips."""
        none = np.zeros(jump.shape[1:])
        return Sliding(none + 1.0, none, none)

    def resolvent(
        self, source: np.ndarray, stiffness: float | np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        r"""Find the jump that lies on the law and on a search direction.

        Parameters
        ----------
        source : ndarray, shape (d, ...)
            Right-hand side :math:`b`, Pa.
        stiffness : float or ndarray
            :math:`k > 0` of the search direction, Pa/m; it broadcasts against ``source``.
        state : ndarray, shape (n_state, ...)
            Last committed state.

        Returns
        -------
        ndarray, shape (d, ...)
            The jump, m.

        Raises
        ------
        ConvergenceError
            If Newton's method does not reach round-off.

        Notes
        -----
        Solves

        .. math:: t([\![u]\!]) + k\, [\![u]\!] = b    \tag{1}

        for a law without tangential traction: :math:`[\![u_T]\!] = b_T / k`, and the normal row
        is one scalar equation per point. For a law that never pulls, whose pressure is convex and
        decreasing, its left-hand side is concave and increasing, so that Newton's method climbs
        monotonically to the root from any start left of it; :math:`b_N / k` is one. A law that is
        not of this kind brings its own resolvent.
        """
        stiffness = np.broadcast_to(stiffness, source.shape)
        return climb(self, source, stiffness, state, source[0] / stiffness[0])


class NormalLaw(InterfaceLaw):
    r"""A frictionless law: the pressure depends on the gap alone, positive, decreasing, convex.

    A subclass has the fields ``gap``, m, so that the local gap is :math:`g = [\![u_N]\!] + g_0`,
    and ``pressure_range`` if it is fitted, and says what pressure and stiffness are. Then

    .. math:: t_N = -p(g), \qquad t_T = 0, \qquad \mathrm{d}t_N / \mathrm{d}g = K(g).    \tag{2}
    """

    @abstractmethod
    def pressure(self, gap: np.ndarray) -> np.ndarray:
        """Pressure, Pa, at a local gap, m; any shape."""

    @abstractmethod
    def stiffness(self, gap: np.ndarray) -> np.ndarray:
        """Contact stiffness, minus the derivative of the pressure, Pa/m, at a local gap, m."""

    @abstractmethod
    def gap_at(self, pressure: np.ndarray) -> np.ndarray:
        """Local gap, m, at which the pressure, Pa, is reached: the inverse of ``pressure``."""

    def elastic_curve(self, low: float, high: float) -> tuple["NormalLaw", float, float]:
        """Curve on which the pressure falls without loss, and its pressures between two, Pa."""
        return self, low, high

    def on_curve(
        self, gap: np.ndarray, state: np.ndarray
    ) -> tuple[np.ndarray, float | np.ndarray, float | np.ndarray]:
        """Gap on the elastic curve of a local gap, m, and the scales of its force and length."""
        return gap, 1.0, 1.0

    def respond(self, jump: np.ndarray, state: np.ndarray) -> Response:
        """Evaluate (2)."""
        gap = jump[0] + self.gap
        traction = np.zeros(jump.shape)
        traction[0] = -self.pressure(gap)  # (2)
        tangent = np.zeros((jump.shape[0], *jump.shape))
        tangent[0, 0] = self.stiffness(gap)
        return Response(traction, tangent, state)

    def resolvent(
        self, source: np.ndarray, stiffness: float | np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Find the jump on the law and on a search direction; see :class:`InterfaceLaw`.

        A soft direction would start Newton's method far inside the obstacle, where an exponential
        overflows. The jump at the pressure ``-source[0]`` is another start: if it is not positive
        it lies left of the root, and if it is positive the first step ends between zero and the
        root.
        """
        stiffness = np.broadcast_to(stiffness, source.shape)
        start = np.asarray(source[0] / stiffness[0])
        pressed = source[0] < 0.0
        floor = self.gap_at(np.where(pressed, -source[0], 1.0)) - self.gap
        start = np.where(pressed, np.maximum(start, floor), start)
        return climb(self, source, stiffness, state, start)


def climb(
    law: InterfaceLaw,
    source: np.ndarray,
    stiffness: np.ndarray,
    state: np.ndarray,
    start: np.ndarray,
    *,
    max_iterations: int = 300,
    tolerance: float = 1e-13,
) -> np.ndarray:
    """Newton's method for (1) from a start that is, or comes after one step, left of the root.

    The residual of (1) is relative to the largest of its three terms. A point is finished as well
    when its step is below the spacing of floating-point numbers at its jump and gap.
    """
    if not np.all(stiffness > 0.0):
        raise ValueError("the stiffness of a search direction must be positive (Pa/m)")
    k = stiffness[0]
    jump: np.ndarray = source / stiffness
    jump[0] = start
    residual = np.inf
    for iteration in range(max_iterations):
        response = law.respond(jump, state)
        t = response.traction[0]
        f = t + k * jump[0] - source[0]
        scale = np.maximum(np.maximum(np.abs(t), np.abs(source[0])), k * np.abs(jump[0]))
        step = -f / (response.tangent[0, 0] + k)
        spacing = 4.0 * np.finfo(float).eps * (np.abs(jump[0]) + abs(law.gap))
        ratio = np.abs(f) / np.where(scale > 0.0, scale, 1.0)
        # from the second iterate on all are left of the root, which only round-off can pass
        passed = (iteration > 0) & (f >= 0.0) & (ratio <= 1e-9)
        open_points = ~((ratio <= tolerance) | (np.abs(step) <= spacing) | passed)
        if not np.any(open_points):
            return jump
        residual = float(np.max(ratio[open_points]))
        if not np.isfinite(residual):
            break
        jump[0] += np.where(open_points, step, 0.0)
    raise ConvergenceError(
        f"the resolvent of {type(law).__name__} found no jump on the search direction (last "
        f"relative residual {residual:.1e}); the law must be decreasing and convex in the gap"
    )
