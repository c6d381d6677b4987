"""Cut bodies with rough joints, or discrete structures, into substructures."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import bsr_array, coo_array, csr_array, hstack, vstack
from scipy.sparse.csgraph import connected_components

from multiscale.errors import CaseError
from multiscale.fe.elasticity import displacement_basis, elastic_matrix, mode_stiffness
from multiscale.laws.bulk import AnisotropicElastic, Elastic
from multiscale.macro.bodies.assembly import Assembly, Platen
from multiscale.macro.continuum.body import Body, evaluate, fixed_motion, load_vector
from multiscale.macro.links.link_system import LinkSystem
from multiscale.macro.substructures.cut_interfaces import cut_interface
from multiscale.macro.substructures.problem import (
    CutBolt,
    CutProblem,
    Links,
    Substructure,
    expand_numbers,
)
from multiscale.numerics.factorisation import compact


def split_boxes(body: Body, parts: tuple[int, ...]) -> np.ndarray:
    """Assign elements to boxes of equal size.

    Parameters
    ----------
    parts : tuple of int, number of boxes along each axis

    Returns
    -------
    ndarray of int, shape (elements,)
    """
    mesh = body.mesh
    middle = mesh.p[:, mesh.t].mean(axis=1)
    low, high = mesh.p.min(axis=1), mesh.p.max(axis=1)
    box = np.floor((middle - low[:, None]) / (high - low)[:, None] * np.array(parts)[:, None])
    box = np.minimum(box.astype(int), np.array(parts)[:, None] - 1)
    return np.unique(np.ravel_multi_index(tuple(box), parts), return_inverse=True)[1]


def cut_assembly(
    assembly: Assembly,
    parts: tuple[int, int] = (1, 1),
    *,
    owners: Sequence[np.ndarray] | None = None,
) -> CutProblem:
    """Cut the bodies of an assembly, with a load case for each of its times.

    The bolts are tightened together by a load case before the others. The unknowns of platens and
    washers come last; substructures share them as they share the nodes where they meet.

    Parameters
    ----------
    parts : tuple of int, boxes of every body in plan, along x and y
    owners : sequence of ndarray of int, shape (elements,), optional
        Substructure of every element, counted from 0 in each body, in place of the boxes.

    Raises
    ------
    CaseError
        If a law is not elastic, a support moves, a platen has fixed nodes, faces do not match, or a
        substructure is in pieces.
    """
    # number the unknowns of bodies, platens, washers and cuts through bolts
    bodies, bolts, sections = assembly.bodies, assembly.bolts, assembly.sections
    owners = owners or [split_boxes(body, (*parts, 1)) for body in bodies]
    plates = [("platen", platen) for platen in assembly.platens]
    plates += [("washer", washer) for bolt in bolts for washer in bolt.washers(bodies)]
    structure = _number(assembly, plates)
    middle = structure.first[len(assembly.platens) :].reshape(-1, 2).tolist()
    cut_bolts = tuple(
        CutBolt((below, above), bolt.stiffness, bolt.preload, bolt.name(bodies))
        for bolt, (below, above) in zip(bolts, middle, strict=True)
    )
    # stiffness of the substructures, and their shares of the loads
    matrices: list[tuple[csr_array, np.ndarray]] = []
    first_number = [0]
    for index, (body, owner) in enumerate(zip(bodies, owners, strict=True)):
        matrices.extend(_stiffness(body, index, np.asarray(owner), structure.of_body[index]))
        first_number.append(len(matrices))
    shares = np.bincount(np.concatenate([unknown for _, unknown in matrices]))
    load = structure.load
    if cut_bolts or sections:
        pull = [bolt.preload * bolt.pull(len(load)) for bolt in cut_bolts]
        load = np.column_stack([np.sum([structure.tension, *pull], axis=0), load])
    load = load / shares[:, None]
    substructures = [
        Substructure(
            K, load[unknown], unknown, structure.position[unknown], structure.component[unknown]
        )
        for K, unknown in matrices
    ]

    # cut the interfaces along the substructures
    numbered = [
        np.asarray(owner) + first for owner, first in zip(owners, first_number, strict=False)
    ]
    interfaces = [
        interface
        for place, joint in enumerate(assembly.interfaces)
        for interface in cut_interface(
            place, joint, bodies, numbered, structure.of_body, substructures
        )
    ]
    return CutProblem(
        tuple(substructures),
        np.concatenate([body.basis.doflocs.T for body in bodies]),
        csr_array(vstack(structure.of_body)),
        tuple(interfaces),
        cut_bolts,
    )


@dataclass(frozen=True, eq=False)
class _Structure:
    of_body: list[csr_array]  # displacement of the nodes of a body from the unknowns, (3 nodes, n)
    position: np.ndarray  # (n, 3), m
    component: np.ndarray  # of int, (n,)
    load: np.ndarray  # (n, cases), N
    first: np.ndarray  # first unknown of every platen, of int, (platens,)
    tension: np.ndarray  # forces of all cuts through bolts, (n,), N


def _number(assembly: Assembly, platens: Sequence[tuple[str, Platen]]) -> _Structure:
    """Count the unknowns: free components of nodes, motions of platens, stretches of sections."""
    bodies, times = assembly.bodies, assembly.times
    first = np.cumsum([0, *(body.basis.doflocs.size for body in bodies)])
    free = _free_rows(assembly, first)
    motions, places, acting = _tie_platens(assembly, platens, first, free)
    follows, ends, middles, axes, pulled = _tie_sections(assembly, first, free)

    # displacement of the nodes from free rows, motions of platens, and stretches of sections
    rows = np.flatnonzero(free)
    entries = np.ones(rows.size), (rows, np.arange(rows.size))
    single = csr_array(entries, shape=(free.size, rows.size))
    expansion = csr_array(hstack([single, *motions, *ends]))
    expansion = csr_array(expansion + follows @ expansion)
    expansion.eliminate_zeros()

    # loads of the bodies, and forces of the platens on their motions
    loads = [np.concatenate([load_vector(body, time) for body in bodies]) for time in times]
    load = expansion.T @ np.reshape(loads, (len(times), first[-1])).T
    load[rows.size : rows.size + len(acting)] += acting
    position = np.concatenate([body.basis.doflocs.T for body in bodies])
    sizes = [len(place) for place in places]
    axes = [*np.repeat([platen.axis for _, platen in platens], sizes), *axes]
    return _Structure(
        [expansion[a:b] for a, b in pairwise(first)],
        np.concatenate([position[rows // 3], *places, *middles]),
        np.append(rows % 3, axes).astype(int),
        load,
        rows.size + np.cumsum([0, *sizes])[: len(platens)],
        expansion.T @ pulled,
    )


def _free_rows(assembly: Assembly, first: np.ndarray) -> np.ndarray:
    """Components of all nodes without supports, shape (3 nodes,); supports must not move."""
    free = np.ones(first[-1], dtype=bool)
    for index, body in enumerate(assembly.bodies):
        name = body.name or f"body {index}"
        if body.mesh.dim() != 3:
            raise CaseError(f"{name} must be three-dimensional to be cut")
        for time in assembly.times:
            fixed, motion = fixed_motion(body, time)
            if np.any(motion):
                raise CaseError(
                    f"the supports of {name} move by up to {np.abs(motion).max():g} m; "
                    f"supports of substructures must be at rest, so give a traction in their place"
                )
            free[first[index] + fixed] = False
    return free


def _tie_platens(
    assembly: Assembly, platens: Sequence[tuple[str, Platen]], first: np.ndarray, free: np.ndarray
) -> tuple[list[csr_array], list[np.ndarray], np.ndarray]:
    """Rows of the nodes that platens move, their places, and forces, (motions, times)."""
    bodies, times = assembly.bodies, assembly.times
    ties, places, forces = [], [], [np.zeros((0, len(times)))]
    for kind, platen in platens:
        name = f"the {kind} on {bodies[platen.body].face_name(platen.boundary, platen.body)}"
        body, nodes = bodies[platen.body], bodies[platen.body].nodes(platen.boundary)
        row = first[platen.body] + 3 * nodes + platen.axis
        if not free[row].all():
            raise CaseError(
                f"{name} moves {np.count_nonzero(~free[row])} nodes along {'xyz'[platen.axis]} "
                f"that a support, a platen or another washer fixes; remove one of the two"
            )
        free[row] = False
        motion = platen.motion(body, body.basis.doflocs[:, nodes])
        row, column = np.repeat(row, motion.shape[1]), np.tile(np.arange(motion.shape[1]), row.size)
        ties.append(csr_array((motion.ravel(), (row, column)), shape=(free.size, motion.shape[1])))
        places.append(platen.positions(body).T)
        point = places[-1][:1].T
        force = [evaluate(platen.force, point, time, f"the force of {name}")[0] for time in times]
        forces.append(np.outer(platen.arm(body), force))
    return ties, places, np.concatenate(forces)


def _tie_sections(
    assembly: Assembly, first: np.ndarray, free: np.ndarray
) -> tuple[csr_array, list[csr_array], list[np.ndarray], list[int], np.ndarray]:
    """Rows that follow others through cuts of bolts, and stretches of the cuts; tensions, N."""
    bodies = assembly.bodies
    follows, pulled = csr_array((free.size, free.size)), np.zeros(free.size)
    ties, places, axes = [], [], []
    for section in assembly.sections:
        lower, upper = section.sides
        first_nodes, second_nodes, axis, along = section.nodes(bodies)
        count = first_nodes.size
        lead = first[lower] + 3 * first_nodes[:, None] + np.arange(3)
        row = first[upper] + 3 * second_nodes[:, None] + np.arange(3)
        if not free[row].all():
            raise CaseError(
                f"the cut through a bolt at "
                f"{bodies[upper].face_name(section.boundaries[1], upper)} "
                f"has nodes that a support, a platen or another cut fixes; remove one of the two"
            )
        free[row] = False
        mean = np.full(count**2, -1.0 / count)
        pairs = np.repeat(row[:, axis], count), np.tile(lead[:, axis], count)
        follows += csr_array((np.ones(row.size), (row.ravel(), lead.ravel())), shape=follows.shape)
        follows += csr_array((mean, pairs), shape=follows.shape)  # (1) of BoltSection
        ends = np.ones(count), (row[:, axis], np.zeros(count, dtype=int))
        ties.append(csr_array(ends, shape=(free.size, 1)))
        places.append(bodies[upper].basis.doflocs[:, second_nodes].mean(axis=1)[None])
        axes.append(axis)
        pulled[row[:, axis]] += along * section.preload / count
        pulled[lead[:, axis]] -= along * section.preload / count
    return follows, ties, places, axes, pulled


def _stiffness(
    body: Body, index: int, owner: np.ndarray, expansion: csr_array
) -> list[tuple[csr_array, np.ndarray]]:
    """Stiffness of every substructure of a body, and its unknowns in rising order."""
    from skfem import ElementHex1

    mesh, matrices = body.mesh, []
    if not isinstance(body.law, Elastic | AnisotropicElastic):
        raise CaseError(
            f"body {index} must be Elastic or AnisotropicElastic to be cut, "
            f"got {type(body.law).__name__}"
        )
    if owner.shape != (mesh.t.shape[1],):
        raise CaseError(
            f"body {index} has {mesh.t.shape[1]} elements, got owners of shape {owner.shape}"
        )
    for number in range(int(owner.max()) + 1):
        elements = np.flatnonzero(owner == number)
        whole = body.name or f"body {index}"
        _check_piece(
            mesh.t[:, elements],
            f"substructure {number} of {whole}" if elements.size < owner.size else whole,
        )
        # elements of this substructure only
        basis = body.basis
        if elements.size < owner.size:
            corners = np.unique(mesh.t[:, elements])
            small = type(mesh)(
                np.ascontiguousarray(mesh.p[:, corners]),
                np.ascontiguousarray(np.searchsorted(corners, mesh.t[:, elements])),
            )
            basis = displacement_basis(small, basis.elem)
        node = np.empty(basis.N, dtype=int)
        node[basis.element_dofs] = body.basis.element_dofs[:, elements]
        # displacement of its nodes from its unknowns
        E = expansion[(3 * node[:, None] + np.arange(3)).ravel()]
        unknown = np.unique(E.indices)
        E = compact(csr_array(E[:, unknown]))
        share = None if body.share is None else body.share[elements]
        K = elastic_matrix(basis, body.law, share)
        if body.bends and isinstance(basis.elem, ElementHex1):
            K = K - mode_stiffness(basis, body.law, share)
        matrices.append((compact(csr_array(E.T @ K @ E)), unknown))
    return matrices


def _check_piece(elements: np.ndarray, name: str) -> None:
    nodes, local = np.unique(elements, return_inverse=True)
    local = local.reshape(elements.shape)
    pairs = np.stack([local[:-1].ravel(), local[1:].ravel()])
    shape = (nodes.size, nodes.size)
    pieces = connected_components(coo_array((np.ones(pairs.shape[1]), pairs), shape=shape))[0]
    if pieces > 1:
        raise CaseError(
            f"{name} is in {pieces} pieces that do not touch; make each piece a body, by "
            f"the name of its volume or of a face of it"
        )


def cut_links(system: LinkSystem, owner: np.ndarray, *, prestressed: bool = False) -> CutProblem:
    r"""Cut a structure of links at its nodes.

    Parameters
    ----------
    system : LinkSystem, the structure; links of finite stiffness
    owner : ndarray of int, shape (links,)
        Substructure of every link: 0, 1, ...; from :func:`split_grid`, for instance.
    prestressed : bool
        Whether the prestress resists that links turn, as in cable nets, with the stiffness
        :math:`\tau^0 / L\, (I - n n^T)` of the displacement of the ends of a link.

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
    from multiscale.macro.links.link_equations import compatibility, equations

    owner = np.asarray(owner)
    if owner.shape != (system.n_links,):
        raise CaseError(
            f"owner must have an entry for each link ({system.n_links},), got shape {owner.shape}"
        )
    model = equations(system)
    if not np.isfinite(model.stiffness).all():
        raise CaseError("substructures need extensible links; give a finite rigidity")
    rows = owner[model.link]
    operator = compatibility(system)
    _check_links(system, owner)

    count = int(owner.max()) + 1
    position = np.repeat(system.position, model.number.shape[1], axis=0).reshape(-1, 3)
    component = np.tile(np.arange(model.number.shape[1]), system.n_nodes)
    free = model.number.ravel() >= 0
    turned, across = _turning(system, model.number) if prestressed else (operator, None)
    of_row = np.repeat(owner, 3) if prestressed else rows
    unknowns = [np.unique(turned[of_row == index].indices) for index in range(count)]
    shares = np.bincount(np.concatenate(unknowns), minlength=model.n)
    substructures = []
    for index, unknown in enumerate(unknowns):
        inside = rows == index
        links = Links(
            csr_array(operator[inside][:, unknown]),
            model.stiffness[inside],
            model.prestress[inside],
            model.lower[inside],
            model.upper[inside],
            np.flatnonzero(inside),
        )
        stiffness = csr_array((unknown.size, unknown.size))  # no stiffness but the links
        if across is not None:
            turns = csr_array(turned[of_row == index][:, unknown])
            stiffness = csr_array(turns.T @ across[of_row == index][:, of_row == index] @ turns)
        substructures.append(
            Substructure(
                stiffness,
                (model.load[unknown] / shares[unknown])[:, None],
                unknown,
                position[free][unknown],
                component[free][unknown],
                links,
            )
        )
    return CutProblem(tuple(substructures), system.position, expand_numbers(model.number))


def _turning(system: LinkSystem, number: np.ndarray) -> tuple[csr_array, csr_array]:
    """Differences of the ends of links, and the force of their prestress across these, N/m."""
    columns = number[system.ends][..., :3]  # (links, ends, components)
    link, end, component = np.nonzero(columns >= 0)
    places = 3 * link + component, columns[link, end, component]
    shape = 3 * system.n_links, int(number.max()) + 1
    difference = csr_array(coo_array((2.0 * end - 1.0, places), shape=shape))
    n, density = system.direction, system.prestress / system.length
    blocks = density[:, None, None] * (np.eye(3) - n[:, :, None] * n[:, None, :])
    rows = np.arange(system.n_links)
    return difference, csr_array(bsr_array((blocks, rows, np.arange(rows.size + 1))))


def split_grid(system: LinkSystem, parts: tuple[int, int]) -> np.ndarray:
    """Assign modules to boxes of equal size in plan.

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


def _check_links(system: LinkSystem, owner: np.ndarray) -> None:
    for number in range(int(owner.max()) + 1):
        nodes, ends = np.unique(system.ends[owner == number], return_inverse=True)
        if not nodes.size:
            raise CaseError(f"substructure {number} has no links; number the owners without gaps")
        ends = ends.reshape(-1, 2)
        graph = csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), (nodes.size, nodes.size))
        pieces, label = connected_components(graph, directed=False)
        if pieces > 1:
            island = nodes[label == np.argmin(np.bincount(label))]
            raise CaseError(
                f"substructure {number} is in {pieces} pieces: node {island[0]} is connected to "
                f"only {island.size - 1} others; cut along modules or use fewer substructures"
            )
