"""Kernels: integrals over elements, and over the common area of the facets of two faces."""

import numpy as np

from multiscale.numerics.compiled import compiled

SLIVER = 1e-12  # intersections smaller than this share of their facet are left out

# seven points of degree 5 on the triangle: barycentric coordinates and weights
_A, _B = (6.0 - np.sqrt(15.0)) / 21.0, (6.0 + np.sqrt(15.0)) / 21.0
_WA, _WB = (155.0 - np.sqrt(15.0)) / 1200.0, (155.0 + np.sqrt(15.0)) / 1200.0
POINTS = np.array(
    [[1 / 3, 1 / 3, 1 / 3]]
    + [[1 - 2 * c if k == i else c for k in range(3)] for c in (_A, _B) for i in range(3)]
)
WEIGHTS = np.array([9.0 / 40.0, _WA, _WA, _WA, _WB, _WB, _WB])


def integrate_pairs(
    x: tuple[np.ndarray, np.ndarray],
    normals: tuple[np.ndarray, np.ndarray],
    numbers: tuple[int, int],
    reach: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of facets, with corners (facets, corners, d), that overlap, and their D and M, m²."""
    if x[0].shape[2] == 2:
        return _integrate_segments(*x, *normals, reach)
    return _integrate_polygons(x, normals, numbers, reach)


def _integrate_segments(
    x1: np.ndarray, x2: np.ndarray, n1: np.ndarray, n2: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of segments and their blocks of (1)."""
    length = np.linalg.norm(n1, axis=1)
    along = (x1[:, 1] - x1[:, 0]) / length[:, None] ** 2
    # ends of side 2 in the coordinate 0..1 of side 1
    s = np.einsum("pd,pqcd->pqc", along, x2[None] - x1[:, None, :1])
    low, high = np.clip(s.min(axis=2), 0.0, 1.0), np.clip(s.max(axis=2), 0.0, 1.0)
    away = np.einsum("pd,pqd->pq", n1, x2.mean(axis=1)[None] - x1.mean(axis=1)[:, None])
    near = np.abs(away) <= reach * length[:, None]
    first, second = np.nonzero((high - low > SLIVER) & (n1 @ n2.T < 0.0) & near)
    low, high, s = low[first, second], high[first, second], s[first, second]
    D, M = np.zeros((2, len(first), 2, 2))
    for point in (0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0)):
        r = low + point * (high - low)
        t = (r - s[:, 0]) / (s[:, 1] - s[:, 0])
        weight = 0.5 * (high - low) * length[first]
        N1, N2 = np.stack([1.0 - r, r], axis=1), np.stack([1.0 - t, t], axis=1)
        D += (weight[:, None] * N1)[:, :, None] * N1[:, None, :]
        M += (weight[:, None] * N1)[:, :, None] * N2[:, None, :]
    return first, second, D, M


def _integrate_polygons(
    x: tuple[np.ndarray, np.ndarray],
    normals: tuple[np.ndarray, np.ndarray],
    numbers: tuple[int, int],
    reach: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of triangles or quadrilaterals and their blocks."""
    (x1, x2), (n1, n2) = x, normals
    unit = n1 / np.linalg.norm(n1, axis=1, keepdims=True)
    circles = []
    for corners in x:
        centre = corners.mean(axis=1)
        radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
        circles.append(np.concatenate([centre, radius[:, None]], axis=1))
    first, second = np.nonzero(_facing(*circles, unit, n2, reach))
    # plane of every facet of side 1
    t1 = x1[:, 1] - x1[:, 0]
    t1 = t1 - np.sum(t1 * unit, axis=1, keepdims=True) * unit
    t1 = t1 / np.linalg.norm(t1, axis=1, keepdims=True)
    plane = np.stack([t1, np.cross(unit, t1)], axis=2)
    flat1, flat2 = ((x - x1[first, :1]) @ plane[first] for x in (x1[first], x2[second]))
    D, M = _clip_pairs(flat1, flat2, *numbers, POINTS, WEIGHTS)
    overlap = np.abs(D).sum(axis=(1, 2)) > 0.0
    return first[overlap], second[overlap], D[overlap], M[overlap]


@compiled
def _facing(c1, c2, unit, n2, reach):  # type: ignore[no-untyped-def]
    """Whether facets face each other within reach, and circles around them overlap."""
    pairs = np.zeros((len(c1), len(c2)), dtype=np.bool_)
    for f in range(len(c1)):
        for g in range(len(c2)):
            height = square = facing = 0.0
            for k in range(3):
                away = c2[g, k] - c1[f, k]
                height += away * unit[f, k]
                square += away * away
                facing += unit[f, k] * n2[g, k]
            size = c1[f, 3] + c2[g, 3]
            near = abs(height) <= reach and square - height * height <= size * size
            pairs[f, g] = near and facing < 0.0
    return pairs


@compiled
def _clip_pairs(flat1, flat2, size1, size2, points, weights):  # type: ignore[no-untyped-def]
    """Blocks of (1) for every pair of facets in the plane of the first, (pairs, corners, 2)."""
    m1, m2 = flat1.shape[1], flat2.shape[1]
    D, M = np.zeros((len(flat1), m1, size1)), np.zeros((len(flat1), m1, size2))
    N1, N2, y = np.empty(m1), np.empty(m2), np.empty(2)
    trial1, trial2 = np.empty(size1), np.empty(size2)
    piece, spare = np.empty((16, 2)), np.empty((16, 2))
    for pair in range(len(flat1)):
        n = _clip(flat2[pair], flat1[pair], piece, spare)
        if abs(_area(piece, n)) <= SLIVER * abs(_area(flat1[pair], m1)):
            continue
        for k in range(1, n - 1):
            area = 0.5 * abs(_cross(piece[0], piece[k], piece[k + 1]))
            for p in range(len(weights)):
                for a in range(2):
                    y[a] = points[p, 0] * piece[0, a] + points[p, 1] * piece[k, a]
                    y[a] += points[p, 2] * piece[k + 1, a]
                _shape(flat1[pair], y, N1)
                _shape(flat2[pair], y, N2)
                _raise_order(N1, trial1)
                _raise_order(N2, trial2)
                for a in range(m1):
                    for b in range(size1):
                        D[pair, a, b] += weights[p] * area * N1[a] * trial1[b]
                    for b in range(size2):
                        M[pair, a, b] += weights[p] * area * N1[a] * trial2[b]
    return D, M


@compiled
def _raise_order(N, trial):  # type: ignore[no-untyped-def]
    """Shape functions of the nodes of a facet from the shape functions of its corners."""
    corners, nodes = len(N), len(trial)
    if nodes == corners:
        for a in range(corners):
            trial[a] = N[a]
        return
    if corners == 3:
        for a in range(3):
            trial[a] = N[a] * (2.0 * N[a] - 1.0)
            trial[3 + a] = 4.0 * N[a] * N[(a + 1) % 3]
        return
    r, s = N[1] + N[2] - N[0] - N[3], N[2] + N[3] - N[0] - N[1]
    bubble = (1.0 - r * r) * (1.0 - s * s)
    # middles of the edges s = -1, r = 1, s = 1, r = -1, of eight nodes; less half a bubble of nine
    share = 0.5 * bubble if nodes == 9 else 0.0
    trial[4] = 0.5 * (1.0 - r * r) * (1.0 - s) - share
    trial[5] = 0.5 * (1.0 + r) * (1.0 - s * s) - share
    trial[6] = 0.5 * (1.0 - r * r) * (1.0 + s) - share
    trial[7] = 0.5 * (1.0 - r) * (1.0 - s * s) - share
    for a in range(4):
        trial[a] = N[a] - 0.5 * (trial[4 + a] + trial[4 + (a + 3) % 4])
        if nodes == 9:
            trial[a] -= 0.25 * bubble
    if nodes == 9:
        trial[8] = bubble


@compiled
def _clip(polygon, window, clipped, new):  # type: ignore[no-untyped-def]
    """Clip a polygon by a convex window (Sutherland, Hodgman) and return its number of corners."""
    n = len(polygon)
    for k in range(n):  # a slice would have the compiler write its error message
        clipped[k, 0], clipped[k, 1] = polygon[k, 0], polygon[k, 1]
    for edge in range(len(window)):
        a, b = window[edge], window[(edge + 1) % len(window)]
        m = 0
        for k in range(n):
            p, q = clipped[k], clipped[(k + 1) % n]
            side_p, side_q = _cross(a, b, p), _cross(a, b, q)
            if side_p >= 0.0:
                new[m, 0], new[m, 1] = p[0], p[1]
                m += 1
            if (side_p > 0.0 and side_q < 0.0) or (side_p < 0.0 and side_q > 0.0):
                share = side_p / (side_p - side_q)
                new[m, 0] = p[0] + share * (q[0] - p[0])
                new[m, 1] = p[1] + share * (q[1] - p[1])
                m += 1
        n = m
        for k in range(n):
            clipped[k, 0], clipped[k, 1] = new[k, 0], new[k, 1]
    return n


@compiled
def _cross(a, b, c):  # type: ignore[no-untyped-def]
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@compiled
def _area(polygon, n):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(1, n - 1):
        total += 0.5 * _cross(polygon[0], polygon[k], polygon[k + 1])
    return total


@compiled
def _shape(corners, y, N):  # type: ignore[no-untyped-def]
    if len(corners) == 3:
        whole = _cross(corners[0], corners[1], corners[2])
        N[0] = _cross(y, corners[1], corners[2]) / whole
        N[1] = _cross(corners[0], y, corners[2]) / whole
        N[2] = 1.0 - N[0] - N[1]
        return
    r, s = 0.0, 0.0
    for _ in range(20):  # Newton; exact after a single step on a parallelogram
        N[0], N[1] = 0.25 * (1 - r) * (1 - s), 0.25 * (1 + r) * (1 - s)
        N[2], N[3] = 0.25 * (1 + r) * (1 + s), 0.25 * (1 - r) * (1 + s)
        ex = N[0] * corners[0, 0] + N[1] * corners[1, 0] + N[2] * corners[2, 0]
        ey = N[0] * corners[0, 1] + N[1] * corners[1, 1] + N[2] * corners[2, 1]
        ex = y[0] - ex - N[3] * corners[3, 0]
        ey = y[1] - ey - N[3] * corners[3, 1]
        xr, yr, xs, ys = 0.0, 0.0, 0.0, 0.0
        signs = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
        for c in range(4):
            by_r = 0.25 * signs[c][0] * (1 + signs[c][1] * s)
            by_s = 0.25 * signs[c][1] * (1 + signs[c][0] * r)
            xr += by_r * corners[c, 0]
            yr += by_r * corners[c, 1]
            xs += by_s * corners[c, 0]
            ys += by_s * corners[c, 1]
        whole = xr * ys - xs * yr
        dr, ds = (ex * ys - ey * xs) / whole, (ey * xr - ex * yr) / whole
        r, s = r + dr, s + ds
        if abs(dr) + abs(ds) < 1e-14:
            break
    N[0], N[1] = 0.25 * (1 - r) * (1 - s), 0.25 * (1 + r) * (1 - s)
    N[2], N[3] = 0.25 * (1 + r) * (1 + s), 0.25 * (1 - r) * (1 + s)


@compiled
def integrate(G, w, stress, tangent, slope, curvature):  # type: ignore[no-untyped-def]
    """Element tangents and forces from stress, tangent and derivative of the volume."""
    n_elements, n_points, n_nodes, d = G.shape
    blocks = np.zeros((n_elements, n_nodes * d, n_nodes * d))
    force = np.zeros((n_elements, n_nodes * d))
    half = np.empty((n_nodes * d, d, d))
    swell = np.empty(n_nodes * d)
    for e in range(n_elements):
        swell[:] = 0.0
        for q in range(n_points):
            weight = w[e, q]
            for a in range(n_nodes):
                for i in range(d):
                    row = a * d + i
                    for j in range(d):
                        force[e, row] += weight * G[e, q, a, j] * stress[e, q, i, j]
                        swell[row] += weight * G[e, q, a, j] * slope[e, q, i, j]
                    for k in range(d):
                        for m in range(d):
                            total = 0.0
                            for j in range(d):
                                total += G[e, q, a, j] * tangent[e, q, i, j, k, m]
                            half[row, k, m] = weight * total
            for row in range(n_nodes * d):
                for b in range(n_nodes):
                    for k in range(d):
                        total = 0.0
                        for m in range(d):
                            total += half[row, k, m] * G[e, q, b, m]
                        blocks[e, row, b * d + k] += total
        for row in range(n_nodes * d):
            for column in range(n_nodes * d):
                blocks[e, row, column] += curvature[e] * swell[row] * swell[column]
    return blocks, force
