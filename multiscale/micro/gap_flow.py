"""Flow of a liquid through the gap of a cell: Reynolds' equation where it is open."""

from dataclasses import dataclass

import numpy as np
import scipy
from scipy.sparse import coo_array, csc_array
from scipy.sparse.csgraph import connected_components

from multiscale.numerics.factorisation import symmetric_lu

CLOSED = 1e-4
"""Relative to the largest gap: smaller gaps are closed, as contact solvers leave such errors."""

IMBALANCE = 1e-6  # relative difference of inflow and outflow above which the flow is NaN


@dataclass(frozen=True, eq=False)
class GapFlow:
    """Flow along an axis of a cell, driven by a pressure difference between its ends."""

    aperture: float  # m, of parallel walls with the same flow; 0 if closed, NaN out of balance
    share: float  # points on paths that lead through, over all points
    speed: np.ndarray  # (nx, ny), flow per width at every point over its mean along the axis


def open_gap(gap: np.ndarray, pressure: np.ndarray) -> np.ndarray:
    """Return the gap at points without pressure, m, and zero elsewhere."""
    free = np.where(pressure > 0.0, 0.0, gap)
    return np.where(free > CLOSED * free.max(initial=0.0), free, 0.0)


def gap_flow(gap: np.ndarray, spacing: tuple[float, float], axis: int) -> GapFlow:
    r"""Solve for the flow of a liquid through the gap of a cell.

    Finite volumes about the points, with harmonic means of :math:`h^3` between neighbours, solve

    .. math:: \nabla \cdot (h^3 \nabla p) = 0, \qquad
        h_\mathrm{eff}^3 = \frac{L}{W\, \Delta p} \int_W -h^3\, \partial_n p \, \mathrm{d}s
        \tag{1}

    where paths lead from one end to the other, with an even pressure on both ends. This bounds the
    permeability of the periodic cell from above.
    """
    h, (along, across) = (gap, spacing) if axis == 0 else (gap.T, spacing[::-1])
    through = _paths(h > 0.0)
    share = float(through.mean())
    if share == 0.0:
        return GapFlow(0.0, share, np.zeros(gap.shape))

    # conductances of half a spacing at the ends, and between neighbours
    largest, ratio = float(h.max()), across / along
    k = np.where(through, h / largest, 0.0) ** 3
    inlet, outlet = 2.0 * ratio * k[0], 2.0 * ratio * k[-1]  # half a spacing from the ends
    forward = ratio * _harmonic_mean(k[:-1], k[1:])
    sideward = _harmonic_mean(k, np.roll(k, -1, axis=1)) / ratio

    # matrix of the open points
    number = np.cumsum(through).reshape(h.shape) - 1
    i = np.concatenate([number[:-1].ravel(), number.ravel()])
    j = np.concatenate([number[1:].ravel(), np.roll(number, -1, axis=1).ravel()])
    c = np.concatenate([forward.ravel(), sideward.ravel()])
    i, j, c = i[c > 0.0], j[c > 0.0], c[c > 0.0]
    size = int(through.sum())
    conductance = np.zeros((2, *h.shape))
    conductance[0, 0], conductance[1, -1] = inlet, outlet
    ends = conductance[:, through]
    diagonal = ends.sum(axis=0) + np.bincount(i, c, size) + np.bincount(j, c, size)
    point = np.arange(size)
    row, column = np.concatenate([point, i, j]), np.concatenate([point, j, i])
    matrix = coo_array((np.concatenate([diagonal, -c, -c]), (row, column)), shape=(size, size))

    # pressure 1 at either end and 0 at the other: neither flow is a difference of near numbers
    down, up = symmetric_lu(csc_array(matrix)).solve(ends.T).T
    flow, back = float(ends[1] @ down), float(ends[0] @ up)
    if not abs(flow - back) <= IMBALANCE * flow:
        return GapFlow(np.nan, share, np.full(gap.shape, np.nan))
    n, m = h.shape
    aperture = largest * np.cbrt(flow * n / (m * ratio))  # (1)

    # speed at the points: mean of the flows on both sides
    p = np.zeros(h.shape)
    p[through] = down
    steps = np.concatenate([[inlet * (1.0 - p[0])], forward * (p[:-1] - p[1:]), [outlet * p[-1]]])
    aside = sideward * (p - np.roll(p, -1, axis=1)) * ratio
    speed = 0.5 * np.hypot(steps[:-1] + steps[1:], aside + np.roll(aside, 1, axis=1)) * m / flow
    return GapFlow(float(aperture), share, speed if axis == 0 else speed.T)


def _harmonic_mean(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Harmonic mean, zero where a or b is zero."""
    total = a + b
    mean: np.ndarray = np.zeros_like(total)
    np.divide(2.0 * a * b, total, out=mean, where=total > 0.0)
    return mean


def _paths(is_open: np.ndarray) -> np.ndarray:
    """Mark points connected to both ends of the first axis; the second axis is periodic."""
    labels, count = scipy.ndimage.label(is_open)
    across = is_open[:, 0] & is_open[:, -1]
    pairs = labels[across, 0], labels[across, -1]
    graph = coo_array((np.ones(pairs[0].size), pairs), shape=(count + 1, count + 1))
    cluster = connected_components(graph, directed=False)[1][labels]
    both = np.intersect1d(cluster[0][is_open[0]], cluster[-1][is_open[-1]])
    return np.asarray(is_open & np.isin(cluster, both))
