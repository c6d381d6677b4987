"""Semismooth Newton on the assembled problem: default for small problems, and oracle."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import norm
from scipy.sparse import csr_array, issparse

from multiscale.convergence import Solution
from multiscale.errors import MultiscaleError
from multiscale.laws.interface_law import InterfaceLaw
from multiscale.macro.interface_newton import InterfaceIterate, find_equilibrium
from multiscale.numerics.factorisation import factorise
from multiscale.numerics.newton import Limits

__all__ = ["solve_interface"]


def solve_interface(
    stiffness: csr_array | np.ndarray,
    load: np.ndarray,
    jump_operator: csr_array,
    weight: np.ndarray,
    law: InterfaceLaw,
    *,
    start: np.ndarray | None = None,
    state: np.ndarray | None = None,
    max_iterations: int = 100,
    tolerance: float = 1e-10,
    callback: Callable[[int, float], None] | None = None,
) -> Solution:
    r"""Solve linear elastic bodies joined by an interface law.

    Find :math:`u` such that

    .. math::
        K u + B^T (w\, t(B u)) = f,    \tag{1}

    the static problem (4)-(5) of the source with a law in place of the inequality.

    Parameters
    ----------
    stiffness : csr_array or ndarray, shape (n, n)
        :math:`K` of the bodies, N/m, supports already taken out. It may be singular as long as
        the closed interface holds the bodies.
    load : ndarray, shape (n,)
        External force :math:`f`, N.
    jump_operator : csr_array, shape (d * points, n)
        :math:`B`, dimensionless: all normal jumps first, then each tangent. Opening positive.
    weight : ndarray, shape (points,)
        Quadrature weights :math:`w`, m².
    law : InterfaceLaw
        Gives :math:`t` and its tangent, Pa and Pa/m.
    start : ndarray, shape (n,), optional
        First :math:`u`, m; zero if not given.
    state : ndarray, shape (law.n_state, points), optional
        Committed state of the law; zero if not given. It is not changed: commit by
        ``law.respond`` at the solution.
    max_iterations : int
        Iteration limit.
    tolerance : float
        Bound on the norm of (1) relative to ``norm(load)`` (without load: relative to the first
        residual); dimensionless.
    callback : callable, optional
        Called as ``callback(iteration, residual)``.

    Returns
    -------
    Solution
        ``value`` is :math:`u`, shape (n,), m.

    Raises
    ------
    ValueError
        If the shapes do not agree.

    See Also
    --------
    multiscale.macro.interface_newton.find_equilibrium : the iteration and its line search.
    """
    n, points = stiffness.shape[0], weight.size
    if load.shape != (n,) or jump_operator.shape[1] != n or jump_operator.shape[0] % points:
        raise ValueError(
            f"load ({n},) and jump_operator (d * {points}, {n}) must match stiffness and weight, "
            f"got {load.shape} and {jump_operator.shape}"
        )
    u = np.zeros(n) if start is None else np.array(start, dtype=float)
    state = np.zeros((law.n_state, points)) if state is None else state
    whole = _Whole(stiffness, load, jump_operator, weight, law, state)
    scale = float(norm(load)) or float(norm(whole.linearise(u).gradient)) or 1.0
    limits = Limits(max_iterations, tolerance, callback)
    return find_equilibrium(replace(whole, scale=scale), u, limits)


@dataclass(frozen=True, eq=False)
class _Whole:
    """Equation (1); the force that its residual is relative to, N."""

    stiffness: csr_array | np.ndarray
    load: np.ndarray
    jump_operator: csr_array
    weight: np.ndarray
    law: InterfaceLaw
    state: np.ndarray
    scale: float = 1.0

    def linearise(self, u: np.ndarray) -> InterfaceIterate:
        """Evaluate the law; the gradient is K u + B^T (w t) - f, N."""
        jump = (self.jump_operator @ u).reshape(-1, self.weight.size)
        response = self.law.respond(jump, self.state)
        force = self.jump_operator.T @ (self.weight * response.traction).ravel()
        gradient = self.stiffness @ u + force - self.load
        return InterfaceIterate(u, gradient, force, self.weight * response.tangent)

    def residual(self, here: InterfaceIterate) -> float:
        """Norm of (1) relative to the load."""
        return float(norm(here.gradient)) / self.scale

    def direction(self, here: InterfaceIterate, floor: float) -> np.ndarray | None:
        """Newton direction, m."""
        B, points, tangent = self.jump_operator, self.weight.size, here.tangent
        if floor:
            tangent = tangent.copy()
            tangent[0, 0] += floor * self._body_stiffness() * self.weight
        i, j, at = np.nonzero(tangent)
        place = (points * i + at, points * j + at)
        weighted = csr_array((tangent[i, j, at], place), shape=(B.shape[0],) * 2)
        matrix = self.stiffness + B.T @ (weighted @ B)  # K + B^T (w D) B
        matrix = csr_array(matrix) if issparse(matrix) else np.asarray(matrix)
        try:
            return -factorise(matrix, name="the tangent stiffness")(here.gradient)
        except MultiscaleError:
            return None

    def _body_stiffness(self) -> float:
        """Stiffness of the bodies per area of the interface, Pa/m."""
        touched = abs(self.jump_operator[: self.weight.size]).T @ self.weight
        diagonal = np.abs(self.stiffness.diagonal())
        return float(np.sum(diagonal[touched > 0.0]) / np.sum(touched))
