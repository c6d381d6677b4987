r"""Contact spots: the areas i over which eqs (2) and (3) of the source are integrated.

A spot is a connected set of contact nodes. On a grid a point has four
neighbours across its periodic edges; on a mesh the nodes of a facet are neighbours. With the normal
and tangential tractions of spot i, projected on the mean plane :math:`n^0, a_a^0`,

.. math::
    \langle t_N \rangle_i = \frac{1}{\Gamma_c^0} \int_{\Gamma_c^i}
    (t_N^i n^i \cdot n^0 + t_T^i \cdot n^0)\, \mathrm{d}\Gamma, \qquad
    \langle t_T^a \rangle_i = \frac{1}{\Gamma_c^0} \int_{\Gamma_c^i}
    (t_N^i n^i \cdot a_a^0 + t_T^i \cdot a_a^0)\, \mathrm{d}\Gamma,    \tag{1}

the averages are the sums over all spots. The integrals are sums of nodal forces, which balance the
stresses of the deformed body and are the coefficients of its tractions in the dual basis.
"""

import numpy as np

from multiscale.micro.averages import to_components

__all__ = ["grid_neighbours", "spot_averages"]


def grid_neighbours(shape: tuple[int, int]) -> np.ndarray:
    """Pairs of neighbours on a periodic grid, shape (2, pairs)."""
    number = np.arange(shape[0] * shape[1]).reshape(shape)
    ahead = [np.roll(number, -1, axis).ravel() for axis in (0, 1)]
    return np.stack([np.tile(number.ravel(), 2), np.concatenate(ahead)])


def spot_averages(
    force: np.ndarray,
    by_normal: np.ndarray,
    area: np.ndarray,
    active: np.ndarray,
    neighbours: np.ndarray,
    nominal_area: float,
) -> dict[str, np.ndarray]:
    """Share of every contact spot in the averages (2) and (3), largest spot first."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    first, second = neighbours
    joined = active[first] & active[second]
    size = 2 * (active.size,)
    links = coo_array((joined[joined], (first[joined], second[joined])), shape=size)
    _, label = connected_components(links, directed=False)
    _, spot = np.unique(label[active], return_inverse=True)
    total = np.bincount(spot, area[active])
    order = np.argsort(-total, kind="stable")

    def share(values: np.ndarray) -> np.ndarray:
        columns = [np.bincount(spot, column)[order] for column in values[active].T]
        return to_components(np.reshape(columns, (3, -1)).T) / nominal_area  # (1)

    return {
        "spot_area": total[order],
        "spot_traction": share(force),
        "spot_traction_by_normal": share(by_normal),
    }
