"""The concurrent way: an interface law that solves a cell at every point of the structure."""

from bisect import bisect_left, insort
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from multiscale.convergence import Status
from multiscale.errors import CaseError, ConvergenceError
from multiscale.laws.interface_law import NormalLaw, Response
from multiscale.micro import FlatCell

if TYPE_CHECKING:
    from multiscale.micro.gap_control import GapCell, GapState

__all__ = ["CellLaw"]

SMALLEST = 0.01
"""Mean gap, relative to the gap of first touch, below which the law goes on along its tangent."""

CLOSE = 1e-6
"""Distance of gaps, relative to the gap of first touch, up to which a cell is solved once."""


@dataclass(frozen=True, eq=False)
class CellLaw(NormalLaw):
    r"""A law without a fit: the mean pressure of one cell held at the local gap.

    Parameters
    ----------
    cell : FlatCell, without hardness
    spacing : float, optional
        Distance of the gaps at which cells are solved, m; between them the law is a cubic with
        the pressures and stiffnesses of both. A tenth of the root mean square height costs some
        thirty cells and changes pressures by up to 2 %, where nearly all is closed; a twentieth
        sixty cells and 0.5 %. Much coarser ones need not be convex. Without it a cell is solved at
        every gap that the structure asks for.

    Attributes
    ----------
    account : mapping of str to int
        ``solved``: cells solved so far; ``reused``: how often one solved before served again;
        ``linear_iterations``: conjugate-gradient iterations in all.

    Raises
    ------
    CaseError
        If the cell is not flat, has a hardness or no roughness, or the spacing is not positive.

    Notes
    -----
    With the mean gap :math:`g`, pressure :math:`\hat p` and stiffness :math:`\hat K` of a cell,

    .. math::
        p(g) &= \hat p(g_k) - \hat K(g_k)\,(g - g_k), \quad
            |g - g_k| \le 5 \cdot 10^{-7} g_{touch}, \tag{1} \\
        p(g) &= \text{cubic with } \hat p, -\hat K \text{ at } g_k \ge g \ge g_{k+1},
            \quad g_k = g_{touch} - k\,\Delta, \tag{2}

    where (2) holds with a spacing. What is kept is what a cell answered at a gap of a fixed grid,
    solved to round-off: the law is a function of the gap alone, whatever it was asked before, and
    memory only saves time. New cells start from the state at the nearest gap. The tangent is the
    derivative: exact for (2), to :math:`10^{-5}` for (1).

    Below a hundredth of the gap of first touch, where nearly all is closed, the law goes on along
    its tangent; ``pressure_range`` ends there.

    A law of one cell has the scatter of one realisation. Solve the structure with several.

    Examples
    --------
    >>> from multiscale.micro import Cell, self_affine
    >>> surface = self_affine(
    ...     (32, 32), (1e-3, 1e-3), seed=1,
    ...     hurst_exponent=0.8, long_cutoff=5e-4, short_cutoff=25e-5, rms_height=1e-6,
    ... )
    >>> law = CellLaw(Cell(surface, 1e-3, 8, 210e9, 0.3, geometry="flat"))
    >>> closing = law.stiffness(np.array([1e-6, 2e-6]))  # Pa/m
    >>> dict(law.account)["solved"]
    2
    >>> pressure = law.pressure(np.array([1e-6, 2e-6]))
    >>> dict(law.account)["solved"], bool(pressure[0] > pressure[1] > 0.0)
    (2, True)
    """

    cell: FlatCell
    spacing: float | None = None
    _held: "GapCell" = field(init=False, repr=False)
    _memory: "_Memory" = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.spacing is not None and not 0.0 < self.spacing < np.inf:
            raise CaseError(f"spacing must be a positive distance (m), got {self.spacing:g}")
        from multiscale.micro.gap_control import assemble_gap_cell

        held = assemble_gap_cell(self.cell)
        room = (1.0 - SMALLEST) * held.touch
        steps = np.ceil(room / self.spacing) if self.spacing else np.ceil((1.0 - SMALLEST) / CLOSE)
        object.__setattr__(self, "_held", held)
        object.__setattr__(self, "_memory", _Memory(held, float(room / steps), int(steps)))

    @property
    def account(self) -> Mapping[str, int]:
        """Cells solved and reused so far."""
        return MappingProxyType(self._memory.account)

    @property
    def touch(self) -> float:
        """Mean gap at first touch, m: beyond it the pressure is zero."""
        return self._held.touch

    @property
    def pressure_range(self) -> tuple[float, float]:  # type: ignore[override]
        """Pressures that cells answer, Pa; beyond, the law goes on along its tangent."""
        return 0.0, self._memory.state(self._memory.last).pressure

    def respond(self, jump: np.ndarray, state: np.ndarray) -> Response:
        """Evaluate the law and its derivative; every gap is looked up once."""
        pressure, stiffness = self._answer(jump[0])
        traction = np.zeros(jump.shape)
        traction[0] = -pressure
        tangent = np.zeros((jump.shape[0], *jump.shape))
        tangent[0, 0] = stiffness
        return Response(traction, tangent, state)

    def pressure(self, gap: np.ndarray) -> np.ndarray:
        """Pressure, Pa, at a local gap, m."""
        return self._answer(gap)[0]

    def stiffness(self, gap: np.ndarray) -> np.ndarray:
        """Minus the derivative of the pressure, Pa/m, at a local gap, m."""
        return self._answer(gap)[1]

    def gap_at(self, pressure: np.ndarray) -> np.ndarray:
        """Local gap, m, at a pressure, Pa; the gap of first touch at zero pressure.

        Newton's method on the logarithm of the pressure, which is nearly linear, in a bracket.
        """
        target = np.asarray(pressure, dtype=float)
        if not np.all((target >= 0.0) & np.isfinite(target)):
            raise ValueError("a pressure must be finite and not negative (Pa)")
        flat = [self._invert(float(p)) for p in target.ravel()]
        return np.array(flat).reshape(target.shape)

    def _invert(self, target: float) -> float:
        if target == 0.0:
            return self.touch
        low, high = SMALLEST * self.touch, self.touch
        p, K = (float(value) for value in self._answer(np.array(low)))
        if target >= p:
            return low - (target - p) / K
        gap = low
        for _ in range(200):
            step = (np.log(p / target)) * p / K if p > 0.0 and K > 0.0 else np.inf
            if abs(p - target) <= 1e-12 * target or high - low <= 1e-15 * self.touch:
                return gap
            low, high = (gap, high) if p > target else (low, gap)
            gap = gap + step if low < gap + step < high else 0.5 * (low + high)
            p, K = (float(value) for value in self._answer(np.array(gap)))
        raise ConvergenceError(
            f"the law of a cell was not inverted at {target:.3g} Pa (last {p:.3g} Pa)"
        )

    def _answer(self, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pressure, Pa, and stiffness, Pa/m, at local gaps, m; NaN where the gap is."""
        memory = self._memory
        g = np.asarray(gap, dtype=float)
        place = np.clip((self.touch - g) / memory.step, 0.0, memory.last)
        inside = place > 0.0  # false for NaN
        place = np.where(inside, place, 0.0)
        whole = np.rint(place) if self.spacing is None else np.floor(place)
        k = np.minimum(whole, memory.last).astype(int)
        p, K, offset = (np.zeros(g.shape) for _ in range(3))
        offset[inside] = g[inside] - memory.gap_of(k[inside])
        p[inside], K[inside] = memory.look_up(k[inside])
        if self.spacing is None:
            p = p - K * offset  # (1)
        else:
            p, K = self._between(k, p, K, offset, inside)
        missing = np.isnan(g)
        return np.where(missing, np.nan, p), np.where(missing, np.nan, K)

    def _between(
        self, k: np.ndarray, p: np.ndarray, K: np.ndarray, offset: np.ndarray, inside: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate (2) and its derivative; beyond the last gap the tangent."""
        memory, h = self._memory, self._memory.step
        cubic = inside & (k < memory.last)
        p2, K2 = p.copy(), K.copy()
        p2[cubic], K2[cubic] = memory.look_up(k[cubic] + 1)
        s = np.where(cubic, -offset / h, 0.0)  # 0 at g_k, 1 at g_(k+1)
        d1, d2 = h * K, h * K2  # derivatives with respect to s
        value = p + s * (d1 + s * (3.0 * (p2 - p) - 2.0 * d1 - d2 + s * (2.0 * (p - p2) + d1 + d2)))
        slope = d1 + s * (
            2.0 * (3.0 * (p2 - p) - 2.0 * d1 - d2) + 3.0 * s * (2.0 * (p - p2) + d1 + d2)
        )
        return np.where(cubic, value, p - K * offset), np.where(cubic, slope / h, K)


@dataclass(eq=False)
class _Memory:
    """States of a cell at gaps ``touch - k step``, k from 0 to ``last``, solved when asked for."""

    cell: "GapCell"
    step: float
    last: int
    states: dict[int, "GapState"] = field(default_factory=dict)
    known: list[int] = field(default_factory=list)  # keys of the states, sorted
    account: dict[str, int] = field(
        default_factory=lambda: {"solved": 0, "reused": 0, "linear_iterations": 0}
    )

    def gap_of(self, k: np.ndarray) -> np.ndarray:
        """Gap, m, of numbers of the grid."""
        return np.asarray(self.cell.touch - k * self.step)

    def look_up(self, k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pressure and stiffness at numbers of the grid, shape (points,)."""
        numbers, place = np.unique(k, return_inverse=True)
        before = self.account["solved"]
        found = [self.state(int(one)) for one in numbers]
        self.account["reused"] += k.size - (self.account["solved"] - before)
        p = np.array([state.pressure for state in found])
        K = np.array([state.stiffness for state in found])
        return p[place], K[place]

    def state(self, k: int) -> "GapState":
        """State at one number of the grid, from memory or from a cell."""
        if k in self.states:
            return self.states[k]
        gap = float(self.gap_of(np.array(k)))
        at = bisect_left(self.known, k)
        near = self.known[max(0, at - 1) : at + 1]
        start = self.states[min(near, key=lambda one: abs(one - k))] if near else None
        found = self.cell.solve(gap, start)
        if found.status is not Status.CONVERGED:
            raise ConvergenceError(
                f"the cell of a law did not converge at a mean gap of {gap:.4g} m, "
                f"{gap / self.cell.touch:.2g} of that at first touch: {found.status.value}"
            )
        self.account["solved"] += 1
        self.account["linear_iterations"] += found.iterations
        self.states[k] = found
        insort(self.known, k)
        return found
