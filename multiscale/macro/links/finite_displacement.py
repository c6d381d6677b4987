"""Equilibrium with geometrically exact elongations."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from multiscale.convergence import Solution, Status
from multiscale.errors import MultiscaleError
from multiscale.macro.links.link_equations import LinkEquations, LinkState, force_scale
from multiscale.macro.links.link_newton import RESIDUAL_STIFFNESS
from multiscale.macro.links.link_system import LinkSystem, nodal_pull
from multiscale.numerics.newton import Limits, NewtonRun, join_solutions, march

MAX_STEP_HALVINGS = 8  # largest number of halvings of a load step

LATERAL_STIFFNESS = (0.0, *10.0 ** np.arange(-8.0, 1.0))
"""Least stiffness of a link across its axis in the tangent, relative to its elastic stiffness. The
next value follows where a step must be halved more than :data:`FEW_HALVINGS` times."""

FEW_HALVINGS, MAX_HALVINGS = 2, 40
"""Halvings of a Newton step, at most, and with the largest lateral stiffness."""


def find_finite_state(
    system: LinkSystem,
    model: LinkEquations,
    load_factors: tuple[float, float],
    start: np.ndarray,
    limits: Limits,
) -> LinkState:
    r"""Follow the equilibrium between two load factors.

    .. math::
        \sum n\, \tau = \alpha F^d, \qquad \tau = P(\tau^0 + k (|x_2 - x_1| - L)),    \tag{1}

    with the actual positions :math:`x` and directions :math:`n`.

    Notes
    -----
    Newton with the exact tangent. A step must lower the energy or the residual. If the tangent is
    not positive definite, or the step must be cut, links have a stiffness across their axes in the
    tangent, as large as necessary: links without tension, or nearly along the line of their ends,
    resist a lateral load only after a large displacement, which the tangent does not foresee. With
    the largest lateral stiffness the tangent is an upper bound at strains below 1, and every
    step lowers the energy. A load step that fails is halved.
    """
    problem = _Problem(system, model)

    def attempt(u: np.ndarray, load_factor: float) -> tuple[Solution, np.ndarray]:
        solution = _newton(problem, load_factor, u, limits)
        return solution, solution.value

    steps = march(attempt, start, load_factors, MAX_STEP_HALVINGS)
    solution = join_solutions([step.solution for step in steps])
    shape = problem.shape(solution.value)
    slack = np.abs(shape.tension - shape.elastic) / model.stiffness
    return LinkState(solution, shape.tension, slack)


class _DeformedLinks(NamedTuple):
    """Links at displaced nodes."""

    length: np.ndarray  # (links,), m
    direction: np.ndarray  # unit vector, (links, 3)
    elastic: np.ndarray  # elastic tension, (links,), N
    tension: np.ndarray  # projected tension, (links,), N


@dataclass(frozen=True, eq=False)
class _Problem:
    """Residual, energy and tangent of (1)."""

    system: LinkSystem
    model: LinkEquations

    def shape(self, u: np.ndarray) -> _DeformedLinks:
        """Return the links at a displacement."""
        system, model = self.system, self.model
        moved = model.at_nodes(u)[:, :3]
        relative = moved[system.ends[:, 1]] - moved[system.ends[:, 0]]
        span = system.span + relative
        length = np.sqrt(np.einsum("li,li->l", span, span))
        # |x|^2 - L^2 without the difference of two nearly equal numbers
        elongation = np.einsum("li,li->l", 2.0 * system.span + relative, relative)
        elongation /= length + system.length
        elastic = model.prestress + model.stiffness * elongation
        tension = np.clip(elastic, model.lower, model.upper)
        return _DeformedLinks(length, span / length[:, None], elastic, tension)

    def residual(self, shape: _DeformedLinks, load_factor: float) -> np.ndarray:
        """Return the residual force, shape (n,), N."""
        force = nodal_pull(self.system, shape.tension[:, None] * shape.direction)
        return np.asarray(load_factor * self.model.load - force[self.model.number >= 0])

    def energy(self, shape: _DeformedLinks, u: np.ndarray, load_factor: float) -> float:
        """Return the potential energy up to a constant, J."""
        model = self.model
        stored = shape.tension * (shape.elastic - 0.5 * shape.tension) / model.stiffness
        return float(stored.sum() - load_factor * model.load @ u)

    def direction(
        self, shape: _DeformedLinks, residual: np.ndarray, lateral: float
    ) -> np.ndarray | None:
        """Return the Newton direction with a lateral stiffness; None if it does not descend."""
        carries = shape.tension == shape.elastic
        along = self.model.stiffness * np.where(carries, 1.0, RESIDUAL_STIFFNESS)
        across = shape.tension / shape.length
        if lateral:
            across = np.maximum(across, lateral * self.model.stiffness)
        try:
            entries = self.model.tangent.geometric(shape.direction, along, across)
            direction = self.model.tangent.factorise(entries)(residual)
        except MultiscaleError:
            return None
        return direction if direction @ residual > 0.0 else None


@np.errstate(all="ignore")  # overflow makes the residual infinite, which stops the loop
def _newton(problem: _Problem, load_factor: float, start: np.ndarray, limits: Limits) -> Solution:
    """Solve (1) at a load factor."""
    model, u = problem.model, start
    scale = force_scale(model, load_factor * model.load)
    shape = problem.shape(u)
    residual = problem.residual(shape, load_factor)
    run = NewtonRun(limits)
    while True:
        stiffest = float(model.stiffness.max()) * float(np.abs(u).max(initial=0.0))
        rounding = 8.0 * np.finfo(float).eps * (float(np.abs(shape.tension).max()) + stiffest)
        if not run.goes_on(float(np.abs(residual).max(initial=0.0)) / scale, rounding / scale):
            break
        step = _step(problem, load_factor, u, shape, residual)
        if step is None:
            run.stop(Status.STALLED)
            break
        u, shape, residual = step
    return run.solution(u)


def _step(
    problem: _Problem,
    load_factor: float,
    u: np.ndarray,
    shape: _DeformedLinks,
    residual: np.ndarray,
) -> tuple[np.ndarray, _DeformedLinks, np.ndarray] | None:
    """Return a Newton step that lowers energy or residual; None if all trials fail."""
    energy, before = problem.energy(shape, u, load_factor), float(np.abs(residual).max())
    for lateral in LATERAL_STIFFNESS:
        direction = problem.direction(shape, residual, lateral)
        if direction is None:
            continue
        slope = float(residual @ direction)
        halvings = MAX_HALVINGS if lateral == LATERAL_STIFFNESS[-1] else FEW_HALVINGS
        for halving in range(halvings + 1):
            step = 0.5**halving
            trial = u + step * direction
            after = problem.shape(trial)
            left = problem.residual(after, load_factor)
            falls = problem.energy(after, trial, load_factor) <= energy - 1e-4 * step * slope
            if falls or float(np.abs(left).max()) < 0.9 * before:
                return trial, after, left
    return None
