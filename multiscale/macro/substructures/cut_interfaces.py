r"""Points where a law joins bodies: nodes, Gauss points, or averages.

Points are the nodes of matching elements of first order. Where meshes do not match, or elements are
of second order, they are averages: with the shape functions :math:`N` of the nodes of both sides,
and :math:`\psi` of the corners of the facets of side 2, or of side 1 where the facets of side 2 are
far larger (with both sides exchanged),

.. math:: D_{ab} = \int \psi_a N^2_b \,\mathrm{d}\Gamma, \qquad
    M_{ab} = \int \psi_a N^1_b \,\mathrm{d}\Gamma, \qquad
    w_a = \sum_b D_{ab}, \qquad
    j_a = \frac{1}{w_a} \sum_b \left(D_{ab} u^2_b - M_{ab} u^1_b\right)    \tag{1}

is the mean jump about corner a of side 2, and :math:`w_a` its area, which is positive. An even
traction gives each side the nodal forces that it is in balance with: the patch test is exact. The
nodes of second order have no such area: that of a corner of quadratic triangles is zero.

References
----------
.. [1] M. A. Puso and T. A. Laursen, Comput. Methods Appl. Mech. Eng. 193 (2004) 601-629,
   doi:10.1016/j.cma.2003.10.010: mortar integrals in three dimensions.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.sparse import csr_array, diags_array, eye_array, vstack

from multiscale.errors import CaseError
from multiscale.fe.elements import is_first_order
from multiscale.fe.faces import corner_integrals, face_areas, face_operator
from multiscale.fe.facets import ContactFace, facet_normals, surface_of
from multiscale.macro.bodies.assembly import Interface
from multiscale.macro.continuum.body import Body
from multiscale.macro.substructures.problem import CutInterface, Substructure

__all__ = ["cut_interface"]

COINCIDENT = 1e-6
"""Distance of nodes that are taken as one point of a joint, relative to the size of a face."""

REACH = 1e-3
"""Distance of facets, relative to the size of a face, beyond which they do not see each other."""

MEET = 0.5
"""Least share of the smaller face that must lie on the other where their meshes do not match."""

COARSE = 4.0
"""Ratio of the mean areas of facets above which the law acts on the side of the smaller facets."""

SLIVER = 1e-9
"""Points of a smaller share of the area of the largest are left out."""

UNLIKE = 100.0
"""Ratio of the sizes of two bodies above which one of them may be in another unit."""


@dataclass(frozen=True, eq=False)
class _Piece:
    """Points between two substructures.

    Attributes
    ----------
    sides : tuple of int, the substructures
    values : tuple of csr_array, shape (points, nodes)
        A component at the points from the nodes of the body on either side; None of the ground.
    weight : ndarray, shape (points,), m²
    """

    sides: tuple[int, int]
    values: tuple[csr_array | None, csr_array]
    weight: np.ndarray


def cut_interface(
    place: int,
    joint: Interface,
    bodies: Sequence[Body],
    owners: Sequence[np.ndarray],
    of_body: Sequence[csr_array],
    parts: Sequence[Substructure],
) -> list[CutInterface]:
    """Cut an interface into one for each pair of substructures that it joins."""
    below, above = joint.sides
    upper, name = bodies[above], str(joint.boundaries[1])
    frame = _frame(upper, name)
    part_above = owners[above][upper.mesh.f2t[0, upper.mesh.boundaries[name]]]
    lower, twin, part_below = None, None, part_above  # of the ground, which never moves
    if below is not None:
        lower, other = bodies[below], str(joint.boundaries[0])
        part_below = owners[below][lower.mesh.f2t[0, lower.mesh.boundaries[other]]]
        twins = _twins(joint, lower, upper)
        if twins is not None:
            twin, part_below = twins[0], part_below[twins[1]]
    owner = part_below, part_above
    if lower is not None and twin is None:
        pieces = _averages(joint, (lower, upper), owner)
    elif joint.quadrature_order is not None or is_first_order(upper.basis):
        pieces = _at_points(joint, (lower, upper), owner, twin)
    else:
        pieces = _averages_of_twins(joint, (lower, upper), owner, twin)
    found = []
    for piece in pieces:
        traces = [
            csr_array((3 * piece.weight.size, parts[part].n))
            if values is None or body is None
            else _in_frame(values, of_body[body][:, parts[part].unknown], frame)
            for part, body, values in zip(piece.sides, joint.sides, piece.values, strict=True)
        ]
        position = piece.values[1] @ upper.basis.doflocs.T
        first, second = traces
        gap = None if joint.gap is None else joint.gap.at(position)
        cut = CutInterface(
            piece.sides, (first, second), joint.law, piece.weight, position, place, gap
        )
        found.append(cut)
    for side, body in enumerate(joint.sides):
        if body is not None and not any(one.trace[side].nnz for one in found):
            held = bodies[body].say_face(str(joint.boundaries[side]), body)
            raise CaseError(
                f"interface {place} lies on a support: all nodes of the boundary {held} are held; "
                f"free them, or put the rigid ground in place of the held body"
            )
    return found


def _at_points(
    joint: Interface,
    bodies: tuple[Body | None, Body],
    owner: tuple[np.ndarray, np.ndarray],
    twin: np.ndarray | None = None,
) -> list[_Piece]:
    """Points of matching faces, or of one on the ground.

    A point belongs to the pair of its facet. A node that several pairs share goes to the pair that
    has most of its area: elastic ties around a node that it has in every pair would only be
    redundant.
    """
    (lower, upper), name = bodies, str(joint.boundaries[1])
    values, area = _points(upper, name, joint.quadrature_order)
    pairs, of_facet = np.unique(np.stack(owner), axis=1, return_inverse=True)
    facets = of_facet.size
    chosen = csr_array((np.ones(facets), (np.arange(facets), of_facet.ravel())))
    share = (area @ chosen).toarray()
    weight, of_point = share.sum(axis=1), np.argmax(share, axis=1)
    above = _of_nodes(values, upper.nodes(name), upper)
    below = None if lower is None or twin is None else _of_nodes(values, twin, lower)
    found = []
    for index in np.unique(of_point):
        mine = np.flatnonzero(of_point == index)
        sides = int(pairs[0, index]), int(pairs[1, index])
        here = None if below is None else below[mine]
        found.append(_Piece(sides, (here, above[mine]), weight[mine]))
    return found


def _averages_of_twins(
    joint: Interface,
    bodies: tuple[Body | None, Body],
    owner: tuple[np.ndarray, np.ndarray],
    twin: np.ndarray | None,
) -> list[_Piece]:
    """Points of matching faces of second order, or of one on the ground, by (1)."""
    (lower, upper), name = bodies, str(joint.boundaries[1])
    facet, corner, node, integral = corner_integrals(upper.basis, name)
    size, mate = (upper.mesh.p.shape[1], upper.basis.N), np.empty(upper.basis.N, dtype=int)
    mate[upper.nodes(name)] = upper.nodes(name) if twin is None else twin
    found = []
    for pair in np.unique(np.stack(owner), axis=1).T:
        here = (np.stack(owner) == pair[:, None]).all(axis=0)[facet]
        D = csr_array((integral[here], (corner[here], node[here])), shape=size)
        mean, weight = _means(D, D)
        below = None if lower is None else _of_nodes(mean[0], mate, lower)
        found.append(_Piece((int(pair[0]), int(pair[1])), (below, mean[1]), weight))
    return found


def _averages(
    joint: Interface, bodies: tuple[Body, Body], owner: tuple[np.ndarray, np.ndarray]
) -> list[_Piece]:
    """Points of faces that do not match, by (1) for each pair of substructures."""
    from scipy.spatial import cKDTree

    from multiscale.fe.mortar import couple

    boundaries = [str(one) for one in joint.boundaries]
    faces = [surface_of(body.mesh, at) for body, at in zip(bodies, boundaries, strict=True)]
    nodes = [body.nodes(at) for body, at in zip(bodies, boundaries, strict=True)]
    x = [body.mesh.p.T[face.nodes] for body, face in zip(bodies, faces, strict=True)]
    trial = [_nodes_of_facets(*one) for one in zip(bodies, faces, nodes, strict=True)]
    size = min(float(np.ptp(at, axis=0).max()) for at in x)
    facet_areas = [
        np.linalg.norm(facet_normals(at[face.facets]), axis=1)
        for at, face in zip(x, faces, strict=True)
    ]
    areas = [float(one.sum()) for one in facet_areas]
    # corners of far larger facets would be too few points
    own = 0 if facet_areas[1].mean() > COARSE * facet_areas[0].mean() else 1
    found = []
    for first, second in product(*map(np.unique, owner)):
        chosen = owner[0] == first, owner[1] == second
        facets, columns = (
            (each[own][chosen[own]], each[1 - own][chosen[1 - own]])
            for each in ([face.facets for face in faces], trial)
        )
        D, M = couple(facets, (x[own], x[1 - own]), REACH * size, columns)
        mean, weight = _means(M, D)
        if weight.size:
            in_order = mean if own else mean[::-1]
            below, above = (_of_nodes(*one) for one in zip(in_order, nodes, bodies, strict=True))
            found.append(_Piece((int(first), int(second)), (below, above), weight))
    covered = sum(float(piece.weight.sum()) for piece in found)
    if not found:
        extent = [float(np.ptp(body.mesh.p, axis=1).max()) for body in bodies]
        unlike = max(extent) > UNLIKE * min(extent)
        hint = "one of the meshes may be in mm and read as m" if unlike else "move one of them"
        away = float(cKDTree(x[0]).query(x[1])[0].min())
        raise CaseError(
            f"the boundaries {_say(joint, bodies)} of a joint do not touch face to face: their "
            f"nodes are {away:.3g} m apart or more, and the bodies {extent[0]:.3g} m and "
            f"{extent[1]:.3g} m long; {hint}"
        )
    if covered < MEET * min(areas):
        raise CaseError(
            f"the boundaries {_say(joint, bodies)} of a joint overlap on "
            f"{covered / min(areas):.2g} of the smaller one, and at least {MEET:g} is asked; name "
            f"the part of the faces where they meet as boundaries of their own"
        )
    return found


def _means(M: csr_array, D: csr_array) -> tuple[list[csr_array], np.ndarray]:
    """Mean values (1) of both sides about the corners that have an area, and these areas, m²."""
    weight = D.sum(axis=1)
    mine = np.flatnonzero(weight > SLIVER * weight.max())
    return [csr_array(diags_array(1.0 / weight[mine]) @ one[mine]) for one in (M, D)], weight[mine]


def _nodes_of_facets(body: Body, face: ContactFace, nodes: np.ndarray) -> np.ndarray:
    """Positions in the nodes of a face of the nodes of every facet: corners, then middles."""
    from scipy.spatial import cKDTree

    if nodes.size == face.nodes.size:
        return face.facets
    x = body.mesh.p.T[face.nodes][face.facets]
    places = [x, 0.5 * (x + np.roll(x, -1, axis=1)), x.mean(axis=1, keepdims=True)]
    place, size = np.concatenate(places, axis=1), float(np.ptp(x.reshape(-1, 3), axis=0).max())
    apart, nearest = cKDTree(body.basis.doflocs[:, nodes].T).query(place)
    is_node = (apart <= COINCIDENT * size).all(axis=0)  # the middle of a facet need not be
    return np.asarray(nearest[:, is_node])


def _say(joint: Interface, bodies: tuple[Body, Body]) -> str:
    """Name both boundaries of an interface."""
    if not all(body.name for body in bodies):
        return str(joint.boundaries)
    sides = zip(bodies, joint.boundaries, strict=True)
    return " and ".join(f"{body.name}.{boundary}" for body, boundary in sides)


def _of_nodes(values: csr_array, nodes: np.ndarray, body: Body) -> csr_array:
    """Values at all nodes of a body from values at some of them."""
    entries = values.tocoo()
    at = (entries.coords[0], nodes[entries.coords[1]])
    return csr_array((entries.data, at), shape=(values.shape[0], body.basis.N))


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
    point = np.searchsorted(nodes, node)
    return (
        eye_array(nodes.size, format="csr"),
        csr_array((area, (point, facet)), shape=(nodes.size, facets)),
    )


def _in_frame(values: csr_array, expansion: csr_array, frame: np.ndarray) -> csr_array:
    """Displacement of points in a frame from the unknowns, by values of nodes, (3 points, n)."""
    x, y, z = (values @ expansion[axis::3] for axis in range(3))
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
        raise CaseError(
            f"the boundary {boundary!r} of a joint must be plane; name each plane part by itself"
        )
    least = np.eye(3)[np.argmin(np.abs(normal).round(9))]  # rounding decides no direction
    first = least - (least @ normal) * normal
    first /= np.linalg.norm(first)
    return np.stack([normal, first, np.cross(normal, first)])


def _twins(joint: Interface, lower: Body, upper: Body) -> tuple[np.ndarray, np.ndarray] | None:
    """Nodes of the lower body at the nodes of the upper boundary, and facets at its facets.

    Nothing if nodes or facets do not match.
    """
    from scipy.spatial import cKDTree

    name, other = str(joint.boundaries[1]), str(joint.boundaries[0])
    low, up = lower.nodes(other), upper.nodes(name)
    at = upper.basis.doflocs[:, up].T
    apart, nearest = cKDTree(lower.basis.doflocs[:, low].T).query(at)
    below, above = lower.mesh.boundaries[other], upper.mesh.boundaries[name]
    middles = [
        body.mesh.p[:, body.mesh.facets[:, facets]].mean(axis=1).T
        for body, facets in ((lower, below), (upper, above))
    ]
    astray, partner = cKDTree(middles[0]).query(middles[1])
    size = float(np.ptp(at, axis=0).max())
    kinds = [type(body.basis.elem) for body in (lower, upper)]
    if kinds[0] is kinds[1] and max(apart.max(), astray.max()) <= COINCIDENT * size:
        return low[nearest], partner
    if joint.quadrature_order is not None:
        raise CaseError(
            f"the boundaries {_say(joint, (lower, upper))} of a joint do not match; mesh both "
            f"faces alike, with the same elements, or give no quadrature_order"
        )
    return None
