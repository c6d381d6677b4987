"""Time stepping of structures with slack and impacts, eqs (6), (8), (9) and (11) of the source."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_array, diags_array

from multiscale.convergence import Solution, Status
from multiscale.errors import CaseError, require
from multiscale.macro.links.link_equations import LinkEquations, equations
from multiscale.macro.links.link_system import LinkSystem, link_dataset
from multiscale.nonsmooth import solve_lcp
from multiscale.numerics.compiled import compiled
from multiscale.numerics.factorisation import Solve
from multiscale.numerics.newton import Limits, NewtonRun, step_length
from multiscale.schema import Dataset

EXCHANGED = ("work", "numerical_dissipation", "link_dissipation", "smallest_link_dissipation")
"""Energies of each step; all but the last are summed over the steps."""

START_TOLERANCE = 1e-9
"""Allowed elongation of an inextensible link at the start, relative to its length."""

MAX_ITERATIONS = 50

TOLERANCE = 1e-12
"""Bound on the residual momentum, relative to the largest; raised to the rounding error."""

UNDERFLOW_LIMIT = float(np.sqrt(np.finfo(float).tiny))
"""Momentum, N s, or rate, m/s, below which the energy of a motion underflows."""


def simulate(
    system: LinkSystem,
    times: np.ndarray,
    mass: np.ndarray | float,
    *,
    load_factor: Callable[[float], float] = lambda time: 1.0,
    support_motion: Callable[[float], np.ndarray] | None = None,
    start: tuple[np.ndarray, np.ndarray] | None = None,
    theta: float = 1.0,
    restitution: float = 0.0,
) -> Dataset:
    r"""Compute the motion of a structure of bars, cables and struts.

    Parameters
    ----------
    system : LinkSystem, the structure; links of infinite rigidity are inextensible cables or struts
    times : ndarray, shape (steps + 1,)
        Increasing times, s. The first belongs to the initial state.
    mass : ndarray, shape (nodes,), or float
        Mass of each node, kg; with beams in (nodes, 6), the last three in kg m2.
    load_factor : callable, factor :math:`\alpha(t)` of the loads of the system, dimensionless
    support_motion : callable, optional
        Displacement of the nodes at a time, shape (nodes, c), m; used at fixed components.
    start : tuple of ndarray, shape (nodes, c), optional
        Displacement, m, and velocity, m/s, at the first time; at rest in the prestressed
        configuration if not given.
    theta : float, from 1/2 (second order, no numerical damping) to 1 (fully implicit)
    restitution : float
        Coefficient of restitution of inextensible links that become taut, from 0 to 1.

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``, a step for each time; ``tension`` of inextensible links is
        the mean over the step. A step that fails is NaN with ``converged`` 0 and ends the motion;
        the attribute ``failure`` states the reason.

    Notes
    -----
    A step of size h from :math:`(u^-, v^-)` solves

    .. math::
        M (v^+ - v^-) + h B^T \bar\tau + B_r^T \pi = h F_\theta, \qquad
        u^+ = u^- + h (\theta v^+ + (1 - \theta) v^-),    \tag{1}

    with :math:`x_\theta = \theta x^+ + (1 - \theta) x^-`, (9) of the source for
    :math:`\theta = 1`. The tension :math:`\bar\tau` of the extensible links gains no energy,
    in steps of any size with any slack links; :math:`\theta = 1/2` conserves it.
    Inextensible links carry impulses :math:`\pi`, (11) of the source,

    .. math::
        0 \le \pi \perp -e^+ \ge 0,    \tag{2}

    so that the distance of their ends is at most their length. With a coefficient of
    restitution :math:`\rho > 0`, links that would be taut in the middle of the step obey instead
    of (2), with the rates :math:`\eta` of their elongations,

    .. math::
        0 \le \pi \perp \max(-\rho\, \eta^-, -\eta^-) - \eta^+ \ge 0, \qquad
        u^+ = u^- + h \bigl( \theta v^+ + (1 - \theta) v^-
        + (\theta - \tfrac12) M^{-1} B_r^T \pi \bigr).    \tag{3}

    The impulses of (3) act in the middle of the step, so that they do the work
    :math:`-\tfrac12 \pi (\eta^+ + \eta^-) \le 0` for every theta; the impulses of (2) do the
    work :math:`-\pi\, \Delta e / h \le 0`. No step of any size gains energy.

    References
    ----------
    .. [1] M. Jean, Comput. Methods Appl. Mech. Eng. 177 (1999) 235-257,
       doi:10.1016/S0045-7825(98)00383-1.
    """
    times = np.asarray(times, dtype=float)
    if times.ndim != 1 or times.size < 2 or not np.all(np.diff(times) > 0.0):
        raise CaseError(f"times must rise and be at least two (s), got {times[:5]}")
    require("theta", theta, "[0.5, 1]")
    require("restitution", restitution, "[0, 1]")
    model = equations(system)
    masses = _nodal_masses(model, mass)
    rigid_bar = np.isinf(model.stiffness) & np.isinf(model.lower) & np.isinf(model.upper)
    if rigid_bar.any():
        raise CaseError(
            f"link {int(np.argmax(rigid_bar))} is an inextensible bar; only cables and struts can "
            f"have an infinite rigidity here"
        )
    scheme = _Scheme(
        system,
        model,
        equations(replace(system, fixed=~np.asarray(system.fixed), balanced=False)),
        masses,
        theta,
        restitution,
        load_factor,
        support_motion,
    )
    state = scheme.begin(float(times[0]), start)

    failure: dict[str, str] = {}
    rows = [scheme.report(state, 0.0, 0.0) | dict.fromkeys(EXCHANGED, 0.0)]
    for time in times[1:]:
        begin = perf_counter()
        new, residual, status = scheme.advance(state, float(time))
        if status is not Status.CONVERGED:
            row: dict[str, Any] = {name: np.nan * np.asarray(rows[0][name]) for name in rows[0]}
            row |= {"time": float(time), "converged": 0, "residual": residual}
            rows.append(row | {"wall_time": perf_counter() - begin})
            reason = status.value.split(";")[0]
            failure["failure"] = f"the motion ends before {time:g} s: {reason}; take smaller steps"
            break
        exchanged = scheme.exchange(state, new)
        rows.append(scheme.report(new, residual, perf_counter() - begin) | exchanged)
        state = new
    values = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    for name in EXCHANGED[:-1]:
        values[name] = np.cumsum(values[name])
    return link_dataset(system, values, step=range(len(rows))).assign_attrs(failure)


def _nodal_masses(model: LinkEquations, mass: np.ndarray | float) -> np.ndarray:
    """Return the mass of each unknown, shape (n,), kg; rotations are multiplied by a length."""
    free = model.number >= 0
    given = np.asarray(mass, dtype=float)
    try:
        masses = np.broadcast_to(given[:, None] if given.ndim == 1 else given, free.shape)
    except ValueError:
        raise CaseError(
            f"mass must be a number or an array of shape ({len(free)},), got shape {np.shape(mass)}"
        ) from None
    wrong = free & ~((masses > 0.0) & np.isfinite(masses))
    if wrong.any():
        node = int(np.argwhere(wrong)[0, 0])
        raise CaseError(f"mass of node {node} must be positive (kg), got {masses[node].min():g}")
    return np.asarray((masses / np.square(model.unit))[free])


class MomentumBalance(NamedTuple):
    """Momentum of a step without impulses: the gradient of a convex function of the velocity."""

    momentum: np.ndarray  # g(y), shape (n,), N s
    stiffness: np.ndarray  # of the links in the tangent of g, times squared steps, (rows,), kg
    largest: float  # largest term of the sum, N s
    rounding: float  # its rounding error, N s


@dataclass(frozen=True)
class _State:
    time: float  # s
    step: float  # size of the last step, s; infinite before the first step
    u: np.ndarray  # displacement, shape (n,), m
    v: np.ndarray  # velocity, shape (n,), m/s
    elongation: np.ndarray  # of the links, shape (rows,), m
    support: np.ndarray  # elongation due to the motion of the supports, (rows,), m
    tension: np.ndarray  # of the extensible links, shape (rows,), N; zero for the others
    impulse: np.ndarray  # of the inextensible links in the last step, (rows,), N s; else zero
    mean: np.ndarray  # mean tension of all links in the last step, shape (rows,), N


@dataclass(frozen=True)
class _Scheme:
    """Structure with its operators, and the parameters of :func:`simulate`."""

    system: LinkSystem
    model: LinkEquations  # of the free unknowns
    supported: LinkEquations  # of the fixed components
    mass: np.ndarray  # of each unknown, shape (n,), kg
    theta: float
    restitution: float
    load_factor: Callable[[float], float]
    support_motion: Callable[[float], np.ndarray] | None

    @cached_property
    def extensible(self) -> np.ndarray:
        """Whether the stiffness of a link is finite, shape (rows,)."""
        return np.asarray(np.isfinite(self.model.stiffness))

    @cached_property
    def side(self) -> np.ndarray:
        """Sign: 1 for inextensible cables, -1 for inextensible struts, 0 for extensible links."""
        rigid = np.where(np.isfinite(self.model.lower), 1.0, -1.0)
        return np.where(self.extensible, 0.0, rigid)

    @cached_property
    def stiffness(self) -> np.ndarray:
        """Stiffness of extensible links, N/m, shape (rows,); zero for the others."""
        return np.asarray(np.where(self.extensible, self.model.stiffness, 0.0))

    @cached_property
    def prestress(self) -> np.ndarray:
        """Prestress of extensible links, N, shape (rows,); zero for the others."""
        return np.where(self.extensible, self.model.prestress, 0.0)

    def begin(self, time: float, start: tuple[np.ndarray, np.ndarray] | None) -> _State:
        """Return the initial state."""
        free = self.model.number >= 0
        u = v = np.zeros(self.model.n)
        if start is not None:
            shape = self.model.number.shape
            for name, given in zip(("displacement", "velocity"), start, strict=True):
                if np.shape(given) != shape:
                    raise CaseError(f"start {name} must have shape {shape}, got {np.shape(given)}")
            u, v = ((np.asarray(given, dtype=float) * self.model.unit)[free] for given in start)
        support = self.support(time)
        e = self.model.elongate(u) + support
        excess = self.side[: self.system.n_links] * e[: self.system.n_links]
        worst = int(np.argmax(excess / self.system.length))
        if excess[worst] > START_TOLERANCE * self.system.length[worst]:
            raise CaseError(
                f"the start changes the length of link {worst}, which is inextensible, by "
                f"{excess[worst]:.3g} m; move its nodes so that it is slack or just taut"
            )
        tension = self.tension(e)
        return _State(time, np.inf, u, v, e, support, tension, np.zeros_like(e), tension)

    def support(self, time: float) -> np.ndarray:
        """Return the elongation of the links due to the motion of the supports, m."""
        if self.support_motion is None:
            return np.zeros(len(self.model.unknown))
        motion = np.asarray(self.support_motion(time), dtype=float) * self.model.unit
        return self.supported.elongate(motion[self.supported.number >= 0])

    def load(self, time: float) -> np.ndarray:
        """Return the nodal loads at a time, N."""
        return float(self.load_factor(time)) * self.model.load

    def tension(self, elongation: np.ndarray) -> np.ndarray:
        """Return the tension of the extensible links, N; zero for the others."""
        elastic = self.prestress + self.stiffness * elongation
        return np.asarray(np.clip(elastic, self.model.lower, self.model.upper))

    def stored(self, state: _State) -> np.ndarray:
        """Return the elastic energy of each link relative to its relaxed length, J."""
        return np.asarray(0.5 * state.tension**2 / self.model.stiffness)

    def advance(self, old: _State, time: float) -> tuple[_State, float, Status]:
        """Solve a step; return the new state, the residual and the status."""
        h, theta = time - old.time, self.theta
        support = self.support(time)
        moved = support - old.support
        drift = old.elongation + moved + h * (1.0 - theta) * self.model.elongate(old.v)
        push = self.mass * old.v + h * (
            theta * self.load(time) + (1.0 - theta) * self.load(old.time)
        )
        before = self.prestress + self.stiffness * old.elongation

        # balance (1) under the limits (2) or (3), in the rate y of the step:
        # with (3), y = v+ + (2 theta - 1) / (2 theta) M^-1 B_r^T pi, and p = pi / (2 theta)
        def balance(y: np.ndarray) -> MomentumBalance:
            return self._balance(h, before, drift, push, y)[0]

        live, sign, bound = self._limits(h, old, drift, moved / h)
        A = csr_array(diags_array(sign) @ self.model.operator[live])
        late = 2.0 * theta - 1.0 if self.restitution > 0.0 else 0.0
        C = late * (A @ (A.T.toarray() / self.mass[:, None]))
        solution = limited_motion(balance, self._factorise, old.v, (A, bound, C))
        y, p = np.split(solution.value, [old.v.size])

        # positions, velocities, impulses and tensions at the end of the step
        u = old.u + h * (theta * y + (1.0 - theta) * old.v)
        v = y - late * (A.T @ p) / self.mass
        impulse = np.zeros_like(drift)
        impulse[live] = (1.0 + late) * sign * p
        e = self.model.elongate(u) + support
        tension = self._balance(h, before, drift, push, y)[1]
        mean = np.where(self.extensible, tension, impulse / h)
        state = _State(time, h, u, v, e, support, self.tension(e), impulse, mean)
        return state, solution.residuals[-1], solution.status

    def _limits(
        self, h: float, old: _State, drift: np.ndarray, moved: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the inextensible links that may act, their signs, and the bounds (2), (3)."""
        live = np.flatnonzero(~self.extensible)
        sign = self.side[live]
        if self.restitution == 0.0:
            return live, sign, -sign * drift[live] / (h * self.theta)  # (2)
        rate = sign * (self.model.elongate(old.v) + moved)[live]
        near = sign * old.elongation[live] + 0.5 * h * rate >= 0.0
        bound = np.maximum(-self.restitution * rate, -rate) - sign * moved[live]  # (3)
        return live[near], sign[near], bound[near]

    def _balance(
        self, h: float, before: np.ndarray, drift: np.ndarray, push: np.ndarray, y: np.ndarray
    ) -> tuple[MomentumBalance, np.ndarray]:
        """Return the momentum of (1) without impulses at the rate y, and the mean tension."""
        model, step, k = self.model, h * self.theta, self.stiffness
        growth = step * model.elongate(y)
        after = self.prestress + k * (drift + growth)
        tension, slope = mean_tension(before, after, model.lower, model.upper, self.theta)
        # rounding of the elongations, which are differences of motions
        cancelling = _largest(np.abs(drift) + np.abs(growth)) + step * _largest(y)
        balance = MomentumBalance(
            self.mass * y + h * model.gather(tension) - push,
            h * step * slope * k,
            max(_largest(push), h * _largest(tension)),
            8.0 * np.finfo(float).eps * h * _largest(k) * cancelling,
        )
        return balance, tension

    def _factorise(self, stiffness: np.ndarray) -> Solve:
        """Factorise M + B^T k B, with the stiffness times squared steps, kg."""
        tangent = self.model.tangent
        entries = tangent.entries(stiffness)
        entries[tangent.diagonal] += self.mass
        return tangent.factorise(entries)

    def exchange(self, old: _State, new: _State) -> dict[str, float]:
        """Return the energies that a step exchanges, J, summed link by link."""
        force = self.theta * self.load(new.time) + (1.0 - self.theta) * self.load(old.time)
        growth, change = new.elongation - old.elongation, new.v - old.v
        if self.restitution > 0.0:  # impulses of (3) act at the mean of both rates
            mean = 0.5 * new.step * self.model.elongate(old.v + new.v)
            growth = np.where(self.extensible, growth, mean + new.support - old.support)
            change = change + self.model.gather(new.impulse) / self.mass
        before, after = self.stored(old), self.stored(new)
        lost = new.mean * growth - (after - before)
        work = float(force @ (new.u - old.u)) + float(new.mean @ (new.support - old.support))
        # dT + dV = W - (theta - 1/2) dv^T M dv - sum (tau_l de_l - dV_l), (4), where each term is
        # at least zero with mean_tension or theta = 1, as V_l is convex
        numerical = (self.theta - 0.5) * float(change @ (self.mass * change))  # (4)
        sums = (work, numerical, float(np.sum(lost)), float(np.min(lost)))
        return dict(zip(EXCHANGED, sums, strict=True))

    def report(self, state: _State, residual: float, seconds: float) -> dict[str, Any]:
        """Return the variables of a time."""
        links, model = self.system.n_links, self.model
        stretch = state.elongation + model.prestress / model.stiffness
        slack = np.where(np.isfinite(model.lower), np.maximum(0.0, -stretch), 0.0)
        slack = np.where(np.isfinite(model.upper), np.maximum(0.0, stretch), slack)
        tension = np.where(self.extensible, state.tension, state.impulse / state.step)[:links]
        displacement = model.at_nodes(state.u)
        if self.support_motion is not None:
            displacement = displacement + np.where(
                model.number < 0, self.support_motion(state.time), 0.0
            )
        return {
            "time": state.time,
            "converged": 1,
            "residual": residual,
            "wall_time": seconds,
            "tension": tension,
            "slack": slack[:links],
            "impulse": state.impulse[:links],
            "displacement": displacement[:, :3],
            "velocity": model.at_nodes(state.v)[:, :3],
            "kinetic_energy": 0.5 * float(state.v @ (self.mass * state.v)),
            "elastic_energy": float(np.sum(self.stored(state))),
        }


@compiled
def mean_tension(
    before: np.ndarray, after: np.ndarray, lower: np.ndarray, upper: np.ndarray, theta: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the tension of a step, a mean of final and average tension, and its slope."""
    # discrete gradient (O. Gonzalez, Comput. Methods Appl. Mech. Eng. 190 (2000) 1763-1783,
    # doi:10.1016/S0045-7825(00)00189-4) of the energy V of a link,
    #     (2 theta - 1) P(tau+) + 2 (1 - theta) dV / de:
    # its work is at least dV; the quotient is summed over the shares of the step below, between and
    # above the bounds
    tension, slope = np.empty_like(after), np.empty_like(after)
    for row in range(after.size):
        low, high = min(before[row], after[row]), max(before[row], after[row])
        end = min(max(after[row], lower[row]), upper[row])
        carries = 1.0 if lower[row] < after[row] < upper[row] else 0.0
        mean, growth = end, 0.5 * carries
        if high > low:
            length = high - low
            first = min(max(low, lower[row]), upper[row])
            last = min(max(high, lower[row]), upper[row])
            taut = (last - first) / length
            mean = 0.5 * (first + last) * taut
            growth = 0.5 * taut * taut
            if low < lower[row]:
                below = (min(high, lower[row]) - low) / length
                mean += lower[row] * below
                growth += abs(end - lower[row]) / length * below
            if high > upper[row]:
                above = (high - max(low, upper[row])) / length
                mean += upper[row] * above
                growth += abs(end - upper[row]) / length * above
        tension[row] = (2.0 * theta - 1.0) * end + 2.0 * (1.0 - theta) * mean
        slope[row] = (2.0 * theta - 1.0) * carries + 2.0 * (1.0 - theta) * growth
    return tension, slope


def limited_motion(
    balance: Callable[[np.ndarray], MomentumBalance],
    factorise: Callable[[np.ndarray], Solve],
    start: np.ndarray,
    limits: tuple[csr_array, np.ndarray, np.ndarray],
) -> Solution:
    """Solve the balance of momentum under the limits (A, b, C) of the rates."""
    # g(y) + A^T p = 0, 0 <= p perp b - A y + C p >= 0 (1): the minimum of a convex function
    A, bound, C = limits
    columns = A.T.toarray()
    n = start.size

    def slope(x: np.ndarray, dx: np.ndarray, share: float) -> float:
        y, p = np.split(x + share * dx, [n])
        return float(dx[:n] @ balance(y).momentum + dx[n:] @ (C @ p))

    p, accuracy = np.zeros_like(bound), 0.0
    x = np.append(start, p)
    now = balance(start)
    run = NewtonRun(Limits(MAX_ITERATIONS, TOLERANCE))
    while True:
        # linearised balance: rates y without and with the impulses p
        solve = factorise(now.stiffness)
        y = x[:n] - solve(now.momentum + columns @ x[n:])
        if bound.size:
            give = solve(columns)
            rates = bound - A @ (y + give @ x[n:])
            rates[np.abs(rates) < UNDERFLOW_LIMIT] = 0.0
            impulses = solve_lcp(A @ give + C, rates, start=x[n:])
            p, accuracy = impulses.value, impulses.residuals[-1]
            y = y - give @ (p - x[n:])
            if not impulses.converged:
                return Solution(np.append(y, p), impulses.status, (*run.residuals, accuracy))

        # residual of (1) at the full step
        new = balance(y)
        size = max(new.largest, _largest(p), UNDERFLOW_LIMIT)
        residual = _largest(new.momentum + columns @ p) / size
        if not run.goes_on(residual, new.rounding / size):
            last = max(residual, accuracy)
            return Solution(np.append(y, p), run.status, (*run.residuals[:-1], last))

        # line search; a full first step satisfies the limits, which the start may violate
        dx = np.append(y, p) - x
        if run.steps or not bound.size:
            length = step_length(partial(slope, x, dx), slope(x, dx, 0.0))
            dx = (min(length, 1.0) if bound.size else length) * dx
        x = x + dx
        now = balance(x[:n])


def _largest(vector: np.ndarray) -> float:
    return float(np.abs(vector).max(initial=0.0))
