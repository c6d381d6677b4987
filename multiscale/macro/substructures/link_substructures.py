"""Cut a discrete structure into substructures."""

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from multiscale.errors import CaseError
from multiscale.macro.links.link_equations import compatibility, equations
from multiscale.macro.links.link_system import LinkSystem
from multiscale.macro.substructures.problem import CutProblem, Links, Substructure, expand_numbers

__all__ = ["cut_links", "split_grid"]


def cut_links(system: LinkSystem, owner: np.ndarray) -> CutProblem:
    """Cut a structure of links at its nodes.

    Parameters
    ----------
    system : LinkSystem, the structure; links of finite stiffness
    owner : ndarray of int, shape (links,)
        Substructure of every link: 0, 1, ...; of :func:`split_grid`, for instance.

    Returns
    -------
    CutProblem
        One load case. Nodes that lie in two substructures are edge interfaces, in three or
        more weak cross-points; their loads are shared out equally.

    Raises
    ------
    CaseError
        If a substructure is empty or in pieces, or a link has a fixed length.
    """
    owner = np.asarray(owner)
    if owner.shape != (system.n_links,):
        raise CaseError(f"owner must have one entry per link ({system.n_links}), got {owner.shape}")
    model = equations(system)
    if not np.isfinite(model.stiffness).all():
        raise CaseError("substructures need extensible links; give a finite rigidity")
    rows = owner[model.link]
    operator = compatibility(system)
    _check_pieces(system, owner)

    count = int(owner.max()) + 1
    position = np.repeat(system.position, model.number.shape[1], axis=0).reshape(-1, 3)
    component = np.tile(np.arange(model.number.shape[1]), system.n_nodes)
    free = model.number.ravel() >= 0
    held_by = [np.unique(operator[rows == part].indices) for part in range(count)]
    shares = np.bincount(np.concatenate(held_by), minlength=model.n)
    parts = []
    for part, unknown in enumerate(held_by):
        mine = rows == part
        links = Links(
            csr_array(operator[mine][:, unknown]),
            model.stiffness[mine],
            model.prestress[mine],
            model.lower[mine],
            model.upper[mine],
            np.flatnonzero(mine),
        )
        parts.append(
            Substructure(
                csr_array((unknown.size, unknown.size)),  # links alone
                (model.load[unknown] / shares[unknown])[:, None],
                unknown,
                position[free][unknown],
                component[free][unknown],
                links,
            )
        )
    return CutProblem(tuple(parts), system.position, expand_numbers(model.number))


def split_grid(system: LinkSystem, parts: tuple[int, int]) -> np.ndarray:
    """Give modules to boxes of equal size in plan.

    Parameters
    ----------
    system : LinkSystem, the structure; links of one ``group`` stay together
    parts : tuple of int, number of boxes along x and y

    Returns
    -------
    ndarray of int, shape (links,), substructure of every link
    """
    middle = system.position[system.ends].mean(axis=1)[:, :2]
    groups, index = np.unique(system.group, return_inverse=True)
    if groups.size == 1:
        index = np.arange(system.n_links)
    weight = np.bincount(index)
    centre = np.stack([np.bincount(index, middle[:, axis]) / weight for axis in (0, 1)], axis=1)
    low, high = system.position[:, :2].min(axis=0), system.position[:, :2].max(axis=0)
    box = np.floor((centre - low) / (high - low) * parts).astype(int)
    box = np.clip(box, 0, np.array(parts) - 1)
    return np.unique((box[:, 1] * parts[0] + box[:, 0])[index], return_inverse=True)[1]


def _check_pieces(system: LinkSystem, owner: np.ndarray) -> None:
    """Refuse substructures that are empty or not connected."""
    for part in range(int(owner.max()) + 1):
        nodes, ends = np.unique(system.ends[owner == part], return_inverse=True)
        if not nodes.size:
            raise CaseError(f"substructure {part} has no links; number the owners without gaps")
        ends = ends.reshape(-1, 2)
        graph = csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), (nodes.size, nodes.size))
        pieces, label = connected_components(graph, directed=False)
        if pieces > 1:
            alone = nodes[label == np.argmin(np.bincount(label))]
            raise CaseError(
                f"substructure {part} is in {pieces} pieces: node {alone[0]} hangs together with "
                f"{alone.size - 1} others only; cut along modules or take fewer substructures"
            )
