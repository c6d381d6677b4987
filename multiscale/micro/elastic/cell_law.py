"""The concurrent way: an interface law that presses a cell at the gaps of a structure."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from multiscale.convergence import Status
from multiscale.errors import CaseError, ConvergenceError
from multiscale.laws.interface_law import NormalLaw
from multiscale.micro.elastic.elastic_cells import FlatCell, assemble_flat_cell

CLOSED = 1e-9
"""Mean gap over the gap at the lowest pressure up to which a cell counts as closed."""

HALVINGS = 60
"""Halvings of an interval of gaps, which reach the spacing of floating-point numbers."""


@dataclass(frozen=True, eq=False)
class CellLaw(NormalLaw):
    r"""A law without a fit: the pressure at which a cell has the local gap.

    Parameters
    ----------
    cell : FlatCell, without hardness
    pressure_range : tuple of float
        Lowest and highest pressure of the cell, Pa; beyond, the law continues as an exponential.
    ratio : float
        Ratio of neighbouring pressures at which the cell is pressed, about: 1.2 takes at most 13
        cells a decade and changes pressures by up to 0.3 %, 1.4 takes 7 and changes them by 1 %.

    Attributes
    ----------
    account : mapping of str to int
        ``solved``: cells pressed so far; ``reused``: gaps by cells that were pressed before;
        ``linear_iterations``: total iterations of their solver.

    Notes
    -----
    The cell has the mean gaps :math:`g_k` at the pressures :math:`p_k = p_0 r^k`. It is pressed
    only where the structure needs a gap in between, and never twice at the same pressure. Between
    :math:`g_k` and :math:`g_{k+1}` the logarithm of the pressure is the cubic with the values and
    slopes

    .. math::
        \ln p_k, \qquad
        \frac{\mathrm{d} \ln p}{\mathrm{d} g} \approx \frac{2 \ln r}{g_{k+1} - g_{k-1}}.    \tag{1}

    The law is a function of the gap only, independent of earlier evaluations; its tangent is the
    derivative of the cubic.

    The law of a cell has the scatter of a single realisation. Solve the structure with several.

    Examples
    --------
    >>> from multiscale.micro import Cell, self_affine
    >>> surface = self_affine(
    ...     (32, 32), (1e-3, 1e-3), seed=1,
    ...     hurst_exponent=0.8, long_cutoff=5e-4, short_cutoff=25e-5, rms_height=1e-6,
    ... )
    >>> law = CellLaw(Cell(surface, 1e-3, 8, 210e9, 0.3, geometry="flat"), (1e6, 1e9))
    >>> pressure = law.pressure(np.array([1e-6, 2e-6]))
    >>> solved = law.account["solved"]
    >>> bool(pressure[0] > pressure[1] > 0.0), solved < 20
    (True, True)
    >>> closing = law.stiffness(np.array([1e-6, 2e-6]))  # Pa/m
    >>> law.account["solved"] == solved
    True
    """

    cell: FlatCell
    pressure_range: tuple[float, float]
    ratio: float = 1.2
    _memory: "_Memory" = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.cell, FlatCell) or self.cell.hardness is not None:
            raise CaseError(
                "only flat cells without hardness serve as a law of gaps; fit a law to the "
                "response of other cells"
            )
        low, high = self.pressure_range
        if not (0.0 < low < high < np.inf and 1.0 < self.ratio < np.inf):
            raise CaseError(
                f"the cell of a law is pressed between two rising pressures (Pa) by a ratio above "
                f"1, got {low:g} to {high:g} by {self.ratio:g}"
            )
        object.__setattr__(self, "_memory", _Memory(self.cell, low, high, self.ratio))

    @property
    def account(self) -> Mapping[str, int]:
        """Cells pressed and reused so far."""
        return MappingProxyType(self._memory.account)

    def pressure(self, gap: np.ndarray) -> np.ndarray:
        """Pressure, Pa, at a local gap, m."""
        return self._answer(gap)[0]

    def stiffness(self, gap: np.ndarray) -> np.ndarray:
        """Minus the derivative of the pressure, Pa/m, at a local gap, m."""
        return self._answer(gap)[1]

    def gap_at(self, pressure: np.ndarray) -> np.ndarray:
        """Local gap, m, at a pressure, Pa; infinite at zero pressure."""
        target = np.asarray(pressure, dtype=float)
        if not np.all((target >= 0.0) & np.isfinite(target)):
            raise ValueError("a pressure must be finite and not negative (Pa)")
        memory = self._memory
        with np.errstate(divide="ignore"):
            x = np.log(target.ravel() / memory.lowest)
        k = np.clip(np.floor(x / memory.step), 0, memory.last - 1).astype(int)
        spline = memory.spline(k)
        near, far = (np.array([memory.gaps[int(j)] for j in k + end]) for end in (0, 1))
        low, high = far, near
        for _ in range(HALVINGS):  # of intervals from p(low) >= p to p(high) <= p
            middle = 0.5 * (low + high)
            above = spline(-middle) > x
            low, high = np.where(above, middle, low), np.where(above, high, middle)
        end = np.where(x <= 0.0, near, far)  # beyond it the tangent
        straight = end - (x - spline(-end)) / spline(-end, 1)
        inside = (x > 0.0) & (x < memory.last * memory.step)
        return np.asarray(np.where(inside, 0.5 * (low + high), straight).reshape(target.shape))

    def _answer(self, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate pressure, Pa, and stiffness, Pa/m, at local gaps, m; NaN at NaN."""
        memory, g = self._memory, np.array(gap, dtype=float)
        p, K = np.where(np.isnan(g), np.nan, np.zeros((2, *g.shape)))
        finite = np.isfinite(g)
        spline = memory.spline(memory.enclose(g[finite]))
        inside = np.clip(-g[finite], spline.x[0], spline.x[-1])  # beyond, the tangent
        slope = spline(inside, 1)
        p[finite] = memory.lowest * np.exp(spline(inside) + slope * (-g[finite] - inside))
        K[finite] = p[finite] * slope
        return p, K


class _Memory:
    """Gaps of a cell at the pressures ``lowest exp(k step)``, k from 0 to ``last``, on demand."""

    def __init__(self, cell: FlatCell, lowest: float, highest: float, ratio: float) -> None:
        decades = np.log(highest / lowest)
        self.lowest, self.last = lowest, max(2, int(np.ceil(decades / np.log(ratio))))
        self.step = float(decades / self.last)
        self.problem = assemble_flat_cell(cell)
        self.gaps: dict[int, float] = {}
        self.account = {"solved": 0, "reused": 0, "linear_iterations": 0}

    def press(self, k: int) -> None:
        """Press the cell at a pressure, once, and store its mean gap, m."""
        if k in self.gaps:
            return
        pressure = self.lowest * np.exp(k * self.step)
        load = pressure * self.problem.area
        # no start from other states, which would change the answer within the tolerance
        state = self.problem.solve(load=load, approach=None, start=None, tolerance=0.0)
        if state.status is not Status.CONVERGED:
            raise ConvergenceError(
                f"the cell of a law did not converge at {pressure:.4g} Pa: {state.status.value}"
            )
        self.gaps[k] = self.problem.surface(state).mean_gap
        self.account["solved"] += 1
        self.account["linear_iterations"] += state.linear_iterations

    def enclose(self, gap: np.ndarray) -> np.ndarray:
        """Return the intervals k of pressures that enclose gaps, m; halve intervals until known."""
        before = self.account["solved"]
        self.press(0)
        self.press(self.last)
        while True:
            k = np.array(sorted(self.gaps))
            g = np.array([self.gaps[j] for j in k])
            at = np.clip(np.searchsorted(-g, -gap, side="right") - 1, 0, k.size - 2)
            wide = np.unique(at[k[at + 1] - k[at] > 1])
            if not wide.size:
                break
            for j in wide:
                self.press(int(k[j] + k[j + 1]) // 2)
        self.account["reused"] += max(gap.size - (self.account["solved"] - before), 0)
        return np.asarray(k[at])

    def spline(self, k: np.ndarray) -> CubicHermiteSpline:
        """Interpolate log pressure against minus the gap; valid in the intervals k only."""
        needed = np.unique(np.clip(k[:, None] + np.arange(-1, 3), 0, self.last))
        for j in (0, self.last, *needed):
            self.press(int(j))
        solved = np.array(sorted(self.gaps))
        g = np.array([self.gaps[j] for j in solved])
        closed = solved[g <= CLOSED * g[0]]
        if closed.size and np.any(needed > closed[0]):  # it may close at the last pressure
            pressure = self.lowest * np.exp(needed[-1] * self.step)
            raise CaseError(
                f"the cell of a law is closed at {pressure:.4g} Pa, where higher pressures have "
                f"the same gap; lower the highest of its pressures"
            )
        solved = solved[: solved.size - max(closed.size - 1, 0)]
        g = g[: solved.size]
        low, high = np.clip(np.arange(solved.size) + np.array([[-1], [1]]), 0, solved.size - 1)
        slope = (solved[high] - solved[low]) * self.step / (g[low] - g[high])  # (1)
        return CubicHermiteSpline(-g, solved * self.step, slope)
