r"""Primal-dual interior point for Coulomb friction, with De Saxcé's term inside Newton's method."""

from dataclasses import dataclass

import numpy as np

from multiscale.nonsmooth.block_system import Solve, factorise_blocks
from multiscale.nonsmooth.friction_problem import ScaledFriction
from multiscale.nonsmooth.lorentz import (
    apply,
    axis,
    divide,
    longest_step,
    lorentz_problem,
    multiply,
    nesterov_todd,
    spin,
    stalled,
)
from multiscale.nonsmooth.progress import Recorder

__all__ = ["shifted_interior_point"]

APEX = 1e-12
"""Rounds the tip of the norm in De Saxcé's term, relative to the velocities."""


def shifted_interior_point(
    problem: ScaledFriction,
    progress: Recorder,
    max_iterations: int = 45,
    regularisation: float = 1e-12,
) -> np.ndarray:
    r"""Follow the central path of a friction problem.

    Parameters
    ----------
    problem : ScaledFriction
        The problem, dimensionless.
    progress : Recorder
        Notes every step and says when to stop.
    max_iterations : int
        Iteration limit.
    regularisation : float
        Added to the diagonal of :math:`W`, relative to it, in the tangent matrix alone.

    Returns
    -------
    ndarray, shape (contacts, 3)
        The last impulses.

    Notes
    -----
    In Lorentz coordinates :math:`x = (\mu r_N, r_T)`, :math:`y = (u_N/\mu + \|u_T\|, u_T)` both
    cones become the self-dual one of :mod:`multiscale.nonsmooth.lorentz`, and

    .. math::
        W x + q + \|y_T\| e - y = 0, \qquad x \circ y = \sigma m\, e, \qquad
        m = \frac{x^T y}{\mathrm{contacts}},    \tag{1}

    with :math:`e = (1, 0, 0)` at every contact. With the scaling :math:`F x = F^{-1} y = \lambda`
    of Nesterov and Todd and :math:`E = I - e\,(0, y_T/\|y_T\|)^T` a Newton step for a right-hand
    side g is

    .. math::
        (W + E F^2)\, \Delta x = E F g - (W x + q + \|y_T\| e - y), \qquad
        \Delta y = F g - F^2 \Delta x.    \tag{2}

    Mehrotra's predictor has :math:`g = -\lambda`, his corrector
    :math:`\lambda \circ g = \sigma m e - \lambda \circ \lambda - F \Delta x \circ F^{-1} \Delta y`.
    The norm :math:`\|y_T\|` makes the problem non-monotone and is linearised like the rest: there
    is no outer iteration on it.

    References
    ----------
    .. [1] Yu. E. Nesterov and M. J. Todd, Math. Oper. Res. 22 (1997) 1-42,
       doi:10.1287/moor.22.1.1, for the scaling.
    .. [2] S. Mehrotra, SIAM J. Optim. 2 (1992) 575-601, doi:10.1137/0802028, for predictor and
       corrector.
    """
    lorentz, unit = lorentz_problem(problem)
    x, y = axis(len(unit)), axis(len(unit))
    means: list[float] = []
    for _ in range(max_iterations):
        mean = float(np.sum(x * y)) / len(x)
        means.append(mean)
        if np.any(spin(x) <= 0.0) or np.any(spin(y) <= 0.0) or not mean > 1e-16:
            break
        if stalled(means):
            break
        newton = _newton(lorentz, x, y, regularisation)
        if newton is None:
            break
        dx, dy, step = _step(newton, x, y, mean)
        if not step > 1e-6:
            break
        x, y = x + step * dx, y + step * dy
        if progress.note(unit * x):
            break
    return np.asarray(unit * x)


@dataclass(frozen=True)
class _Newton:
    """Equation (2) at one point."""

    scaled: np.ndarray
    scaling: tuple[np.ndarray, np.ndarray, np.ndarray]
    tilt: np.ndarray
    defect: np.ndarray
    solve: Solve

    def direction(self, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solve (2) for the steps of x and y."""
        F, _, F2 = self.scaling
        Fg = apply(F, g)
        dx = self.solve(apply(self.tilt, Fg) - self.defect)
        return dx, Fg - apply(F2, dx)


def _newton(
    lorentz: ScaledFriction, x: np.ndarray, y: np.ndarray, regularisation: float
) -> _Newton | None:
    """Linearise (1) and factorise the matrix of (2); None if that fails."""
    slide = np.sqrt(y[:, 1] ** 2 + y[:, 2] ** 2 + APEX**2)
    defect = lorentz.respond(x) - y
    defect[:, 0] += slide
    tilt = np.tile(np.eye(3), (len(x), 1, 1))
    tilt[:, 0, 1:] -= y[:, 1:] / slide[:, None]
    scaling = nesterov_todd(x, y)
    added = tilt @ scaling[2] + regularisation * np.eye(3)
    if not np.all(np.isfinite(added)):
        return None
    solve = factorise_blocks(lorentz, added)
    if solve is None:
        return None
    return _Newton(apply(scaling[0], x), scaling, tilt, defect, solve)


def _step(
    newton: _Newton, x: np.ndarray, y: np.ndarray, mean: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Directions of x and y by predictor and corrector, and the length of the step."""
    centre = mean * axis(len(x))
    dx, dy = newton.direction(-newton.scaled)  # predictor
    if not np.all(np.isfinite(dx)):
        return dx, dy, 0.0
    step = min(1.0, 0.99 * min(longest_step(x, dx), longest_step(y, dy)))
    left = float(np.sum((x + step * dx) * (y + step * dy))) / len(x)
    sigma = min(1.0, max((left / mean) ** 3, 1e-6)) if left > 0.0 else 1e-3

    squared = multiply(newton.scaled, newton.scaled)
    F, inverse, _ = newton.scaling
    second = multiply(apply(F, dx), apply(inverse, dy))
    for target in (sigma * centre - squared - second, max(sigma, 0.5) * centre - squared):
        dx, dy = newton.direction(divide(newton.scaled, target))
        if not np.all(np.isfinite(dx)):
            return dx, dy, 0.0
        step = min(1.0, 0.99 * min(longest_step(x, dx), longest_step(y, dy)))
        if step >= 0.1:
            break  # otherwise once more, towards the centre
    return dx, dy, step
