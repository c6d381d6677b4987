"""Faces and interfaces: oriented facets, areas of nodes, mortar integrals."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from skfem import MeshHex, MeshQuad, MeshTet, MeshTri

from multiscale.errors import CaseError
from multiscale.fe.elasticity import displacement_basis
from multiscale.fe.faces import face_of, face_points, facet_normals, mortar_rows, plane_frame
from tests.contact_scenes import block, distorted, rotation_2d


def test_facets_look_outwards_and_their_nodes_share_the_area():
    for kind in (MeshTri, MeshQuad, MeshTet, MeshHex):
        mesh = distorted(kind, seed=3)
        d = mesh.dim()
        for side, axis, sign in (("top", d - 1, 1.0), ("left", 0, -1.0)):
            face = face_of(mesh, side)
            normal = face.normals
            assert np.all(sign * normal[:, axis] > 0.0)
            values, areas = face_points(displacement_basis(mesh, mesh.elem()), side)
            np.testing.assert_array_equal(values.indices, face.nodes)
            # facets of distorted hexahedra are warped: their area exceeds the normals' length
            assert areas.sum() == pytest.approx(np.linalg.norm(normal, axis=1).sum(), rel=2e-2)


@pytest.mark.parametrize("kind", [MeshQuad, MeshHex])
def test_a_face_bent_around_an_axis_is_not_plane(kind):
    mesh = block(kind, (2,) * kind().dim(), np.zeros(kind().dim()), np.ones(kind().dim()))
    bent = mesh.with_boundaries({"bent": np.union1d(*map(mesh.boundaries.get, ("top", "left")))})
    plane_frame(face_of(mesh, "top"), "top")
    with pytest.raises(CaseError, match="boundary 'bent' of a joint must be plane"):
        plane_frame(face_of(bent, "bent"), "bent")


def surfaces(d, kinds, seed):
    """Two flat surfaces that overlap in part, turned in space."""
    low = np.zeros(d)
    body = block(kinds[0], (3, 4, 1)[-d:], low, np.ones(d))
    high = np.full(d, 1.3)
    two = block(kinds[1], (4, 3, 1)[-d:], low + 0.2, high)
    top, bottom = face_of(body, "top"), face_of(two, "bottom")
    x1, x2 = body.p.T[top.nodes].copy(), two.p.T[bottom.nodes].copy()
    x1[:, -1], x2[:, -1] = 0.0, 0.1
    turn = Rotation.random(random_state=seed).as_matrix() if d == 3 else rotation_2d(seed)
    return top.facets, bottom.facets, x1 @ turn.T, x2 @ turn.T


PAIRS = [
    pytest.param(2, (MeshQuad, MeshTri), id="segments"),
    pytest.param(3, (MeshHex, MeshHex), id="quadrilaterals"),
    pytest.param(3, (MeshTet, MeshHex), id="triangle on quadrilateral"),
    pytest.param(3, (MeshTet, MeshTet), id="triangles"),
]


@pytest.mark.parametrize(("d", "kinds"), PAIRS)
def test_mortar_integrals_are_exact_on_the_common_area(d, kinds):
    f1, f2, x1, x2 = surfaces(d, kinds, seed=4)
    D, M = mortar_rows((f1, f2), (x1, x2))
    common = 0.8 ** (d - 1)
    assert D.sum() == pytest.approx(common, rel=1e-13)
    np.testing.assert_allclose(D.sum(axis=1), M.sum(axis=1), atol=1e-15)
    # a linear field is the same on both sides but for the gap of 0.1 along the normal
    jump = M @ x2 - D @ x1
    normal = facet_normals(x1[f1])[0]
    normal /= np.linalg.norm(normal)
    np.testing.assert_allclose(jump, 0.1 * np.outer(D.sum(axis=1), normal), atol=1e-14)


def test_surfaces_beyond_reach_or_back_to_back_do_not_see_each_other():
    f1, f2, x1, x2 = surfaces(3, (MeshHex, MeshHex), seed=5)
    assert mortar_rows((f1, f2), (x1, x2), reach=0.05)[0].sum() == 0.0
    assert mortar_rows((f1, f2[:, ::-1]), (x1, x2))[0].sum() == 0.0
