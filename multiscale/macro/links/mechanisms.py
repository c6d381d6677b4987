"""Mechanisms, states of self-stress and stability under load."""

from dataclasses import replace

import numpy as np
from numpy.linalg import norm
from scipy.linalg import svd
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

from multiscale.errors import CaseError, MultiscaleError
from multiscale.macro.links.link_equations import LinkEquations, LinkState, Tangent, compatibility
from multiscale.macro.links.link_system import LinkSystem
from multiscale.numerics.factorisation import Solve

RANK_TOLERANCE = 1e-10
"""Singular values of the compatibility operator below this share of the largest count as zero."""

MAX_DENSE_SIZE = 4000  # largest number of links or unknowns for a singular value decomposition

LARGEST_CONDITION = 1e14
"""Condition number of the tangent without slack above which a structure is a mechanism."""

REGULARISATION = 1e-11
"""Stiffness that regularises the tangent of a mechanism, relative to the diagonal."""

LARGEST_SHIFT = 1e3
"""Largest shift of eigenvalues to a definite matrix, relative to the largest diagonal entry."""


def self_stress(system: LinkSystem) -> np.ndarray:
    r"""Return independent states of self-stress, :math:`B^T \tau = 0`.

    Parameters
    ----------
    system : LinkSystem, structure of bars, cables and struts with its supports

    Returns
    -------
    ndarray, shape (modes, links)
        Orthonormal tensions. A single state has the sign that puts most cables in tension.

    Examples
    --------
    >>> from multiscale.macro import tensegrity_grid
    >>> module = replace(tensegrity_grid(1), fixed=np.zeros((8, 3), dtype=bool))
    >>> tension = self_stress(module)[0]
    >>> np.round(tension[[0, 4, 8, 12]] / tension[0], 6)
    array([ 1.      ,  1.414214,  1.414214, -2.44949 ])
    """
    operator = compatibility(system)
    if max(operator.shape) > MAX_DENSE_SIZE:
        raise CaseError(
            f"modes are computed by a dense decomposition of at most {MAX_DENSE_SIZE} links or "
            f"unknowns, got {operator.shape}; analyse a single module"
        )
    left, values, _ = svd(operator.toarray())
    rank = np.count_nonzero(values > RANK_TOLERANCE * values.max(initial=0.0))
    modes = left[:, rank:].T[:, : system.n_links]
    if len(modes) == 1:
        cables = np.isfinite(system.bounds[0])
        modes = modes * (np.sign(modes[0, cables].sum()) or 1.0)
    return np.asarray(modes)


def prestress_by_itself(system: LinkSystem, largest: float) -> LinkSystem:
    r"""Return a structure with a state of self-stress that its links can carry.

    Among several states it maximises the force in the least stressed cable or strut,

    .. math:: \max_{\tau \in \ker B^T} \min_i \sigma_i \tau_i, \qquad |\tau| \le 1,    \tag{1}

    with :math:`\sigma = 1` for cables and -1 for struts. Bars carry both signs; the minimum
    excludes them and links without force in all states.

    Parameters
    ----------
    largest : float, largest force in a link, N

    Returns
    -------
    LinkSystem, the same structure with its prestress

    Examples
    --------
    >>> from multiscale.macro import tensegrity_grid
    >>> free = np.zeros((8, 3), dtype=bool)
    >>> module = replace(tensegrity_grid(1), fixed=free, prestress=np.zeros(16))
    >>> module = prestress_by_itself(module, 1000.0)
    >>> module.prestress[[0, 4, 8, 12]].round(3)
    array([  408.248,   577.35 ,   577.35 , -1000.   ])
    """
    from scipy.optimize import linprog

    if np.any(system.prestress):
        raise CaseError(
            "the links have a prestress already; give either the prestress or a state of "
            "self-stress"
        )
    states = self_stress(system)
    lower, upper = system.bounds
    sign = np.where(np.isfinite(lower), 1.0, -1.0)
    reached = norm(states, axis=0) > RANK_TOLERANCE
    one_sided = reached & (np.isfinite(lower) | np.isfinite(upper))
    if not len(states):
        raise CaseError(
            "the structure has no state of self-stress: no tensions without load are in equilibrium"
        )
    if not one_sided.any():
        raise CaseError(
            "without cables and struts the state of self-stress is ambiguous; give the prestress "
            "of each link"
        )
    # (1) as a linear program in the shares of the states and the least tension
    m, signed = len(states), (sign * states)[:, one_sided].T
    force = np.column_stack([states.T, np.zeros(system.n_links)])
    least = np.column_stack([-signed, np.ones(len(signed))])
    answer = linprog(
        np.append(np.zeros(m), -1.0),
        A_ub=np.vstack([least, force, -force]),
        b_ub=np.concatenate([np.zeros(len(least)), np.ones(2 * system.n_links)]),
        bounds=(None, None),
    )
    if not (answer.success and answer.x[m] > RANK_TOLERANCE):
        raise CaseError(
            f"none of the {m} states of self-stress has all its cables in tension and all its "
            f"struts in compression; change the nodes or the kinds of links"
        )
    tension = answer.x[:m] @ states
    return replace(system, prestress=largest / np.abs(tension).max() * tension)


def factorise_taut(model: LinkEquations) -> Solve:
    """Factorise the stiffness of the structure without slack."""
    tangent = model.tangent
    entries = tangent.entries(model.finite_stiffness)
    solve = tangent.factorise(entries)
    scale = np.sqrt(entries[tangent.diagonal])
    signs = np.random.default_rng(seed=0).choice([-1.0, 1.0], size=model.n)
    with np.errstate(all="ignore"):
        motion = np.abs(solve(scale * signs) * scale).max(initial=0.0)
    if not motion < LARGEST_CONDITION:
        raise MultiscaleError("the structure is a mechanism")
    return solve


def name_mechanism(model: LinkEquations, u: np.ndarray) -> str:
    """Return a sentence that names the nodes that move freely in a state, or an empty string."""
    if not np.isfinite(u).all():
        u = np.zeros_like(u)
    tangent, stiffness = model.tangent, model.finite_stiffness
    elastic = model.prestress + stiffness * model.elongate(u)
    carries = (elastic >= model.lower) & (elastic <= model.upper)
    entries = tangent.entries(np.where(carries, stiffness, 0.0))
    spring = REGULARISATION * tangent.entries(stiffness)[tangent.diagonal]
    spring = np.maximum(spring, 1e-3 * spring.max(initial=0.0))  # directions without links
    entries[tangent.diagonal] += spring
    try:
        solve = tangent.factorise(entries)
    except MultiscaleError:
        return ""
    # power iteration: only the springs resist a free motion
    motion = np.random.default_rng(seed=0).standard_normal(model.n)
    for _ in range(4):
        motion = solve(spring * motion)
        motion /= norm(motion)
    if norm(solve(spring * motion)) < 0.5:
        return ""
    return name_motion(model, motion)


def name_motion(model: LinkEquations, motion: np.ndarray) -> str:
    """Return a sentence that names the nodes that move most in a free motion, shape (n,)."""
    size = norm(model.at_nodes(motion)[:, :3], axis=1)
    if not size.any():
        size = norm(model.at_nodes(motion), axis=1)
    moving = np.flatnonzero(size > 0.3 * size.max())
    order = moving[np.argsort(-size[moving], kind="stable")]
    named = ", ".join(str(node) for node in order[:5])
    more = f" and {order.size - 5} more" if order.size > 5 else ""
    return f"{'nodes' if order.size > 1 else 'node'} {named}{more} can move without resistance"


def stability_eigenvalues(
    system: LinkSystem, model: LinkEquations, state: LinkState
) -> tuple[float, float]:
    """Return the smallest eigenvalues, N/m, of the tangent without and with geometric stiffness."""
    # B^T k B, and with sum tau/L (I - n n^T) (1), without slack links
    links, tangent = system.n_links, model.tangent
    taut = (state.slack == 0.0) & np.isfinite(model.stiffness)
    material = tangent.entries(np.where(taut, model.stiffness, 0.0))
    across = state.tension[:links] / system.length
    geometric = tangent.geometric(system.direction, np.zeros(links), across)
    whole = material + geometric
    return smallest_eigenvalue(tangent, material), smallest_eigenvalue(tangent, whole)


def smallest_eigenvalue(tangent: Tangent, entries: np.ndarray) -> float:
    """Smallest eigenvalue of an upper triangle, N/m, by inverse Lanczos; NaN without an answer."""
    n, diagonal = tangent.start.size - 1, tangent.diagonal
    matrix = tangent.matrix(entries)
    if n < 20:
        return float(np.linalg.eigvalsh(matrix.toarray())[0])
    shift, largest = 0.0, float(np.abs(entries[diagonal]).max())
    while not shift > LARGEST_SHIFT * largest:
        shifted = entries.copy()
        shifted[diagonal] += shift
        try:
            solve = tangent.factorise(shifted, signs=True)
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
