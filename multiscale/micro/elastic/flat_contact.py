r"""Contact on a flat reference surface, by projected gradients on its compliance."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from multiscale.convergence import Solution, Status, check_limits
from multiscale.errors import CaseError
from multiscale.micro.elastic.lateral_fft import SurfaceFilter
from multiscale.numerics.compiled import compiled
from multiscale.numerics.vectors import dot

_GAIN = 0.03  # reduction of the residual in single precision, on the nodes near contact
_NEAR = 0.02  # largest distance of a node near contact, over the range of the gap
_EXACT = 1e-4  # error of the load after a step, relative to the residual
_FINE = 256  # fewest points along an edge for a first guess on every other point,
_COARSE = 3e-3  # and the tolerance of this guess
_ROUNDING = 1e-12  # relative rounding of the difference of two squares
_MATH = {"reassoc", "contract", "nnan", "nsz"}  # of kernels: numbers may be infinite, as the cap


@dataclass(frozen=True)
class FlatSolution(Solution):
    """Contact forces, N, as ``value``, and the approach, m."""

    approach: float = 0.0


def solve_flat(
    compliance: Callable[[np.ndarray], np.ndarray],
    gap: np.ndarray,
    closing: np.ndarray,
    *,
    load: float | None = None,
    approach: float | None = None,
    cap: float = np.inf,
    start: np.ndarray | None = None,
    max_iterations: int = 500,
    tolerance: float = 1e-4,
) -> FlatSolution:
    r"""Minimise the complementary energy of contact forces on a surface by projected gradients.

    .. math::
        0 \le \lambda \perp C \lambda + g - b\,\delta \ge 0, \qquad b^t \lambda = F, \qquad
        \lambda \le \lambda_{max},    \tag{1}

    where surfaces may overlap at the cap :math:`\lambda_{max}` of the forces.
    """
    check_limits(tolerance, max_iterations)
    if load is not None and load > cap * float(np.sum(closing)):
        raise CaseError(
            f"the load of {load:.4g} N is more than the {cap * float(np.sum(closing)):.4g} N that "
            f"the whole surface carries at its hardness; lower the pressure"
        )
    shape, gap, closing = gap.shape, np.ravel(gap), np.ravel(closing)

    def respond(force: np.ndarray) -> np.ndarray:
        return np.asarray(compliance(force.reshape(shape)), force.dtype).ravel()

    # Step lengths of Barzilai and Borwein in turn and the exact minimum along the feasible
    # direction (Y.-H. Dai and R. Fletcher, Math. Program. 106 (2006) 403-421,
    # doi:10.1007/s10107-005-0595-2): one product with C in an iteration, in single precision for
    # nodes near contact; all nodes are checked in double precision each time that the residual has
    # fallen to 3/100, and at the end.
    # first forces, in the box and with the load
    delta = 0.0 if approach is None else approach
    first = closing * delta - gap if load is None else closing
    guess = None if start is None or not start.any() else np.ravel(start)
    forces = np.clip(first if guess is None else guess, 0.0, cap)
    if load is not None:
        forces *= load / dot(closing, forces)
        state = forces, np.zeros_like(forces), closing, 1.0, cap
        forces = np.clip(forces + closing * _approach(*state, load, 0.0, 0.0), 0.0, cap)
    elif guess is None:
        forces *= dot(forces, forces) / dot(forces, respond(forces))
        forces = np.minimum(forces, cap)
    moved = respond(forces)
    scale = float(np.ptp(gap)) or float(np.max(np.abs(moved))) or 1.0
    step, unit = dot(forces, forces) / dot(forces, moved), float(np.max(forces))
    if load is not None:
        delta = dot(forces, moved + gap) / load
    node, force = np.arange(gap.size), forces
    status, residuals, bound = Status.MAX_ITERATIONS, list[float](), np.inf
    residual = 0.0  # of the last iteration
    for iteration in range(max_iterations):
        for fresh in (iteration == 0, True):
            if fresh:  # all nodes, in double precision
                forces[node] = force
                apart = (respond(forces) if iteration else moved) + gap
                near = (forces > 0.0) | (apart - closing * delta < _NEAR * scale)
                room = delta + float(np.min((apart - closing * delta)[~near], initial=np.inf))
                node = np.flatnonzero(near)
                force, opening, closes = forces[node], apart[node], closing[node]
                direction = np.empty(node.size)
                spread = np.zeros(gap.size, np.float32)
            state = force, opening, closes, step, cap
            if load is not None:
                delta = _approach(*state, load, delta, _EXACT * residual)
            sums = _project(*state, delta, direction, node, unit, spread)
            deepest, slope, length, distance, carried = sums
            among_near = max(distance / (carried or 1.0), deepest) / scale
            residual = max(among_near, (delta - room) / scale)
            if fresh or among_near > bound:
                break
        residuals.append(residual)
        if fresh:
            bound = max(_GAIN * residual, tolerance)
            if residual <= tolerance:
                status = Status.CONVERGED
                break
        # exact minimum along the feasible direction, and the next step length
        sums = _advance(*state, delta, direction, node, unit, respond(spread), slope)
        curvature, along, across, squared, raised, free = sums
        if not curvature > 0.0:
            if fresh:  # the minimum up to rounding
                status = Status.STALLED
                break
            bound = np.inf
            continue
        step = length / curvature
        if iteration % 2:  # in the tangent of the box, and of the load
            mean = raised / free if load is not None and free > 0.0 else 0.0
            along, tangent = along - mean * across, squared - mean * raised
            if along > 0.0 and tangent > _ROUNDING * squared:
                step = along / tangent
    forces[node] = force
    return FlatSolution(forces.reshape(shape), status, tuple(residuals), approach=delta)


def coarse_start(
    compliance: SurfaceFilter, gap: np.ndarray, closing: np.ndarray, *, load: float, cap: float
) -> np.ndarray | None:
    """Guess the forces under a load from a solution on every other point; None on odd grids."""
    if min(gap.shape) < _FINE or gap.shape[0] % 2 or gap.shape[1] % 2:
        return None
    problem, cap = (compliance.coarse, gap[::2, ::2], closing[::2, ::2]), 4.0 * cap
    guess = coarse_start(*problem, load=load, cap=cap)
    forces = solve_flat(*problem, load=load, cap=cap, start=guess, tolerance=_COARSE).value
    for axis in (0, 1):
        between = 0.5 * (forces + np.roll(forces, -1, axis))
        rows = np.stack([forces, between], axis + 1)
        forces = rows.reshape(gap.shape[0], -1)
    return 0.25 * forces


@compiled
def _approach(force, opening, closing, step, cap, load, delta, tolerance):  # type: ignore[no-untyped-def]
    """Solve for the approach at which the projected forces after a step carry the load."""
    low, high, reach = -np.inf, np.inf, load / step
    for _ in range(200):
        carried, slope = _carry(force, opening, closing, step, cap, delta)
        excess = carried - load
        if abs(excess) <= max(tolerance, 1e-14) * load:
            break
        if excess > 0.0:
            high = delta
        else:
            low = delta
        new = delta - excess / slope if slope > 0.0 else np.nan
        if not low < new < high:
            new = 0.5 * (low + high)
            if not np.isfinite(new):
                new = delta - np.sign(excess) * reach
                reach *= 2.0
        if new == delta:
            break
        delta = new
    return delta


@compiled(fastmath=_MATH)
def _carry(force, opening, closing, step, cap, delta):  # type: ignore[no-untyped-def]
    load, slope = 0.0, 0.0
    for i in range(force.size):
        moved = force[i] - step * (opening[i] - closing[i] * delta)
        boxed = min(max(moved, 0.0), cap)
        load += closing[i] * boxed
        slope += step * closing[i] * closing[i] if moved == boxed else 0.0
    return load, slope


@compiled(fastmath=_MATH)
def _project(  # type: ignore[no-untyped-def]
    force, opening, closing, step, cap, delta, direction, node, unit, spread
):
    """Write the projected step; return overlap, two products, complementarity and total force."""
    slope, length, distance, carried, deepest = 0.0, 0.0, 0.0, 0.0, -np.inf
    for i in range(force.size):
        apart = opening[i] - closing[i] * delta
        change = min(max(force[i] - step * apart, 0.0), cap) - force[i]
        direction[i] = change
        slope += change * apart
        length += change * change
        carried += force[i]
        full = force[i] >= cap  # here the surfaces may overlap
        overlap = 0.0 if full else -apart
        deepest = overlap if overlap > deepest else deepest  # max() takes twice as long
        distance += force[i] * max(apart, overlap)
    per_unit = 1.0 / unit
    for i in range(force.size):
        spread[node[i]] = per_unit * direction[i]
    return deepest, slope, length, distance, carried


@compiled(fastmath=_MATH)
def _advance(  # type: ignore[no-untyped-def]
    force, opening, closing, step, cap, delta, direction, node, unit, response, slope
):
    """Go to the minimum of the energy on the way, or as far as it leads; return products."""
    # of the way and the change of the opening; over the forces that a step leaves within their box,
    # of change and way, closing and way, change and itself, closing and change, closing and itself
    curvature, along, across, squared, raised, free = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(force.size):
        curvature += direction[i] * (unit * response[node[i]])
    if not curvature > 0.0:
        return curvature, along, across, squared, raised, free
    share = min(1.0, -slope / curvature)
    for i in range(force.size):
        change = unit * response[node[i]]
        moved = force[i] - step * (opening[i] - closing[i] * delta)
        inside = 1.0 if (moved > 0.0) & (moved < cap) else 0.0
        along += inside * direction[i] * change
        across += inside * direction[i] * closing[i]
        squared += inside * change * change
        raised += inside * change * closing[i]
        free += inside * closing[i] * closing[i]
        force[i] += share * direction[i]
        opening[i] += share * change
    return curvature, along, across, squared, raised, free
