r"""Real contact area: position of the contact edge between two nodes.

Towards the edge of a smooth contact the pressure falls as the square root of the distance. A
straight edge along a row of nodes with the spacing :math:`h` is a problem of Wiener and Hopf. With
the compliance :math:`C(\theta)` of the nodes at a wavenumber :math:`q = \theta / h`, over
:math:`C_0` of the continuous surface,

.. math::
    f(\theta) &= \ln \left( \frac{C}{C_0}\, \frac{2 \sin(\theta / 2)}{\theta} \right),
    \qquad 0 \le \theta \le \pi, \\
    B &= \frac14 + \frac{1}{4 \pi} \int_0^\pi \frac{f}{\sin^2(\theta / 2)}\, \mathrm{d}\theta,
    \qquad b = \frac12 - \frac1\pi \int_0^\pi f \cos \theta\, \mathrm{d}\theta.    \tag{1}

The forces :math:`\lambda_0, \lambda_1, \ldots` of the nodes, from the outermost node inwards, have
the generating function :math:`(\alpha + \beta z) (1 - z)^{-3/2} e^{-f_+(z)}` with the part
:math:`f_+ = \sum_{n > 0} a_n z^n` of :math:`f = a_0 + 2 \sum a_n \cos n \theta`. Its first two
terms give :math:`\alpha / \beta`. At :math:`z = 1` it gives the square root far inside, which ends

.. math:: s = \frac{1}{\lambda_1 / \lambda_0 - b} - B    \tag{2}

spacings beyond the outermost node, where :math:`b = \tfrac12 - a_1` and
:math:`B = \tfrac14 - \sum n a_n`. As the edge moves by one spacing, :math:`\lambda_1 / \lambda_0`
falls from infinity to :math:`1 + b`; there the next node comes into contact.

Each contact node counts with its area, and each side on which the next node is free adds
:math:`s - \tfrac12` of it. In (2), :math:`\lambda_1^2 - \lambda_0^2` is the slope of
:math:`\lambda^2` at the outermost node, of second order in the spacing where :math:`\lambda^2` is
concave, as under a round asperity. :math:`\lambda_1 / \lambda_0` is taken as at least
:math:`1 + b`; where it is less in spots of one or two nodes, no place follows from the forces, and
:math:`s` is its mean :math:`\tfrac12 - B`. Sides along x and y share an oblique edge by the squares
of the slopes of :math:`\lambda^2`.

Under a flowing material the pressure is even and drops at once. If :math:`\lambda^2`, which rises
by equal steps inside a smooth edge, levels off at a flowing node :math:`k \le 2` (by less than a
tenth of the step before), that node is full, and the nodes outside it are full by the shares of
its force that they carry,

.. math:: s = \tfrac12 - k + \sum_{i < k} \lambda_i / \lambda_k.    \tag{3}

References
----------
.. [1] B. Noble, Methods Based on the Wiener-Hopf Technique, Pergamon Press, 1958: the method.
"""

from typing import NamedTuple

import numpy as np

TINY = np.finfo(float).tiny
LEVEL = 0.1  # of squares, step inwards over step before: 0 in an even pressure, 1 at a smooth edge


class EdgeLayer(NamedTuple):
    """Effect of a grid on the forces at a straight edge of contact, (1), in spacings."""

    reach: float  # B: how far contact nodes reach beyond half a spacing from the edge, in the mean
    ratio: float  # b


def edge_layer(compliance_ratio: np.ndarray) -> EdgeLayer:
    """Evaluate (1) from ratios of nodal to continuous compliance at theta from 0 to pi."""
    theta = np.linspace(0.0, np.pi, len(compliance_ratio))[1:]
    f = np.log(compliance_ratio[1:] * 2.0 * np.sin(0.5 * theta) / theta)
    start = f[0] - (f[1] - f[0]) / 3.0 if len(f) > 1 else f[0]  # even in theta
    f = np.concatenate([[0.0], f - start])
    theta = np.concatenate([[0.0], theta])
    weighted = f[1:] / np.sin(0.5 * theta[1:]) ** 2
    weighted = np.concatenate([weighted[:1], weighted])
    return EdgeLayer(
        float(0.25 + np.trapezoid(weighted, theta) / (4.0 * np.pi)),
        float(0.5 - np.trapezoid(f * np.cos(theta), theta) / np.pi),
    )


HALF_SPACE = edge_layer(np.ones(65))
"""The exact compliance of a flat surface, by the Fourier series of the nodes."""


def contact_fraction(
    force: np.ndarray,
    weight: np.ndarray,
    *,
    edges: tuple[EdgeLayer, EdgeLayer] = (HALF_SPACE, HALF_SPACE),
    flowing: np.ndarray | bool = False,
) -> float:
    """Real over nominal contact area."""
    area = contact_areas(force, weight, edges=edges, flowing=flowing)
    return max(float(np.sum(area)) / float(np.sum(weight)), 0.0)


def contact_areas(
    force: np.ndarray,
    weight: np.ndarray,
    *,
    edges: tuple[EdgeLayer, EdgeLayer] = (HALF_SPACE, HALF_SPACE),
    flowing: np.ndarray | bool = False,
) -> np.ndarray:
    """Real contact area that each node stands for, m2."""
    active = force > 0.0
    area = np.where(active, weight, 0.0)
    if force.ndim == 2 and active.any() and not active.all():
        may_flow, flows = np.broadcast_to(flowing, force.shape), np.any(flowing)
        square = np.maximum(force, 0.0)
        square /= np.max(force)
        square *= square
        for axis, edge in enumerate(edges):
            for side in (1, -1):
                # outermost contact nodes of this side, and squared forces inwards
                edge_nodes = np.flatnonzero(active & ~np.roll(active, -side, axis))
                outer = np.unravel_index(edge_nodes, force.shape)
                inner = [_shifted(outer, axis, -k * side, force.shape) for k in range(4)]
                inwards = [square[nodes] for nodes in inner]
                sides = [square[_shifted(outer, 1 - axis, k, force.shape)] for k in (-1, 1)]
                # share of this side in an oblique edge
                along = np.maximum(inwards[1] - inwards[0], inwards[0]) ** 2  # free outside
                across = _fall(sides[0], inwards[0], sides[1])
                share = weight[outer] * along / np.maximum(along + across, TINY)
                # position of the edge, smooth or at a flowing node
                place = _smooth_edge(inwards, edge)
                for k in (2, 1, 0) if flows else ():
                    before = inwards[k - 1] if k else 0.0
                    full = inwards[k + 1] - inwards[k] <= LEVEL * (inwards[k] - before)
                    full &= (inwards[k] > 0.0) & may_flow[inner[k]]
                    shares = [np.sqrt(node / np.maximum(inwards[k], TINY)) for node in inwards[:k]]
                    place = np.where(full, 0.5 - k + sum(shares), place)  # (3)
                area[outer] += share * (place - 0.5)
    return area


def _shifted(
    nodes: tuple[np.ndarray, ...], axis: int, steps: int, shape: tuple[int, ...]
) -> tuple[np.ndarray, ...]:
    """Shift nodes of a periodic grid by a number of steps along an axis."""
    moved = list(nodes)
    moved[axis] = (nodes[axis] + steps) % shape[axis]
    return tuple(moved)


def _fall(low: np.ndarray, here: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Squared slope of squared forces along an axis at contact nodes; one-sided at an edge."""
    both = (low > 0.0) & (high > 0.0)
    steepest = np.maximum(np.maximum(low, high) - here, here)
    return np.asarray(np.where(both, 0.5 * (high - low), steepest) ** 2)


def _smooth_edge(inwards: list[np.ndarray], edge: EdgeLayer) -> np.ndarray:
    """Position (2) of an edge with a square root of the pressure, from squared forces."""
    first, second, third = inwards[:3]
    bend = np.where(third > 0.0, np.minimum(first - 2.0 * second + third, 0.0), 0.0)
    ratio = np.sqrt((second - 0.5 * bend) / np.maximum(first, TINY))
    least = 1.0 + edge.ratio
    place = 1.0 / (np.maximum(ratio, least) - edge.ratio) - edge.reach  # (2)
    return np.where((third > 0.0) | (ratio > least), place, 0.5 - edge.reach)
