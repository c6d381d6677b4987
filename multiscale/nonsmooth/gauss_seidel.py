r"""Nonlinear Gauss-Seidel: contact after contact, each solved exactly with the others held.

The kernels take 3x3 blocks in compressed rows, so that a simulation of many bodies can call them
on blocks that it builds itself, with the impulses of the last time step as start.
"""

from time import perf_counter

import numpy as np
from scipy.sparse import csr_array

from multiscale.nonsmooth.friction_problem import ScaledFriction
from multiscale.nonsmooth.one_contact import solve_one_contact
from multiscale.nonsmooth.progress import Progress
from multiscale.numerics.compiled import compiled, prange, thread_count

__all__ = ["colour_contacts", "gauss_seidel", "sweep", "sweep_coloured"]

BURST = 20
"""Sweeps between two looks at the error."""

MANY = 3000
"""Contacts from which on the threads are worth starting."""


def gauss_seidel(
    problem: ScaledFriction, reaction: np.ndarray, progress: Progress, max_iterations: int = 20000
) -> np.ndarray:
    r"""Solve a friction problem by sweeps over its contacts.

    Large problems are swept colour by colour. The order depends on the problem alone, and threads
    do not change the numbers: so they are used after the first 20 sweeps for as long as they are
    faster than one, which they are not where other programs hold the processors.

    References
    ----------
    .. [1] M. Jean, Comput. Methods Appl. Mech. Eng. 177 (1999) 235-257,
       doi:10.1016/S0045-7825(98)00383-1.
    """
    r = reaction.copy()
    contacts = problem.friction.size
    rows = (problem.blocks, problem.columns, problem.starts, problem.diagonal)
    law = (problem.velocity, problem.friction)
    order, bounds = np.arange(contacts), np.array([0, contacts])
    if contacts >= MANY:
        order, bounds = colour_contacts(problem.columns, problem.starts)
    threaded = contacts >= MANY and thread_count() > 1
    serial = np.inf  # seconds for a sweep on one thread
    for done in range(0, max_iterations, BURST):
        sweeps = min(BURST, max_iterations - done)
        if threaded and done > 0:
            began = perf_counter()
            sweep_coloured(*rows, *law, order, bounds, r, sweeps)
            threaded = perf_counter() - began < serial * sweeps
        else:
            began = perf_counter()
            sweep(*rows, *law, order, r, sweeps)
            serial = (perf_counter() - began) / sweeps
        if progress.note(r):
            break
    return r


@compiled
def _update(blocks, columns, starts, diagonal, velocity, friction, reaction, i):  # type: ignore[no-untyped-def]
    """Solve contact i with the others held."""
    q0, q1, q2 = velocity[i, 0], velocity[i, 1], velocity[i, 2]
    own = diagonal[i]
    for k in range(starts[i], starts[i + 1]):
        if k != own:
            j = columns[k]
            x, y, z = reaction[j, 0], reaction[j, 1], reaction[j, 2]
            q0 += blocks[k, 0, 0] * x + blocks[k, 0, 1] * y + blocks[k, 0, 2] * z
            q1 += blocks[k, 1, 0] * x + blocks[k, 1, 1] * y + blocks[k, 1, 2] * z
            q2 += blocks[k, 2, 0] * x + blocks[k, 2, 1] * y + blocks[k, 2, 2] * z
    r0, r1, r2 = solve_one_contact(blocks[own], q0, q1, q2, friction[i])
    reaction[i, 0], reaction[i, 1], reaction[i, 2] = r0, r1, r2


@compiled
def sweep(blocks, columns, starts, diagonal, velocity, friction, order, reaction, sweeps):  # type: ignore[no-untyped-def]
    """Solve the contacts one after another in the given order, ``sweeps`` times, in place."""
    for _ in range(sweeps):
        for i in order:
            _update(blocks, columns, starts, diagonal, velocity, friction, reaction, i)


@compiled(parallel=True)
def sweep_coloured(  # type: ignore[no-untyped-def]
    blocks, columns, starts, diagonal, velocity, friction, order, colours, reaction, sweeps
):
    """Run :func:`sweep` with the contacts of one colour side by side; the same numbers.

    ``order[colours[c] : colours[c + 1]]`` are contacts of colour c, no two of which share a block.
    """
    for _ in range(sweeps):
        for c in range(colours.size - 1):
            for k in prange(colours[c], colours[c + 1]):
                i = order[k]
                _update(blocks, columns, starts, diagonal, velocity, friction, reaction, i)


def colour_contacts(columns: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colour contacts so that no two of one colour share a block of W.

    Examples
    --------
    >>> colour_contacts(np.array([0, 1, 0, 1, 2, 1, 2]), np.array([0, 2, 5, 7]))
    (array([0, 2, 1]), array([0, 2, 3]))
    """
    contacts = starts.size - 1
    rows = csr_array((np.ones(columns.size), columns, starts), shape=(contacts, contacts))
    both = csr_array(rows + rows.T)  # a block on one side of the diagonal is enough to couple
    colour = _greedy_colours(both.indices, both.indptr)
    order = np.argsort(colour, kind="stable")
    bounds = np.concatenate([[0], np.cumsum(np.bincount(colour))])
    return order, bounds


@compiled
def _greedy_colours(columns, starts):  # type: ignore[no-untyped-def]
    """Give every contact the smallest colour that none of its neighbours has yet."""
    contacts = starts.size - 1
    colour = np.full(contacts, -1, np.int64)
    seen = np.full(contacts + 1, -1, np.int64)
    for i in range(contacts):
        for k in range(starts[i], starts[i + 1]):
            if colour[columns[k]] >= 0:
                seen[colour[columns[k]]] = i
        c = 0
        while seen[c] == i:
            c += 1
        colour[i] = c
    return colour
