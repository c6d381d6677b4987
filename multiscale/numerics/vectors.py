"""Long vectors in one pass through the memory, on all threads, with the same sums on any number."""

from collections.abc import Callable
from typing import Any

import numpy as np

from multiscale.executors import run_ranges
from multiscale.numerics.compiled import compiled

__all__ = ["LEAST", "advance", "dot", "turn"]

PARTS = 64  # of a vector, with sums that are added in their order
LEAST = 2**18  # numbers for a thread


def dot(a: np.ndarray, b: np.ndarray) -> float:
    """Scalar product of two arrays of one shape and any precision."""
    return _sum_parts(_dot, a.size, a.ravel(), b.ravel())


def turn(factor: float, p: np.ndarray, z: np.ndarray) -> None:
    """Overwrite p with z + factor p."""
    run_ranges(_turn, p.size, factor, p, z, least=LEAST)


def advance(factor: float, p: np.ndarray, u: np.ndarray, q: np.ndarray, r: np.ndarray) -> float:
    """Add factor p to u, take factor q from r and return the square of r."""
    return _sum_parts(_advance, p.size, factor, p, u, q, r)


def _sum_parts(kernel: Callable[..., None], size: int, *arguments: Any) -> float:
    """Sum over the parts of vectors what a kernel writes for each of them."""
    sums = np.empty(PARTS)
    run_ranges(kernel, PARTS, *arguments, sums, least=-(-LEAST * PARTS // max(size, 1)))
    return float(sums.sum())


@compiled(fastmath=True)
def _dot(begin, end, a, b, sums):  # type: ignore[no-untyped-def]
    n = a.size
    for part in range(begin, end):
        mine = slice(part * n // PARTS, (part + 1) * n // PARTS)
        x, y, total = a[mine], b[mine], 0.0
        for i in range(x.size):
            total += np.float64(x[i]) * y[i]
        sums[part] = total


@compiled(fastmath=True)
def _turn(begin, end, factor, p, z):  # type: ignore[no-untyped-def]
    p, z = p[begin:end], z[begin:end]
    for i in range(p.size):
        p[i] = z[i] + factor * p[i]


@compiled(fastmath=True)
def _advance(begin, end, factor, p, u, q, r, sums):  # type: ignore[no-untyped-def]
    n = p.size
    for part in range(begin, end):
        mine = slice(part * n // PARTS, (part + 1) * n // PARTS)
        along, moved, change, rest, total = p[mine], u[mine], q[mine], r[mine], 0.0
        for i in range(along.size):
            moved[i] += factor * along[i]
            left = rest[i] - factor * change[i]
            rest[i] = left
            total += left * left
        sums[part] = total
