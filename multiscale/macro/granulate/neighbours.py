r"""Neighbouring grains by a hierarchical cell list.

Grains are sorted into levels by size; the cells of a level are twice as wide as in the next level.
A pair is found from its smaller grain by a search of its own level and all coarser levels, so that
the work is proportional to the number of grains whatever the ratio of their sizes.
"""

import numpy as np

from multiscale.executors import run_ranges
from multiscale.numerics.compiled import compiled

__all__ = ["find_pairs"]

LEAST = 1000  # grains for a thread


def find_pairs(
    position: np.ndarray, radius: np.ndarray, reach: float, period: np.ndarray
) -> np.ndarray:
    r"""Find all pairs of grains whose gap is at most a reach.

    Notes
    -----
    Level k has the radii in :math:`(R_{\max} 2^{-k-1}, R_{\max} 2^{-k}]` and cells that are wider
    than :math:`2 R_{\max} 2^{-k}` plus the reach, in a hash table. Grains are counted and listed in
    two parallel passes; the list does not depend on the number of threads.

    References
    ----------
    .. [1] H. Mio, A. Shimosaka, Y. Shirakawa and J. Hidaka, J. Chem. Eng. Japan 38 (2005)
       969-975, for cells of several sizes in granular simulations.
    """
    largest = float(radius.max())
    level = np.floor(np.log2(largest / radius) * (1.0 - 1e-12)).astype(np.int64)
    levels = int(level.max()) + 1
    width = np.empty((levels, 3))
    count = np.zeros((levels, 3), np.int64)  # cells along a period, 0 without a period
    for k in range(levels):
        cell = 2.0 * largest * 0.5**k + reach
        for a in range(3):
            if np.isfinite(period[a]):
                count[k, a] = max(1, int(period[a] / cell))
                width[k, a] = period[a] / count[k, a]
            else:
                width[k, a] = cell
    table = 1 << max(4, int(2 * radius.size - 1).bit_length())
    grains = (position, radius, reach, period)
    grid = (level, width, count, *_fill_cells(position, level, width, count, table))
    found = np.empty(radius.size, np.int64)
    run_ranges(_count_pairs, radius.size, grains, grid, found, least=LEAST)
    starts = np.concatenate([[0], np.cumsum(found)])
    pairs = np.empty((starts[-1], 2), np.int32)
    run_ranges(_list_pairs, radius.size, grains, grid, starts, pairs, least=LEAST)
    return pairs


@compiled
def _hash(k, a, b, c, table):  # type: ignore[no-untyped-def]
    """Return the slot of a cell in a table whose size is a power of two."""
    return (a * 73856093 ^ b * 19349663 ^ c * 83492791 ^ k * 2654435761) & (table - 1)


@compiled
def _fill_cells(position, level, width, count, table):  # type: ignore[no-untyped-def]
    """Chain the grains of each slot of the table."""
    heads = np.full(table, -1, np.int64)
    following = np.empty(level.size, np.int64)
    cells = np.empty((level.size, 3), np.int64)
    for i in range(level.size - 1, -1, -1):
        k = level[i]
        for a in range(3):
            c = int(np.floor(position[i, a] / width[k, a]))
            cells[i, a] = c % count[k, a] if count[k, a] > 0 else c
        slot = _hash(k, cells[i, 0], cells[i, 1], cells[i, 2], table)
        following[i] = heads[slot]
        heads[slot] = i
    return heads, following, cells


@compiled
def _visit(i, grains, grid, out, first):  # type: ignore[no-untyped-def]
    """Count the pairs of grain i, and list them in ``out`` if it is not empty."""
    position, radius, reach, period = grains
    level, width, count, heads, following, cells = grid
    found = 0
    home = np.empty(3, np.int64)
    low = np.empty(3, np.int64)
    high = np.empty(3, np.int64)
    for k in range(level[i] + 1):
        for a in range(3):
            home[a] = int(np.floor(position[i, a] / width[k, a]))
            low[a], high[a] = -1, 1
            if count[k, a] == 1:
                low[a], high[a] = 0, 0
            elif count[k, a] == 2:
                low[a] = 0
        for da in range(low[0], high[0] + 1):
            ca = home[0] + da
            if count[k, 0] > 0:
                ca %= count[k, 0]
            for db in range(low[1], high[1] + 1):
                cb = home[1] + db
                if count[k, 1] > 0:
                    cb %= count[k, 1]
                for dc in range(low[2], high[2] + 1):
                    cc = home[2] + dc
                    if count[k, 2] > 0:
                        cc %= count[k, 2]
                    j = heads[_hash(k, ca, cb, cc, heads.size)]
                    while j >= 0:
                        here = cells[j, 0] == ca and cells[j, 1] == cb and cells[j, 2] == cc
                        # a pair within a level is found by its first grain
                        if here and level[j] == k and (k < level[i] or j > i):
                            square = 0.0
                            for a in range(3):
                                d = position[i, a] - position[j, a]
                                if period[a] < np.inf:
                                    d -= period[a] * np.round(d / period[a])
                                square += d * d
                            distance = radius[i] + radius[j] + reach
                            if square <= distance * distance:
                                if out.shape[0] > 0:
                                    out[first + found, 0] = i
                                    out[first + found, 1] = j
                                found += 1
                        j = following[j]
    return found


@compiled
def _count_pairs(begin, end, grains, grid, found):  # type: ignore[no-untyped-def]
    none = np.empty((0, 2), np.int32)
    for i in range(begin, end):
        found[i] = _visit(i, grains, grid, none, np.int64(0))


@compiled
def _list_pairs(begin, end, grains, grid, starts, pairs):  # type: ignore[no-untyped-def]
    """List the pairs in the order of the grains that find them."""
    for i in range(begin, end):
        if starts[i + 1] > starts[i]:
            _visit(i, grains, grid, pairs, starts[i])
