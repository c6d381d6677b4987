"""Cut elastic bodies into substructures, with rough joints between the bodies."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_array, csr_array, eye_array, hstack, vstack
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from multiscale.errors import CaseError
from multiscale.fe.elasticity import displacement_basis, elastic_matrix
from multiscale.fe.faces import face_areas, face_operator
from multiscale.laws.bulk import AnisotropicElastic, Elastic
from multiscale.macro.bodies.assembly import Assembly, Interface, Platen
from multiscale.macro.continuum.body import Body, evaluate, fixed_motion, load_vector
from multiscale.macro.substructures.problem import CutInterface, CutProblem, Substructure

__all__ = ["cut_assembly", "cut_bodies", "split_boxes"]

COINCIDENT = 1e-6
"""Distance of nodes that are taken as one point of a joint, relative to the size of a face."""


def split_boxes(body: Body, parts: tuple[int, ...]) -> np.ndarray:
    """Give elements to boxes of equal size.

    Parameters
    ----------
    body : Body
    parts : tuple of int
        Number of boxes along each axis.

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


def cut_assembly(assembly: Assembly, parts: tuple[int, int] = (1, 1)) -> CutProblem:
    """Cut every body of an assembly into boxes in plan; one load case for each of its times.

    Raises
    ------
    CaseError
        As :func:`cut_bodies`.
    """
    owners = [split_boxes(body, (*parts, 1)) for body in assembly.bodies]
    return cut_bodies(
        assembly.bodies,
        owners,
        assembly.interfaces,
        times=assembly.times,
        platens=assembly.platens,
    )


def cut_bodies(
    bodies: Sequence[Body],
    owners: Sequence[np.ndarray],
    joints: Sequence[Interface] = (),
    *,
    times: Sequence[float] = (1.0,),
    platens: Sequence[Platen] = (),
) -> CutProblem:
    """Cut bodies in three dimensions.

    Parameters
    ----------
    bodies : sequence of Body
        Linear elastic, on supports that do not move.
    owners : sequence of ndarray of int, shape (elements,)
        Substructure of every element, counted from 0 in each body.
    joints : sequence of Interface
        Laws between the bodies, or between a body and the ground.
    times : sequence of float
        One load case for each: the tractions at that time.
    platens : sequence of Platen
        Rigid plates on the bodies. Their unknowns come last; substructures share them as they
        share the nodes where they meet.

    Returns
    -------
    Problem

    Raises
    ------
    CaseError
        If a law is not elastic, a support moves, a platen is held, faces do not match, or a
        substructure is in pieces.
    """
    structure = _number(bodies, platens, times)
    found: list[tuple[csr_array, np.ndarray]] = []
    first_part = [0]
    for index, (body, owner) in enumerate(zip(bodies, owners, strict=True)):
        found.extend(_stiffness(body, index, np.asarray(owner), structure.of_body[index]))
        first_part.append(len(found))
    shares = np.bincount(np.concatenate([unknown for _, unknown in found]))
    load = structure.load / shares[:, None]
    parts = [
        Substructure(
            K, load[unknown], unknown, structure.position[unknown], structure.component[unknown]
        )
        for K, unknown in found
    ]
    interfaces = [
        interface
        for place, joint in enumerate(joints)
        for interface in _interfaces(
            place, joint, bodies, owners, structure.of_body, first_part, parts
        )
    ]
    return CutProblem(
        tuple(parts),
        np.concatenate([body.basis.doflocs.T for body in bodies]),
        csr_array(vstack(structure.of_body)),
        tuple(interfaces),
    )


@dataclass(frozen=True, eq=False)
class _Structure:
    """Unknowns of all bodies and platens.

    Attributes
    ----------
    of_body : list of csr_array, shape (3 nodes, n)
        Displacement of the nodes of every body from the unknowns.
    position : ndarray, shape (n, 3)
        m.
    component : ndarray of int, shape (n,)
    load : ndarray, shape (n, cases)
        N.
    """

    of_body: list[csr_array]
    position: np.ndarray
    component: np.ndarray
    load: np.ndarray


def _number(
    bodies: Sequence[Body], platens: Sequence[Platen], times: Sequence[float]
) -> _Structure:
    """Count the unknowns: what no support holds and no platen moves, then motions of platens."""
    first = np.cumsum([0, *(body.basis.doflocs.size for body in bodies)])
    free = np.ones(first[-1], dtype=bool)
    for index, body in enumerate(bodies):
        if body.mesh.dim() != 3:
            raise CaseError(f"body {index} must be three-dimensional to be cut")
        for time in times:
            held, motion = fixed_motion(body, time)
            if np.any(motion):
                raise CaseError(
                    f"the supports of body {index} move by up to {np.abs(motion).max():g} m; "
                    f"substructures take supports at rest, so give a traction in their place"
                )
            free[first[index] + held] = False
    ties, places, forces = [], [], []
    for index, platen in enumerate(platens):
        body, nodes = bodies[platen.body], bodies[platen.body].nodes(platen.boundary)
        row = first[platen.body] + 3 * nodes + platen.axis
        if not free[row].all():
            raise CaseError(
                f"platen {index} moves {np.count_nonzero(~free[row])} nodes of body {platen.body} "
                f"along axis {platen.axis} that a support or another platen holds; take one of them"
            )
        free[row] = False
        motion = platen.motion(body, body.basis.doflocs[:, nodes])
        row, column = np.repeat(row, motion.shape[1]), np.tile(np.arange(motion.shape[1]), row.size)
        ties.append(csr_array((motion.ravel(), (row, column)), shape=(free.size, motion.shape[1])))
        places.append(platen.positions(body).T)
        point = places[-1][:1].T
        force = [
            evaluate(platen.force, point, time, f"the force of platen {index}")[0] for time in times
        ]
        forces.append(np.outer(platen.arm(body), force))
    own = np.flatnonzero(free)
    single = csr_array((np.ones(own.size), (own, np.arange(own.size))), shape=(free.size, own.size))
    expansion = csr_array(hstack([single, *ties]))
    expansion.eliminate_zeros()
    load = np.concatenate(
        [np.stack([load_vector(body, time) for time in times], axis=1) for body in bodies]
    )
    load = expansion.T @ load
    load[own.size :] += np.concatenate([np.zeros((0, len(times))), *forces])
    position = np.concatenate([body.basis.doflocs.T for body in bodies])
    return _Structure(
        [expansion[a:b] for a, b in pairwise(first)],
        np.concatenate([position[own // 3], *places]),
        np.concatenate(
            [
                own % 3,
                *(np.full(len(at), one.axis) for at, one in zip(places, platens, strict=True)),
            ]
        ),
        load,
    )


def _stiffness(
    body: Body, index: int, owner: np.ndarray, expansion: csr_array
) -> list[tuple[csr_array, np.ndarray]]:
    """Stiffness of every substructure of a body, and its unknowns, rising."""
    mesh, found = body.mesh, []
    if not isinstance(body.law, Elastic | AnisotropicElastic):
        raise CaseError(
            f"body {index} must be Elastic or AnisotropicElastic to be cut, "
            f"got {type(body.law).__name__}"
        )
    if owner.shape != (mesh.t.shape[1],):
        raise CaseError(
            f"body {index} has {mesh.t.shape[1]} elements, got owners of shape {owner.shape}"
        )
    for part in range(int(owner.max()) + 1):
        elements = np.flatnonzero(owner == part)
        _check_piece(mesh.t[:, elements], f"substructure {part} of body {index}")
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
        mine = expansion[(3 * node[:, None] + np.arange(3)).ravel()]
        unknown = np.unique(mine.indices)
        mine = csr_array(mine[:, unknown])
        found.append((csr_array(mine.T @ elastic_matrix(basis, body.law) @ mine), unknown))
    return found


def _check_piece(elements: np.ndarray, name: str) -> None:
    """Refuse elements that do not hang together."""
    nodes, local = np.unique(elements, return_inverse=True)
    local = local.reshape(elements.shape)
    pairs = np.stack([local[:-1].ravel(), local[1:].ravel()])
    shape = (nodes.size, nodes.size)
    pieces = connected_components(coo_array((np.ones(pairs.shape[1]), pairs), shape=shape))[0]
    if pieces > 1:
        raise CaseError(f"{name} is in {pieces} pieces that do not touch; cut the mesh otherwise")


def _interfaces(
    place: int,
    joint: Interface,
    bodies: Sequence[Body],
    owners: Sequence[np.ndarray],
    of_body: Sequence[csr_array],
    first_part: Sequence[int],
    parts: Sequence[Substructure],
) -> list[CutInterface]:
    """One interface for each pair of substructures that a joint joins.

    A point belongs to the pair of its facet. A node that several pairs share goes to the pair that
    has most of its area: elastic ties around a node that it has in every pair would only be
    redundant. The ground is a side of the substructure on it that never moves.
    """
    below, above = joint.sides
    upper, name = bodies[above], str(joint.boundaries[1])
    facets = upper.mesh.boundaries[name]
    values, area = _points(upper, name, joint.quadrature_order)
    frame = _frame(upper, name)
    moved = [_in_frame(values, of_body[above], upper.nodes(name), frame)]
    owner = [first_part[above] + owners[above][upper.mesh.f2t[0, facets]]]
    if below is None:
        moved.insert(0, csr_array(moved[0].shape))
        owner.insert(0, owner[0])
    else:
        lower = bodies[below]
        twin, partner = _twins(joint, lower, upper)
        moved.insert(0, _in_frame(values, of_body[below], twin, frame))
        owner.insert(0, first_part[below] + owners[below][lower.mesh.f2t[0, partner]])
    pairs, of_facet = np.unique(np.stack(owner), axis=1, return_inverse=True)
    of_facet = csr_array((np.ones(facets.size), (np.arange(facets.size), of_facet.ravel())))
    share = (area @ of_facet).toarray()
    weight, of_point = share.sum(axis=1), np.argmax(share, axis=1)
    position = values @ upper.basis.doflocs[:, upper.nodes(name)].T
    found = []
    for index in np.unique(of_point):
        mine = np.flatnonzero(of_point == index)
        rows = (weight.size * np.arange(3)[:, None] + mine).ravel()
        first, second = (int(side) for side in pairs[:, index])
        traces = [
            csr_array(side[rows][:, parts[part].unknown])
            for side, part in zip(moved, (first, second), strict=True)
        ]
        found.append(
            CutInterface(
                (first, second), tuple(traces), joint.law, weight[mine], position[mine], place
            )
        )
    return found


def _points(body: Body, boundary: str, order: int | None) -> tuple[csr_array, csr_array]:
    """Values of a component at the points of a joint, and area of a point in every facet, m².

    Shapes (points, nodes of the boundary) and (points, facets).
    """
    nodes, facets = body.nodes(boundary), body.mesh.boundaries[boundary].size
    if order is not None:
        values, weight, _ = face_operator(body.basis, boundary, order=order)
        facet = np.repeat(np.arange(facets), weight.size // facets)
        at = np.arange(weight.size)
        return values[:, nodes], csr_array((weight, (at, facet)), shape=(at.size, facets))
    node, facet, area = face_areas(body.basis, boundary)
    if not np.isin(nodes, node).all():
        raise CaseError(
            f"some nodes of the boundary {boundary!r} stand for no area with "
            f"{type(body.basis.elem).__name__}; give the interface a quadrature_order"
        )
    point = np.searchsorted(nodes, node)
    return (
        eye_array(nodes.size, format="csr"),
        csr_array((area, (point, facet)), shape=(nodes.size, facets)),
    )


def _in_frame(
    values: csr_array, expansion: csr_array, nodes: np.ndarray, frame: np.ndarray
) -> csr_array:
    """Displacement of points in a frame from the unknowns, by values of nodes, (3 points, n)."""
    x, y, z = (values @ expansion[3 * nodes + axis] for axis in range(3))
    rows = csr_array(vstack([a * x + b * y + c * z for a, b, c in frame]))
    rows.eliminate_zeros()
    return rows


def _frame(upper: Body, boundary: str) -> np.ndarray:
    """Return the normal from side 1 to side 2 and two tangents, shape (3, 3)."""
    from skfem import FacetBasis

    faces = FacetBasis(upper.mesh, upper.mesh.elem(), facets=boundary, intorder=2)
    normals = -np.asarray(faces.normals).reshape(3, -1)
    normal = normals.mean(axis=1)
    if np.ptp(normals, axis=1).max() > COINCIDENT:
        raise CaseError(f"the boundary {boundary!r} of a joint must be plane")
    least = np.eye(3)[np.argmin(np.abs(normal).round(9))]  # rounding decides no direction
    first = least - (least @ normal) * normal
    first /= np.linalg.norm(first)
    return np.stack([normal, first, np.cross(normal, first)])


def _twins(joint: Interface, lower: Body, upper: Body) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of the lower body at the nodes of the upper boundary, and facets at its facets."""
    low, up = (
        body.nodes(str(name)) for body, name in zip((lower, upper), joint.boundaries, strict=True)
    )
    at = upper.basis.doflocs[:, up].T
    distance, nearest = cKDTree(lower.basis.doflocs[:, low].T).query(at)
    size = float(np.ptp(at, axis=0).max())
    if distance.max() > COINCIDENT * size:
        worst = at[np.argmax(distance)]
        raise CaseError(
            f"the boundaries {joint.boundaries} of a joint do not match: no node of the first lies "
            f"at {worst.round(9)} m of the second (nearest {distance.max():.2g} m away); mesh both "
            f"faces alike"
        )
    twin = low[nearest]
    below, above = (
        body.mesh.boundaries[name]
        for body, name in zip((lower, upper), joint.boundaries, strict=True)
    )
    middles = [
        body.mesh.p[:, body.mesh.facets[:, facets]].mean(axis=1).T
        for body, facets in ((lower, below), (upper, above))
    ]
    distance, nearest = cKDTree(middles[0]).query(middles[1])
    alike = type(lower.basis.elem) is type(upper.basis.elem)
    if distance.max() > COINCIDENT * size or not alike:
        raise CaseError(
            f"the facets of the boundaries {joint.boundaries} of a joint do not match; mesh both "
            f"faces alike, with the same elements"
        )
    return twin, below[nearest]
