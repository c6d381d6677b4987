"""Stability under load: eigenvalues of the tangent and the critical load factor."""

from collections.abc import Sequence

import numpy as np
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

from multiscale.errors import CaseError, ConvergenceError, MultiscaleError
from multiscale.macro.discrete.checks import check_supports
from multiscale.macro.discrete.compatibility import LinkEquations, equations
from multiscale.macro.discrete.link_state import LinkState
from multiscale.macro.discrete.link_system import LinkSystem
from multiscale.macro.discrete.link_tangent import Tangent, prepare_tangent
from multiscale.macro.discrete.small_displacement import find_state
from multiscale.numerics.newton import Limits

__all__ = ["critical_factor", "material_entries", "smallest_eigenvalue", "stability_entries"]

BISECTIONS = 100
LARGEST_SHIFT = 1e3  # relative to the diagonal


def critical_factor(
    system: LinkSystem, load_factors: Sequence[float], *, tolerance: float = 1e-6
) -> float:
    r"""Return the load factor at which the structure loses its stability.

    Parameters
    ----------
    system : LinkSystem
    load_factors : sequence of float
        Increasing load factors; the interval before the first unstable state is bisected.
    tolerance : float, width of the last bracket relative to its upper end; dimensionless

    Returns
    -------
    float
        Critical load factor; infinite if the structure is stable at all load factors.

    Raises
    ------
    CaseError
        If the load factors do not increase, or the structure is not supported.
    ConvergenceError
        If an equilibrium is not found, or the bisection misses the tolerance.

    Notes
    -----
    The equilibrium is computed for small displacements. Its tangent with the geometric stiffness of
    the tensions,

    .. math:: K(\alpha) = B^T k B + \sum \frac{\tau}{L} (I - n n^T),    \tag{1}

    without slack links, is tested for definiteness by its Cholesky factors. Bending of a beam
    between its nodes is resolved only if the beam is divided into several.
    """
    factors = [float(factor) for factor in load_factors]
    if not factors or not np.all(np.diff(factors) > 0.0):
        raise CaseError(f"load_factors must increase, got {factors}")
    check_supports(system)
    model = equations(system)
    tangent = prepare_tangent(system, model)
    start = np.zeros(model.n)

    def stable(factor: float) -> bool:
        nonlocal start
        state = find_state(model, tangent, factor, start, "auto", Limits())
        if not state.solution.converged:
            raise ConvergenceError(f"no equilibrium found at load factor {factor:g}")
        start = state.solution.value
        return is_definite(tangent, stability_entries(system, model, tangent, state))

    low = factors[0]
    for factor in factors:
        if not stable(factor):
            break
        low = factor
    else:
        return float(np.inf)
    high = factor
    for _ in range(BISECTIONS):
        if high - low <= tolerance * abs(high):
            return high
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    raise ConvergenceError(
        f"after {BISECTIONS} bisections the critical load factor lies between {low:.9g} and "
        f"{high:.9g}, wider than the tolerance {tolerance:g}; give a larger tolerance, or "
        f"load_factors whose first is nearer to it"
    )


def material_entries(model: LinkEquations, tangent: Tangent, state: LinkState) -> np.ndarray:
    """Return the upper triangle of the tangent B^T k B of the links that are not slack, N/m."""
    taut = (state.slack == 0.0) & np.isfinite(model.stiffness)
    return tangent.entries(np.where(taut, model.stiffness, 0.0))


def stability_entries(
    system: LinkSystem, model: LinkEquations, tangent: Tangent, state: LinkState
) -> np.ndarray:
    """Return the upper triangle of the tangent (1) with the geometric stiffness, N/m."""
    links = system.n_links
    across = state.tension[:links] / system.length
    geometric = tangent.geometric(system.direction, np.zeros(links), across)
    return np.asarray(material_entries(model, tangent, state) + geometric)


def is_definite(tangent: Tangent, entries: np.ndarray) -> bool:
    """Return whether a symmetric matrix, given by its upper triangle, is positive definite."""
    try:
        tangent.factorise(entries, signs=True)
    except MultiscaleError:
        return False
    return True


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
