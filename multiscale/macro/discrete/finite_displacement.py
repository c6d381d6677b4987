"""One load factor with geometrically exact elongations."""

from dataclasses import dataclass

import numpy as np

from multiscale.convergence import Solution, Status
from multiscale.errors import MultiscaleError
from multiscale.macro.discrete.compatibility import LinkEquations
from multiscale.macro.discrete.link_newton import RESIDUAL_STIFFNESS
from multiscale.macro.discrete.link_state import LinkState, force_scale
from multiscale.macro.discrete.link_system import LinkSystem
from multiscale.macro.discrete.link_tangent import Tangent
from multiscale.numerics.newton import Limits, NewtonRun, join_solutions, march

__all__ = ["find_finite_state"]

CUTS = 8
"""How often a load step may be halved."""

HALVINGS = 12
"""How often a Newton step may be halved."""


def find_finite_state(
    system: LinkSystem,
    model: LinkEquations,
    tangent: Tangent,
    load_factors: tuple[float, float],
    start: np.ndarray,
    limits: Limits,
) -> LinkState:
    r"""Follow the equilibrium from one load factor to another.

    .. math::
        \sum n\, \tau = \alpha F^d, \qquad \tau = P(\tau^0 + k (|x_2 - x_1| - L)),    \tag{1}

    with the actual positions :math:`x` and directions :math:`n`.

    Parameters
    ----------
    system, model, tangent
        The structure; links with three unknowns per node.
    load_factors : tuple of float
        Where to start and where to arrive.
    start : ndarray, shape (n,)
        Displacement at the first, m.
    limits : Limits
        When to stop.

    Notes
    -----
    Newton with the exact tangent. Where it is not positive definite, the geometric stiffness of
    compressed links is left out, so that the direction still descends; a step must lower the
    energy or the residual. A load step that fails is halved.
    """
    problem = _Problem(system, model, tangent)

    def attempt(u: np.ndarray, load_factor: float) -> tuple[Solution, np.ndarray]:
        solution = _newton(problem, load_factor, u, limits)
        return solution, solution.value

    parts = march(attempt, start, load_factors, CUTS)
    solution = join_solutions([part.solution for part in parts])
    shape = problem.shape(solution.value)
    slack = np.abs(shape.tension - shape.elastic) / model.stiffness
    return LinkState(solution, shape.tension, slack)


@dataclass(frozen=True, eq=False)
class _Shape:
    """Actual length (m), direction, elastic and true tension (N) of every link."""

    length: np.ndarray
    direction: np.ndarray
    elastic: np.ndarray
    tension: np.ndarray


@dataclass(frozen=True, eq=False)
class _Problem:
    """Equation (1)."""

    system: LinkSystem
    model: LinkEquations
    tangent: Tangent

    def shape(self, u: np.ndarray) -> _Shape:
        """Links at a displacement."""
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
        return _Shape(length, span / length[:, None], elastic, tension)

    def residual(self, shape: _Shape, load_factor: float) -> np.ndarray:
        """Force out of balance, shape (n,), N."""
        pull = shape.tension[:, None] * shape.direction
        force = np.zeros((self.system.n_nodes, 3))
        for i in range(3):
            force[:, i] = np.bincount(self.system.ends[:, 1], pull[:, i], len(force))
            force[:, i] -= np.bincount(self.system.ends[:, 0], pull[:, i], len(force))
        return np.asarray(load_factor * self.model.load - force[self.model.number >= 0])

    def energy(self, shape: _Shape, u: np.ndarray, load_factor: float) -> float:
        """Potential energy, J, less a constant."""
        model = self.model
        stored = shape.tension * (shape.elastic - 0.5 * shape.tension) / model.stiffness
        return float(stored.sum() - load_factor * model.load @ u)

    def direction(self, shape: _Shape, residual: np.ndarray) -> np.ndarray:
        """Newton direction; without the softening of compressed links where it must be."""
        carries = shape.tension == shape.elastic
        along = self.model.stiffness * np.where(carries, 1.0, RESIDUAL_STIFFNESS)
        across = shape.tension / shape.length
        for kept in (across, np.maximum(across, RESIDUAL_STIFFNESS * along)):
            try:
                entries = self.tangent.geometric(shape.direction, along, kept)
                direction = self.tangent.factorise(entries)(residual)
            except MultiscaleError:
                continue
            if direction @ residual > 0.0:
                return direction
        raise MultiscaleError("the tangent stiffness is not positive definite")


@np.errstate(all="ignore")  # an overflow shows in the residual
def _newton(problem: _Problem, load_factor: float, start: np.ndarray, limits: Limits) -> Solution:
    model, u = problem.model, start
    scale = force_scale(model, load_factor * model.load)
    shape = problem.shape(u)
    residual = problem.residual(shape, load_factor)
    run = NewtonRun(limits)
    while run.goes_on(
        float(np.abs(residual).max(initial=0.0)) / scale, _rounding(model, u, shape) / scale
    ):
        try:
            direction = problem.direction(shape, residual)
        except MultiscaleError:
            run.stop(Status.STALLED)
            break
        step = _descend(problem, load_factor, u, shape, residual, direction)
        if step is None:
            run.stop(Status.STALLED)
            break
        u, shape, residual = step
    return run.solution(u)


def _rounding(model: LinkEquations, u: np.ndarray, shape: _Shape) -> float:
    """Force out of balance that the rounding of displacement and tensions brings, N."""
    stiffest = float(model.stiffness.max()) * float(np.abs(u).max(initial=0.0))
    return float(8.0 * np.finfo(float).eps * (np.abs(shape.tension).max() + stiffest))


def _descend(
    problem: _Problem,
    load_factor: float,
    u: np.ndarray,
    shape: _Shape,
    residual: np.ndarray,
    direction: np.ndarray,
) -> tuple[np.ndarray, _Shape, np.ndarray] | None:
    """Halve the step until the energy falls as it should, or the residual does."""
    energy, slope = problem.energy(shape, u, load_factor), float(residual @ direction)
    before = float(np.abs(residual).max())
    for halving in range(HALVINGS):
        step = 0.5**halving
        trial = u + step * direction
        after = problem.shape(trial)
        left = problem.residual(after, load_factor)
        falls = problem.energy(after, trial, load_factor) <= energy - 1e-4 * step * slope
        if falls or float(np.abs(left).max()) < 0.9 * before:
            return trial, after, left
    return None
