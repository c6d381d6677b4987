"""A normal law with a bed of sliders under it: tangential stiffness, micro-slip and friction."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from multiscale.errors import CaseError, ConvergenceError
from multiscale.laws.interface_law import InterfaceLaw, NormalLaw, Response, Sliding
from multiscale.laws.parameters import check_parameter
from multiscale.laws.unloading import HystereticLaw

__all__ = ["Sliders"]

CREEP = 1e-3
"""Slip in a step up to which a slab counts as sticking, relative to its elastic displacement at
the friction limit."""

FINE = 2000
"""Pressures at which the elastic curve is sampled to find the edges."""

FINEST = 1e-5
"""Distance of gaps, relative to the decay length, for derivatives."""

NOWHERE = 1e300
"""Gap of the last edge, m: the last slab has none."""


@dataclass(frozen=True, eq=False)
class Sliders(InterfaceLaw):
    r"""A normal law that resists sliding: a bed of springs, each with a slider of Coulomb.

    Parameters
    ----------
    normal : NormalLaw or HystereticLaw
        Gives pressure p and normal stiffness K of a gap.
    friction : float
        Coefficient :math:`\mu \ge 0`.
    stiffness_ratio : float
        Tangential over normal stiffness, :math:`\kappa > 0`; :math:`2(1-\nu)/(2-\nu)` for spots
        that are far apart.
    pressures : tuple of float, optional
        Lowest and highest pressure between which the bed is fine, Pa; the data of the normal law
        if not given. Beyond them the law is as safe, but coarse.
    slabs : int
        Number M of slabs. At constant pressure 16, 24, 32 and 48 err by at most 3.3, 1.8, 1.1 and
        0.6 % of :math:`\mu p` over two decades of pressure, 6.1, 3.3, 2.0 and 1.1 % over four, and
        the root mean square is a fifth. Cycles of the amplitude :math:`a = \mu p / (\kappa K)`
        over two decades lose 14, 7, 5 and 2 % too much at most, of 2a 4, 2, 1.2 and .6 %; of a/2
        still 9 % with 48 slabs, and nothing where no slab slips.

    Raises
    ------
    CaseError
        If a parameter is outside its range, the normal law is of another kind, such as
        :class:`RigidContact`, or it has no data and there are no pressures.

    Notes
    -----
    A convex decreasing law is a bed of springs of heights s with the density :math:`p''(s)`,
    :math:`p(g) = \int p''(s) \langle s - g\rangle_+ \mathrm{d}s`. Each has a tangential spring
    :math:`\kappa p''(s)` and a slider that holds :math:`\mu` times its normal force. At constant
    pressure the first loading is :math:`t = \mu [p(g) - p(g + \kappa u / \mu)]` [1]_, and
    reversals follow Masing's rule.

    Edges :math:`b_0 = -\infty < b_1 < \dots < b_M = \infty` cut the heights into slabs. With
    :math:`h = \max(g, b_{i-1})` a slab that :math:`g < b_i` touches has the load and stiffness

    .. math::
        w_i = K(h) - K(b_i), \quad
        N_i = p(h) - p(b_i) - K(b_i)(b_i - h) + w_i (h - g),    \tag{a}

    whose sums are K and p at every gap: initial stiffness and full slip are exact for any M. The
    state is the force of every slab over :math:`\kappa`, :math:`A_i`, two components; the
    stiffness of its springs that carry it, :math:`l_i`; and the last jump. Zero is virgin. In a
    step from :math:`g_0` to :math:`g_1` with a change :math:`d` of the tangential jump,

    .. math::
        B &= \min(1, w_1/l_0) A_0, \qquad
        m = \begin{cases} w_1 & g_1 \ge g_0 \\
            (N_1 - N_0)/(g_0 - g_1) & \text{else, mean of } w \end{cases}    \tag{b} \\
        A^* &= B + m d, \quad A = \min(1, \mu N_1/(\kappa |A^*|)) A^*, \quad
            t = \kappa \textstyle\sum A,    \tag{c} \\
        l &= \begin{cases} w_1 & \text{slipping} \\
            |A|^2 / (|B|^2/l_m + 2 B \cdot d + m |d|^2) & \text{else, from } l_m \text{ to } w_1
            \end{cases}, \quad l_m = \min(l_0, w_1).    \tag{d}

    With the stored energy :math:`E = \tfrac{\kappa}{2} \sum |A|^2 / l` every step of any size has
    :math:`t \cdot d \ge E - E_0`: no path gains energy. The normal row does not feel the tangents.

    The edges are at equal increments of :math:`\int \sqrt{p''/p}\, \mathrm{d}g`, so that every slab
    carries about the same share of the pressure at its lower edge.

    Where the normal law flows (:class:`HystereticLaw`) the bed is the one of the unloading branch
    at the largest pressure so far, whose shares (a) grow with it. The balance of energy and the
    answer at a constant largest pressure are tested; how a metal that flows carries shear while
    its largest pressure grows was not compared with anything.

    References
    ----------
    .. [1] M. Ciavarella, Int. J. Solids Struct. 35 (1998) 2349-2362, and J. Jäger, Arch. Appl.
       Mech. 65 (1995) 478-487, for smooth bodies.
    .. [2] W. D. Iwan, J. Appl. Mech. 33 (1966) 893-900: beds of springs and sliders.

    Examples
    --------
    >>> from multiscale.laws import Exponential
    >>> law = Sliders(Exponential(1e9, 1e-6), 0.3, pressures=(1e6, 1e8))
    >>> gap = law.normal.gap_at(np.array([1e7, 1e7]))
    >>> jump = np.stack([gap, [1e-9, 1e-4], [0.0, 0.0]])  # m: a little shear, and full slip
    >>> law.respond(jump, law.at_rest(np.stack([gap, 0.0 * gap, 0.0 * gap]))).traction[1].round(-1)
    array([   8000., 3000000.])
    """

    normal: NormalLaw | HystereticLaw
    friction: float
    stiffness_ratio: float = 0.8
    pressures: tuple[float, float] | None = None
    slabs: int = 48

    def __post_init__(self) -> None:
        check_parameter(self, "friction", lowest=0.0)
        check_parameter(self, "stiffness_ratio")
        if not isinstance(self.normal, NormalLaw | HystereticLaw):
            raise CaseError(
                f"sliders stand on a law of the gap alone, got one of type "
                f"{type(self.normal).__name__}; give a NormalLaw or a HystereticLaw"
            )
        low, high = self._pressures
        if not 0.0 < low < high < np.inf:
            raise CaseError(
                f"sliders need a lowest and a highest pressure (Pa), positive and finite, got "
                f"{low:g} and {high:g}; give pressures=(low, high) that the joint will carry"
            )
        if self.slabs < 1:
            raise CaseError(f"a bed of sliders needs one slab or more, got {self.slabs}")

    @property
    def n_state(self) -> int:  # type: ignore[override]
        """Rows of the state: those of the normal law, A, l and the last jump."""
        return self.normal.n_state + 3 * self.slabs + 3

    @property
    def normal_law(self) -> NormalLaw | HystereticLaw:
        """The law of the gap."""
        return self.normal

    def at_rest(self, jump: np.ndarray) -> np.ndarray:
        """State of an interface that was pressed to a jump and carries no shear."""
        state = np.zeros((self.n_state, *jump.shape[1:]))
        own = self.normal.n_state
        state[:own] = self.normal.respond(jump, state[:own]).state
        state[-3:] = jump
        return state

    def friction_limit(self, pressure: np.ndarray) -> np.ndarray:
        """Coulomb's limit, Pa, at a pressure, Pa."""
        return self.friction * pressure

    def respond(self, jump: np.ndarray, state: np.ndarray) -> Response:
        """Evaluate (a) to (d) with their consistent tangent."""
        return self._step(jump, state)[0]

    def sliding(self, jump: np.ndarray, state: np.ndarray) -> Sliding:
        """Slip and energy of a step; see :class:`InterfaceLaw`."""
        work, before, after, slipping = self._step(jump, state)[1]
        return Sliding(slipping, work - (after - before), after)

    def _step(self, jump: np.ndarray, state: np.ndarray) -> tuple[Response, np.ndarray]:
        """Response, and work, stored energy before and after, and share of the load that slips."""
        from multiscale.laws.slabs import respond_slabs

        own = self.normal.n_state
        response = self.normal.respond(jump, state[:own])
        start, end = self._place(state[-3], state[:own]), self._place(jump[0], response.state)
        shear, tangent, bed, account = respond_slabs(
            _flat(jump),
            _flat(state[own:]),
            start,
            end,
            self._slope(_flat(jump), _flat(state[:own]), start, end),
            self._edges,
            self.friction,
            self.stiffness_ratio,
            CREEP,
        )
        shape = jump.shape[1:]
        traction, whole = response.traction.copy(), response.tangent.copy()
        traction[1:] = shear.reshape(2, *shape)
        whole[1:] = tangent.reshape(2, 3, *shape)
        new = np.concatenate([response.state, bed.reshape(len(bed), *shape)])
        return Response(traction, whole, new), account.reshape(4, *shape)

    def resolvent(
        self, source: np.ndarray, stiffness: float | np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Find the jump on the law and on a search direction; see :class:`InterfaceLaw`.

        The normal row does not feel the tangents. With the gap known, (c) and the direction are
        the gradient of a strictly convex function of the tangential jump, which has one root.
        """
        from multiscale.laws.slabs import resolve

        own, k = self.normal.n_state, np.broadcast_to(stiffness, source.shape)
        jump = self.normal.resolvent(source, k, state[:own])
        now = self.normal.respond(jump, state[:own]).state
        found, failed = resolve(
            _flat(source),
            _flat(k),
            _flat(state[own:]),
            self._place(state[-3], state[:own]),
            self._place(jump[0], now),
            self._edges,
            self.friction,
            self.stiffness_ratio,
        )
        if np.any(failed):
            raise ConvergenceError(
                f"the resolvent of Sliders found no tangential jump at {np.sum(failed)} of "
                f"{failed.size} points; check that the source is finite (Pa)"
            )
        jump[1:] = found.reshape(2, *jump.shape[1:])
        return jump

    @property
    def _pressures(self) -> tuple[float, float]:
        """Pressures between which the bed is fine, Pa."""
        return self.normal.pressure_range if self.pressures is None else self.pressures

    @cached_property
    def _edges(self) -> np.ndarray:
        """Gap, pressure and stiffness at the upper edges on the elastic curve, (3, slabs)."""
        curve, low, high = self.normal.elastic_curve(*self._pressures)
        p = np.geomspace(high, 1e-4 * low, FINE)
        b = curve.gap_at(p)
        K = curve.stiffness(b)
        bend = np.maximum(np.diff(K) * np.diff(-b), 0.0)  # p'' dg^2
        s = np.append(0.0, np.cumsum(np.sqrt(bend / (0.5 * (p[1:] + p[:-1])))))
        # the last slab carries at the lowest pressure the share 1 - (1 + x) e^-x that each of the
        # others carries under an exponential law of decay length db / x
        x = s / max(self.slabs - 2, 1)
        last = p + K * np.maximum(b - curve.gap_at(np.array(low)), 0.0)
        end = np.flatnonzero(np.append(last <= (1.0 - (1.0 + x) * np.exp(-x)) * low, True))[0]
        at = np.linspace(0.0, s[min(end, FINE - 1)], self.slabs - 1)
        gap = np.interp(at, s, b)
        edges = np.zeros((3, self.slabs))
        edges[:, :-1] = gap, curve.pressure(gap), curve.stiffness(gap)
        edges[0, -1] = NOWHERE
        return edges

    @cached_property
    def _curve(self) -> NormalLaw:
        """The elastic curve."""
        return self.normal.elastic_curve(*self._pressures)[0]

    def _place(self, jump: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Gap, pressure, stiffness on the elastic curve, and its scales, shape (5, points)."""
        gap, force, length = self.normal.on_curve(jump + self.normal.gap, state)
        place = [gap, self._curve.pressure(gap), self._curve.stiffness(gap), force, length]
        return np.stack([np.broadcast_to(row, jump.shape).reshape(-1) for row in place])

    def _slope(
        self, jump: np.ndarray, state: np.ndarray, start: np.ndarray, end: np.ndarray
    ) -> np.ndarray:
        """Differentiate with the gap what :func:`respond_slabs` asks for, centrally."""
        gap, p, K, force, length = end
        slope, flows = np.zeros((3, gap.size)), force != start[3]
        decay = np.where(K > 0.0, p / np.where(K > 0.0, K, 1.0), 1e-9)
        step = np.maximum(FINEST * decay, 1e-9 * np.abs(gap))
        bend = self._curve.stiffness(gap + step) - self._curve.stiffness(gap - step)
        slope[0] = np.where(flows, 0.0, force / length**2 * bend / (2.0 * step))
        if np.any(flows):
            step, sides = FINEST * length[flows], []
            for sign in (1.0, -1.0):
                moved, before = jump[:, flows], state[:, flows]
                moved[0] += sign * step
                now = self.normal.respond(moved, before).state
                _, F, L = self.normal.on_curve(moved[0] + self.normal.gap, now)
                sides.append(np.stack([np.log(F), np.log(F / L)]))
            slope[1:, flows] = (sides[0] - sides[1]) / (2.0 * step)
        return slope


def _flat(value: np.ndarray) -> np.ndarray:
    """All points in one axis."""
    points = int(np.prod(value.shape[1:]))
    return np.ascontiguousarray(value, dtype=float).reshape(value.shape[0], points)
