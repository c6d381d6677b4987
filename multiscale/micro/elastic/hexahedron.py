r"""Edge derivatives and geometry of the layered cell's trilinear hexahedra, in batches along y.

In the reference element the gradient of a trilinear field needs differences along one edge
direction and interpolation along the other two. With Gauss points at :math:`\pm 1/\sqrt 3` both
are products of :math:`2 \times 2` matrices, and the derivative along an edge direction is the same
at both Gauss points of that direction: 12 numbers instead of 24 per component.
"""

import numpy as np

from multiscale.numerics.compiled import compiled

__all__ = [
    "BATCH",
    "FAR",
    "NEAR",
    "X",
    "Y",
    "Z",
    "differences",
    "differences_transposed",
    "element_geometry",
    "gather",
    "lateral_heights",
    "scatter",
    "shape_functions",
]

BATCH = 32  # elements along y in one batch; the arrays of one batch stay in the first two caches
X, Y, Z = 4 * BATCH, 2 * BATCH, BATCH  # distances of corner values along x, y and z
NEAR, FAR = 0.5 + 0.5 / np.sqrt(3.0), 0.5 - 0.5 / np.sqrt(3.0)  # linear shape functions


@compiled(fastmath=True, forceinline=True)
def shape_functions(like):  # type: ignore[no-untyped-def]
    """:data:`NEAR` and :data:`FAR` in the precision of an array."""
    return like.dtype.type(NEAR), like.dtype.type(FAR)


@compiled(fastmath=True)
def differences(nodes, grad, d, e, f, scale, lanes):  # type: ignore[no-untyped-def]
    """Edge derivative in one direction at the Gauss points (qe, qf) of the other two.

    ``d``, ``e`` and ``f`` are the distances in ``nodes`` between neighbours along the direction
    of the derivative and along the other two; ``grad`` gets four rows.
    """
    for v in range(lanes):
        a = scale * (nodes[d + v] - nodes[v])
        b = scale * (nodes[d + f + v] - nodes[f + v])
        p, q = NEAR * a + FAR * b, FAR * a + NEAR * b
        a = scale * (nodes[d + e + v] - nodes[e + v])
        b = scale * (nodes[d + e + f + v] - nodes[e + f + v])
        r, s = NEAR * a + FAR * b, FAR * a + NEAR * b
        grad[v], grad[BATCH + v] = NEAR * p + FAR * r, NEAR * q + FAR * s
        grad[2 * BATCH + v], grad[3 * BATCH + v] = FAR * p + NEAR * r, FAR * q + NEAR * s


@compiled(fastmath=True)
def differences_transposed(grad, nodes, d, e, f, scale, lanes):  # type: ignore[no-untyped-def]
    """Add the transpose of :func:`differences` to ``nodes``."""
    for v in range(lanes):
        p = scale * (NEAR * grad[v] + FAR * grad[2 * BATCH + v])
        q = scale * (NEAR * grad[BATCH + v] + FAR * grad[3 * BATCH + v])
        r = scale * (FAR * grad[v] + NEAR * grad[2 * BATCH + v])
        s = scale * (FAR * grad[BATCH + v] + NEAR * grad[3 * BATCH + v])
        a, b = NEAR * p + FAR * q, FAR * p + NEAR * q
        nodes[v] -= a
        nodes[d + v] += a
        nodes[f + v] -= b
        nodes[d + f + v] += b
        a, b = NEAR * r + FAR * s, FAR * r + NEAR * s
        nodes[e + v] -= a
        nodes[d + e + v] += a
        nodes[e + f + v] -= b
        nodes[d + e + f + v] += b


@compiled(fastmath=True)
def lateral_heights(heights, i, i1, start, dx, dy, lateral, lanes):  # type: ignore[no-untyped-def]
    """Surface heights (rows 0-3) and slopes (x: rows 4-5, y: rows 6-7) at the Gauss points."""
    ny = heights.shape[1]
    for v in range(lanes):
        j, j1 = start + v, (start + v + 1) % ny
        h00, h01, h10, h11 = heights[i, j], heights[i, j1], heights[i1, j], heights[i1, j1]
        p, q = NEAR * h00 + FAR * h10, NEAR * h01 + FAR * h11
        r, s = FAR * h00 + NEAR * h10, FAR * h01 + NEAR * h11
        lateral[v], lateral[BATCH + v] = NEAR * p + FAR * q, FAR * p + NEAR * q
        lateral[2 * BATCH + v], lateral[3 * BATCH + v] = NEAR * r + FAR * s, FAR * r + NEAR * s
        p, q = (h10 - h00) / dx, (h11 - h01) / dx
        lateral[4 * BATCH + v], lateral[5 * BATCH + v] = NEAR * p + FAR * q, FAR * p + NEAR * q
        p, q = (h01 - h00) / dy, (h11 - h10) / dy
        lateral[6 * BATCH + v], lateral[7 * BATCH + v] = NEAR * p + FAR * q, FAR * p + NEAR * q


@compiled(fastmath=True)
def element_geometry(lateral, z0, z1, f0, f1, geometry, lanes):  # type: ignore[no-untyped-def]
    """Element heights and slopes of the vertical map z = Z + phi h at the Gauss points."""
    real = geometry.dtype.type
    near, far = real(NEAR * f0 + FAR * f1), real(FAR * f0 + NEAR * f1)
    thickness, stretch = real(z1 - z0), real(f1 - f0)
    for q in range(4):
        height, slope, to = q * BATCH, (4 + q) * BATCH, (4 + 2 * q) * BATCH
        for v in range(lanes):
            geometry[height + v] = thickness + stretch * lateral[height + v]
            geometry[to + v] = near * lateral[slope + v]
            geometry[to + BATCH + v] = far * lateral[slope + v]


@compiled(fastmath=True)
def gather(field, sides, layer, start, lanes, nodes):  # type: ignore[no-untyped-def]
    """Corner values of a batch, component by component; the base is fixed.

    ``field`` has the shape (nx, layers, 3, ny) and ``sides`` are the two planes of a strip of
    elements. Lanes without an element repeat the first one.
    """
    ny = field.shape[3]
    for k in range(3):
        for a in range(2):
            for c in range(2):
                low = (8 * k + 4 * a + c) * BATCH
                high = low + 2 * BATCH
                if layer + c == 0:
                    for v in range(BATCH):
                        nodes[low + v] = 0.0
                        nodes[high + v] = 0.0
                else:
                    row = field[sides[a], layer + c - 1, k]
                    for v in range(lanes):
                        nodes[low + v] = row[start + v]
                    for v in range(lanes - 1):
                        nodes[high + v] = row[start + v + 1]
                    nodes[high + lanes - 1] = row[(start + lanes) % ny]
                    for v in range(lanes, BATCH):
                        nodes[low + v], nodes[high + v] = nodes[low], nodes[high]


@compiled(fastmath=True)
def scatter(nodes, sides, layer, start, lanes, out):  # type: ignore[no-untyped-def]
    """Add corner forces to a field, the transpose of :func:`gather`."""
    ny = out.shape[3]
    for k in range(3):
        for a in range(2):
            for c in range(2):
                low = (8 * k + 4 * a + c) * BATCH
                high = low + 2 * BATCH
                if layer + c > 0:
                    row = out[sides[a], layer + c - 1, k]
                    near, far = row[start:], row[start + 1 :]  # for loops over lanes at once
                    for v in range(lanes):
                        near[v] += nodes[low + v]
                    for v in range(lanes - 1):
                        far[v] += nodes[high + v]
                    row[(start + lanes) % ny] += nodes[high + lanes - 1]
