"""Interior-point method for the dual quadratic program, with the factors of the tangent."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from multiscale.convergence import Status
from multiscale.errors import MultiscaleError
from multiscale.macro.links.link_equations import LinkEquations, LinkState, force_scale
from multiscale.numerics.factorisation import Solve
from multiscale.numerics.newton import Limits, NewtonRun

BOUNDARY_SHARE = 0.995  # largest step, relative to the step that reaches the boundary

START_DISTANCE = 0.1
"""Distance of the first iterate from the boundary, relative to the mean tension."""

FREE_RESISTANCE = 1.0
"""Resistance of a motion below which it counts as free if the method has failed, dimensionless;
stable grids of any size have 50."""

CERTAIN_SHARE = 1e-9  # share of ``FREE_RESISTANCE`` below which the iteration stops

RIGID_STIFFNESS = 1e6
"""Stiffness of a link of fixed length in the matrix, relative to the largest finite stiffness."""


@np.errstate(all="ignore")  # overflow makes the residual infinite, which stops the loop
def solve_interior_point(model: LinkEquations, load_factor: float, limits: Limits) -> LinkState:
    r"""Compute tensions and slack by an interior-point method [1]_.

    A quadratic program is dual to the energy of :func:`solve_newton`. With s = 1 for cables and -1
    for struts, and 1/k = 0 for links of fixed length, its solution satisfies

    .. math::
        B^T \tau = \alpha F^d, \quad \frac{\tau - \tau^0}{k} = B u + s \lambda, \quad
        0 \le s \tau \perp \lambda \ge 0.    \tag{1}

    .. [1] S. Mehrotra, SIAM J. Optim. 2 (1992) 575-601, doi:10.1137/0802028.
    """
    problem = _Problem(model, load_factor * model.load)
    run = NewtonRun(replace(limits, tolerance=10.0 * limits.tolerance))
    least, ray = np.inf, np.zeros(model.n)
    try:
        point = problem.begin()
    except MultiscaleError:
        run.stop(Status.STALLED)
        return problem.report(_Point(ray, model.prestress, 0.0 * model.prestress), run)

    while run.goes_on(problem.residual(point)):
        if least < CERTAIN_SHARE * FREE_RESISTANCE:
            break
        weight = problem.weight(point)
        try:
            solve = model.factorise(weight)
        except MultiscaleError:
            run.stop(Status.STALLED)
            break
        point = _mehrotra_step(problem, point, weight, solve)
        resistance = problem.resistance(point.u)
        if resistance < least:
            least, ray = resistance, point.u
    if not run.converged and least < FREE_RESISTANCE:
        run.stop(Status.INFEASIBLE)
        point = point._replace(u=ray)
    return problem.report(point, run)


class _Point(NamedTuple):
    """Iterate or its change: displacement (n,), m; tension, N, and slack, m, both (rows,)."""

    u: np.ndarray
    tau: np.ndarray
    slack: np.ndarray


class _Problem:
    """Conditions (1) and their linearisation."""

    def __init__(self, model: LinkEquations, load: np.ndarray) -> None:
        self.model, self.load = model, load
        self.sign = np.where(np.isfinite(model.lower), 1.0, 0.0) - np.isfinite(model.upper)
        self.one_sided = self.sign != 0.0
        self.give = 1.0 / model.stiffness
        self.measure = model.finite_stiffness  # N/m: makes a length comparable to a force
        self.regularisation = np.where(
            np.isinf(model.stiffness), 1.0 / (RIGID_STIFFNESS * self.measure), 0.0
        )

    def begin(self) -> _Point:
        """Return the first iterate: the structure without slack, moved into the interior."""
        model, mask = self.model, self.one_sided
        solve = model.factorise(self.measure)
        u = solve(self.load - model.gather(model.prestress))
        elastic = model.prestress + self.measure * model.elongate(u)
        inwards = START_DISTANCE * float(np.abs(elastic).mean())
        tension = np.maximum(self.sign * elastic, 0.0) + inwards
        slack = np.maximum(-self.sign * elastic, 0.0) + inwards
        return _Point(
            u,
            np.where(mask, self.sign * tension, elastic),
            np.where(mask, slack / self.measure, 0.0),
        )

    def errors(self, point: _Point) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return residual forces (N), incompatibility (m), tension times slack (N m)."""
        model = self.model
        balance = model.gather(point.tau) - self.load
        fit = self.give * (point.tau - model.prestress)
        fit = fit - model.elongate(point.u) - self.sign * point.slack
        return balance, fit, np.where(self.one_sided, np.abs(point.tau) * point.slack, 0.0)

    def residual(self, point: _Point) -> float:
        """Return the largest error of (1) beyond the rounding of u, dimensionless."""
        balance, fit, product = self.errors(point)
        largest = float(np.abs(point.tau).max()) or 1.0
        rounding = 8.0 * np.finfo(float).eps * float(np.abs(point.u).max(initial=0.0))
        misfit = float(np.max(self.measure * (np.abs(fit) - rounding), initial=0.0))
        unbalanced = float(np.abs(balance).max(initial=0.0)) - rounding * float(self.measure.max())
        gap = float(np.sqrt(np.max(self.measure * product, initial=0.0)))
        scale = force_scale(self.model, self.load)
        # a sum propagates NaN, a maximum does not
        return max(unbalanced, 0.0) / scale + (misfit + gap) / largest

    def resistance(self, u: np.ndarray) -> float:
        """Return the load per link that unit tension in every link could balance in a motion."""
        e = self.model.elongate(u)
        resisted = np.where(self.one_sided, np.maximum(self.sign * e, 0.0), np.abs(e))
        pushed = float(self.load @ u) / (float(np.abs(self.load).sum()) or 1.0)
        return resisted.size * float(resisted.max()) / pushed if pushed > 0.0 else np.inf

    def weight(self, point: _Point) -> np.ndarray:
        """Return the stiffness w of every row, N/m."""
        fading = np.divide(
            point.slack, np.abs(point.tau), out=np.zeros_like(point.tau), where=self.one_sided
        )
        return np.asarray(1.0 / (self.give + self.regularisation + fading))

    def direction(
        self, point: _Point, weight: np.ndarray, solve: Solve, product: np.ndarray
    ) -> _Point:
        """Return the Newton direction of (1) for given products of tension and slack."""
        model = self.model
        balance, fit, _ = self.errors(point)
        size = np.where(self.one_sided, np.abs(point.tau), 1.0)
        force = weight * (fit + self.sign * product / size)
        u = solve(model.gather(force) - balance)
        tau = weight * model.elongate(u) - force
        slack = -(product + point.slack * self.sign * tau) / size
        return _Point(u, tau, np.where(self.one_sided, slack, 0.0))

    def longest_step(self, point: _Point, change: _Point) -> float:
        """Return the step, at most 1, at which a tension or a slack becomes zero."""
        step = 1.0
        for value, rate in (
            (np.abs(point.tau), self.sign * change.tau),
            (point.slack, change.slack),
        ):
            falls = self.one_sided & (rate < 0.0)
            step = min(step, float(np.min(-value[falls] / rate[falls], initial=1.0)))
        return step

    def report(self, point: _Point, run: NewtonRun) -> LinkState:
        """Return the state with the smaller of tension and slack set to zero, and its residual."""
        taut = np.abs(point.tau) > self.measure * point.slack
        tension = np.where(taut | ~self.one_sided, point.tau, 0.0)
        slack = np.where(taut, 0.0, point.slack)
        solution = run.solution(point.u)
        if solution.converged:
            balance = self.model.gather(tension) - self.load
            scale = force_scale(self.model, self.load)
            last = float(np.abs(balance).max(initial=0.0)) / scale
            solution = replace(solution, residuals=(*solution.residuals[:-1], last))
        return LinkState(solution, tension, slack)


def _mehrotra_step(problem: _Problem, point: _Point, weight: np.ndarray, solve: Solve) -> _Point:
    """Predict without centring, then correct with the second-order products of the prediction."""
    mask, sign = problem.one_sided, problem.sign
    product = np.where(mask, np.abs(point.tau) * point.slack, 0.0)
    count = float(np.count_nonzero(mask)) or 1.0
    mean = float(product.sum()) / count
    # predictor, and the mean product after it
    guess = problem.direction(point, weight, solve, product)
    step = problem.longest_step(point, guess)
    after = (np.abs(point.tau) + step * sign * guess.tau) * (point.slack + step * guess.slack)
    left = float(after[mask].sum()) / count
    # corrector, to a step inside the boundary
    centring = mean * (left / mean) ** 3 if mean > 0.0 else 0.0
    change = problem.direction(
        point, weight, solve, product + sign * guess.tau * guess.slack - centring
    )
    step = min(1.0, BOUNDARY_SHARE * problem.longest_step(point, change) if mask.any() else 1.0)
    return _Point(
        point.u + step * change.u, point.tau + step * change.tau, point.slack + step * change.slack
    )
