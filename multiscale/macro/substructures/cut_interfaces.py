r"""Points where a law joins bodies: nodes, Gauss points, or averages.

Without matching facets of first order or with nine nodes, the points are corners a of the facets of
one side. With its mortar rows D and M, (1) of :mod:`multiscale.fe.faces`, area and jump are

.. math:: w_a = \sum_b D_{ab}, \qquad
    j_a = \frac{1}{w_a} \sum_b \left(D_{ab} u^2_b - M_{ab} u^1_b\right).    \tag{1}
"""

from collections.abc import Iterator, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, vstack

from multiscale.errors import CaseError
from multiscale.fe.elasticity import is_first_order
from multiscale.fe.faces import (
    OrientedFace,
    corner_integrals,
    face_of,
    face_points,
    facet_nodes,
    match_faces,
    mean_rows,
    mortar_rows,
    plane_frame,
)
from multiscale.macro.bodies.assembly import Interface
from multiscale.macro.continuum.body import Body
from multiscale.macro.substructures.problem import CutInterface, Substructure

REACH = 1e-3
"""Distance of facets, relative to the size of a face, beyond which they do not overlap."""

MEET = 0.5
"""Least share of the smaller face that must lie on the other where their meshes do not match."""

COARSE = 4.0
"""Ratio of the mean areas of facets above which the law acts on the side of the smaller facets."""

UNLIKE = 100.0
"""Ratio of the sizes of two bodies above which a unit of length may be wrong."""


class _Piece(NamedTuple):
    sides: tuple[int, int]
    # a component at the points from the nodes of either body, (points, nodes); None of the ground
    values: tuple[csr_array | None, csr_array]
    area: np.ndarray  # (points,), m²


def cut_interface(
    place: int,
    joint: Interface,
    bodies: Sequence[Body],
    owners: Sequence[np.ndarray],
    of_body: Sequence[csr_array],
    substructures: Sequence[Substructure],
) -> list[CutInterface]:
    """Cut an interface along the pairs of substructures that it joins."""
    below, above = joint.sides
    upper, lower = bodies[above], None if below is None else bodies[below]
    boundaries = str(joint.boundaries[0]), str(joint.boundaries[1])
    face = face_of(upper.mesh, boundaries[1])
    frame = plane_frame(face, boundaries[1])

    # substructures on either side of every facet; any number serves for the ground at rest
    owner_above = owners[above][upper.mesh.f2t[0, upper.mesh.boundaries[boundaries[1]]]]
    owner, match = (owner_above, owner_above), None
    if below is not None and lower is not None:
        owner_below = owners[below][lower.mesh.f2t[0, lower.mesh.boundaries[boundaries[0]]]]
        match = match_faces((lower.basis, upper.basis), boundaries)
        owner = owner_below if match is None else owner_below[match[1]], owner_above
        if match is None and joint.quadrature_order is not None:
            raise CaseError(
                f"the boundaries {_name(joint, (lower, upper))} of a joint do not match; mesh both "
                f"faces with the same elements, or leave out quadrature_order"
            )

    # values of both bodies at the points of each pair of substructures
    if lower is not None and match is None:
        pieces = _average_across(joint, (lower, upper), owner)
    else:
        mate = np.zeros(upper.basis.N, dtype=int)  # node of the lower body at each node
        if match is not None:
            mate[upper.nodes(boundaries[1])] = match[0]
        has_areas = is_first_order(upper.basis) or upper.basis.elem.facet_dofs > 0  # nine nodes
        by_nodes = joint.quadrature_order is not None or has_areas
        of_pairs = _at_points if by_nodes else _average_about_corners
        pieces = [
            _Piece(sides, (lower and _renumber(values, mate, lower), values), area)
            for sides, values, area in of_pairs(joint, upper, owner)
        ]

    # traces of the substructures in the frame of the interface
    interfaces = []
    for piece in pieces:
        first, second = (
            csr_array((3 * piece.area.size, substructures[owner].n))
            if values is None or body is None
            else _in_frame(values, of_body[body][:, substructures[owner].unknown], frame)
            for owner, body, values in zip(piece.sides, joint.sides, piece.values, strict=True)
        )
        position = piece.values[1] @ upper.basis.doflocs.T
        gap = None if joint.gap is None else joint.gap.at(position)
        interfaces.append(
            CutInterface(piece.sides, (first, second), joint.law, piece.area, position, place, gap)
        )
    for side, body in enumerate(joint.sides):
        if body is not None and not any(cut.trace[side].nnz for cut in interfaces):
            fixed = bodies[body].face_name(boundaries[side], body)
            raise CaseError(
                f"interface {place} lies on a support: all nodes of the boundary {fixed} are "
                f"fixed; free them, or put the rigid ground in place of the fixed body"
            )
    return interfaces


Rows = Iterator[tuple[tuple[int, int], csr_array, np.ndarray]]
"""Substructures, values of the upper body at the points between them, and areas, m²."""


def _at_points(joint: Interface, upper: Body, owner: tuple[np.ndarray, np.ndarray]) -> Rows:
    """Points of matching faces, or of a face on the ground."""
    values, area = face_points(upper.basis, str(joint.boundaries[1]), joint.quadrature_order)
    pairs, of_facet = np.unique(np.stack(owner), axis=1, return_inverse=True)
    facets = of_facet.size
    share = area @ csr_array((np.ones(facets), (np.arange(facets), of_facet.ravel())))
    total, of_point = share.sum(axis=1), np.argmax(share.toarray(), axis=1)
    for pair in np.unique(of_point):
        points = np.flatnonzero(of_point == pair)
        yield (int(pairs[0, pair]), int(pairs[1, pair])), values[points], total[points]


def _average_about_corners(
    joint: Interface, upper: Body, owner: tuple[np.ndarray, np.ndarray]
) -> Rows:
    """Averages (1) of matching faces of second order, or of a face on the ground."""
    facet, corner, node, integral = corner_integrals(upper.basis, str(joint.boundaries[1]))
    size = upper.mesh.p.shape[1], upper.basis.N
    for pair in np.unique(np.stack(owner), axis=1).T:
        here = (np.stack(owner) == pair[:, None]).all(axis=0)[facet]
        D = csr_array((integral[here], (corner[here], node[here])), shape=size)
        values, _, area = mean_rows(D, D)
        yield (int(pair[0]), int(pair[1])), values, area


def _average_across(
    joint: Interface, bodies: tuple[Body, Body], owner: tuple[np.ndarray, np.ndarray]
) -> list[_Piece]:
    """Averages (1) of faces that do not match, for each pair of substructures."""
    sides = list(zip(bodies, map(str, joint.boundaries), strict=True))
    faces = [face_of(body.mesh, boundary) for body, boundary in sides]
    columns = [
        facet_nodes(body.basis, boundary, face)
        for (body, boundary), face in zip(sides, faces, strict=True)
    ]
    facet_areas = [np.linalg.norm(face.normals, axis=1) for face in faces]
    reach = REACH * min(float(np.ptp(face.position, axis=0).max()) for face in faces)
    # corners of far larger facets would be too few points
    coarse = facet_areas[1].mean() > COARSE * facet_areas[0].mean()
    order = (0, 1) if coarse else (1, 0)  # the side of the points first
    pieces = []
    for pair in product(*map(np.unique, owner)):
        chosen = [owner[side] == pair[side] for side in (0, 1)]
        a, b = order
        D, M = mortar_rows(
            (faces[a].facets[chosen[a]], faces[b].facets[chosen[b]]),
            (faces[a].position, faces[b].position),
            reach,
            columns=(columns[a][chosen[a]], columns[b][chosen[b]]),
            sizes=(bodies[a].basis.N, bodies[b].basis.N),
        )
        *values, area = mean_rows(D, M)
        if area.size:
            lower, upper = values if coarse else values[::-1]
            pieces.append(_Piece((int(pair[0]), int(pair[1])), (lower, upper), area))
    _check_overlap(joint, bodies, faces, sum(float(piece.area.sum()) for piece in pieces))
    return pieces


def _check_overlap(
    joint: Interface, bodies: tuple[Body, Body], faces: Sequence[OrientedFace], covered: float
) -> None:
    """Refuse faces that do not touch, or overlap on less than a share of the smaller face."""
    from scipy.spatial import cKDTree

    if covered == 0.0:
        extent = [float(np.ptp(body.mesh.p, axis=1).max()) for body in bodies]
        unlike = max(extent) > UNLIKE * min(extent)
        hint = "a mesh in mm may have been read as m" if unlike else "move one of the bodies"
        away = float(cKDTree(faces[0].position).query(faces[1].position)[0].min())
        raise CaseError(
            f"the boundaries {_name(joint, bodies)} of a joint do not touch face to face: their "
            f"nodes are {away:.3g} m apart or more, and the bodies {extent[0]:.3g} m and "
            f"{extent[1]:.3g} m long; {hint}"
        )
    smaller = min(float(np.linalg.norm(face.normals, axis=1).sum()) for face in faces)
    if covered < MEET * smaller:
        raise CaseError(
            f"the boundaries {_name(joint, bodies)} of a joint overlap on "
            f"{covered / smaller:.2g} of the smaller face, and at least {MEET:g} is required; name "
            f"the regions where the faces meet as separate boundaries"
        )


def _name(joint: Interface, bodies: tuple[Body, Body]) -> str:
    if not all(body.name for body in bodies):
        return str(joint.boundaries)
    sides = zip(bodies, joint.boundaries, strict=True)
    return " and ".join(f"{body.name}.{boundary}" for body, boundary in sides)


def _renumber(values: csr_array, number: np.ndarray, body: Body) -> csr_array:
    """Values from the nodes of a body by values from other nodes at the same places."""
    entries = values.tocoo()
    at = (entries.coords[0], number[entries.coords[1]])
    return csr_array((entries.data, at), shape=(values.shape[0], body.basis.N))


def _in_frame(values: csr_array, expansion: csr_array, frame: np.ndarray) -> csr_array:
    """Displacement of points in a frame from the unknowns, by values of nodes, (3 points, n)."""
    x, y, z = (values @ expansion[axis::3] for axis in range(3))
    rows = csr_array(vstack([a * x + b * y + c * z for a, b, c in frame]))
    rows.eliminate_zeros()
    return rows
