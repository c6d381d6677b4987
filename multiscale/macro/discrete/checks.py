"""Checks of a structure before a computation, with one sentence per fault."""

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from multiscale.errors import CaseError
from multiscale.fe.rigid_motion import count_free_motions

if TYPE_CHECKING:
    from multiscale.macro.discrete.link_system import LinkSystem

__all__ = [
    "check_balance",
    "check_links",
    "check_nodes",
    "check_supports",
    "nodal_masses",
    "nodal_pull",
    "out_of_balance",
]

BALANCE_TOLERANCE = 1e-6
"""Largest allowed force out of balance, relative to the largest prestress."""

MIN_RELATIVE_LENGTH = 1e-9
"""Smallest allowed length of a link, relative to the size of the structure."""


def check_nodes(system: "LinkSystem") -> None:
    """Refuse arrays of nodes with wrong shapes or numbers that are not finite."""
    nodes, c = system.n_nodes, system.n_components
    expected = {"position": (nodes, 3), "fixed": (nodes, c), "load": (nodes, c)}
    for name, shape in expected.items():
        found = np.shape(getattr(system, name))
        if found != shape:
            why = " (six unknowns per node with beams)" if c == 6 and name != "position" else ""
            raise CaseError(f"{name} must have shape {shape}{why}, got {found}")
    for name in ("position", "load"):
        finite = np.isfinite(getattr(system, name)).all(axis=1)
        if not finite.all():
            raise CaseError(f"{name} of node {int(np.argmin(finite))} is not finite")


def check_links(system: "LinkSystem") -> None:
    """Refuse links without ends, length or law, duplicates, and prestress outside the bounds."""
    links, nodes = system.n_links, system.n_nodes
    if links == 0 or np.shape(system.ends) != (links, 2):
        raise CaseError(f"ends must have shape (links, 2), got {np.shape(system.ends)}")
    for name in ("kind", "prestress", "group"):
        if np.shape(getattr(system, name)) != (links,):
            found = np.shape(getattr(system, name))
            raise CaseError(f"{name} must have one entry per link, ({links},), got {found}")
    for name, top in (("ends", nodes), ("kind", len(system.laws))):
        outside = np.flatnonzero(
            ((getattr(system, name) < 0) | (getattr(system, name) >= top)).reshape(links, -1).any(1)
        )
        if outside.size:
            k = int(outside[0])
            raise CaseError(
                f"{name} of link {k} must lie between 0 and {top - 1}, got "
                f"{getattr(system, name)[k]}"
            )
    if not np.isfinite(system.prestress).all():
        raise CaseError(
            f"prestress of link {int(np.argmin(np.isfinite(system.prestress)))} is not finite"
        )
    lower, upper = system.bounds
    wrong = np.flatnonzero((system.prestress < lower) | (system.prestress > upper))
    if wrong.size:
        k = int(wrong[0])
        law = type(system.laws[system.kind[k]]).__name__.lower()
        raise CaseError(
            f"prestress of link {k}, a {law}, must lie between {lower[k]:g} and {upper[k]:g} N, "
            f"got {system.prestress[k]:g}"
        )
    touched = np.zeros(system.n_nodes, dtype=bool)
    touched[system.ends.ravel()] = True
    if not touched.all():
        loose = np.flatnonzero(~touched)
        named = ", ".join(str(node) for node in loose[:5])
        more = f" and {loose.size - 5} more" if loose.size > 5 else ""
        subject = f"node {named} has" if loose.size == 1 else f"nodes {named}{more} have"
        raise CaseError(f"{subject} no link; connect or remove loose nodes")
    size = float(np.ptp(system.position, axis=0).max())
    shortest = int(np.argmin(system.length))
    if not system.length[shortest] > MIN_RELATIVE_LENGTH * size:
        a, b = system.ends[shortest]
        raise CaseError(
            f"link {shortest} between nodes {a} and {b} has length {system.length[shortest]:g} m; "
            f"merge the nodes or move them apart"
        )
    low, high = np.sort(system.ends, axis=1).T.astype(np.int64)
    key = (system.group.astype(np.int64) * system.n_nodes + low) * system.n_nodes + high
    order = np.argsort(key, kind="stable")
    twice = np.flatnonzero(np.diff(key[order]) == 0)
    if twice.size:
        first, second = order[twice[0]], order[twice[0] + 1]
        a, b = system.ends[first]
        raise CaseError(
            f"links {first} and {second} both join nodes {a} and {b}; remove one, or give them "
            f"different groups if they belong to different modules"
        )


def out_of_balance(system: "LinkSystem") -> np.ndarray:
    r"""Return the force :math:`B^T \tau^0` of the prestress, shape (nodes, 3), N; zero if fixed."""
    force = nodal_pull(system, system.prestress[:, None] * system.direction)
    force[system.fixed[:, :3]] = 0.0
    return force


def nodal_pull(system: "LinkSystem", pull: np.ndarray) -> np.ndarray:
    """Sum pulls of the links, shape (links, 3), N, at their second ends less the first ends."""
    force = np.zeros((system.n_nodes, 3))
    for i in range(3):
        force[:, i] = np.bincount(system.ends[:, 1], pull[:, i], system.n_nodes)
        force[:, i] -= np.bincount(system.ends[:, 0], pull[:, i], system.n_nodes)
    return force


def check_balance(system: "LinkSystem") -> None:
    """Refuse a prestress that is not in equilibrium."""
    largest = float(np.abs(system.prestress).max())
    if largest == 0.0:
        return
    force = np.sqrt(np.square(out_of_balance(system)).sum(axis=1))
    worst = int(np.argmax(force))
    if force[worst] > BALANCE_TOLERANCE * largest:
        bad = int(np.count_nonzero(force > BALANCE_TOLERANCE * largest))
        named = "1 node" if bad == 1 else f"{bad} nodes"
        raise CaseError(
            f"the prestress is out of balance at {named}, worst at node {worst} by "
            f"{force[worst]:.4g} N ({100 * force[worst] / largest:.2g} % of its largest tension); "
            f"take forces that are in balance with each other, as self_stress finds them"
        )


def check_supports(system: "LinkSystem") -> None:
    """Refuse a structure with a part that can move as a rigid body."""
    graph = coo_array(
        (np.ones(system.n_links, dtype=np.int8), tuple(system.ends.T)), (system.n_nodes,) * 2
    )
    parts, part = connected_components(graph, directed=False)
    for k in range(parts):
        inside = np.flatnonzero(part == k)
        freedom = count_free_motions(system.position[inside], np.asarray(system.fixed)[inside])
        if freedom:
            whole = "the structure" if parts == 1 else f"the part with node {inside[0]}"
            raise CaseError(
                f"{whole} ({inside.size} nodes) is not supported: {freedom} of its rigid motions "
                f"are free; fix more directions of its nodes"
            )


def nodal_masses(system: "LinkSystem", mass: np.ndarray | float, free: np.ndarray) -> np.ndarray:
    """Return the mass of every component of the nodes, shape (nodes, components), kg."""
    given = np.asarray(mass, dtype=float)
    if given.ndim == 1:
        given = given[:, None]
    try:
        masses = np.broadcast_to(given, free.shape)
    except ValueError:
        raise CaseError(
            f"mass must be one number or one per node ({system.n_nodes},), got {np.shape(mass)}"
        ) from None
    if not np.all(masses[free] > 0.0) or not np.all(np.isfinite(masses[free])):
        node = int(np.argwhere(free & ~((masses > 0.0) & np.isfinite(masses)))[0, 0])
        raise CaseError(f"mass of node {node} must be positive (kg), got {masses[node].min():g}")
    return masses
