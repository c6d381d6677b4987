r"""Averages over the nominal area of forces on a contact surface, its spots, and its flow.

Spots are connected sets of contact nodes. The averages, eqs (2) and (3) of the source, are the sums
over all spots i of their tractions, projected on the mean plane :math:`n^0, a_a^0`,

.. math::
    \langle t_N \rangle_i = \frac{1}{\Gamma_c^0} \int_{\Gamma_c^i}
    (t_N^i n^i \cdot n^0 + t_T^i \cdot n^0)\, \mathrm{d}\Gamma, \qquad
    \langle t_T^a \rangle_i = \frac{1}{\Gamma_c^0} \int_{\Gamma_c^i}
    (t_N^i n^i \cdot a_a^0 + t_T^i \cdot a_a^0)\, \mathrm{d}\Gamma.    \tag{1}
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy

if TYPE_CHECKING:
    from skfem import Element, Mesh

TINY = np.finfo(float).tiny
LEVEL = 0.1  # of squares, step inwards over step before: 0 in an even pressure, 1 at a smooth edge


class EdgeLayer(NamedTuple):
    """Effect of a grid on forces at a straight edge, (1) of :func:`contact_areas`, in spacings."""

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

SPOTS = {"spot_area": (), "spot_traction": (3,), "spot_traction_by_normal": (3,)}
"""Variables of contact spots, and the shape of each variable for a single spot."""


@dataclass(frozen=True)
class Keep:
    """Variables of a response in addition to averages; see :func:`~multiscale.micro.solve_cell`."""

    fields: bool = False
    spots: bool = False
    flow: bool = False
    stress: bool = False


@dataclass(frozen=True, eq=False)
class ContactSurface:
    """Contact surface of a cell in equilibrium, with nodes in a grid, (nx, ny), or a list, (n,)."""

    force: np.ndarray  # (nx, 3, ny) or (n, 3), contact forces on the body, N
    normal: np.ndarray  # (nx, 3, ny) or (n, 3), unit normals into the obstacle
    pressing: np.ndarray  # force with which a node presses, N; 0 if it is free
    gap: np.ndarray  # vertical distance of each node to the obstacle, m
    node_area: np.ndarray  # nominal area of each node on the mean plane, m2
    weight: np.ndarray  # the same area in the current configuration, m2
    jump: np.ndarray  # (3,), mean displacement jump, normal component first, m
    mean_gap: float  # m
    edges: tuple[EdgeLayer, EdgeLayer] = (HALF_SPACE, HALF_SPACE)  # of contact, along x and y
    flowing: np.ndarray | bool = False  # nodes below which the material flows
    slip: tuple[float, float] | None = None  # share of slipping nodes, work of friction, J/m2
    flowing_share: float | None = None  # flowing over all points of a metal body
    recovered_force: np.ndarray | None = None  # (3,), contact force from the Cauchy stress, N
    neighbours: Callable[[], np.ndarray] | None = None  # pairs of nodes, (2, pairs), of a mesh
    to_grid: Callable[[np.ndarray], np.ndarray] = np.asarray  # nodal values to the fields' grid

    def on_grid(self, node: np.ndarray, edges: tuple[EdgeLayer, EdgeLayer]) -> "ContactSurface":
        """Arrange the nodes of a list on a periodic grid; ``node`` has the shape (nx, ny)."""
        scalars = {
            name: getattr(self, name)[node] for name in ("pressing", "gap", "node_area", "weight")
        }
        vectors = {
            name: np.moveaxis(getattr(self, name)[node], 2, 1) for name in ("force", "normal")
        }
        return replace(self, **scalars, **vectors, edges=edges, neighbours=None, to_grid=np.asarray)


def average_surface(
    surface: ContactSurface, keep: Keep, spacing: tuple[float, float] | None = None
) -> dict[str, Any]:
    """Average a contact surface; add the requested spots, flow and fields (ny, nx)."""
    area = float(np.sum(surface.node_area))
    real = contact_areas(
        surface.pressing, surface.weight, edges=surface.edges, flowing=surface.flowing
    )
    step: dict[str, Any] = {
        "traction": average_traction(surface.force, area),
        "displacement_jump": surface.jump,
        "mean_gap": surface.mean_gap,
        "contact_fraction": max(float(np.sum(real)) / area, 0.0),
    }
    # force along the normal, for spots and friction
    if keep.spots or surface.slip is not None:
        along = np.sum(surface.force * surface.normal, axis=1, keepdims=True)
        by_normal = along * surface.normal
    if surface.slip is not None:
        step["traction_by_normal"] = average_traction(by_normal, area)
        step["slip_fraction"], step["friction_work"] = surface.slip
    if surface.flowing_share is not None:
        step["flowing_fraction"] = surface.flowing_share
    if surface.recovered_force is not None:
        step["recovered_traction"] = to_components(surface.recovered_force) / area
    if keep.spots:
        step |= _spot_averages(surface, by_normal, real, area)
    if keep.fields or keep.flow:
        # below overhangs the projected area is zero or negative
        pressure, closed = np.zeros_like(surface.gap), surface.pressing != 0.0
        np.divide(-surface.force[:, 2], surface.node_area, out=pressure, where=closed)
        pressure, gap = surface.to_grid(pressure), surface.to_grid(surface.gap)
        if keep.fields:
            step |= {"pressure": pressure.T, "gap": gap.T}
        if keep.flow and spacing is not None:
            flows = [gap_flow(open_gap(gap, pressure), spacing, axis) for axis in (0, 1)]
            step["hydraulic_aperture"] = [flow.aperture for flow in flows]
            step["percolating_share"] = [flow.share for flow in flows]
    return step


def average_traction(force: np.ndarray, area: float) -> np.ndarray:
    """Average nodal forces, components along axis 1, over the nominal area: (2), (3)."""
    return to_components(np.sum(force, axis=(0, *range(2, force.ndim)))) / area


def to_components(vector: np.ndarray) -> np.ndarray:
    """Order components x, y, z along the last axis as normal, along x, along y."""
    return np.asarray(vector[..., [2, 0, 1]])


def _spot_averages(
    surface: ContactSurface, by_normal: np.ndarray, real: np.ndarray, area: float
) -> dict[str, np.ndarray]:
    """Share of every contact spot in the averages (2) and (3), largest spot first."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    # pairs of neighbouring nodes
    active = surface.pressing.ravel() > 0.0
    if surface.neighbours is None:
        number = np.arange(active.size).reshape(surface.pressing.shape)
        ahead = [np.roll(number, -1, axis).ravel() for axis in (0, 1)]
        first, second = np.tile(number.ravel(), 2), np.concatenate(ahead)
    else:
        first, second = surface.neighbours()
    # spots: connected components of the contact nodes, largest first
    joined = active[first] & active[second]
    links = coo_array(
        (joined[joined], (first[joined], second[joined])), shape=(active.size, active.size)
    )
    _, label = connected_components(links, directed=False)
    _, spot = np.unique(label[active], return_inverse=True)
    total = np.bincount(spot, real.ravel()[active]).astype(float)  # integer without spots
    order = np.argsort(-total, kind="stable")

    def share(forces: np.ndarray) -> np.ndarray:
        nodal = np.moveaxis(forces, 1, -1).reshape(-1, 3)[active]
        columns = [np.bincount(spot, column)[order] for column in nodal.T]
        return to_components(np.reshape(columns, (3, -1)).T) / area  # (1)

    return {
        "spot_area": total[order],
        "spot_traction": share(surface.force),
        "spot_traction_by_normal": share(by_normal),
    }


def pad_spots(values: list[np.ndarray], axis: int) -> list[np.ndarray]:
    """Extend arrays of spots along an axis to the length of the longest; new rows are NaN."""
    most = max(array.shape[axis] for array in values)
    padded = []
    for array in values:
        rows = [(0, 0)] * array.ndim
        rows[axis] = (0, most - array.shape[axis])
        padded.append(np.pad(array, rows, constant_values=np.nan))
    return padded


def recovered_force(
    mesh: "Mesh",
    element: "Element",
    displacement: np.ndarray,
    active: np.ndarray,
    lame: float | np.ndarray,
    shear: float | np.ndarray,
) -> np.ndarray:
    r"""Integrate :math:`\sigma n` over the contact spots from the Cauchy stress, N."""
    from skfem import CellBasis, FacetBasis

    top = mesh.boundaries["top"]
    facets = top[np.any(active[mesh.facets[:, top]], axis=0)]
    if not len(facets):
        return np.zeros(3)
    # means over elements: at a facet, a linear element mixes values of the facet and of its centre
    # mean stress of the elements behind the facets
    elements = mesh.f2t[0, facets]
    basis = CellBasis(mesh, element, elements=elements)
    gradient = np.array([basis.interpolate(component).grad for component in displacement])
    strain = np.sum(gradient * basis.dx, axis=-1) / np.sum(basis.dx, axis=-1)
    strain = 0.5 * (strain + np.swapaxes(strain, 0, 1))
    lame, shear = (np.broadcast_to(value, (mesh.nelements,))[elements] for value in (lame, shear))
    stress = 2.0 * shear * strain + lame * np.trace(strain) * np.eye(3)[:, :, None]
    # facet areas times outward normals
    facet_basis = FacetBasis(mesh, element, facets=facets)
    area = np.sum(np.asarray(facet_basis.normals) * facet_basis.dx, axis=-1)
    return np.asarray(np.einsum("ijf,jf->i", stress, area))


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
    r"""Real contact area of each node, m2, from the position of the contact edge.

    A straight edge along a row of nodes with the spacing :math:`h`, within which the pressure grows
    as the square root of the distance, is a problem of Wiener and Hopf (B. Noble, Methods Based on
    the Wiener-Hopf Technique, Pergamon Press, 1958). With the compliance :math:`C(\theta)` of the
    nodes at the wavenumber :math:`\theta / h` over :math:`C_0` of the continuous surface, and
    :math:`f = \ln (2 C \sin(\theta / 2) / (C_0\, \theta)) = a_0 + 2 \sum a_n \cos n \theta`,

    .. math::
        B = \frac14 + \frac{1}{4 \pi} \int_0^\pi \frac{f}{\sin^2(\theta / 2)}\, \mathrm{d}\theta,
        \qquad b = \frac12 - \frac1\pi \int_0^\pi f \cos \theta\, \mathrm{d}\theta.    \tag{1}

    Forces from the outermost node inwards have the generating function
    :math:`(\alpha + \beta z) (1 - z)^{-3/2} \exp(-\sum_{n > 0} a_n z^n)`, of which the square root
    far inside ends

    .. math:: s = \frac{1}{\lambda_1 / \lambda_0 - b} - B, \qquad
        \lambda_1 / \lambda_0 \ge 1 + b,    \tag{2}

    spacings beyond the outermost node, and each side adds :math:`s - \tfrac12` of the area of a
    node. Where :math:`\lambda^2` levels off at a node :math:`k \le 2` of a flowing material, with
    an even pressure, :math:`s = \tfrac12 - k + \sum_{i < k} \lambda_i / \lambda_k` (3).
    """
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
                # sides along x and y share an oblique edge by the squares of the slopes of lambda²
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
    # lambda_1² - lambda_0² is the slope of lambda² at the outermost node, of second order in the
    # spacing where lambda² is concave, as under a round asperity
    bend = np.where(third > 0.0, np.minimum(first - 2.0 * second + third, 0.0), 0.0)
    ratio = np.sqrt((second - 0.5 * bend) / np.maximum(first, TINY))
    least = 1.0 + edge.ratio
    place = 1.0 / (np.maximum(ratio, least) - edge.ratio) - edge.reach  # (2)
    # in spots of one or two nodes the forces may determine no place: the mean 1/2 - B
    return np.where((third > 0.0) | (ratio > least), place, 0.5 - edge.reach)


# --- flow of a liquid through the gap: Reynolds' equation where it is open --------------------

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
    """Solve for the flow through a gap by finite volumes; it bounds the permeability from above."""
    from scipy.sparse import coo_array, csc_array

    from multiscale.numerics.factorisation import symmetric_lu

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

    # div(h³ grad p) = 0 with an even pressure on both ends:
    #     h_eff³ = L / (W dp) ∫_W -h³ dp/dn ds  (1)
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
    total = a + b
    mean: np.ndarray = np.zeros_like(total)
    np.divide(2.0 * a * b, total, out=mean, where=total > 0.0)
    return mean


def _paths(is_open: np.ndarray) -> np.ndarray:
    """Mark points connected to both ends of the first axis; the second axis is periodic."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    labels, count = scipy.ndimage.label(is_open)
    across = is_open[:, 0] & is_open[:, -1]
    pairs = labels[across, 0], labels[across, -1]
    graph = coo_array((np.ones(pairs[0].size), pairs), shape=(count + 1, count + 1))
    cluster = connected_components(graph, directed=False)[1][labels]
    both = np.intersect1d(cluster[0][is_open[0]], cluster[-1][is_open[-1]])
    return np.asarray(is_open & np.isin(cluster, both))
