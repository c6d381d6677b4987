"""Base classes of interface laws, which map a jump to a traction, and laws side by side."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import groupby
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.errors import CaseError, ConvergenceError
from multiscale.units import html_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAX_ITERATIONS = 300
TOLERANCE = 1e-13  # bound on the residual of a resolvent relative to the largest of its three terms


@dataclass(frozen=True)
class Response:
    """Response of a law to a jump.

    Attributes
    ----------
    traction : ndarray, shape (d, ...), Pa; tension positive, contact negative
    tangent : ndarray, shape (d, d, ...), derivative of the traction with respect to the jump, Pa/m
    state : ndarray, shape (n_state, ...), new internal variables, with the units of the law
    """

    traction: np.ndarray
    tangent: np.ndarray
    state: np.ndarray


@dataclass(frozen=True)
class Sliding:
    """Slip and energy of a step at every point.

    Attributes
    ----------
    slipping : ndarray, shape (...)
        Share of the pressure carried by slipping contacts in the step, 0 to 1.
    dissipated : ndarray, shape (...)
        Work of the tangential traction at the end of the step minus the change of the stored
        energy, J/m²: never negative, and the dissipation by slip to first order in the step.
    stored : ndarray, shape (...)
        Energy stored by the tangential traction at the end of the step, J/m².
    state : ndarray, shape (n_state, ...), internal variables at the end of the step
    """

    slipping: np.ndarray
    dissipated: np.ndarray
    stored: np.ndarray
    state: np.ndarray


class InterfaceLaw(ABC):
    """Maps a displacement jump to a traction, pointwise.

    Every array has its component axis first, row 0 normal; any axes may follow (elements,
    points, quadrature points). A law never changes its arguments and stores nothing between
    calls: the state is an argument and a result.

    Attributes
    ----------
    n_state : int, number of internal variables per point
    gap : float, initial gap between the mean planes, m
    damage : float, share of the interface that carries no load, dimensionless
    pressure_range : tuple of float
        Lowest and highest pressure of the fitted data, Pa; (0, inf) for a law without data.
    pressure_limit : float, pressure above which data contradict the law, Pa; infinite if none do
    compliant : bool, whether a jump determines the traction; rigid contact has a resolvent only
    """

    n_state: int = 0
    compliant: bool = True
    gap: float = 0.0
    damage: float = 0.0
    pressure_range: tuple[float, float] = (0.0, np.inf)
    pressure_limit: float = np.inf

    @abstractmethod
    def respond(self, jump: np.ndarray, state: np.ndarray) -> Response:
        """Return traction, tangent and new state for a jump of shape (d, ...), m."""

    def _repr_html_(self) -> str:
        rows = {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]
        with np.printoptions(precision=4, threshold=6):
            return html_table(type(self).__name__, rows)

    @property
    def normal_law(self) -> "InterfaceLaw":
        """Law of the gap only; the law itself if it has no tangential traction."""
        return self

    def friction_limit(self, pressure: np.ndarray) -> np.ndarray:
        """Return the largest tangential traction at a pressure, Pa; zero without friction."""
        return 0.0 * pressure

    def at_rest(self, jump: np.ndarray) -> np.ndarray:
        """Return the state of an interface at rest at a jump, m, without tangential traction."""
        return np.zeros((self.n_state, *jump.shape[1:]))

    def unsheared(self, state: np.ndarray) -> np.ndarray:
        """Return a state with its normal history and without tangential traction."""
        return state

    def shaken_down(self) -> "InterfaceLaw":
        """Return the law, with the same state, of further loads without plastic flow.

        It is the law itself if it unloads as it loads.
        """
        return self

    def from_here(self, state: np.ndarray) -> np.ndarray:
        """Return the state for tangential jumps relative to the last committed jump.

        The traction depends only on their changes, which rounding loses in long slips on stiff
        laws.
        """
        return state

    def sliding(self, jump: np.ndarray, state: np.ndarray) -> Sliding:
        """Return slip and energy of the step from a state to a jump; full slip without friction."""
        none = np.zeros(jump.shape[1:])
        return Sliding(none + 1.0, none, none, self.respond(jump, state).state)

    def slipping_load(self, jump: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Share of the pressure of contacts that slip as a shear reaches a jump, from a state.

        Valid for a first shear at constant pressure. Without friction the share is 1.
        """
        return np.ones(jump.shape[1:])

    def resolvent(
        self, source: np.ndarray, stiffness: float | np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        r"""Return the jump that lies on the law and on a search direction.

        .. math:: t([\![u]\!]) + k\, [\![u]\!] = b    \tag{1}

        Parameters
        ----------
        source : ndarray, shape (d, ...), right-hand side :math:`b`, Pa
        stiffness : float or ndarray
            Stiffness :math:`k > 0` of the search direction, Pa/m; broadcasts against ``source``.
        state : ndarray, shape (n_state, ...), last committed state

        Returns
        -------
        ndarray, shape (d, ...), jump, m; a ConvergenceError is raised short of round-off

        Notes
        -----
        Without a tangential traction :math:`[\![u_T]\!] = b_T / k`. For a pressure that is never
        negative, convex and decreasing, Newton's method increases monotonically to the root of the
        normal row from any start left of it, such as :math:`b_N / k`. Other laws override this
        method.
        """
        k = np.broadcast_to(stiffness, source.shape)
        return newton_from_the_left(self, source, k, state, self._left_of_root(source[0], k[0]))

    def _left_of_root(self, b: np.ndarray, k: np.ndarray) -> np.ndarray:
        """Return a normal jump from which Newton's method increases to the root of (1)."""
        return np.asarray(b / k)


class GapLaw(InterfaceLaw):
    """Law of the gap only, with or without memory; a bed of sliders can be laid on it."""

    unloading_ratio: float | None = None
    """Stiffness at the start of unloading over the stiffness of loading; None if elastic."""

    @property
    @abstractmethod
    def first_loading(self) -> "NormalLaw":
        """Law of the first loading."""

    @abstractmethod
    def elastic_curve(self, low: float, high: float) -> tuple["NormalLaw", float, float]:
        """Return the curve of elastic unloading, and the range of its pressures, Pa."""

    @abstractmethod
    def on_curve(
        self, gap: np.ndarray, state: np.ndarray
    ) -> tuple[np.ndarray, float | np.ndarray, float | np.ndarray]:
        """Return the gap on the elastic curve at a local gap, m, and scales of force and length."""


class NormalLaw(GapLaw):
    r"""Frictionless law with a positive, decreasing, convex pressure over the gap.

    A subclass is a dataclass with the fields ``gap``, initial gap :math:`g_0`, m, and, if it is
    fitted, ``pressure_range``, pressures of the data, Pa, outside of which it extrapolates. It
    defines pressure and stiffness over the local gap :math:`g = [\![u_N]\!] + g_0`:

    .. math:: t_N = -p(g), \qquad t_T = 0, \qquad \mathrm{d}t_N / \mathrm{d}g = K(g).    \tag{2}
    """

    @abstractmethod
    def pressure(self, gap: np.ndarray) -> np.ndarray:
        """Return the pressure, Pa, at a local gap, m; any shape."""

    @abstractmethod
    def stiffness(self, gap: np.ndarray) -> np.ndarray:
        """Return the contact stiffness, minus the derivative of the pressure, Pa/m, at a gap, m."""

    @abstractmethod
    def gap_at(self, pressure: np.ndarray) -> np.ndarray:
        """Return the local gap, m, at a pressure, Pa: the inverse of :meth:`pressure`."""

    def plot(self, pressure: np.ndarray | None = None, *, ax: "Axes | None" = None) -> "Axes":
        """Plot pressure against local gap, at the pressures of the data if none are given, Pa."""
        import matplotlib.pyplot as plt

        if pressure is None:
            if not 0.0 < self.pressure_range[0] < self.pressure_range[1] < np.inf:
                raise CaseError(
                    "the law has no data with a range of pressures to plot; give pressures"
                )
            pressure = np.geomspace(*self.pressure_range, 200)
        ax = ax or plt.gca()
        ax.plot(1e6 * self.gap_at(np.asarray(pressure)), 1e-6 * np.asarray(pressure))
        ax.set(yscale="log", xlabel="gap (µm)", ylabel="pressure (MPa)")
        return ax

    @property
    def first_loading(self) -> "NormalLaw":
        """The law itself."""
        return self

    def elastic_curve(self, low: float, high: float) -> tuple["NormalLaw", float, float]:
        """Return the law itself, which unloads as it loads."""
        return self, low, high

    def on_curve(
        self, gap: np.ndarray, state: np.ndarray
    ) -> tuple[np.ndarray, float | np.ndarray, float | np.ndarray]:
        """Return the gap, which needs no scales."""
        return gap, 1.0, 1.0

    def respond(self, jump: np.ndarray, state: np.ndarray) -> Response:
        """Evaluate (2)."""
        gap = jump[0] + self.gap
        traction = np.zeros(jump.shape)
        traction[0] = -self.pressure(gap)  # (2)
        tangent = np.zeros((jump.shape[0], *jump.shape))
        tangent[0, 0] = self.stiffness(gap)
        return Response(traction, tangent, state)

    def _left_of_root(self, b: np.ndarray, k: np.ndarray) -> np.ndarray:
        # with a small stiffness b/k is a very negative gap, where an exponential overflows: the
        # jump at the pressure -b lies left of the root, or its first step ends there
        start, pressed = np.asarray(b / k), b < 0.0
        floor = self.gap_at(np.where(pressed, -b, 1.0)) - self.gap
        return np.where(pressed, np.maximum(start, floor), start)


def newton_from_the_left(
    law: InterfaceLaw,
    source: np.ndarray,
    stiffness: np.ndarray,
    state: np.ndarray,
    start: np.ndarray,
) -> np.ndarray:
    """Solve (1) by Newton's method; the first or second iterate lies left of the root."""
    if not np.all(stiffness > 0.0):
        raise ValueError("the stiffness of a search direction must be positive (Pa/m)")
    k = stiffness[0]
    jump: np.ndarray = source / stiffness
    jump[0] = start
    residual = np.inf
    for iteration in range(MAX_ITERATIONS):
        response = law.respond(jump, state)
        t = response.traction[0]
        f = t + k * jump[0] - source[0]
        scale = np.maximum(np.maximum(np.abs(t), np.abs(source[0])), k * np.abs(jump[0]))
        step = -f / (response.tangent[0, 0] + k)
        spacing = 4.0 * np.finfo(float).eps * (np.abs(jump[0]) + abs(law.gap))
        ratio = np.abs(f) / np.where(scale > 0.0, scale, 1.0)
        # from the second iterate on all are left of the root up to round-off
        passed = (iteration > 0) & (f >= 0.0) & (ratio <= 1e-9)
        open_points = ~((ratio <= TOLERANCE) | (np.abs(step) <= spacing) | passed)
        if not np.any(open_points):
            return jump
        residual = float(np.max(ratio[open_points]))
        if not np.isfinite(residual):
            break
        jump[0] += np.where(open_points, step, 0.0)
    raise ConvergenceError(
        f"no jump on the search direction solves the resolvent of {type(law).__name__} (last "
        f"relative residual {residual:.1e}); the law must be decreasing and convex in the gap"
    )


def check_parameters(law: object, lowest: float | None = None, **units: str) -> None:
    """Refuse parameters of a law, with their units, outside a range; positive without a lowest."""
    bound = {None: "be positive and", 0.0: "not be negative, but"}
    asked = bound.get(lowest, f"be at least {lowest:g} and" if lowest else "")
    for name, unit in units.items():
        value = np.asarray(getattr(law, name), dtype=float)
        wrong = value[~(np.isfinite(value) & (value > 0.0 if lowest is None else value >= lowest))]
        if wrong.size:
            raise CaseError(f"{name} must {asked} finite ({unit}), got {float(wrong.flat[0]):g}")


def forwarded(field: str, name: str) -> Any:
    """Return a property that is an attribute of a field of its object."""
    return property(attrgetter(f"{field}.{name}"))


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
