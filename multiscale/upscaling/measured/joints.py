r"""Answers of measured joints by the law of their interface, with their gradients.

:math:`\ln K(x)`, :math:`x = \ln p`, is linear between the points of a grid; bodies and the frame of
the machine are compliances :math:`c` in series.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import ClassVar, NamedTuple

import numpy as np

from multiscale.errors import ConvergenceError
from multiscale.upscaling.observations import list_pressures

NODES, WEIGHTS = (np.polynomial.legendre.leggauss(3)[0] + 1.0) / 2.0, np.array([5, 8, 5]) / 18.0
"""Points and weights of Gauss on an interval of length 1."""

SETTLED, REACHED = 1e-13, 1e-8  # of a pressure, relative: where steps end, and least accuracy

SAME = 0.01  # relative difference of preloads of rows of the same loop

LEAST_PRESSURE = 0.05  # of a preload less the zero of the load, over it


@dataclass(frozen=True, eq=False)
class Curve:
    """Stiffness of an interface over its pressure, with its rates by m parameters."""

    x: np.ndarray  # (points,), logarithm of the pressure, evenly rising
    log_stiffness: np.ndarray  # (points,), of K in Pa/m
    rates: np.ndarray  # (m, points), of ln K by the parameters

    def at(self, pressure: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return ln K, its rates (m, ...) and its slope over ln p."""
        x = np.log(pressure)
        rates = np.array([np.interp(x, self.x, rate) for rate in self.rates])
        place = self._place(x)
        slope = (np.diff(self.log_stiffness) / np.diff(self.x))[place]
        return np.interp(x, self.x, self.log_stiffness), rates.reshape(-1, *x.shape), slope

    def rising(self) -> "Curve":
        """Return the mean of the least rising curve above and of the largest one below."""
        values, place = self.log_stiffness, np.arange(self.x.size)
        highest = np.maximum.accumulate(values)
        lowest = np.minimum.accumulate(values[::-1])[::-1]
        above = np.maximum.accumulate(np.where(values >= highest, place, 0))
        below = np.where(values <= lowest, place, place.size)
        below = np.minimum.accumulate(below[::-1])[::-1]
        log_stiffness, rates = (
            0.5 * (rows[..., above] + rows[..., below]) for rows in (values, self.rates)
        )
        return replace(self, log_stiffness=log_stiffness, rates=rates)

    def closure(self, pressure: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        r"""Return :math:`\int \mathrm{d}p / K` from the lowest pressure, m, and its rates."""
        x = np.log(np.atleast_1d(pressure))
        place = self._place(x)
        width = x - self.x[place]
        total = self._closures[:, place] + width * self._means(self.x[place], width)
        shaped = total.reshape(-1, *np.shape(pressure))
        return shaped[0], shaped[1:]

    def _place(self, x: np.ndarray) -> np.ndarray:
        return np.clip(np.searchsorted(self.x, x, side="right") - 1, 0, self.x.size - 2)

    @cached_property
    def _closures(self) -> np.ndarray:
        """Closure and its rates at the points of the grid, shape (1 + m, points)."""
        width = np.diff(self.x)
        steps = width * self._means(self.x[:-1], width)
        return np.pad(np.cumsum(steps, axis=1), ((0, 0), (1, 0)))

    def _means(self, begin: np.ndarray, width: np.ndarray) -> np.ndarray:
        """Return the means of p / K and of its rates over intervals, shape (1 + m, intervals)."""
        x = begin + NODES[:, None] * width
        integrand = np.exp(x - np.interp(x, self.x, self.log_stiffness))
        rates = [-integrand * np.interp(x, self.x, rate) for rate in self.rates]
        return np.asarray(np.tensordot(WEIGHTS, np.array([integrand, *rates]), axes=(0, 1)))


class BedCurve(NamedTuple):
    """Law of an interface with its derivatives; parameters are of the curve, ln kappa, ln mu."""

    curve: Curve
    ratio: float  # kappa
    friction: float  # mu


@dataclass(frozen=True, eq=False)
class MeasuredJoint(ABC):
    """A table of measured values of a joint with an even pressure.

    Attributes
    ----------
    name : str, of the table, in messages
    pressure : ndarray, shape (rows,), preload over the nominal area, Pa
    value : ndarray, shape (rows,), in the units of ``rows``
    deviation : ndarray, shape (rows,), standard deviation of the error of every value, same unit
    nuisances : mapping of str to float
        Standard deviations, about zero, of ``"frame"`` (compliance in series, m/Pa), ``"offset"``
        (zero of the load, Pa) and, for closures, ``"zero"`` (zero of the displacement, m).
    bodies : float, compliance of the bodies between the sensors, m/Pa
    """

    name: str
    pressure: np.ndarray
    value: np.ndarray
    deviation: np.ndarray
    nuisances: Mapping[str, float]
    bodies: float = 0.0

    unit: ClassVar[str]
    sheared: ClassVar[bool] = False  # whether the answer depends on kappa and mu
    linear: ClassVar[bool] = False  # whether an answer takes long and has noise: draws linearise it

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Names of the rows in messages, and the units of their values."""
        return [(f"row {k + 1}", self.unit) for k in range(self.value.size)]

    @abstractmethod
    def answer(
        self, interface: BedCurve, nuisances: Mapping[str, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate the values by a law, and their gradient.

        Returns
        -------
        value : ndarray, shape (rows,)
        gradient : ndarray, shape (rows, m + 2 + nuisances), by the parameters of the curve,
            ln kappa, ln mu, and the nuisances in their order
        """

    def _columns(
        self,
        of_curve: np.ndarray,
        ratio: np.ndarray | float,
        friction: np.ndarray | float,
        **by: np.ndarray,
    ) -> np.ndarray:
        """Assemble a gradient from its columns; a nuisance without a column has no effect."""
        nothing = np.zeros(self.value.size)
        rows = [by.get(name, nothing) for name in self.nuisances]
        return np.column_stack([*of_curve, nothing + ratio, nothing + friction, *rows])


Answer = Callable[[MeasuredJoint, BedCurve, Mapping[str, float]], tuple[np.ndarray, np.ndarray]]
"""Maps a table, a law and nuisances to values and gradient; see :meth:`MeasuredJoint.answer`."""


def _loaded(pressure: np.ndarray, nuisances: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return true pressures for stated pressures, and their derivative by the zero of the load."""
    p, least = pressure + nuisances.get("offset", 0.0), LEAST_PRESSURE * pressure
    return np.maximum(p, least), 1.0 * (p > least)


class MeasuredStiffness(MeasuredJoint):
    r"""Normal stiffness at preloads: :math:`1 / k = 1 / K(p) + c`."""

    unit = "Pa m-1"

    def answer(
        self, interface: BedCurve, nuisances: Mapping[str, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate the stiffness of the interface, bodies and frame in series."""
        p, moves = _loaded(self.pressure, nuisances)
        log_stiffness, rates, slope = interface.curve.at(p)
        compliance = np.exp(-log_stiffness)
        if self.sheared:
            compliance /= interface.ratio
        k = 1.0 / (compliance + self.bodies + nuisances.get("frame", 0.0))
        by_log = k**2 * compliance
        return k, self._columns(
            by_log * rates,
            by_log * self.sheared,
            0.0,
            frame=-(k**2),
            offset=by_log * slope / p * moves,
        )


class MeasuredTangential(MeasuredStiffness):
    r"""Tangential stiffness without slip: :math:`1 / k = 1 / (\kappa K(p)) + c`."""

    sheared = True


class MeasuredClosure(MeasuredJoint):
    """Closure since the first row: the integral of dp / K, and c (p - p_0) of the bodies."""

    unit = "m"

    def answer(
        self, interface: BedCurve, nuisances: Mapping[str, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate the closure of the interface, bodies and frame."""
        p, moves = _loaded(self.pressure, nuisances)
        total, rates = interface.curve.closure(p)
        flexibility = np.exp(-interface.curve.at(p)[0]) * moves
        raised, later = p - p[0], 1.0 * (np.arange(p.size) > 0)
        series = self.bodies + nuisances.get("frame", 0.0)
        value = total - total[0] + series * raised + later * nuisances.get("zero", 0.0)
        by_offset = flexibility - flexibility[0] + series * (moves - moves[0])
        return value, self._columns(
            rates - rates[:, :1], 0.0, 0.0, frame=raised, offset=by_offset, zero=later
        )


@dataclass(frozen=True, eq=False)
class MeasuredLoop(MeasuredJoint):
    r"""Shear, Pa, over the tangential displacement of the joint, along loops at constant preloads.

    The first loading :math:`B(\delta)` of :class:`~multiscale.laws.Sliders` under the pressure p is

    .. math:: t = \mu (p - q), \qquad
        \delta = \frac\mu\kappa \int_q^p \frac{\mathrm{d}p'}{K(p')} + c\, t;    \tag{1}

    reversals follow Masing's rule, :math:`t = t_r \pm 2 B(|\delta - \delta_r| / 2)`.
    """

    displacement: np.ndarray = field(kw_only=True)  # (rows,), m

    unit: ClassVar[str] = "Pa"
    sheared: ClassVar[bool] = True

    @cached_property
    def _branches(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Amplitudes and pressures of first loadings, and their sums in the rows (rows, first)."""
        amplitudes, pressures, sums = list[float](), list[float](), list[dict[int, float]]()
        for rows in split_loops(self.pressure):
            for terms in masing_terms(self.displacement[rows]):
                row = {}
                for amplitude, factor in terms:
                    row[len(amplitudes)] = factor
                    amplitudes.append(amplitude)
                    pressures.append(float(self.pressure[rows].mean()))
                sums.append(row)
        matrix = np.zeros((len(sums), len(amplitudes)))
        for matrix_row, row in zip(matrix, sums, strict=True):
            matrix_row[list(row)] = list(row.values())
        return np.array(amplitudes), np.array(pressures), matrix

    def answer(
        self, interface: BedCurve, nuisances: Mapping[str, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate the shear along the loops."""
        amplitude, pressure, sums = self._branches
        p, moves = _loaded(pressure, nuisances)
        series = self.bodies + nuisances.get("frame", 0.0)
        t, by_curve, by_ratio, by_friction, by_series, by_p = _first_loading(
            amplitude, p, interface, series
        )
        return sums @ t, self._columns(
            by_curve @ sums.T,
            sums @ by_ratio,
            sums @ by_friction,
            frame=sums @ by_series,
            offset=sums @ (by_p * moves),
        )


def _first_loading(
    amplitude: np.ndarray, p: np.ndarray, interface: BedCurve, series: float
) -> tuple[np.ndarray, ...]:
    """Return (1), and its derivatives by rates, ln kappa, ln mu, compliance and pressure."""
    curve, kappa, mu = interface
    total, rates = curve.closure(p)
    plain = replace(curve, rates=np.empty((0, curve.x.size)))
    low, high = np.full(p.size, curve.x[0]), np.log(p)

    def displacement(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacement at q = exp(y) less the given displacement, and its derivative by y."""
        q = np.exp(y)
        delta = mu / kappa * (total - plain.closure(q)[0]) + series * mu * (p - q)
        compliance = np.exp(-np.interp(y, curve.x, curve.log_stiffness))  # 1 / K(q)
        slope = -q * mu * (compliance / kappa + series)
        return delta - amplitude, slope

    # q by Newton's method between ends that are halved; full slip below the lowest pressure
    y = high.copy()
    full = displacement(low)[0] <= 0.0
    for _ in range(100):
        error, slope = displacement(y)
        low, high = np.where(error >= 0.0, y, low), np.where(error <= 0.0, y, high)
        new = y - error / slope
        inside = (new >= low) & (new <= high)
        step = np.where(inside, new, 0.5 * (low + high)) - y
        done = np.abs(step) <= SETTLED
        y = y + step
        if np.all(done | full):
            break
    if not np.all(((np.abs(step) <= REACHED) & np.isfinite(error)) | full):
        raise ConvergenceError(
            f"the slip of sliders under {list_pressures(p)} does not converge in 100 steps; "
            f"look for stiffnesses of the law that are not numbers"
        )
    q = np.where(full, 0.0, np.exp(y))
    t = mu * (p - q)
    # implicit derivatives: delta(q; parameters) is given
    safe = np.exp(np.where(full, curve.x[0], y))
    soft = np.exp(-curve.at(safe)[0]) / kappa  # 1 / (kappa K(q))
    stick = np.where(full, 0.0, 1.0 / (soft + series))  # dt / d delta
    closed, closed_rates = curve.closure(safe)
    slip = mu / kappa * (total - closed)
    by_curve = -stick * mu / kappa * (rates - closed_rates)
    by_p = mu - stick * mu * (np.exp(-curve.at(p)[0]) / kappa + series)
    by_friction = np.where(full, t, t - stick * (slip + series * t))
    return t, by_curve, stick * slip, by_friction, -stick * t, by_p


def split_loops(pressure: np.ndarray) -> list[slice]:
    """Return the consecutive rows of every loop, with preloads that differ by less than SAME."""
    starts = [0]
    for row, p in enumerate(pressure):
        if abs(p - pressure[starts[-1]]) > SAME * pressure[starts[-1]]:
            starts.append(row)
    return [slice(*ends) for ends in pairwise([*starts, pressure.size])]


def masing_terms(displacement: np.ndarray) -> list[list[tuple[float, float]]]:
    """Return amplitudes and factors of first loadings that add up to the force (Madelung)."""
    rows: list[list[tuple[float, float]]] = []
    turns: list[float] = []  # displacements of the open reversals
    last, way = 0.0, 0.0
    for at in map(float, displacement):
        step = float(np.sign(at - last))
        if step * way < 0.0:
            turns.append(last)
        way = step or way
        # leave the loops that the path closes
        while turns:
            if len(turns) == 1 and at * turns[0] < 0.0 and abs(at) >= abs(turns[0]):
                turns.clear()  # on the first loading of the other sign
            elif len(turns) > 1 and (at - turns[-2]) * (turns[-2] - turns[-1]) >= 0.0:
                del turns[-2:]
            else:
                break
        start = turns[0] if turns else at
        halves = [
            (0.5 * abs(b - a), 2.0 * float(np.sign(b - a))) for a, b in pairwise([*turns, at])
        ]
        rows.append([(abs(start), float(np.sign(start))), *(halves if turns else ())])
        last = at
    return rows
