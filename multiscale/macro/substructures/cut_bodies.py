"""Cut elastic bodies into substructures, with rough joints between the bodies."""

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from multiscale.errors import CaseError
from multiscale.fe.elasticity import displacement_basis, elastic_matrix
from multiscale.fe.faces import face_areas
from multiscale.laws.bulk import AnisotropicElastic, Elastic
from multiscale.macro.bodies.assembly import Assembly, Interface
from multiscale.macro.continuum.body import Body, fixed_motion, load_vector
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
    return cut_bodies(assembly.bodies, owners, assembly.interfaces, times=assembly.times)


def cut_bodies(
    bodies: Sequence[Body],
    owners: Sequence[np.ndarray],
    joints: Sequence[Interface] = (),
    *,
    times: Sequence[float] = (1.0,),
) -> CutProblem:
    """Cut bodies in three dimensions.

    Parameters
    ----------
    bodies : sequence of Body
        Linear elastic, on supports that do not move.
    owners : sequence of ndarray of int, shape (elements,)
        Substructure of every element, counted from 0 in each body.
    joints : sequence of Interface
        Laws between the bodies.
    times : sequence of float
        One load case for each: the tractions at that time.

    Returns
    -------
    Problem

    Raises
    ------
    CaseError
        If a law is not elastic, a support moves, faces do not match, or a substructure is in
        pieces.
    """
    first_node = np.cumsum([0, *(body.mesh.p.shape[1] for body in bodies)])
    first_part = np.cumsum([0, *(int(owner.max()) + 1 for owner in owners)])
    position = np.concatenate([body.mesh.p.T for body in bodies])
    number = _number([*bodies], times)
    parts: list[Substructure] = []
    for index, (body, owner) in enumerate(zip(bodies, owners, strict=True)):
        mine = number[first_node[index] : first_node[index + 1]]
        parts.extend(_parts(body, index, np.asarray(owner), mine, times))
    interfaces = [
        interface
        for place, joint in enumerate(joints)
        for interface in _interfaces(
            place, joint, bodies, owners, number, first_node, first_part, parts
        )
    ]
    return CutProblem(tuple(parts), position, number, tuple(interfaces))


def _number(bodies: Sequence[Body], times: Sequence[float]) -> np.ndarray:
    """Unknown of every component of every node, -1 where it is held."""
    held = []
    for index, body in enumerate(bodies):
        if body.mesh.dim() != 3:
            raise CaseError(f"body {index} must be three-dimensional to be cut")
        mask = np.zeros(3 * body.mesh.p.shape[1], dtype=bool)
        for time in times:
            unknown, motion = fixed_motion(body, time)
            if np.any(motion):
                raise CaseError(
                    f"the supports of body {index} move by up to {np.abs(motion).max():g} m; "
                    f"substructures take supports at rest, so give a traction in their place"
                )
            mask[unknown] = True
        held.append(mask)
    free = ~np.concatenate(held)
    number = np.full(free.size, -1)
    number[free] = np.arange(np.count_nonzero(free))
    return number.reshape(-1, 3)


def _parts(
    body: Body, index: int, owner: np.ndarray, number: np.ndarray, times: Sequence[float]
) -> list[Substructure]:
    if not isinstance(body.law, Elastic | AnisotropicElastic):
        raise CaseError(
            f"body {index} must be Elastic or AnisotropicElastic to be cut, "
            f"got {type(body.law).__name__}"
        )
    mesh = body.mesh
    if owner.shape != (mesh.t.shape[1],):
        raise CaseError(
            f"body {index} has {mesh.t.shape[1]} elements, got owners of shape {owner.shape}"
        )
    force = np.stack([load_vector(body, time) for time in times], axis=1)
    count = int(owner.max()) + 1
    nodes_of = [np.unique(mesh.t[:, owner == part]) for part in range(count)]
    shares = np.bincount(np.concatenate(nodes_of), minlength=mesh.p.shape[1])
    force = force / np.repeat(np.maximum(shares, 1), 3)[:, None]
    parts = []
    for part, nodes in enumerate(nodes_of):
        elements = np.flatnonzero(owner == part)
        _check_piece(mesh.t[:, elements], f"substructure {part} of body {index}")
        small = type(mesh)(
            np.ascontiguousarray(mesh.p[:, nodes]),
            np.ascontiguousarray(np.searchsorted(nodes, mesh.t[:, elements])),
        )
        basis = displacement_basis(small, mesh.elem())
        K = elastic_matrix(basis, body.law)
        unknown = number[nodes].ravel()
        free = np.flatnonzero(unknown >= 0)
        parts.append(
            Substructure(
                csr_array(K[free][:, free]),
                force.reshape(-1, 3, len(times))[nodes].reshape(-1, len(times))[free],
                unknown[free],
                np.repeat(mesh.p[:, nodes].T, 3, axis=0)[free],
                np.tile(np.arange(3), nodes.size)[free],
            )
        )
    return parts


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
    number: np.ndarray,
    first_node: np.ndarray,
    first_part: np.ndarray,
    parts: Sequence[Substructure],
) -> list[CutInterface]:
    """One interface for each pair of substructures that a joint joins.

    Its points are nodes. One that several pairs share goes to the pair that has most of its
    area: elastic ties around a node that it has in every pair would only be redundant.
    """
    lower, upper = (bodies[side] for side in joint.sides)
    basis = displacement_basis(upper.mesh, upper.mesh.elem())
    node, facet, area = face_areas(basis, joint.boundaries[1])
    twin = _twins(joint, lower, upper)
    frame = _frame(upper, joint.boundaries[1])
    facets = upper.mesh.boundaries[joint.boundaries[1]]
    pair = np.stack(
        [
            _owner_below(joint, lower, upper, twin, owners, facets),
            owners[joint.sides[1]][upper.mesh.f2t[0, facets]],
        ]
    )
    pairs, of_facet = np.unique(pair, axis=1, return_inverse=True)
    nodes, point = np.unique(node, return_inverse=True)
    share = np.zeros((nodes.size, pairs.shape[1]))
    np.add.at(share, (point, of_facet.ravel()[facet]), area)
    weight, of_node = share.sum(axis=1), np.argmax(share, axis=1)
    found = []
    for index in np.unique(of_node):
        mine = np.flatnonzero(of_node == index)
        traces, sides = [], []
        for body, piece, at in zip(
            joint.sides, pairs[:, index], (twin[nodes[mine]], nodes[mine]), strict=True
        ):
            sides.append(int(first_part[body] + piece))
            traces.append(_trace(number[first_node[body] + at], frame, parts[sides[-1]].unknown))
        position = upper.mesh.p[:, nodes[mine]].T
        found.append(
            CutInterface(
                (sides[0], sides[1]), tuple(traces), joint.law, weight[mine], position, place
            )
        )
    return found


def _trace(unknown: np.ndarray, frame: np.ndarray, own: np.ndarray) -> csr_array:
    """Displacement of nodes in the frame of the joint, shape (3 nodes, unknowns)."""
    order, count = np.argsort(own), len(unknown)
    row, column, value = [], [], []
    for direction in range(3):
        for axis in range(3):
            kept = np.flatnonzero((unknown[:, axis] >= 0) & (frame[direction, axis] != 0.0))
            row.append(direction * count + kept)
            column.append(order[np.searchsorted(own[order], unknown[kept, axis])])
            value.append(np.full(kept.size, frame[direction, axis]))
    triplets = (np.concatenate(value), (np.concatenate(row), np.concatenate(column)))
    return csr_array(triplets, shape=(3 * count, own.size))


def _frame(upper: Body, boundary: str) -> np.ndarray:
    """Return the normal from side 1 to side 2 and two tangents, shape (3, 3)."""
    from skfem import FacetBasis

    faces = FacetBasis(upper.mesh, upper.mesh.elem(), facets=boundary)
    normals = -np.asarray(faces.normals).reshape(3, -1)
    normal = normals.mean(axis=1)
    if np.ptp(normals, axis=1).max() > COINCIDENT:
        raise CaseError(f"the boundary {boundary!r} of a joint must be plane")
    least = np.eye(3)[np.argmin(np.abs(normal))]
    first = least - (least @ normal) * normal
    first /= np.linalg.norm(first)
    return np.stack([normal, first, np.cross(normal, first)])


def _twins(joint: Interface, lower: Body, upper: Body) -> np.ndarray:
    """Node of the lower body at every node of the upper face, -1 elsewhere."""
    for body, name in zip((lower, upper), joint.boundaries, strict=True):
        body.check_boundary(name)
    low, up = (
        np.unique(body.mesh.facets[:, body.mesh.boundaries[name]])
        for body, name in zip((lower, upper), joint.boundaries, strict=True)
    )
    distance, nearest = cKDTree(lower.mesh.p[:, low].T).query(upper.mesh.p[:, up].T)
    size = float(np.ptp(upper.mesh.p[:, up], axis=1).max())
    if distance.max() > COINCIDENT * size:
        worst = upper.mesh.p[:, up[np.argmax(distance)]]
        raise CaseError(
            f"the boundaries {joint.boundaries} of a joint do not match: no node of the first lies "
            f"at {worst.round(9)} m of the second (nearest {distance.max():.2g} m away); mesh both "
            f"faces alike"
        )
    twin = np.full(upper.mesh.p.shape[1], -1)
    twin[up] = low[nearest]
    return twin


def _owner_below(
    joint: Interface,
    lower: Body,
    upper: Body,
    twin: np.ndarray,
    owners: Sequence[np.ndarray],
    facets: np.ndarray,
) -> np.ndarray:
    """Substructure of the lower body under every facet of the upper face."""
    below = lower.mesh.boundaries[joint.boundaries[0]]
    key = {
        tuple(sorted(nodes)): facet
        for facet, nodes in zip(below, lower.mesh.facets[:, below].T.tolist(), strict=True)
    }
    mine = np.sort(twin[upper.mesh.facets[:, facets]], axis=0).T.tolist()
    try:
        partner = np.array([key[tuple(nodes)] for nodes in mine])
    except KeyError:
        raise CaseError(
            f"the facets of the boundaries {joint.boundaries} of a joint do not match; mesh both "
            f"faces alike"
        ) from None
    return np.asarray(owners[joint.sides[0]][lower.mesh.f2t[0, partner]])
