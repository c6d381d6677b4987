"""Kernels that read long vectors once; sums do not depend on the number of threads."""

from collections.abc import Callable
from typing import Any

import numpy as np

from multiscale.executors import run_ranges
from multiscale.numerics.compiled import compiled

BLOCKS = 64  # blocks of a vector, with sums that are added in their order
LEAST = 2**18  # least numbers per thread


def dot(a: np.ndarray, b: np.ndarray) -> float:
    """Scalar product of two arrays of equal shape and any precision."""
    return _sum_blocks(_dot, a.size, a.ravel(), b.ravel())


def turn(factor: float, p: np.ndarray, z: np.ndarray) -> None:
    """Overwrite p with z + factor p."""
    run_ranges(_turn, p.size, factor, p, z, least=LEAST)


def advance(factor: float, p: np.ndarray, u: np.ndarray, q: np.ndarray, r: np.ndarray) -> float:
    """Add factor p to u, take factor q from r and return the square of r."""
    return _sum_blocks(_advance, p.size, factor, p, u, q, r)


def _sum_blocks(kernel: Callable[..., None], size: int, *arguments: Any) -> float:
    """Add up the sums that a kernel writes for each block of vectors."""
    sums = np.empty(BLOCKS)
    run_ranges(kernel, BLOCKS, *arguments, sums, least=-(-LEAST * BLOCKS // max(size, 1)))
    return float(sums.sum())


@compiled(fastmath=True)
def _dot(begin, end, a, b, sums):  # type: ignore[no-untyped-def]
    n = a.size
    for block in range(begin, end):
        entries = slice(block * n // BLOCKS, (block + 1) * n // BLOCKS)
        x, y, total = a[entries], b[entries], 0.0
        for i in range(x.size):
            total += np.float64(x[i]) * y[i]
        sums[block] = total


@compiled(fastmath=True)
def _turn(begin, end, factor, p, z):  # type: ignore[no-untyped-def]
    p, z = p[begin:end], z[begin:end]
    for i in range(p.size):
        p[i] = z[i] + factor * p[i]


@compiled(fastmath=True)
def _advance(begin, end, factor, p, u, q, r, sums):  # type: ignore[no-untyped-def]
    n = p.size
    for block in range(begin, end):
        entries = slice(block * n // BLOCKS, (block + 1) * n // BLOCKS)
        along, moved, change, rest, total = p[entries], u[entries], q[entries], r[entries], 0.0
        for i in range(along.size):
            moved[i] += factor * along[i]
            left = rest[i] - factor * change[i]
            rest[i] = left
            total += left * left
        sums[block] = total
