r"""Equilibrium of links past limit points, by the length of the path of displacement and load [1]_.

From a point :math:`(u_0, \lambda_0)` with the direction :math:`(\dot u, \dot\lambda)`, with the
length U of the first linear displacement and the load factor :math:`\Lambda` to reach,

.. math::
    f(u) - \lambda F^d = 0, \qquad
    \dot u \cdot (u - u_0) / U^2 + \dot\lambda\, (\lambda - \lambda_0) / \Lambda^2 = h.    \tag{1}

.. [1] H. B. Keller, in Applications of Bifurcation Theory (1977) 359-384.
"""

from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.linalg import norm
from scipy.sparse import block_array, csr_array
from scipy.sparse.linalg import eigsh

from multiscale.convergence import Solution, Status, check_limits
from multiscale.errors import CaseError, ConvergenceError, MultiscaleError
from multiscale.macro.links.link_equations import LinkEquations, LinkState, equations, force_scale
from multiscale.macro.links.link_newton import RESIDUAL_STIFFNESS
from multiscale.macro.links.link_system import LinkSystem, check_supports
from multiscale.macro.links.mechanisms import smallest_eigenvalue
from multiscale.macro.links.statics import FiniteLinks, join_steps, step_values
from multiscale.numerics.factorisation import factorise
from multiscale.schema import MACRO_RESULT, Dataset

FIRST, SHORTEST, LONGEST = 0.02, 1e-7, 0.1
"""First, shortest and longest distance of two points, relative to the scales of (1)."""

ITERATIONS, FEW = 15, 4
"""Limit of the iterations of a point, and number with which the distance stays the same."""

HALVINGS = 60  # limit of the steps towards a critical point
CRITICAL = 1e-9  # width, relative to the distance of two points, at which it is reached
DENSE, ROUNDING = 500, 1e-10
"""Unknowns up to which the mode is computed by a dense matrix; shift of the sparse matrix."""

LATERAL = 1e-6  # work of the load on the mode, relative to both, up to which the point bifurcates


@dataclass(frozen=True, eq=False)
class _Point:
    """Point of the path with the direction in which the path leaves it."""

    x: np.ndarray  # displacement, m, and load factor, (n + 1,)
    ahead: np.ndarray  # direction of length 1 in the scales, (n + 1,)
    eigenvalue: float  # smallest of the tangent, N/m
    residual: float  # relative to the load
    iterations: int
    seconds: float


class _Path:
    """The path (1) of a structure."""

    def __init__(self, system: LinkSystem, target: float, tolerance: float) -> None:
        self.model: LinkEquations = equations(system)
        self.links = FiniteLinks(system, self.model)
        self.scale = force_scale(self.model, target * self.model.load)
        self.tolerance, n = tolerance, self.model.n
        try:
            first = factorise(self.tangent(np.zeros(n)), name="the tangent of the links")
        except MultiscaleError as error:
            raise CaseError(
                f"the unloaded links are a mechanism, so no path starts from rest: {error}; give "
                f"them a prestress"
            ) from error
        length = float(norm(first(target * self.model.load))) or 1.0
        self.weight = np.append(np.full(n, length**-2.0), target**-2.0)
        self.load_only = np.append(np.zeros(n), np.sign(target))

    def entries(self, u: np.ndarray) -> np.ndarray:
        """Upper triangle of the exact tangent, N/m."""
        shape, k = self.links.shape(u), self.model.stiffness
        along = k * np.where(shape.tension == shape.elastic, 1.0, RESIDUAL_STIFFNESS)
        across = shape.tension / shape.length
        return self.model.tangent.geometric(shape.direction, along, across)

    def tangent(self, u: np.ndarray) -> csr_array:
        """Exact tangent, (n, n), N/m."""
        return self.model.tangent.matrix(self.entries(u))

    def residual(self, x: np.ndarray) -> np.ndarray:
        """Residual force, (n,), N."""
        return self.links.residual(self.links.shape(x[:-1]), x[-1])

    def change(self, x: np.ndarray, row: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Solve the linear equations of (1) with a row for the last."""
        load = csr_array(-self.model.load[:, None])
        last = csr_array(row[None])
        matrix = block_array([[self.tangent(x[:-1]), load], [last[:, :-1], last[:, -1:]]])
        return factorise(csr_array(matrix), name="the tangent of the path")(right)

    def point(
        self, x: np.ndarray, row: np.ndarray, goal: float, before: np.ndarray
    ) -> _Point | None:
        """Solve (1) from a start, with the inner product of x with the row; None if it fails."""
        begin, stiffest = perf_counter(), float(self.model.stiffness.max())
        for iteration in range(ITERATIONS):
            force = self.residual(x)
            size = float(np.abs(force).max())
            rounding = 8.0 * np.finfo(float).eps * stiffest * float(np.abs(x[:-1]).max())
            missing = goal - float(row @ x)
            try:
                if size <= max(self.tolerance * self.scale, rounding) and iteration:
                    ahead = self.change(x, self.weight * before, self.unit)
                    ahead /= np.sqrt(ahead @ (self.weight * ahead))
                    value = smallest_eigenvalue(self.model.tangent, self.entries(x[:-1]))
                    seconds = perf_counter() - begin
                    return _Point(x, ahead, value, size / self.scale, iteration, seconds)
                x = x + self.change(x, row, np.append(force, missing))
            except MultiscaleError:
                return None
            if not np.isfinite(x).all():
                return None
        return None

    @property
    def unit(self) -> np.ndarray:
        """Right-hand side of a direction."""
        return np.append(np.zeros(self.model.n), 1.0)

    def advance(self, last: _Point, distance: float) -> _Point | None:
        """Return the point at a distance from the last."""
        row = self.weight * last.ahead
        start = last.x + distance * last.ahead
        return self.point(start, row, float(row @ start), last.ahead)


def solve_past_limit(
    system: LinkSystem,
    load_factor: float = 1.0,
    *,
    max_steps: int = 400,
    tolerance: float = 1e-10,
) -> Dataset:
    r"""Follow the equilibrium of links from rest to a load factor, also where the load must fall.

    Elongations and directions are exact, as in :func:`solve_static` with ``exact``.

    Parameters
    ----------
    system : LinkSystem, extensible links without beams; not a mechanism without load
    load_factor : float, where the path ends when it first gets there, dimensionless
    max_steps : int, limit of the points of the path
    tolerance : float, bound on the largest residual force relative to the largest nodal load

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``, with a ``step`` for each point: ``load_factor``, tension,
        displacement and ``stability_eigenvalue``, the smallest of the exact tangent, N/m. At the
        first zero of this eigenvalue, which is a step too, ``critical_factor`` and
        ``critical_mode (node component)``, of largest component 1; the attribute ``critical`` is
        ``"limit point"`` where the load works on the mode, else ``"bifurcation"``. The path stays
        on its branch there. A path that does not end has the attribute ``failure``.

    Raises
    ------
    CaseError
        If the load factor is zero or not finite, there is no load, or links do not fit.
    ConvergenceError
        If the state at rest has no equilibrium.
    """
    check_limits(tolerance, max_steps)
    if not np.isfinite(load_factor) or load_factor == 0.0:
        raise CaseError(f"load_factor of a path must be finite and not zero, got {load_factor}")
    if system.n_components == 6 or np.isinf(system.stiffness).any():
        raise CaseError("a path past limit points needs extensible links without beams")
    check_supports(system)
    path = _Path(system, load_factor, tolerance)
    model = path.model
    if not np.any(model.load):
        raise CaseError("a path past limit points needs a load on free nodes")

    # equilibrium at rest, then point by point
    start = path.point(np.zeros(model.n + 1), path.load_only, 0.0, path.load_only)
    if start is None:
        raise ConvergenceError("the links have no equilibrium at rest from which a path starts")
    points, distance, failure, critical = [start], FIRST, "", -1
    while len(points) < max_steps:
        last = points[-1]
        following = path.advance(last, distance)
        if following is None or following.ahead @ (path.weight * last.ahead) < 0.5:
            distance *= 0.5
            if distance < SHORTEST:
                failure = f"the path stops at the load factor {last.x[-1]:.6g}"
                break
            continue
        if critical < 0 and last.eigenvalue > 0.0 >= following.eigenvalue:
            points.append(_critical_point(path, last, distance))
            critical = len(points) - 1
        if following.x[-1] / load_factor >= 1.0:
            goal = abs(load_factor)
            end = path.point(following.x, path.load_only, goal, following.ahead)
            if end is not None:
                points.append(end)
                break
        points.append(following)
        distance = min(distance * np.sqrt(FEW / following.iterations), LONGEST)
    else:
        failure = f"the path is at the load factor {points[-1].x[-1]:.6g} after {max_steps} steps"

    # variables of the points
    columns = [_values(system, path, point) for point in points]
    result = join_steps(system, np.array([point.x[-1] for point in points]), columns)
    if failure:
        result = result.assign_attrs(failure=failure)
    return result if critical < 0 else _with_mode(result, path, points[critical])


def _critical_point(path: _Path, last: _Point, distance: float) -> _Point:
    """Bisect the distance at which the smallest eigenvalue passes zero."""
    low, high, best = 0.0, distance, last
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        point = path.advance(last, middle)
        if point is None or high - low <= CRITICAL * distance:
            break
        low, high = (middle, high) if point.eigenvalue > 0.0 else (low, middle)
        best = point
    return best


def _values(system: LinkSystem, path: _Path, point: _Point) -> dict[str, object]:
    shape = path.links.shape(point.x[:-1])
    solution = Solution(point.x[:-1], Status.CONVERGED, (point.residual,))
    slack = np.abs(shape.tension - shape.elastic) / path.model.stiffness
    values = step_values(system, path.model, LinkState(solution, shape.tension, slack))
    return values | {
        "stability_eigenvalue": point.eigenvalue,
        "iterations": point.iterations,
        "wall_time": point.seconds,
    }


def _with_mode(result: Dataset, path: _Path, point: _Point) -> Dataset:
    """Add the load factor, mode and kind of the critical point."""
    model = path.model
    tangent = path.tangent(point.x[:-1])
    if model.n < DENSE:
        mode = np.linalg.eigh(tangent.toarray())[1][:, 0]
    else:
        shift = ROUNDING * float(np.abs(tangent.diagonal()).max())
        mode = eigsh(tangent, 1, sigma=-shift, v0=np.ones(model.n))[1][:, 0]
    works = abs(float(mode @ model.load)) > LATERAL * float(norm(mode) * norm(model.load))
    at_nodes = model.at_nodes(mode)[:, :3]
    at_nodes /= at_nodes.flat[np.argmax(np.abs(at_nodes))]
    values = {"critical_factor": point.x[-1], "critical_mode": at_nodes}
    kind = "limit point" if works else "bifurcation"
    return MACRO_RESULT.assign(result, values).assign_attrs(critical=kind)
