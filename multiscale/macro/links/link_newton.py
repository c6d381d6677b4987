"""Proximal semismooth Newton method for links that go slack."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse.csgraph import connected_components

from multiscale.convergence import Status
from multiscale.errors import MultiscaleError
from multiscale.macro.links.link_equations import (
    LinkEquations,
    LinkState,
    force_scale,
    round_off,
    state_of,
)
from multiscale.numerics.compiled import compiled
from multiscale.numerics.factorisation import Solve
from multiscale.numerics.newton import Limits, NewtonRun

RESIDUAL_STIFFNESS = 1e-8
"""Stiffness of a slack link in the tangent, relative to its elastic stiffness."""

SINGULAR_STIFFNESS = 1e-2  # the same after a short step, which indicates a singular tangent

SHORT_STEP, GOOD_STEP = 0.01, 0.5
"""Step lengths below which this stiffness is increased, and above which it is divided by ten."""

MAX_SHORT_STEPS = 4  # number of successive short steps after which the method stops

LARGE = 10_000
"""Unknowns from which a factorisation costs so much that the first factors are reused, and that
zones far from equilibrium are solved before the next factorisation."""

MAX_SOFTENING, REUSE_DECREASE = 1.5, 0.5
"""Length of the first step up to which the factors without slack are reused, and share to which
every step with them must reduce the work of the residual forces."""

SOFTENED_STIFFNESS = 0.3  # stiffness of a slack link in a large structure after a longer first step

FAST_DECREASE = 0.1
"""Decrease of the residual in one step up to which a large structure with an unchanged set of
slack links needs no new factors."""

ZONE_LIMITS = Limits(max_iterations=8, tolerance=1e-3)
"""Limits for a zone; the tolerance is relative to the largest residual force of all zones."""

LARGEST_TOLERANCE = 0.999  # largest tolerance of a zone relative to its load, which can be small

CORE_SHARE = 0.01
"""Residual force from which an unknown is in the core of a zone, relative to the largest."""

MIN_RINGS, MAX_RINGS = 2, 20
"""Rings of links around the cores: fewer constrain the displacement, more have no benefit."""

ZONE_SHARE = 0.1  # share of the unknowns up to which zones cost less than they save
MAX_PAIRS = 8  # number of last steps with a curvature that corrects reused factors


@dataclass
class SlackStiffness:
    """Stiffness of slack links in the tangent, adapted to the length of the Newton steps."""

    share: float = RESIDUAL_STIFFNESS  # of the elastic stiffness of a slack link
    least: float = RESIDUAL_STIFFNESS
    short: int = 0  # number of successive short steps

    @property
    def exhausted(self) -> bool:
        """Whether an increased stiffness has not lengthened the steps."""
        return self.short == MAX_SHORT_STEPS

    def reset(self) -> None:
        """Restore the smallest stiffness, once the set of slack links is constant."""
        if not self.short:
            self.share = self.least

    def adapt(self, step: float) -> None:
        """Increase the stiffness after a short step, decrease it after a long step."""
        self.short = self.short + 1 if step < SHORT_STEP else 0
        if self.short:
            self.share = min(max(10.0 * self.share, SINGULAR_STIFFNESS), 1.0)
        elif step > GOOD_STEP:
            self.share = max(0.1 * self.share, self.least)


@np.errstate(over="ignore", invalid="ignore")  # an overflow shows in the residual
def solve_newton(
    model: LinkEquations,
    load_factor: float,
    start: np.ndarray,
    limits: Limits,
    taut: Solve | None = None,
) -> LinkState:
    r"""Solve for the displacement at which the tensions balance the load.

    .. math::
        B^T \tau = \alpha F^d, \qquad \tau = P(\tau^0 + k B u),    \tag{1}

    eqs (7), (14) and (15) of the source, the gradient of a convex, piecewise quadratic energy.
    """
    # The derivative of the energy along a direction is piecewise linear and increasing: the step to
    # its zero is exact. In large structures with few slack links factors without slack are reused
    # first and corrected by the last steps (J. Nocedal, Math. Comput. 35 (1980) 773-782,
    # doi:10.1090/S0025-5718-1980-0572855-7); else
    # zones around the largest residuals are solved apart (P. J. Lanzkron, D. J. Rose and J. T.
    # Wilkes, SIAM J. Sci. Comput. 17 (1996) 538-559). Elongations are summed step by step: rounding
    # is relative to their size.
    u = np.array(start, dtype=float)
    load = load_factor * model.load
    imbalance = model.gather(model.prestress)
    scale = force_scale(model, load)
    lower, upper = model.lower - model.prestress, model.upper - model.prestress
    elastic = model.stiffness * model.elongate(u)
    run, slack_stiffness = NewtonRun(limits), SlackStiffness()
    residual, direction, step = imbalance, u, 0.0
    solve, factored = taut, np.ones(elastic.size, dtype=bool)
    factored_share = slack_stiffness.share
    large = model.n >= LARGE
    reused, before, last_work = taut is not None and large, factored, np.inf
    pairs: list[tuple[np.ndarray, np.ndarray]] = []

    while True:
        # residual of (1), and the curvature of the last step with reused factors
        change = np.clip(elastic, lower, upper)  # tau - tau^0
        last, residual = residual, load - imbalance - model.gather(change)
        if reused and step > 0.0:
            pairs = [*pairs[1 - MAX_PAIRS :], (step * direction, last - residual)]
        rounding = round_off(model.prestress + change)
        if not run.goes_on(float(np.abs(residual).max(initial=0.0)) / scale, rounding / scale):
            break
        if slack_stiffness.exhausted:
            run.stop(Status.STALLED)
            break

        # direction: from reused factors while they reduce the work, else from the tangent
        carries = change == elastic
        same = np.array_equal(carries, factored)
        if same:
            slack_stiffness.reset()
        reused = reused and (same or not np.array_equal(carries, before))
        if reused and solve is not None:
            direction = secant_direction(solve, pairs, residual)
            reused = residual @ direction <= REUSE_DECREASE * last_work
        if not reused:
            fast = large and np.abs(residual).max() < FAST_DECREASE * np.abs(last).max()
            stale = slack_stiffness.share != factored_share and not fast
            if solve is None or not same or stale:
                share = np.where(carries, 1.0, slack_stiffness.share)
                try:
                    solve = model.factorise(share * model.stiffness)
                except MultiscaleError:
                    run.stop(Status.STALLED)
                    break
                factored, factored_share = carries, slack_stiffness.share
            direction = solve(residual)

        # exact line search; in large structures also along the relaxed direction
        growth = model.stiffness * model.elongate(direction)
        before, last_work = carries, float(residual @ direction)
        step = exact_step(elastic, growth, model.stiffness, lower, upper, last_work)
        if large and not reused:
            relaxed = direction + relax_zones(model, load, elastic + growth)
            relaxed_growth = model.stiffness * model.elongate(relaxed)
            work = float(residual @ relaxed)
            longer = exact_step(elastic, relaxed_growth, model.stiffness, lower, upper, work)
            if work > 0.0 and longer > step:
                direction, growth, step = relaxed, relaxed_growth, longer
        u, elastic = u + step * direction, elastic + step * growth

        # stiffness of slack links for the next step
        reused = reused and (bool(pairs) or step <= MAX_SOFTENING)
        slack_stiffness.adapt(step)
        if large and not run.steps and step > MAX_SOFTENING:
            slack_stiffness.share = SOFTENED_STIFFNESS

    return state_of(model, run.solution(u), elastic)


def relax_zones(model: LinkEquations, load: np.ndarray, elastic: np.ndarray) -> np.ndarray:
    """Return the displacement that balances the zones farthest from equilibrium separately, m."""
    u = np.zeros(model.n)
    for unknowns, zone, residual in unbalanced_zones(model, load, elastic):
        relative = ZONE_LIMITS.tolerance * residual / force_scale(zone, zone.load)
        limits = replace(ZONE_LIMITS, tolerance=min(relative, LARGEST_TOLERANCE))
        state = solve_newton(zone, 1.0, u[unknowns], limits)
        u[unknowns] = state.solution.value
    return u


def unbalanced_zones(
    model: LinkEquations, load: np.ndarray, elastic: np.ndarray
) -> Iterator[tuple[np.ndarray, LinkEquations, float]]:
    """Yield unknowns, equations and largest residual force of the disconnected zones."""
    force = model.prestress + elastic
    residual = np.abs(load - model.gather(np.clip(force, model.lower, model.upper)))
    # cores, and rings of neighbours around them
    zone, rings = residual > CORE_SHARE * residual.max(), 0
    while rings < MAX_RINGS:
        larger = _with_neighbours(model.unknown, zone)
        if np.count_nonzero(larger) > ZONE_SHARE * model.n:
            break
        zone, rings = larger, rings + 1
    if rings < MIN_RINGS:
        return

    # equations of each connected zone, with the forces of the links as prestress
    unknowns = np.flatnonzero(zone)
    graph = model.tangent.pattern[unknowns][:, unknowns]
    count, label = connected_components(graph, directed=False)
    zone_of, position = np.full(model.n + 1, -1), np.full(model.n + 1, -1, dtype=np.int32)
    zone_of[unknowns] = label
    row_label = zone_of[model.unknown].max(axis=1)  # -1, a fixed component, selects the last entry
    for rows, inside in zip(_members(row_label, count), _members(label, count), strict=True):
        position[unknowns[inside]] = np.arange(inside.size)
        of_rows = ("link", "coefficient", "stiffness", "lower", "upper")
        zone_model = replace(
            model,
            **{name: getattr(model, name)[rows] for name in of_rows},
            unknown=position[model.unknown[rows]],
            prestress=force[rows],
            load=load[unknowns[inside]],
            number=model.number[:0],
        )
        yield unknowns[inside], zone_model, float(residual.max())


def _members(label: np.ndarray, count: int) -> list[np.ndarray]:
    """Return the indices of the entries of each label from 0 to count - 1."""
    order = np.argsort(label, kind="stable")
    return np.split(order, np.searchsorted(label[order], np.arange(count + 1)))[1:-1]


@compiled
def _with_neighbours(unknown: np.ndarray, zone: np.ndarray) -> np.ndarray:
    """Add to a set of unknowns, shape (n,), all unknowns that a row of B connects with it."""
    larger = zone.copy()
    for row in range(unknown.shape[0]):
        touched = False
        for p in range(unknown.shape[1]):
            if unknown[row, p] >= 0 and zone[unknown[row, p]]:
                touched = True
        if touched:
            for p in range(unknown.shape[1]):
                if unknown[row, p] >= 0:
                    larger[unknown[row, p]] = True
    return larger


def secant_direction(
    solve: Solve, pairs: list[tuple[np.ndarray, np.ndarray]], residual: np.ndarray
) -> np.ndarray:
    """Return the quasi-Newton direction of eq (6) of [1]_ of :func:`solve_newton`, m."""
    force, shares = residual, []
    for step, change in reversed(pairs):
        shares.append(step @ force / (step @ change))
        force = force - shares[-1] * change
    direction = solve(force)
    for (step, change), share in zip(pairs, reversed(shares), strict=True):
        direction = direction + (share - change @ direction / (step @ change)) * step
    return direction


@compiled
def exact_step(
    elastic: np.ndarray,
    growth: np.ndarray,
    stiffness: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    work: float,
) -> float:
    """Return the zero of the piecewise linear slope of the energy, by Newton inside a bracket."""
    # the slope is its initial value, minus ``work``, plus the gains of the tensions: a difference
    # of two nearly equal sums would be rounding near the solution
    low, high, step = 0.0, np.inf, 1.0
    for _ in range(100):
        slope, curvature = -work, 0.0
        for row in range(elastic.size):
            force = elastic[row] + step * growth[row]
            tension = min(max(force, lower[row]), upper[row])
            before = min(max(elastic[row], lower[row]), upper[row])
            taut = tension == force
            gain = step * growth[row] if taut and before == elastic[row] else tension - before
            slope += gain * growth[row] / stiffness[row]
            if taut:
                curvature += growth[row] * growth[row] / stiffness[row]
        if slope > 0.0:
            high = step
        else:
            low = step
        following = step - slope / curvature if curvature > 0.0 else 2.0 * step
        if abs(following - step) <= 1e-13 * step:
            return following
        if high < np.inf and not low < following < high:
            following = 0.5 * (low + high)
        step = min(max(following, 0.5 * low), 10.0 * step)
    return step
