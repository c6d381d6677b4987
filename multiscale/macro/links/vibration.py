"""Small vibration of links about their equilibrium, with the stiffness of their tensions."""

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csr_array, triu
from scipy.sparse.linalg import LinearOperator, eigsh

from multiscale.errors import CaseError, MultiscaleError, require
from multiscale.macro.links.link_equations import LinkEquations, equations, rotary_inertia
from multiscale.macro.links.link_system import LinkSystem
from multiscale.numerics.factorisation import prepare_cholesky
from multiscale.schema import MACRO_RESULT, Dataset

SOFTEST = 1e-13
"""Square of a frequency, over the largest stiffness over mass of an unknown, that is rounding."""


def natural_frequencies(
    system: LinkSystem, rest: Dataset, mass: float, *, count: int = 5
) -> Dataset:
    r"""Return a structure at rest with its frequencies of small vibration.

    Parameters
    ----------
    system : LinkSystem, of extensible links
    rest : Dataset
        Its steps at rest under small displacements, from :func:`~.solve_static` for a sequence of
        load factors.
    mass : float, of every node, kg
    count : int, number of frequencies

    Returns
    -------
    Dataset
        ``rest`` with ``natural_frequency (step, mode)`` and ``first_frequency (step)``, Hz. They
        are NaN at steps that did not converge or that are not stable.

    Raises
    ------
    CaseError
        If the mass is not positive, or links have a fixed length.

    Notes
    -----
    With the tangent of the taut links and the geometric stiffness of the tensions
    :math:`\tau`, the frequencies :math:`\omega` solve

    .. math::
        \Big( B^T k B + \sum \frac{\tau}{L} (I - n n^T) \Big) \phi = \omega^2 M \phi.    \tag{1}

    The mass of a node with beams is distributed over their sections, taken as homogeneous, which
    gives it the inertia :math:`m\, EI / EA` against bending, and the sum of both against twist. A
    beam is divided into several elements; its tension does not bend it between their nodes.

    Examples
    --------
    >>> from multiscale.macro import solve_static, tensegrity_grid
    >>> grid = tensegrity_grid(4)
    >>> moving = natural_frequencies(grid, solve_static(grid, [0.0, 1.0]), mass=2.0)
    >>> moving["first_frequency"].round(2).values
    array([26.43, 26.41])
    """
    require("mass of a node", mass, "(0, inf)", "kg")
    model, links = equations(system), system.n_links
    if np.isinf(model.stiffness).any():
        raise CaseError("frequencies need extensible links and beams; give finite rigidities")
    inertia = mass * _inertia(system, model)
    count = min(count, int(np.count_nonzero(inertia.diagonal())))
    values = np.full((rest.sizes["step"], count), np.nan)
    for step in np.flatnonzero(rest["converged"].to_numpy() == 1):
        tension, slack = (rest[name].to_numpy()[step] for name in ("tension", "slack"))
        stiffness = model.stiffness.copy()
        stiffness[:links][slack > 0.0] = 0.0
        across = model.tangent.geometric(system.direction, np.zeros(links), tension / system.length)
        entries = model.tangent.entries(stiffness) + across
        values[step] = lowest_frequencies(model.tangent.matrix(entries), inertia, count)
    moving = {"natural_frequency": values, "first_frequency": values[:, 0]}
    return MACRO_RESULT.assign(rest, moving).assign_coords(mode=np.arange(1, count + 1))


def _inertia(system: LinkSystem, model: LinkEquations) -> csr_array:
    """Return the inertia of the unknowns over the mass of a node."""
    each = np.zeros((system.n_nodes, *2 * (model.unit.size,)))
    each[:, range(3), range(3)] = 1.0
    if model.unit.size > 3:
        each[:, 3:, 3:] = rotary_inertia(system)
    each /= np.outer(model.unit, model.unit)
    row, column = np.broadcast_arrays(model.number[:, :, None], model.number[:, None])
    moves = (row >= 0) & (column >= 0) & (each != 0.0)
    return csr_array((each[moves], (row[moves], column[moves])), shape=(model.n, model.n))


def lowest_frequencies(stiffness: csr_array, mass: csr_array, count: int) -> np.ndarray:
    """Return the lowest frequencies, Hz, rising; NaN if the stiffness is not positive definite."""
    n, upper = stiffness.shape[0], csr_array(triu(stiffness, format="csr"))
    upper.sort_indices()
    try:
        solve = prepare_cholesky(upper.indptr, upper.indices)(upper.data, True)
    except MultiscaleError:
        return np.full(count, np.nan)
    # the largest 1 / omega^2, as unknowns may have no mass
    if n <= 4 * count:
        inverse = eigh(mass.toarray(), stiffness.toarray(), eigvals_only=True)[-count:]
    else:
        operator = LinearOperator((n, n), matvec=solve, dtype=float)
        start = np.random.default_rng(seed=0).standard_normal(n)
        inverse = eigsh(
            mass, count, stiffness, Minv=operator, v0=start, which="LA", return_eigenvectors=False
        )
    inverse = np.sort(inverse)[::-1]
    if not inverse[-1] > 0.0 or inverse[0] * stiffness.max() * SOFTEST > mass.max():
        return np.full(count, np.nan)
    return np.asarray(1.0 / (2.0 * np.pi * np.sqrt(inverse)))
