r"""Quasi-static modal analysis: frequency and damping of a mode against its amplitude [1]_, [2]_.

A structure at rest is loaded by :math:`\alpha M \phi`. With the change v of the displacement
and the modal amplitude :math:`q = \phi^T M v`, the loading curve :math:`\alpha(q)` gives

.. math::
    \omega^2(q) = \frac{\alpha}{q}, \qquad
    \zeta(q) = \frac{D}{2 \pi \omega^2 q^2}, \qquad
    D = 4 \left( \int_0^q \alpha\, \mathrm{d}q' - E \right), \tag{1}

with the energy E stored in bodies and joints. By Masing's rule the loss D of a cycle is four times
the loss of the loading if the normal load of the joints is constant; otherwise the cycle is solved
for :math:`D = \oint \alpha\, \mathrm{d}q`. The usual form of (1),
:math:`8 \int \alpha\, \mathrm{d}q' - 4 \alpha q`, counts elastic curvature as a loss.

.. [1] H. Festjens, G. Chevallier and J.-L. Dion, J. Sound Vib. 332 (2013) 4821-4838,
   doi:10.1016/j.jsv.2013.04.020.
.. [2] R. M. Lacayo and M. S. Allen, Mech. Syst. Signal Process. 118 (2019) 133-157.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from multiscale.laws.interface_law import InterfaceLaw, Response
from multiscale.macro.monolithic import Assembled
from multiscale.macro.substructures.load_path import closed_cycle
from multiscale.macro.substructures.stepping import JointState, sliding_share
from multiscale.macro.substructures.whole import assemble
from multiscale.macro.vibration.modes import Preloaded, TangentModes
from multiscale.schema import COMPONENTS, VIBRATION, Dataset, with_cautions

SPRING = 1e3
"""Stiffness of the spring on the modal amplitude that drives a mode, relative to the mode."""

FIRST = 0.1  # amplitude of the first step, relative to the smallest requested amplitude
SLID = 0.99  # slipping share of the load of an interface at which it slides without limit

OPENS = 0.01
"""Share of the pressure at rest below which a point opens, and smallest share of open area."""

SHEARED = 0.02
"""Shear at rest, relative to the friction limit, above which loading curves depend on it."""

ABSCISSAE, WEIGHTS = (0.5 * rule for rule in np.polynomial.legendre.leggauss(6))
"""Gauss points about the middle of an interval of length 1, for the energy of normal laws."""

MIDDLE = 1e-3
"""Displacement in the middle of a cycle, relative to its amplitude: a load serves as a scale."""

TOLERANCE = 1e-9  # residual of a step, relative to the load that drives the mode


@dataclass(frozen=True)
class Amplitudes:
    """Amplitudes of a mode, and the steps to them.

    Parameters
    ----------
    values : tuple of float, rising modal amplitudes, kg^1/2 m
    full_cycle : bool, whether cycles are solved; otherwise their loss follows from Masing's rule
    ratio : float, largest ratio of neighbouring amplitudes of the loading curve
    steps : int, steps from the middle of a cycle to its amplitude
    """

    values: tuple[float, ...]
    full_cycle: bool = False
    ratio: float = 1.5
    steps: int = 10

    def curve(self) -> tuple[np.ndarray, np.ndarray]:
        """Rising amplitudes of the loading curve, and the positions of ``values`` among them."""
        ends = np.array([FIRST * self.values[0], *self.values])
        counts = np.ceil(np.log(ends[1:] / ends[:-1]) / np.log(self.ratio) - 1e-9).astype(int)
        segments = [
            np.geomspace(low, high, count + 1)[1:]
            for low, high, count in zip(ends, ends[1:], counts, strict=False)
        ]
        return np.append(ends[0], np.concatenate(segments)), np.cumsum(counts)


@dataclass(frozen=True, eq=False)
class Backbone:
    """Frequency and damping of a mode against its amplitude; NaN where joints slide away."""

    frequency: np.ndarray  # shape (amplitudes,), Hz
    damping: np.ndarray  # share of critical damping due to the joints, (amplitudes,)
    pressure: np.ndarray  # (2, amplitudes, points), Pa, at the amplitude in both directions
    slipping: np.ndarray  # share of the pressure that slips
    opens: np.ndarray  # whether contact opens in one direction, (amplitudes,)
    sheared: bool  # whether the preload leaves shear in the joints: curves depend on it
    failure: str  # reason why the last amplitudes have no solution, or empty


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
        response = self.law.respond(jump, state)
        return replace(response, traction=response.traction - self.rest)

    def resolvent(
        self, source: np.ndarray, stiffness: float | np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Return the jump on the law and on a search direction."""
        return self.law.resolvent(source + self.rest, stiffness, state)


@dataclass(frozen=True, eq=False)
class _Point:
    value: np.ndarray  # change of the displacement since rest, (n,), m
    amplitude: float  # q, kg^1/2 m
    force: float  # alpha, kg^1/2 m/s2
    state: JointState  # committed
    slipping: np.ndarray  # share of the pressure that slips in the last step, (points,)
    sheared: float  # energy stored by the tangential tractions of the joints, J
    failure: str = ""  # reason why the step to the next amplitude failed


@dataclass(frozen=True, eq=False)
class _Mode:
    """A mode of a structure at rest, driven by a spring on its amplitude."""

    rest: Preloaded
    structure: Assembled  # condensed, with the spring, loaded by the spring
    law: TractionChange  # of all joints
    square: float  # squared frequency at rest, s⁻²

    @property
    def start(self) -> _Point:
        """The structure at rest."""
        law, state = self.rest.law, self.rest.state
        nothing = np.zeros(self.structure.load.shape[0])
        stored = float(law.sliding(state.jump, state.history).stored @ self.structure.weight)
        return _Point(nothing, 0.0, 0.0, state, np.zeros(state.jump.shape[1]), stored)

    def follow(self, point: _Point, amplitudes: Sequence[float]) -> Iterator[_Point]:
        """Follow the mode through amplitudes, until a step fails."""
        for amplitude in amplitudes:
            point = self._step(point, amplitude)
            yield point
            if point.failure:
                return

    def _step(self, point: _Point, amplitude: float) -> _Point:
        """Solve a step to an amplitude, which is reached exactly only without slip in the step."""
        spring = SPRING * self.square
        force = point.force + self.square * (amplitude - point.amplitude)
        reach = amplitude + force / spring
        law, state = self.rest.law, point.state
        # start from the extrapolated path, then from the last point
        grow = amplitude / point.amplitude if point.amplitude * amplitude > 0.0 else 1.0
        moved = (grow - 1.0) * point.value
        for change in (moved, 0.0 * moved):
            opened = (self.structure.jump @ change).reshape(state.jump.shape)
            with np.errstate(over="ignore", invalid="ignore"):  # if the start is too far away
                solution = self.structure.solve(
                    self.law,
                    np.array([reach]),
                    start=point.value + change,
                    jump=state.jump + opened,
                    state=state.history,
                    tolerance=TOLERANCE,
                )
            if solution.converged:
                break
        else:
            return replace(point, failure=solution.status.value)

        # amplitude reached, and committed state
        q = float(self.structure.load[:, 0] @ solution.value) / spring
        state, account = state.advance(law, solution.value, solution.jump, state.traction)
        slipping = sliding_share(law, solution.jump, account)
        sheared = float(account.stored @ self.structure.weight)
        return _Point(solution.value, q, spring * (reach - q), state, slipping, sheared)

    def stored(self, point: _Point) -> float:
        """Energy stored in bodies and joints at a point of the path since rest, J."""
        u, rest = point.value, self.rest.state
        spring = SPRING * self.square * point.amplitude**2
        bodies = 0.5 * (float(u @ (self.structure.stiffness @ u)) - spring)
        # work of the normal tractions by Gauss quadrature over the jump
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
        """Return the reason for the end of the path, a failed step or a sliding interface."""
        if point.failure:
            return f"there is no equilibrium ({point.failure})"
        rubs = self.rest.law.friction_limit(np.ones(point.slipping.size)) > 0.0
        load = np.where(rubs, np.maximum(self.pressure(point), 0.0), 0.0) * self.structure.weight
        number = self.rest.path["point_joint"].values
        for joint in np.unique(number):
            inside = number == joint
            slips = float(load[inside] @ point.slipping[inside])
            if slips > SLID * float(load[inside].sum()):
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
    """Follow a mode over its amplitudes, in both directions from rest.

    Parameters
    ----------
    load : ndarray, shape (whole unknowns, modes), M phi of all modes, kg^1/2
    mode : int, counted from 0
    progress : callable, called after each amplitude of each direction
    """
    square, points = float(modes.square[mode]), rest.state.jump.shape[1]
    count = len(amplitudes.values)
    if not points:
        empty, zero = np.zeros((2, count, 0)), np.zeros(count)
        constant = np.full(count, modes.frequency[mode])
        return Backbone(constant, zero, empty, empty, zero > 0.0, False, "")
    driven = _drive(rest, load[:, mode], square)
    grid, places = amplitudes.curve()
    pressure, slipping = np.full((2, 2, count, points), np.nan)
    stored = np.full((2, count), np.nan)
    curves, ends, failures = [], [], []

    # loading curves in both directions
    for side, sign in enumerate((1.0, -1.0)):
        path, failure = [driven.start], ""
        for step, point in enumerate(driven.follow(path[0], (sign * grid).tolist())):
            if failure := driven.sliding(point):
                break
            path.append(point)
            if step in places:
                k = int(np.searchsorted(places, step))
                pressure[side, k], slipping[side, k] = driven.pressure(point), point.slipping
                stored[side, k] = driven.stored(point)
                progress()
        curves.append(sign * np.array([(point.amplitude, point.force) for point in path]).T)
        ends.append([path[place + 1] for place in places if place + 1 < len(path)])
        failures.append(failure)

    # loss and stiffness of the mean of both directions, in which odd terms in q cancel
    both = min(curve.shape[1] for curve in curves)
    q, alpha = 0.5 * (curves[0][:, :both] + curves[1][:, :both])
    n = min(map(len, ends))
    at = places[:n] + 1
    size, lost, stiffness = np.full((3, count), np.nan)
    size[:n], stiffness[:n] = q[at], alpha[at] / q[at]
    worked = loading_work(q, alpha, square)[at] - stored[:, :n].mean(axis=0)
    lost[:n] = np.maximum(4.0 * worked, 0.0)  # (1); negative only by rounding

    # full cycles where Masing's rule does not hold
    opens, sheared = _opens(driven, pressure), _sheared(driven)
    for k in range(n):
        if amplitudes.full_cycle or opens[k] or sheared:
            lost[k], size[k], stiffness[k] = _cycle(driven, ends[0][k], size[k], amplitudes.steps)
    failure = ""
    if np.isnan(lost).any():
        why = next(filter(None, failures), "a cycle has no equilibrium")
        failure = (
            f"mode {mode + 1} has no solution from the modal amplitude "
            f"{amplitudes.values[int(np.argmax(np.isnan(lost)))]:.4g} kg^1/2 m on: {why}; "
            f"give smaller amplitudes"
        )
    frequency = np.sqrt(stiffness) / (2.0 * np.pi)
    damping = lost / (2.0 * np.pi * stiffness * size**2)  # (1)
    return Backbone(frequency, damping, pressure, slipping, opens, sheared, failure)


def _drive(rest: Preloaded, load: np.ndarray, square: float) -> _Mode:
    """Return a mode of the condensed structure, driven by a spring on its amplitude."""
    structure = assemble(rest.condensed.with_loads(load[:, None]).small.with_locked_bolts())
    spring, pull = SPRING * square, structure.load[:, [rest.free.n_cases]]
    stiffness = csr_array(structure.stiffness + spring * csr_array(pull @ pull.T))
    driven = replace(structure, stiffness=stiffness, load=spring * pull)
    traction = rest.law.respond(rest.state.jump, rest.state.history).traction
    return _Mode(rest, driven, TractionChange(rest.law, traction), square)


def _opens(driven: _Mode, pressure: np.ndarray) -> np.ndarray:
    """Return whether much of the area at rest opens at pressures, (2, amplitudes, points)."""
    rest, area = driven.pressure(driven.start), driven.structure.weight
    left = (rest > 0.0) & (pressure < OPENS * rest)  # false for NaN
    return np.asarray((left @ area > OPENS * area[rest > 0.0].sum()).any(axis=0))


def _sheared(driven: _Mode) -> bool:
    traction, area = driven.law.rest, driven.structure.weight
    limit = driven.rest.law.friction_limit(np.maximum(-traction[0], 0.0))
    return bool(np.linalg.norm(traction[1:], axis=0) @ area > SHEARED * (limit @ area))


def _cycle(driven: _Mode, end: _Point, amplitude: float, steps: int) -> tuple[float, float, float]:
    from scipy.integrate import simpson

    path = closed_cycle(steps)
    path = amplitude * np.where(path == 0.0, MIDDLE, path)
    points = [end, *driven.follow(end, path.tolist())]
    if points[-1].failure:
        return np.nan, np.nan, np.nan
    q, alpha = np.array([(point.amplitude, point.force) for point in points]).T
    half = 2 * steps
    span = q[-1] - q[half]
    secant = (alpha[-1] - alpha[half]) / span
    # work by Simpson's rule on both branches, less the secant, which does no work
    branches = (slice(0, half + 1), slice(half, None))
    lost = sum(simpson((alpha - secant * q)[branch], x=q[branch]) for branch in branches)
    return float(lost), 0.5 * span, secant


def loading_work(amplitude: np.ndarray, force: np.ndarray, square: float) -> np.ndarray:
    """Return the work of a loading curve up to its points, J.

    >>> q = np.linspace(0.0, 1.0, 5)
    >>> round(float(loading_work(q, q - 0.3 * q**2, 1.0)[-1]), 12)  # a deficit of .3 q
    0.4
    """
    q = amplitude[1:]
    d = square - force[1:] / q
    # work = w_0² q²/2 - ∫ d q dq with the deficit d = w_0² - alpha/q, a power of q between two
    # points, as in micro-slip; below the first point it has the power of the first interval
    ratio = d[1:] / np.where(d[:-1] == 0.0, np.inf, d[:-1])
    slope = np.log(np.where(ratio > 0.0, ratio, 1.0)) / np.log(q[1:] / q[:-1])
    slope = np.clip(np.append(slope[:1] if slope.size else 1.0, slope), -1.0, 50.0)
    below = np.append(0.0, q[:-1] / q[1:]) ** (slope + 2.0)
    area = np.cumsum(d * q**2 / (slope + 2.0) * (1.0 - below))
    return np.append(0.0, 0.5 * square * q**2 - area)


def vibrate(
    rest: Preloaded,
    modes: TangentModes,
    load: np.ndarray,
    amplitudes: Mapping[int, Amplitudes],
    *,
    material_damping: float = 0.0,
    progress: Callable[[int, int], None] = lambda finished, total: None,
) -> Dataset:
    """Follow modes over their amplitudes.

    Parameters
    ----------
    load : ndarray, shape (whole unknowns, modes), M phi of all modes, kg^1/2
    amplitudes : mapping of int to Amplitudes, amplitudes by mode, counted from 0
    material_damping : float, share of critical damping of every mode due to the bodies
    progress : callable, called as ``progress(finished, total)`` with numbers of amplitudes

    Returns
    -------
    Dataset
        Follows ``VIBRATION``; a step is an amplitude of a mode. Steps at which a mode slides away
        are NaN with ``converged`` 0, and the attribute ``failure`` gives the reason.
    """
    # backbone of each mode
    total, finished = 2 * sum(len(levels.values) for levels in amplitudes.values()), 0

    def count() -> None:
        nonlocal finished
        finished += 1
        progress(finished, total)

    progress(0, total)
    curves = [
        follow_backbone(rest, modes, load, mode, levels, count)
        for mode, levels in amplitudes.items()
    ]

    # dataset
    shape = modes.nodal(rest.free)
    largest = np.linalg.norm(shape, axis=2).max(axis=1)
    number = np.repeat([*amplitudes], [len(levels.values) for levels in amplitudes.values()])
    q = np.concatenate([levels.values for levels in amplitudes.values()])
    frequency, damping, opens = (
        np.concatenate([getattr(curve, name) for curve in curves])
        for name in ("frequency", "damping", "opens")
    )
    values: dict[str, Any] = {
        "mode_frequency": modes.frequency,
        "shape": shape,
        "position": rest.free.position,
        "step_mode": 1 + number,
        "modal_amplitude": q,
        "largest_displacement": largest[number] * q,
        "frequency": frequency,
        "fall": modes.frequency[number] - frequency,
        "damping": material_damping + damping,
        "opens": opens.astype(int),
        "converged": np.isfinite(damping).astype(int),
    }
    if rest.state.jump.size:
        values |= _joints(rest.path, curves)
    result = VIBRATION.build(values).assign_coords(
        component=["x", "y", "z"], mode=1 + np.arange(len(shape))
    )
    if rest.state.jump.size:
        result = result.assign_coords(direction=list(COMPONENTS))

    # cautions
    cautions = [
        f"mode {mode + 1}: contact opens at amplitudes from "
        f"{levels.values[int(np.argmax(curve.opens))]:.4g} kg^1/2 m on, where Masing's rule is "
        f"not valid: the loss belongs to a full cycle, and both directions differ"
        for (mode, levels), curve in zip(amplitudes.items(), curves, strict=True)
        if curve.opens.any()
    ]
    cautions += [
        f"modes {', '.join(str(mode + 1) for mode in group)} have the same frequency, and any sum "
        f"of their shapes is a mode: the shapes are chosen to move along the axes"
        for group in modes.coinciding
    ]
    if any(curve.sheared for curve in curves):
        cautions.append(
            "after the preload the joints have shear, so both directions differ and Masing's "
            "rule is not valid: frequency and loss belong to full cycles; after a preload "
            "without friction there is no shear"
        )
    result = with_cautions(result, str(rest.path.attrs.get("cautions", "")), *cautions)
    failures = [curve.failure for curve in curves if curve.failure]
    return result.assign_attrs(failure="\n".join(failures)) if failures else result


def _joints(path: Dataset, curves: list[Backbone]) -> dict[str, Any]:
    """Return traction and slip at the points of the joints, at rest and at the amplitudes."""
    pressure = np.concatenate([curve.pressure for curve in curves], axis=1)
    slipping = np.concatenate([curve.slipping for curve in curves], axis=1)
    load = np.maximum(np.nan_to_num(pressure), 0.0) * path["point_area"].values
    carried = load.sum(axis=2)
    slips = np.sum(load * np.nan_to_num(slipping), axis=2)
    share = (slips / np.where(carried > 0.0, carried, np.nan)).max(axis=0)
    copied = ("point_position", "point_area", "point_joint")
    return {name: path[name].values for name in copied} | {
        "rest_traction": path["traction"].values[-1],
        "pressure": pressure,
        "slipping": slipping,
        "slipping_load": share,
    }
