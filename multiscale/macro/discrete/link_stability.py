"""Stability under load: eigenvalues of the tangent."""

import numpy as np
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

from multiscale.errors import MultiscaleError
from multiscale.macro.discrete.compatibility import LinkEquations
from multiscale.macro.discrete.link_state import LinkState
from multiscale.macro.discrete.link_system import LinkSystem
from multiscale.macro.discrete.link_tangent import Tangent

__all__ = ["material_entries", "smallest_eigenvalue", "stability_entries"]

LARGEST_SHIFT = 1e3  # relative to the diagonal


def material_entries(model: LinkEquations, tangent: Tangent, state: LinkState) -> np.ndarray:
    """Return the upper triangle of the tangent B^T k B of the links that are not slack, N/m."""
    taut = (state.slack == 0.0) & np.isfinite(model.stiffness)
    return tangent.entries(np.where(taut, model.stiffness, 0.0))


def stability_entries(
    system: LinkSystem, model: LinkEquations, tangent: Tangent, state: LinkState
) -> np.ndarray:
    r"""Return the upper triangle of the tangent with the geometric stiffness, N/m.

    .. math:: K = B^T k B + \sum \frac{\tau}{L} (I - n n^T)    \tag{1}

    Slack links are left out. Bending of a beam between its nodes is resolved only if the beam is
    divided into several.
    """
    links = system.n_links
    across = state.tension[:links] / system.length
    geometric = tangent.geometric(system.direction, np.zeros(links), across)
    return np.asarray(material_entries(model, tangent, state) + geometric)


def smallest_eigenvalue(tangent: Tangent, entries: np.ndarray) -> float:
    """Return the smallest eigenvalue of a symmetric matrix, given by its upper triangle, N/m.

    Lanczos on the inverse of the matrix, shifted to be positive definite. The result is NaN if no
    shift makes it definite, or Lanczos does not converge.
    """
    n, diagonal = tangent.start.size - 1, tangent.diagonal
    matrix = tangent.matrix(entries)
    if n < 20:
        return float(np.linalg.eigvalsh(matrix.toarray())[0])
    shift, largest = 0.0, float(np.abs(entries[diagonal]).max())
    while not shift > LARGEST_SHIFT * largest:
        held = entries.copy()
        held[diagonal] += shift
        try:
            solve = tangent.factorise(held, signs=True)
            break
        except MultiscaleError:
            shift = max(10.0 * shift, 1e-10 * largest)
    else:
        return float(np.nan)
    inverse = LinearOperator((n, n), matvec=solve, dtype=float)
    start = np.random.default_rng(seed=0).standard_normal(n)
    try:
        return float(
            eigsh(matrix, 1, sigma=-shift, OPinv=inverse, v0=start, return_eigenvectors=False)[0]
        )
    except ArpackNoConvergence:
        return float(np.nan)
