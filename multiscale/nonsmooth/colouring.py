"""Colours of the contact graph: contacts of one colour can be solved side by side."""

import numpy as np
from scipy.sparse import csr_array

from multiscale.numerics.compiled import compiled

__all__ = ["colour_contacts"]


def colour_contacts(columns: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colour contacts so that no two of one colour share a block of W.

    Parameters
    ----------
    columns, starts : ndarray, shapes (blocks,) and (contacts + 1,)
        Block pattern of W in compressed rows.

    Returns
    -------
    order : ndarray, shape (contacts,), contacts sorted by colour
    bounds : ndarray, shape (colours + 1,)
        ``order[bounds[c] : bounds[c + 1]]`` are the contacts of colour c.

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
