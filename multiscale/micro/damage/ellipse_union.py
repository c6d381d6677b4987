r"""Exact area of a union of ellipses within a convex polygon, a sum over arcs of its boundary.

By Green's theorem an arc :math:`c + M w` with :math:`w = (\cos\theta, \sin\theta)` contributes

.. math:: \tfrac12 \int x \times \mathrm{d}x = \tfrac12\, c \times M (w_1 - w_0)
    + \tfrac12 \det M\, (\theta_1 - \theta_0).    \tag{1}
"""

import numpy as np

from multiscale.numerics.compiled import compiled

BOUNDARY_MARGIN = 1e-11  # relative distance by which rounding may move a point across a boundary


def union_area(polygon: np.ndarray, centre: np.ndarray, root: np.ndarray) -> float:
    """Area of the union of ellipses in a convex polygon, m²."""
    if len(centre) == 0:
        return 0.0
    size = float(np.ptp(polygon, axis=0).max())
    origin = polygon.mean(axis=0)
    root = root / size
    (a, b), (c, d) = root.transpose(1, 2, 0)
    inverse = np.array([[d, -b], [-c, a]]) / (a * d - b * c)
    area = _union_area(
        (polygon - origin) / size,
        (centre - origin) / size,
        root,
        inverse.transpose(2, 0, 1).copy(),
        0.5 * (np.hypot(a + d, b - c) + np.hypot(a - d, b + c)),  # larger semi-axis
    )
    return float(size**2 * area)


@compiled
def _union_area(polygon, centre, root, inverse, radius):  # type: ignore[no-untyped-def]
    """Sum (1) over the segments of the boundary of the union."""
    near = _neighbours(polygon, centre, radius)
    breaks = np.empty(8 + 2 * len(polygon) + 4 * len(centre))
    total = 0.0
    # exposed arcs of the ellipses
    for i in range(len(centre)):
        if near[i, i]:
            total += _arcs(i, polygon, centre, root, inverse, near[i], breaks)
    # segments of the edges of the polygon that lie in an ellipse
    for a in range(len(polygon)):
        p, q = polygon[a], polygon[(a + 1) % len(polygon)]
        n = _crossings(p, q, centre, inverse, breaks)
        for b in range(n - 1):
            s, t = _samples(breaks[b], breaks[b + 1])
            x, y = p[0] + s * (q[0] - p[0]), p[1] + s * (q[1] - p[1])
            u, v = p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])
            for j in range(len(centre)):
                depth = min(
                    _depth(x, y, centre[j], inverse[j]), _depth(u, v, centre[j], inverse[j])
                )
                if depth >= -BOUNDARY_MARGIN:
                    total += 0.5 * (p[0] * q[1] - p[1] * q[0]) * (breaks[b + 1] - breaks[b])
                    break
    return total


@compiled
def _neighbours(polygon, centre, radius):  # type: ignore[no-untyped-def]
    """Whether circumcircles of two ellipses meet; diagonal: of an ellipse and the polygon."""
    reach = 0.0
    for corner in polygon:
        reach = max(reach, np.hypot(corner[0], corner[1]))
    n = len(centre)
    near = np.zeros((n, n), dtype=np.bool_)
    for i in range(n):
        near[i, i] = np.hypot(centre[i, 0], centre[i, 1]) <= reach + radius[i]
        for j in range(i):
            distance = np.hypot(centre[i, 0] - centre[j, 0], centre[i, 1] - centre[j, 1])
            near[i, j] = near[j, i] = distance <= radius[i] + radius[j]
    return near


@compiled
def _samples(low, high):  # type: ignore[no-untyped-def]
    """Choose two samples of a segment, as another boundary may touch it at a single point."""
    return low + 0.37 * (high - low), low + 0.61 * (high - low)


@compiled
def _depth(x, y, centre, inverse):  # type: ignore[no-untyped-def]
    """Depth of a point in an ellipse: positive inside, zero on the boundary; dimensionless."""
    x0, y0 = x - centre[0], y - centre[1]
    u = inverse[0, 0] * x0 + inverse[0, 1] * y0
    v = inverse[1, 0] * x0 + inverse[1, 1] * y0
    return 1.0 - u * u - v * v


@compiled
def _exposed(x, y, i, polygon, centre, inverse, near):  # type: ignore[no-untyped-def]
    """Whether a boundary point of ellipse i lies in the polygon and in no other ellipse."""
    for a in range(len(polygon)):
        p, q = polygon[a], polygon[(a + 1) % len(polygon)]
        dx, dy = q[0] - p[0], q[1] - p[1]
        if dx * (y - p[1]) - dy * (x - p[0]) <= BOUNDARY_MARGIN * np.hypot(dx, dy):
            return False
    for j in range(len(centre)):
        if j != i and near[j]:
            depth = _depth(x, y, centre[j], inverse[j])
            # the first of equal ellipses counts
            if depth > BOUNDARY_MARGIN or (depth > -BOUNDARY_MARGIN and j < i):
                return False
    return True


@compiled
def _arcs(i, polygon, centre, root, inverse, near, breaks):  # type: ignore[no-untyped-def]
    M, cx, cy = root[i], centre[i, 0], centre[i, 1]
    # angles where another boundary may cross the ellipse
    n = np.int64(0)  # as in every later call: one signature
    for a in range(len(polygon)):
        p, q = polygon[a], polygon[(a + 1) % len(polygon)]
        gx, gy = q[1] - p[1], p[0] - q[0]
        B, C = M[0, 0] * gx + M[1, 0] * gy, M[0, 1] * gx + M[1, 1] * gy
        n = _add_angles(gx * (cx - p[0]) + gy * (cy - p[1]), B, C, breaks, n)
    for j in range(len(centre)):
        if j != i and near[j]:
            n = _arc_ellipse(M, cx, cy, centre[j], inverse[j], breaks, n)
    breaks[n], breaks[n + 1] = 0.0, 2.0 * np.pi
    n += 2
    _sort(breaks, n)
    # segments between them on the boundary of the union
    det = M[0, 0] * M[1, 1] - M[0, 1] * M[1, 0]
    total = 0.0
    for b in range(n - 1):
        low, high = breaks[b], breaks[b + 1]
        if high - low < 1e-14:
            continue
        counts = True
        for angle in _samples(low, high):
            x = cx + M[0, 0] * np.cos(angle) + M[0, 1] * np.sin(angle)
            y = cy + M[1, 0] * np.cos(angle) + M[1, 1] * np.sin(angle)
            counts &= _exposed(x, y, i, polygon, centre, inverse, near)
        if counts:
            u, v = np.cos(high) - np.cos(low), np.sin(high) - np.sin(low)
            dx, dy = M[0, 0] * u + M[0, 1] * v, M[1, 0] * u + M[1, 1] * v
            total += 0.5 * (cx * dy - cy * dx) + 0.5 * det * (high - low)
    return total


@compiled
def _crossings(p, q, centre, inverse, breaks):  # type: ignore[no-untyped-def]
    """Sorted places t in [0, 1] where a segment may cross an ellipse, and their number."""
    breaks[0], breaks[1] = 0.0, 1.0
    n = np.int64(2)  # as in every later call: one signature
    dx, dy = q[0] - p[0], q[1] - p[1]
    for j in range(len(centre)):
        W = inverse[j]
        x0, y0 = p[0] - centre[j, 0], p[1] - centre[j, 1]
        a0, b0 = W[0, 0] * x0 + W[0, 1] * y0, W[1, 0] * x0 + W[1, 1] * y0
        a1, b1 = W[0, 0] * dx + W[0, 1] * dy, W[1, 0] * dx + W[1, 1] * dy
        A, B, C = a1 * a1 + b1 * b1, a0 * a1 + b0 * b1, a0 * a0 + b0 * b0 - 1.0
        under = B * B - A * C
        if under > 0.0 and A > 0.0:
            for sign in (-1.0, 1.0):
                t = (-B + sign * np.sqrt(under)) / A
                if 0.0 < t < 1.0:
                    breaks[n] = t
                    n += 1
    _sort(breaks, n)
    return n


@compiled
def _sort(values, n):  # type: ignore[no-untyped-def]
    """Sort the first n values, which are few; the sort of NumPy takes seconds to compile."""
    for k in range(1, n):
        value, j = values[k], k
        while j > 0 and values[j - 1] > value:
            values[j] = values[j - 1]
            j -= 1
        values[j] = value


@compiled
def _add_angles(A, B, C, breaks, n):  # type: ignore[no-untyped-def]
    """Add the roots of A + B cos t + C sin t."""
    size = np.hypot(B, C)
    if size > 0.0 and abs(A) < size:
        middle, half = np.arctan2(C, B), np.arccos(-A / size)
        breaks[n] = (middle - half) % (2.0 * np.pi)
        breaks[n + 1] = (middle + half) % (2.0 * np.pi)
        n += 2
    return n


@compiled
def _arc_ellipse(M, cx, cy, other, W, breaks, n):  # type: ignore[no-untyped-def]
    """Add the angles where an ellipse crosses another: a trigonometric quartic."""
    x0, y0 = cx - other[0], cy - other[1]
    p0, q0 = W[0, 0] * x0 + W[0, 1] * y0, W[1, 0] * x0 + W[1, 1] * y0
    pc, ps = W[0, 0] * M[0, 0] + W[0, 1] * M[1, 0], W[0, 0] * M[0, 1] + W[0, 1] * M[1, 1]
    qc, qs = W[1, 0] * M[0, 0] + W[1, 1] * M[1, 0], W[1, 0] * M[0, 1] + W[1, 1] * M[1, 1]
    # |W x|^2 - 1 = A + B cos t + C sin t + D cos 2t + E sin 2t
    A = p0 * p0 + q0 * q0 - 1.0 + 0.5 * (pc * pc + qc * qc + ps * ps + qs * qs)
    B, C = 2.0 * (p0 * pc + q0 * qc), 2.0 * (p0 * ps + q0 * qs)
    D = 0.5 * (pc * pc + qc * qc - ps * ps - qs * qs)
    E = pc * ps + qc * qs
    if np.hypot(D, E) <= 1e-12 * (abs(A) + np.hypot(B, C)):
        return _add_angles(A, B, C, breaks, n)
    companion = np.zeros((4, 4), dtype=np.complex128)
    lead = 0.5 * (D - 1j * E)
    companion[0, 0] = -0.5 * (B - 1j * C) / lead
    companion[0, 1] = -A / lead
    companion[0, 2] = -0.5 * (B + 1j * C) / lead
    companion[0, 3] = -0.5 * (D + 1j * E) / lead
    companion[1, 0] = companion[2, 1] = companion[3, 2] = 1.0
    for z in np.linalg.eigvals(companion):
        if abs(abs(z) - 1.0) > 0.1:
            continue
        t = np.arctan2(z.imag, z.real)
        for _ in range(3):  # Newton steps on the real circle; an additional place does no harm
            slope = C * np.cos(t) - B * np.sin(t) + 2.0 * (E * np.cos(2 * t) - D * np.sin(2 * t))
            value = A + B * np.cos(t) + C * np.sin(t) + D * np.cos(2 * t) + E * np.sin(2 * t)
            if slope != 0.0:
                t -= min(max(value / slope, -0.1), 0.1)
        breaks[n] = t % (2.0 * np.pi)
        n += 1
    return n
