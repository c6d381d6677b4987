"""Long vectors in one pass through the memory, on all threads, with the same sums on any number."""

import numpy as np

from multiscale.numerics.compiled import compiled, prange

__all__ = ["advance", "dot", "turn"]

PARTS = 64  # of a vector, whose sums are added in their order


@compiled(parallel=True, fastmath=True)
def dot(a, b):  # type: ignore[no-untyped-def]
    """Scalar product of two vectors."""
    n, sums, whole = a.size, np.empty(PARTS), 0.0
    for part in prange(PARTS):
        mine = slice(part * n // PARTS, (part + 1) * n // PARTS)
        x, y, total = a[mine], b[mine], 0.0
        for i in range(x.size):
            total += np.float64(x[i]) * y[i]
        sums[part] = total
    for part in range(PARTS):
        whole += sums[part]
    return whole


@compiled(parallel=True, fastmath=True)
def turn(factor, p, z):  # type: ignore[no-untyped-def]
    """Overwrite p with z + factor p."""
    for i in prange(p.size):
        p[i] = z[i] + factor * p[i]


@compiled(parallel=True, fastmath=True)
def advance(factor, p, u, q, r):  # type: ignore[no-untyped-def]
    """Add factor p to u, take factor q from r and return the square of r."""
    n, sums, square = p.size, np.empty(PARTS), 0.0
    for part in prange(PARTS):
        mine = slice(part * n // PARTS, (part + 1) * n // PARTS)
        along, moved, change, rest, total = p[mine], u[mine], q[mine], r[mine], 0.0
        for i in range(along.size):
            moved[i] += factor * along[i]
            left = rest[i] - factor * change[i]
            rest[i] = left
            total += left * left
        sums[part] = total
    for part in range(PARTS):
        square += sums[part]
    return square
