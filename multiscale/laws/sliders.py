"""Bed of springs and sliders on a normal law: tangential stiffness, micro-slip and friction."""

from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from multiscale.errors import CaseError, ConvergenceError, require
from multiscale.laws.interface_law import (
    GapLaw,
    InterfaceLaw,
    NormalLaw,
    Response,
    Sliding,
    check_parameters,
)

STICKING_SLIP = 1e-3
"""Slip in a step up to which a slab counts as sticking, relative to its elastic displacement at
the friction limit."""

LEAST = 1e-9  # least pressure of sticking contacts relative to the pressure, where all would slip
CURVE_SAMPLES = 2000  # number of pressures at which the elastic curve is sampled to find the edges
DIFFERENCE_STEP = 1e-5  # step of central differences by the gap, relative to the decay length
LAST_EDGE = 1e300  # gap of the last edge, m: the last slab is unbounded


class SliderBed(InterfaceLaw):
    """Law of the gap below a bed of tangential springs, each with a Coulomb slider."""

    friction: float

    @property
    @abstractmethod
    def _layout(self) -> tuple[int, int, float]:
        """Rows of the normal history, number of springs, tangential over normal stiffness."""

    @abstractmethod
    def _press(self, jump: np.ndarray, history: np.ndarray) -> tuple[Response, np.ndarray]:
        """Return the normal response, and the springs at the end of the step (``end`` of slabs)."""

    @abstractmethod
    def _springs(self, jump: np.ndarray, history: np.ndarray) -> np.ndarray:
        """Return the springs at a committed normal jump (``start`` of slabs)."""

    @abstractmethod
    def _resolve_normal(self, source: np.ndarray, k: np.ndarray, history: np.ndarray) -> np.ndarray:
        """Return the jump on a search direction without friction."""

    @property
    def _edges(self) -> np.ndarray:
        """Upper edges of slabs; none for springs without a common curve."""
        return np.zeros((3, 0))

    def _slope(
        self, jump: np.ndarray, history: np.ndarray, start: np.ndarray, end: np.ndarray
    ) -> np.ndarray:
        """Return ``slope`` of :func:`respond_slabs`; empty for springs without a common curve."""
        return np.zeros((3, 0))

    @property
    def n_state(self) -> int:  # type: ignore[override]
        """Number of rows of the state."""
        rows, springs, _ = self._layout
        return rows + 3 * springs + 3

    def at_rest(self, jump: np.ndarray) -> np.ndarray:
        """Return the state of an interface pressed to a jump, m, without shear."""
        state = np.zeros((self.n_state, *jump.shape[1:]))
        rows = self._layout[0]
        state[:rows] = self._press(jump, state[:rows])[0].state
        state[-3:] = jump
        return state

    def unsheared(self, state: np.ndarray) -> np.ndarray:
        """Return the state with the same pressure and no force in the sliders."""
        rows = self._layout[0]
        return np.concatenate([state[:rows], np.zeros_like(state[rows:-3]), state[-3:]])

    def from_here(self, state: np.ndarray) -> np.ndarray:
        """Return the state with a last tangential jump of zero."""
        return np.concatenate([state[:-2], np.zeros((2, *state.shape[1:]))])

    def friction_limit(self, pressure: np.ndarray) -> np.ndarray:
        """Return Coulomb's limit, Pa, at a pressure, Pa."""
        return self.friction * pressure

    def respond(self, jump: np.ndarray, state: np.ndarray) -> Response:
        """Evaluate the law with its consistent tangent."""
        return self._step(jump, state)[0]

    def sliding(self, jump: np.ndarray, state: np.ndarray) -> Sliding:
        """Return slip and energy of a step; see :class:`InterfaceLaw`."""
        if not self.friction:
            return super().sliding(jump, state)
        response, (work, before, after, slipping) = self._step(jump, state)
        return Sliding(slipping, work - (after - before), after, response.state)

    def _step(self, jump: np.ndarray, state: np.ndarray) -> tuple[Response, np.ndarray]:
        """Return response, and work, stored energy before and after, and slipping share."""
        from multiscale.laws.slabs import respond_slabs

        (rows, springs, kappa), shape = self._layout, jump.shape[1:]
        history = state[:rows]
        normal, end = self._press(jump, history)
        if not self.friction:  # no springs
            new = np.concatenate([normal.state, np.zeros((3 * springs, *shape)), jump])
            return replace(normal, state=new), np.zeros((4, *shape))
        start = self._springs(state[-3], history)
        shear, slopes, bed, account = respond_slabs(
            _flat(jump),
            _flat(state[rows:]),
            start,
            end,
            self._slope(_flat(jump), _flat(history), start, end),
            self._edges,
            self.friction,
            kappa,
            STICKING_SLIP,
        )
        traction, tangent = normal.traction.copy(), normal.tangent.copy()
        traction[1:] = shear.reshape(2, *shape)
        tangent[1:] = slopes.reshape(2, 3, *shape)
        new = np.concatenate([normal.state, bed.reshape(len(bed), *shape)])
        return Response(traction, tangent, new), account.reshape(4, *shape)

    def resolvent(
        self, source: np.ndarray, stiffness: float | np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Solve the normal row, which is independent of friction, then the tangential rows."""
        from multiscale.laws.slabs import resolve

        rows, _, kappa = self._layout
        history, k = state[:rows], np.full(source.shape, stiffness, dtype=float)
        jump = self._resolve_normal(source, k, history)
        if not self.friction:
            return jump
        tangential, failed = resolve(
            _flat(source),
            _flat(k),
            _flat(state[rows:]),
            self._springs(state[-3], history),
            self._press(jump, history)[1],
            self._edges,
            self.friction,
            kappa,
        )
        if np.any(failed):
            raise ConvergenceError(
                f"no tangential jump solves the resolvent of {type(self).__name__} at "
                f"{np.sum(failed)} of {failed.size} points; check that the source is finite (Pa)"
            )
        jump[1:] = tangential.reshape(2, *jump.shape[1:])
        return jump


@dataclass(frozen=True, eq=False)
class Sliders(SliderBed):
    r"""Frictional law: a normal law as a bed of springs, each with a Coulomb slider.

    Parameters
    ----------
    normal : GapLaw, law of the pressure p and normal stiffness K at a gap
    friction : float, friction coefficient :math:`\mu \ge 0`, dimensionless
    stiffness_ratio : float
        Tangential over normal stiffness, :math:`\kappa > 0`; :math:`2(1-\nu)/(2-\nu)` for contact
        spots far apart; dimensionless.
    pressures : tuple of float, optional
        Range of pressures in which the bed is finely divided, Pa; the data of the normal law if not
        given. Outside, the balance of energy holds, but the bed is coarse.
    slabs : int
        Number M of slabs. With 16, 24, 32 and 48 slabs over two decades of pressure the errors at
        constant pressure are at most 3.3, 1.8, 1.1 and 0.6 % of :math:`\mu p`, over four decades
        6.1, 3.3, 2.0 and 1.1 %, and the dissipation in cycles of amplitude
        :math:`a = \mu p / (\kappa K)` is too large by at most 14, 7, 5 and 2 %, of 2a by 4, 2, 1.2
        and .6 %; of a/2 by 9 % with 48 slabs, and it is zero if no slab slips.

    Notes
    -----
    A convex decreasing law is a bed of springs of heights s with the density :math:`p''(s)`,
    :math:`p(g) = \int p''(s) \langle s - g\rangle_+ \mathrm{d}s`. Each has a tangential spring
    :math:`\kappa p''(s)` and a slider with the limit :math:`\mu` times its normal force. At
    constant pressure the first loading is :math:`t = \mu [p(g) - p(g + \kappa u / \mu)]` [1]_, and
    reversals follow Masing's rule. Without friction there are no tangential springs.

    Edges :math:`b_0 = -\infty < b_1 < \dots < b_M = \infty` divide the heights into slabs. With
    :math:`h = \max(g, b_{i-1})` the load and stiffness of a slab in contact, :math:`g < b_i`, are

    .. math::
        w_i = K(h) - K(b_i), \quad
        N_i = p(h) - p(b_i) - K(b_i)(b_i - h) + w_i (h - g),    \tag{a}

    with the sums K and p at every gap: initial stiffness and full slip are exact for any M. The
    state is the force of every slab over :math:`\kappa`, :math:`A_i`, two components; the
    stiffness of the springs that carry it, :math:`l_i`; and the last jump. It is zero before the
    first loading. In a step from :math:`g_0` to :math:`g_1` with a change :math:`d` of the
    tangential jump,

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
    :math:`t \cdot d \ge E - E_0`: no path gains energy. The normal traction does not depend on the
    tangential jump.

    The edges are at equal increments of :math:`\int \sqrt{p''/p}\, \mathrm{d}g`, so that every slab
    carries about the same share of the pressure at its lower edge. For plastic contact
    (:class:`HystereticLaw`) the bed belongs to the unloading branch at the largest pressure so far,
    and its shares (a) grow with this pressure; shear during plastic flow has not been validated.

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

    normal: GapLaw
    friction: float
    stiffness_ratio: float = 0.8
    pressures: tuple[float, float] | None = None
    slabs: int = 48

    def __post_init__(self) -> None:
        check_parameters(self, lowest=0.0, friction="1")
        check_parameters(self, stiffness_ratio="1")
        if not isinstance(self.normal, GapLaw):
            raise CaseError(
                f"sliders need a law of the gap only, got the type "
                f"{type(self.normal).__name__}; give a NormalLaw or a HystereticLaw"
            )
        low, high = self._pressures
        if not 0.0 < low < high < np.inf:
            raise CaseError(
                f"sliders need a lowest and a highest pressure (Pa), positive and finite, got "
                f"{low:g} and {high:g}; give pressures=(low, high) that the joint will carry"
            )
        require("slabs", self.slabs, "[1, inf)", integer=True)

    @property
    def _layout(self) -> tuple[int, int, float]:
        return self.normal.n_state, self.slabs, self.stiffness_ratio

    @property
    def normal_law(self) -> GapLaw:
        """Law of the gap only."""
        return self.normal

    def shaken_down(self) -> "Sliders":
        """Return the bed on the curve of unloading; see :class:`InterfaceLaw`."""
        return replace(self, normal=self.normal.shaken_down())  # type: ignore[arg-type]  # same kind

    def _press(self, jump: np.ndarray, history: np.ndarray) -> tuple[Response, np.ndarray]:
        response = self.normal.respond(jump, history)
        end = self._springs(jump[0], response.state) if self.friction else np.zeros((5, 1, 0))
        return response, end

    def _resolve_normal(self, source: np.ndarray, k: np.ndarray, history: np.ndarray) -> np.ndarray:
        return self.normal.resolvent(source, k, history)

    def slipping_load(self, jump: np.ndarray, state: np.ndarray) -> np.ndarray:
        r"""Share of the pressure of slipping springs; see :class:`InterfaceLaw`.

        Springs shorter than :math:`g' = g + \kappa u / \mu` slip, which carry
        :math:`p(g) - p(g') - K(g') (g' - g)`, with :math:`p(g') = p - |t| / \mu`.
        Unlike the slabs that slip in a step, it is continuous.
        """
        if not self.friction:
            return super().slipping_load(jump, state)
        shear = np.linalg.norm(self.respond(jump, state).traction[1:], axis=0).reshape(-1)
        gap, p, _, force, _ = self._springs(jump[0], state[: self.normal.n_state])
        carried = np.maximum(
            p - shear / (self.friction * np.where(force > 0.0, force, 1.0)), LEAST * p
        )
        closed = carried > 0.0
        edge = self._curve.gap_at(np.where(closed, carried, 1.0))
        stuck = carried + self._curve.stiffness(edge) * np.maximum(edge - gap, 0.0)
        share = 1.0 - stuck / np.where(closed, p, 1.0)
        return np.asarray(np.where(closed, np.maximum(share, 0.0), 1.0).reshape(jump.shape[1:]))

    @property
    def _pressures(self) -> tuple[float, float]:
        """Pressures between which the bed is finely divided, Pa."""
        return self.normal.pressure_range if self.pressures is None else self.pressures

    @cached_property
    def _edges(self) -> np.ndarray:
        """Gap, pressure and stiffness at the upper edges on the elastic curve, shape (3, slabs)."""
        curve, low, high = self.normal.elastic_curve(*self._pressures)
        p = np.geomspace(high, 1e-4 * low, CURVE_SAMPLES)
        b = curve.gap_at(p)
        K = curve.stiffness(b)
        bend = np.maximum(np.diff(K) * np.diff(-b), 0.0)  # p'' dg^2
        s = np.append(0.0, np.cumsum(np.sqrt(bend / (0.5 * (p[1:] + p[:-1])))))
        # at the lowest pressure the last slab carries the share 1 - (1 + x) e^-x, as any other slab
        # does under an exponential law of decay length db / x
        x = s / max(self.slabs - 2, 1)
        last = p + K * np.maximum(b - curve.gap_at(np.array(low)), 0.0)
        end = np.flatnonzero(np.append(last <= (1.0 - (1.0 + x) * np.exp(-x)) * low, True))[0]
        at = np.linspace(0.0, s[min(end, CURVE_SAMPLES - 1)], self.slabs - 1)
        gap = np.interp(at, s, b)
        edges = np.zeros((3, self.slabs))
        edges[:, :-1] = gap, curve.pressure(gap), curve.stiffness(gap)
        edges[0, -1] = LAST_EDGE
        return edges

    @cached_property
    def _curve(self) -> NormalLaw:
        return self.normal.elastic_curve(*self._pressures)[0]

    def _springs(self, jump: np.ndarray, history: np.ndarray) -> np.ndarray:
        """Return gap, pressure, stiffness on the elastic curve, and its scales, (5, 1, points)."""
        gap, force, length = self.normal.on_curve(jump + self.normal.gap, history)
        place = np.empty((5, *jump.shape))
        place[:3] = gap, self._curve.pressure(gap), self._curve.stiffness(gap)
        place[3], place[4] = force, length
        return place.reshape(5, 1, -1)

    @np.errstate(invalid="ignore")  # a trial jump may be where the law has no numbers
    def _slope(
        self, jump: np.ndarray, history: np.ndarray, start: np.ndarray, end: np.ndarray
    ) -> np.ndarray:
        """Return ``slope`` of :func:`respond_slabs` by central differences."""
        gap, p, K, force, length = end[:, 0]
        slope, flows = np.zeros((3, gap.size)), force != start[3, 0]
        decay = np.where(K > 0.0, p / np.where(K > 0.0, K, 1.0), 1e-9)
        step = np.maximum(DIFFERENCE_STEP * decay, 1e-9 * np.abs(gap))
        bend = self._curve.stiffness(gap + step) - self._curve.stiffness(gap - step)
        still = flows | (step == 0.0)  # at first contact, where the pressure is zero
        curve = force / length**2 * bend / np.where(still, 1.0, 2.0 * step)
        slope[0] = np.where(still, 0.0, curve)
        if np.any(flows):
            step, sides = DIFFERENCE_STEP * length[flows], []
            for sign in (1.0, -1.0):
                moved, before = jump[:, flows], history[:, flows]
                moved[0] += sign * step
                now = self.normal.respond(moved, before).state
                _, F, L = self.normal.on_curve(moved[0] + self.normal.gap, now)
                sides.append(np.stack([np.log(F), np.log(F / L)]))
            slope[1:, flows] = (sides[0] - sides[1]) / (2.0 * step)
        return slope


def _flat(value: np.ndarray) -> np.ndarray:
    points = int(np.prod(value.shape[1:]))
    return np.ascontiguousarray(value, dtype=float).reshape(value.shape[0], points)
