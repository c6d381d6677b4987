r"""Quasi-static modal analysis: frequency and damping of a mode against its amplitude.

A structure at rest is loaded by :math:`\alpha M \phi`. With the change v of the displacement and
the modal amplitude :math:`q = \phi^T M v`, the loading curve :math:`\alpha(q)` tells

.. math::
    \omega^2(q) = \frac{\alpha}{q}, \qquad
    \zeta(q) = \frac{D}{2 \pi \omega^2 q^2}, \qquad
    D = 4 \left( \int_0^q \alpha\, \mathrm{d}q' - E \right), \tag{1}

where E is the energy that bodies and joints store. By Masing's rule every slider slips twice as far
in each half of a cycle as in the loading, so that the loss D of a cycle is four times the loss of
the loading, if the normal load of the joints stays as it is; it is
:math:`\oint \alpha\, \mathrm{d}q` of a cycle that is solved else. The usual form of (1),
:math:`8 \int \alpha\, \mathrm{d}q' - 4 \alpha q`, takes the curvature of elastic joints for a loss.

References
----------
.. [1] H. Festjens, G. Chevallier and J.-L. Dion, J. Sound Vib. 332 (2013) 4821-4838,
   doi:10.1016/j.jsv.2013.04.020.
.. [2] R. M. Lacayo and M. S. Allen, Mech. Syst. Signal Process. 118 (2019) 133-157.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from multiscale.laws.interface_law import InterfaceLaw, Response
from multiscale.macro.substructures.path import closed_cycle
from multiscale.macro.substructures.state import JointState
from multiscale.macro.substructures.stepping import sliding_share
from multiscale.macro.substructures.whole import Assembled
from multiscale.macro.vibration.preloaded import Preloaded
from multiscale.macro.vibration.tangent_modes import TangentModes

__all__ = ["Amplitudes", "Backbone", "TractionChange", "follow_backbone", "loading_work"]

SPRING = 1e3
"""Stiffness of the spring on the modal amplitude that drives a mode, over the mode's own."""

FIRST = 0.1
"""Amplitude of the first step, relative to the smallest that is asked for."""

SLID = 0.99
"""Share of the load of an interface that slips from which it slides away."""

OPENS = 0.01
"""Share of the pressure at rest up to which a point opens, and of the area that then counts."""

SHEARED = 0.02
"""Shear at rest, relative to what friction bears, above which loading curves depend on it."""

ABSCISSAE, WEIGHTS = (0.5 * one for one in np.polynomial.legendre.leggauss(6))
"""Gauss points about the middle of an interval of length 1, for the energy of normal laws."""

MIDDLE = 1e-3
"""Middle of a cycle, relative to its amplitude."""

TOLERANCE = 1e-9
"""Residual of a step, relative to the load that drives the mode."""


@dataclass(frozen=True)
class Amplitudes:
    """Amplitudes of modes, and how they are reached.

    Parameters
    ----------
    values : tuple of float, rising modal amplitudes, kg^1/2 m
    full_cycle : bool, whether cycles are solved; Masing's rule tells their loss if not
    ratio : float, largest ratio of neighbouring amplitudes of the loading curve
    steps : int, steps from the middle of a cycle to its amplitude
    """

    values: tuple[float, ...]
    full_cycle: bool = False
    ratio: float = 1.5
    steps: int = 10

    def curve(self) -> tuple[np.ndarray, np.ndarray]:
        """Amplitudes of the loading curve, rising, and the places of those that are asked for."""
        ends = np.array([FIRST * self.values[0], *self.values])
        counts = np.ceil(np.log(ends[1:] / ends[:-1]) / np.log(self.ratio) - 1e-9).astype(int)
        parts = [
            np.geomspace(low, high, count + 1)[1:]
            for low, high, count in zip(ends, ends[1:], counts, strict=False)
        ]
        return np.append(ends[0], np.concatenate(parts)), np.cumsum(counts)


@dataclass(frozen=True, eq=False)
class Backbone:
    """Frequency and damping of one mode against its amplitude; NaN where it slides away.

    Attributes
    ----------
    frequency : ndarray, shape (amplitudes,), Hz
    damping : ndarray, shape (amplitudes,), share of critical damping that the joints give
    pressure, slipping : ndarray, shape (2, amplitudes, points)
        Pressure, Pa, and share of it that slips, at the amplitude in both directions.
    opens : ndarray of bool, shape (amplitudes,), whether contact opens in one of them
    sheared : bool
        Whether the preload leaves shear in the joints, so that loading curves depend on it.
    failure : str, why the last amplitudes have no answer; empty if all have one
    """

    frequency: np.ndarray
    damping: np.ndarray
    pressure: np.ndarray
    slipping: np.ndarray
    opens: np.ndarray
    sheared: bool
    failure: str


@dataclass(frozen=True)
class TractionChange(InterfaceLaw):
    """Change of the traction of a law from a traction at rest, shape (3, points), Pa."""

    law: InterfaceLaw
    rest: np.ndarray

    @property
    def n_state(self) -> int:  # type: ignore[override]
        """Number of rows of the state."""
        return self.law.n_state

    def respond(self, jump: np.ndarray, state: np.ndarray) -> Response:
        """Subtract the traction at rest."""
        own = self.law.respond(jump, state)
        return replace(own, traction=own.traction - self.rest)

    def resolvent(
        self, source: np.ndarray, stiffness: float | np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Find the jump on the law and on a search direction."""
        return self.law.resolvent(source + self.rest, stiffness, state)


@dataclass(frozen=True, eq=False)
class _Point:
    """A point of the path of a mode.

    Attributes
    ----------
    value : ndarray, shape (n,), change of the displacement since rest, m
    amplitude, force : float, q, kg^1/2 m, and alpha, kg^1/2 m/s2
    state : JointState, of the joints
    slipping : ndarray, shape (points,), share of the pressure that slips in the step to it
    sheared : float, energy that the tangential tractions of the joints store, J
    failure : str
    """

    value: np.ndarray
    amplitude: float
    force: float
    state: JointState
    slipping: np.ndarray
    sheared: float
    failure: str = ""


@dataclass(frozen=True, eq=False)
class _Mode:
    """One mode of a structure at rest, driven by a spring on its amplitude.

    Attributes
    ----------
    rest : Preloaded
    structure : Assembled, small, with the spring; its load is the load of the spring
    law : SideBySide less its traction at rest
    square : float, of the frequency at rest, s⁻²
    """

    rest: Preloaded
    structure: Assembled
    law: TractionChange
    square: float

    @property
    def start(self) -> _Point:
        """The structure at rest."""
        law, state = self.rest.law, self.rest.state
        nothing = np.zeros(self.structure.load.shape[0])
        stored = float(law.sliding(state.jump, state.history).stored @ self.structure.weight)
        return _Point(nothing, 0.0, 0.0, state, np.zeros(state.jump.shape[1]), stored)

    def follow(self, point: _Point, amplitudes: Sequence[float]) -> Iterator[_Point]:
        """Take the mode to amplitudes one after the other, until it cannot follow."""
        for amplitude in amplitudes:
            point = self._step(point, amplitude)
            yield point
            if point.failure:
                return

    def _step(self, point: _Point, amplitude: float) -> _Point:
        """Take the mode to an amplitude, nearly: both force and amplitude are those it has there.

        The spring reaches so far that the amplitude is met if nothing slips in the step.
        """
        spring = SPRING * self.square
        force = point.force + self.square * (amplitude - point.amplitude)
        reach = amplitude + force / spring
        law, state = self.rest.law, point.state
        grow = amplitude / point.amplitude if point.amplitude * amplitude > 0.0 else 1.0
        moved = (grow - 1.0) * point.value
        opened = (self.structure.jump @ moved).reshape(state.jump.shape)
        starts = [(point.value + moved, opened), (point.value, 0.0 * opened)]
        for value, more in starts:  # along the path, else from where it stands
            with np.errstate(over="ignore", invalid="ignore"):  # where a start is too far
                solution = self.structure.solve(
                    self.law,
                    np.array([reach]),
                    start=value,
                    jump=state.jump + more,
                    state=state.history,
                    tolerance=TOLERANCE,
                )
            if solution.converged:
                break
        q = float(self.structure.load[:, 0] @ solution.value) / spring
        if not solution.converged:
            return replace(point, failure=solution.status.value)
        state, done = state.advance(law, solution.value, solution.jump, state.traction)
        slipping = sliding_share(law, solution.jump, done)
        force = spring * (reach - q)
        sheared = float(done.stored @ self.structure.weight)
        return _Point(solution.value, q, force, state, slipping, sheared)

    def stored(self, point: _Point) -> float:
        """Energy that bodies and joints store at a point of the path since rest, J."""
        u, rest = point.value, self.rest.state
        spring = SPRING * self.square * point.amplitude**2
        bodies = 0.5 * (float(u @ (self.structure.stiffness @ u)) - spring)
        opened, normal = point.state.jump[0] - rest.jump[0], 0.0
        for at, weight in zip(0.5 + ABSCISSAE, WEIGHTS, strict=True):
            jump = np.concatenate([[rest.jump[0] + at * opened], rest.jump[1:]])
            change = self.law.respond(jump, rest.history).traction[0]
            normal += weight * float((change * opened) @ self.structure.weight)
        return bodies + normal + point.sheared - self.start.sheared

    def pressure(self, point: _Point) -> np.ndarray:
        """Pressure at a point of the path, shape (points,), Pa."""
        state = point.state
        return np.asarray(-self.rest.law.respond(state.jump, state.history).traction[0])

    def sliding(self, point: _Point) -> str:
        """Report which interface with friction slides away; nothing if none does."""
        if point.failure:
            return f"no equilibrium was found ({point.failure})"
        rubs = self.rest.law.friction_limit(np.ones(point.slipping.size)) > 0.0
        load = np.where(rubs, np.maximum(self.pressure(point), 0.0), 0.0) * self.structure.weight
        number = self.rest.path["point_joint"].values
        for joint in np.unique(number):
            mine = number == joint
            slips = float(load[mine] @ point.slipping[mine])
            if slips > SLID * float(load[mine].sum()):
                return f"more than {100.0 * SLID:g} % of the load of interface {int(joint)} slips"
        return ""


def follow_backbone(
    rest: Preloaded,
    modes: TangentModes,
    load: np.ndarray,
    mode: int,
    amplitudes: Amplitudes,
    progress: Callable[[], None] = lambda: None,
) -> Backbone:
    """Follow one mode over its amplitudes, in both directions from rest.

    Parameters
    ----------
    rest : Preloaded
    modes : TangentModes
    load : ndarray, shape (whole unknowns, modes), M phi of all modes, kg^1/2
    mode : int, counted from 0
    amplitudes : Amplitudes
    progress : callable, called after each amplitude of each direction
    """
    square, points = float(modes.square[mode]), rest.state.jump.shape[1]
    asked = len(amplitudes.values)
    if not points:
        none = np.zeros((2, asked, 0))
        constant = np.full(asked, modes.frequency[mode])
        nothing = np.zeros(asked)
        return Backbone(constant, nothing, none, none, nothing > 0.0, False, "")
    driven = _drive(rest, load[:, mode], square)
    grid, places = amplitudes.curve()
    force, reached, stored = np.full((3, 2, asked), np.nan)
    curves: list[np.ndarray] = []
    pressure, slipping = (np.full((2, asked, points), np.nan) for _ in range(2))
    ends: list[list[_Point]] = [[], []]
    failures = ["", ""]
    for side, sign in enumerate((1.0, -1.0)):
        q, alpha = [0.0], [0.0]
        at = dict(zip(places.tolist(), range(asked), strict=True))
        for step, point in enumerate(driven.follow(driven.start, (sign * grid).tolist())):
            if told := driven.sliding(point):
                failures[side] = told
                break
            q.append(sign * point.amplitude)
            alpha.append(sign * point.force)
            if (k := at.get(step)) is not None:
                ends[side].append(point)
                pressure[side, k], slipping[side, k] = driven.pressure(point), point.slipping
                stored[side, k] = driven.stored(point)
                progress()
        found = len(ends[side])
        known = places[:found] + 1
        curves.append(np.array([q, alpha]))
        reached[side, :found], force[side, :found] = curves[side][:, known]
    sizes, stiffness = reached.sum(axis=0), force.sum(axis=0) / reached.sum(axis=0)
    both = min(len(one[0]) for one in curves)
    mean = 0.5 * (curves[0][:, :both] + curves[1][:, :both])  # what is odd in q loses nothing
    found = int(np.isfinite(sizes).sum())
    lost, q_mean = np.full(asked, np.nan), 0.5 * sizes
    worked = loading_work(mean[0], mean[1], square)[places[:found] + 1]
    # the loss is not negative but for rounding
    lost[:found] = np.maximum(4.0 * (worked - stored.mean(axis=0)[:found]), 0.0)  # (1)
    opens, sheared = _opens(driven, pressure), _sheared(driven)
    for k in np.flatnonzero(np.isfinite(lost)):
        if amplitudes.full_cycle or opens[k] or sheared:
            lost[k], q_mean[k], stiffness[k] = _cycle(
                driven, ends[0][k], q_mean[k], amplitudes.steps
            )
    frequency = np.sqrt(stiffness) / (2.0 * np.pi)
    unknown = np.flatnonzero(np.isnan(lost))
    failure = ""
    if unknown.size:
        why = next(filter(None, failures), "a cycle found no equilibrium")
        failure = (
            f"mode {mode + 1} has no answer from the modal amplitude "
            f"{amplitudes.values[unknown[0]]:.4g} kg^1/2 m on: {why}; ask for smaller amplitudes"
        )
    damping = lost / (2.0 * np.pi * stiffness * q_mean**2)  # (1)
    return Backbone(frequency, damping, pressure, slipping, opens, sheared, failure)


def _drive(rest: Preloaded, load: np.ndarray, square: float) -> _Mode:
    """Put the spring on the amplitude of a mode."""
    own = rest.loaded(load[:, None])
    spring = SPRING * square
    pull = own.load[:, 0]
    driven = Assembled(
        csr_array(own.stiffness + spring * csr_array(np.outer(pull, pull))),
        spring * own.load,
        own.jump,
        own.weight,
    )
    still = rest.law.respond(rest.state.jump, rest.state.history).traction
    return _Mode(rest, driven, TractionChange(rest.law, still), square)


def _opens(driven: _Mode, pressure: np.ndarray) -> np.ndarray:
    """Tell where pressures, shape (2, amplitudes, points), leave much of the area at rest."""
    rest, area = driven.pressure(driven.start), driven.structure.weight
    left = (rest > 0.0) & (pressure < OPENS * rest)  # NaN is not
    pressed = area[rest > 0.0].sum()
    return np.asarray((left @ area > OPENS * pressed).any(axis=0))


def _sheared(driven: _Mode) -> bool:
    """Tell whether the preload leaves shear in the joints."""
    rest, area = driven.rest, driven.structure.weight
    shear = np.linalg.norm(driven.law.rest[1:], axis=0)
    limit = rest.law.friction_limit(np.maximum(-driven.law.rest[0], 0.0))
    return bool(shear @ area > SHEARED * (limit @ area))


def _cycle(driven: _Mode, end: _Point, amplitude: float, steps: int) -> tuple[float, float, float]:
    """Loss, amplitude and secant stiffness of a closed cycle from its positive end."""
    path = closed_cycle(steps)
    path = amplitude * np.where(path == 0.0, MIDDLE, path)  # a load is needed as a scale
    found = [end, *driven.follow(end, path.tolist())]
    if len(found) <= path.size or found[-1].failure:
        return np.nan, np.nan, np.nan
    q = np.array([one.amplitude for one in found])
    alpha = np.array([one.force for one in found])
    half = 2 * steps
    span, pulled = q[-1] - q[half], alpha[-1] - alpha[half]
    return _closed_work(q, alpha), 0.5 * span, pulled / span


def _closed_work(q: np.ndarray, alpha: np.ndarray) -> float:
    r"""Work of a closed path by Simpson's rule on both branches, of nearly even steps of q."""
    from scipy.integrate import simpson

    half = q.size // 2
    deficit = alpha - (alpha[-1] - alpha[half]) / (q[-1] - q[half]) * q  # a line does no work
    branches = (slice(0, half + 1), slice(half, None))
    return float(sum(simpson(deficit[part], x=q[part]) for part in branches))


def loading_work(amplitude: np.ndarray, force: np.ndarray, square: float) -> np.ndarray:
    r"""Work of a loading curve up to its points, J.

    Notes
    -----
    With the deficit :math:`d = \omega_0^2 - \alpha/q`, the work is
    :math:`\tfrac12 \omega_0^2 q^2 - \int d\, q'\, \mathrm{d}q'`. Between the points d is a power of
    q, as it is in micro-slip, and below the first one of the same power as behind it.

    Examples
    --------
    >>> q = np.linspace(0.0, 1.0, 5)
    >>> round(float(loading_work(q, q - 0.3 * q**2, 1.0)[-1]), 12)  # a deficit of .3 q
    0.4
    """
    q = amplitude[1:]
    d = square - force[1:] / q
    ratio = d[1:] / np.where(d[:-1] == 0.0, np.inf, d[:-1])
    slope = np.log(np.where(ratio > 0.0, ratio, 1.0)) / np.log(q[1:] / q[:-1])
    slope = np.clip(np.append(slope[:1] if slope.size else 1.0, slope), -1.0, 50.0)
    below = np.append(0.0, q[:-1] / q[1:]) ** (slope + 2.0)
    area = np.cumsum(d * q**2 / (slope + 2.0) * (1.0 - below))
    return np.append(0.0, 0.5 * square * q**2 - area)
