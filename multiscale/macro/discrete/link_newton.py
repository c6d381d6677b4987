"""Proximal semismooth Newton for links that go slack."""

from dataclasses import dataclass

import numba
import numpy as np

from multiscale.convergence import Status
from multiscale.errors import MultiscaleError
from multiscale.macro.discrete.compatibility import LinkEquations
from multiscale.macro.discrete.link_state import LinkState, force_scale, round_off, state_of
from multiscale.macro.discrete.link_tangent import Tangent
from multiscale.numerics.cholesky import Solve
from multiscale.numerics.newton import Limits, NewtonRun

__all__ = ["RESIDUAL_STIFFNESS", "Lending", "exact_step", "solve_newton"]

RESIDUAL_STIFFNESS = 1e-8
"""Stiffness left to a slack link in the tangent, relative to its own."""

SUPPORT = 1e-2
"""The same after a short step, which shows that the tangent has become singular."""

SHORT_STEP, GOOD_STEP = 0.01, 0.5
"""Steps below which more is left to slack links, and above which a tenth of it."""

PATIENCE = 4
"""Short steps in a row after which the method gives up."""


@dataclass
class Lending:
    """Stiffness that slack links keep in the tangent, relative to their own.

    Attributes
    ----------
    share : float
    short : int
        Number of short steps in a row.
    """

    share: float = RESIDUAL_STIFFNESS
    short: int = 0

    @property
    def exhausted(self) -> bool:
        """Whether more stiffness did not lengthen the steps."""
        return self.short == PATIENCE

    def settle(self) -> None:
        """Take back what was lent: the slack links are known."""
        if not self.short:
            self.share = RESIDUAL_STIFFNESS

    def follow(self, step: float) -> None:
        """Lend more after a short step, and less after a good one."""
        self.short = self.short + 1 if step < SHORT_STEP else 0
        if self.short:
            self.share = min(max(10.0 * self.share, SUPPORT), 1.0)
        elif step > GOOD_STEP:
            self.share = max(0.1 * self.share, RESIDUAL_STIFFNESS)


@np.errstate(over="ignore", invalid="ignore")  # an overflow shows in the residual
def solve_newton(
    model: LinkEquations,
    tangent: Tangent,
    load_factor: float,
    start: np.ndarray,
    limits: Limits,
    taut: Solve | None = None,
) -> LinkState:
    r"""Find the displacement at which the tensions balance the load.

    .. math::
        B^T \tau = \alpha F^d, \qquad \tau = P(\tau^0 + k B u),    \tag{1}

    eqs (7), (14) and (15) of the source, with the projection :math:`P` onto the admissible
    tensions: the proximal operator of the dual energy.

    Parameters
    ----------
    model : Equations
        The structure.
    tangent : Tangent
        Its pattern.
    load_factor : float
        :math:`\alpha`.
    start : ndarray, shape (n,)
        First displacement, m.
    limits : Limits
        The tolerance bounds the largest force out of balance, relative to the largest nodal
        load (without load: to the largest prestress). The rounding of the tensions is allowed
        for.
    taut : callable, optional
        Solve with the tangent without slack, if it has just been factorised.

    Notes
    -----
    (1) is the gradient of a convex, piecewise quadratic energy. Its derivative along a Newton
    direction is piecewise linear and increasing, so that the step to its zero is exact and the
    energy falls in every iteration. The tangent leaves a small stiffness to slack links, a
    larger one while so many are slack that it is singular; the residual does not.

    The elongations are summed up step by step beside the displacement, not computed from it:
    their rounding then follows their own size, and equilibrium is met to the rounding of the
    tensions however stiff the bars are.
    """
    u = np.array(start, dtype=float)
    load = load_factor * model.load
    imbalance = model.gather(model.prestress)
    scale = force_scale(model, load)
    lower, upper = model.lower - model.prestress, model.upper - model.prestress
    elastic = model.stiffness * model.elongate(u)
    run, lending = NewtonRun(limits), Lending()
    solve, lent, factored = taut, lending.share, np.ones(elastic.size, dtype=bool)

    while True:
        change = np.clip(elastic, lower, upper)  # tau - tau^0
        residual = load - imbalance - model.gather(change)
        rounding = round_off(model.prestress + change)
        if not run.goes_on(float(np.abs(residual).max(initial=0.0)) / scale, rounding / scale):
            break
        if lending.exhausted:
            run.stop(Status.STALLED)
            break

        carries = change == elastic
        same = np.array_equal(carries, factored)
        if same:
            lending.settle()
        if solve is None or not same or lending.share != lent:
            share = np.where(carries, 1.0, lending.share)
            try:
                solve = tangent.factorise(tangent.entries(share * model.stiffness))
            except MultiscaleError:
                run.stop(Status.STALLED)
                break
            factored, lent = carries, lending.share
        direction = solve(residual)
        growth = model.stiffness * model.elongate(direction)
        work = float(residual @ direction)
        step = exact_step(elastic, growth, model.stiffness, lower, upper, work)
        u, elastic = u + step * direction, elastic + step * growth
        lending.follow(step)

    return state_of(model, run.solution(u), elastic)


@numba.njit(cache=True, error_model="numpy")
def exact_step(
    elastic: np.ndarray,
    growth: np.ndarray,
    stiffness: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    work: float,
) -> float:
    """Zero of the piecewise linear slope of the energy, by Newton inside a bracket.

    Elastic changes of the tensions, their growth with the step, and their bounds are in N,
    ``work`` of the forces out of balance along the direction in J. The slope is that at the
    start, less ``work``, and what the tensions gain: a difference of nearly equal sums would
    lose it near the solution.
    """
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
