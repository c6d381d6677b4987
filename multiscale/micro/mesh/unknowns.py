r"""Unknowns of a cell on a mesh with conditions on its sides, and multigrid as their inverse.

Nodal displacements are :math:`u = E v`. On the contact face of quadratic tetrahedra :math:`v` are
coefficients in a basis with positive integrals over every facet [1]_,

.. math::
    \varphi_c = N_c + \alpha \sum_e N_e, \quad \varphi_e = (1 - 2\alpha) N_e, \qquad
    u_e = (1 - 2\alpha) v_e + \alpha (v_{c_1} + v_{c_2}),    \tag{1}

with corners c, middles e of edges and :math:`\alpha = 1/5` (0 for other elements). Contact in
:math:`v` is contact in the mean with the dual basis of :math:`\varphi`.

.. [1] A. Popp, B. I. Wohlmuth, M. W. Gee and W. A. Wall, SIAM J. Sci. Comput. 34 (2012)
   B421-B446, doi:10.1137/110848190.
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from multiscale.errors import CaseError
from multiscale.fe.multigrid import POLYNOMIAL, nodal_cycle
from multiscale.laws.bulk.bulk_law import cofactor
from multiscale.micro.elastic.active_set import Constrained
from multiscale.micro.path import ContactState, ElasticCell
from multiscale.numerics.krylov import Operator, conjugate_gradients

if TYPE_CHECKING:
    from skfem import CellBasis, FacetBasis

ALPHA = 0.2


@dataclass(frozen=True, eq=False)
class CellUnknowns:
    """Free unknowns of a cell of n nodes, and the nodes of its contact face."""

    expand: sparse.csr_array  # (3 n, unknowns), E: displacements from the unknowns
    place: np.ndarray  # (unknowns,), place 3 a + i of every unknown among components i of nodes a
    image: np.ndarray  # (n,), the node itself, or its image on the low sides
    nodes: np.ndarray  # (contacts,), contact nodes without their images
    number: np.ndarray  # (contacts, 3), unknowns of the coefficients; -1 if fixed
    values: sparse.csr_array  # (n, n), nodal values from coefficients of (1)
    coefficients: sparse.csr_array  # (contacts, n), coefficients of contact nodes from nodal values
    weight: np.ndarray  # (contacts,), projected area of every coefficient, m2
    facets: np.ndarray  # (corners and middles, facets), positions in ``nodes``

    def neighbours(self) -> np.ndarray:
        """Return pairs of contact nodes that share a facet, shape (2, pairs)."""
        first, second = np.triu_indices(len(self.facets), 1)
        return np.stack([self.facets[first].ravel(), self.facets[second].ravel()])


@dataclass(frozen=True, eq=False)
class ElasticMesh:
    """The equations of an elastic body on a mesh, with contact quantities at the contact nodes."""

    problem: ElasticCell
    basis: "CellBasis"  # of a displacement component
    unknowns: CellUnknowns
    stiffness: sparse.csr_array  # (unknowns, unknowns), N/m


def cell_unknowns(basis: "CellBasis", sides: str) -> CellUnknowns:
    """Enumerate the unknowns of a cell with a condition on its sides."""
    points, base = basis.doflocs, basis.get_dofs("base").all()
    top_facets, face_values, coefficients, weight = _top_face(basis)
    top = np.unique(top_facets)
    bottom, lowest = float(points[2, base].max()), top[np.argmin(points[2, top])]
    if points[2, lowest] <= bottom:
        x, y, z = points[:, lowest]
        raise CaseError(
            f"the contact face comes down to z = {z:.4g} m at ({x:.4g}, {y:.4g}) m, and the base "
            f"reaches {bottom:.4g} m; make the cell deeper"
        )

    # free components
    free = np.ones((basis.N, 3), dtype=bool)
    image = _periodic_images(points) if sides == "periodic" else np.arange(basis.N)
    free[image != np.arange(basis.N)] = False
    free[image[base]] = False
    on_sides = [_side(points, axis) for axis in (0, 1)]
    both = np.union1d(*on_sides)
    leader = both[np.argmax(points[2, both])]
    if sides == "sliding":
        for axis in (0, 1):
            free[on_sides[axis], axis] = False
    if sides == "displacement":
        free[both] = False
        free[leader, 2] = True
    # numbers of the unknowns, and the expansion E
    unknown = np.where(free, np.cumsum(free).reshape(free.shape) - 1, -1)[image]
    nodes, facets = np.unique(image[top_facets], return_inverse=True)
    number, share = unknown[nodes], np.ones((basis.N, 3))
    if sides == "displacement":
        # all sides follow their highest node in proportion to z; only this node can touch a flat
        unknown[both, 2] = unknown[leader, 2]
        share[both, 2] = (points[2, both] - bottom) / (points[2, leader] - bottom)
        unknown[base] = -1
    numbered = np.flatnonzero(unknown.ravel() >= 0)
    expand = sparse.csr_array(
        (share.ravel()[numbered], (numbered, unknown.ravel()[numbered])),
        shape=(3 * basis.N, int(free.sum())),
    )
    values = sparse.kron(face_values, sparse.eye_array(3), format="csr")
    return CellUnknowns(
        sparse.csr_array(values @ expand),
        np.flatnonzero(free),
        image,
        nodes,
        number,
        face_values,
        coefficients[nodes],
        np.bincount(image, weight)[nodes],
        facets.reshape(top_facets.shape),
    )


def _top_face(
    basis: "CellBasis",
) -> tuple[np.ndarray, sparse.csr_array, sparse.csr_array, np.ndarray]:
    """Nodes of contact facets, matrix of (1) and inverse, (n, n), projected areas, (n,), m2."""
    from skfem import FacetBasis

    face = FacetBasis(basis.mesh, basis.elem, facets="top", dofs=basis.dofs)
    size = np.array([np.sum(np.abs(shape[0]) * face.dx, axis=1) for shape in face.basis])
    onto = size > 1e-9 * size.max(axis=0)
    facets = face.element_dofs.T[onto.T].reshape(onto.shape[1], -1).T
    total = _integrals(face, np.asarray(face.normals)[2] * face.dx, basis.N)
    if len(facets) != 6:
        unit = sparse.eye_array(basis.N, format="csr")
        return facets, unit, unit, total

    edges = np.unique(basis.mesh.f2e[:, basis.mesh.boundaries["top"]])
    middle, corners = basis.edge_dofs[0, edges], basis.nodal_dofs[0][basis.mesh.edges[:, edges]]
    keep, shape = np.ones(basis.N), 2 * (basis.N,)
    keep[middle] = 1.0 - 2.0 * ALPHA
    mean = sparse.csr_array(
        (np.full(corners.size, ALPHA), (np.tile(middle, 2), corners.ravel())), shape=shape
    )
    values = sparse.csr_array(sparse.diags_array(keep) + mean)  # (1)
    inverse = sparse.diags_array(1.0 / keep) @ (sparse.eye_array(basis.N) - mean)
    return facets, values, sparse.csr_array(inverse), values.T @ total


def _integrals(face: "FacetBasis", weight: np.ndarray, size: int) -> np.ndarray:
    shares = [np.sum(np.asarray(shape[0]) * weight, axis=1) for shape in face.basis]
    return np.bincount(face.element_dofs.ravel(), np.ravel(shares), minlength=size)


def strained_weight(basis: "CellBasis", unknowns: CellUnknowns, moved: np.ndarray) -> np.ndarray:
    """Projected area of every contact coefficient of a strained cell, m2."""
    from skfem import FacetBasis

    face = FacetBasis(basis.mesh, basis.elem, facets="top", dofs=basis.dofs)
    gradient = np.array([face.interpolate(component).grad for component in moved])
    F = gradient + np.eye(3)[:, :, None, None]
    projected = np.sum(cofactor(F)[2] * np.asarray(face.normals), axis=0) * face.dx
    total = unknowns.values.T @ _integrals(face, projected, basis.N)
    return np.asarray(np.bincount(unknowns.image, total)[unknowns.nodes])


def mean_strain(basis: "CellBasis") -> np.ndarray:
    """Integrate u1 n1, u2 n2 and u1 n2 + u2 n1 over the sides; zero if u is periodic."""
    from skfem import FacetBasis

    mesh, area = basis.mesh, np.zeros((2, basis.N))
    middle = mesh.p[:, mesh.facets].mean(axis=1)
    for axis in (0, 1):
        facets = np.intersect1d(_side(middle, axis), mesh.boundary_facets())
        face = FacetBasis(mesh, basis.elem, facets=facets, dofs=basis.dofs)
        outwards = np.asarray(face.normals)[axis] * face.dx
        area[axis] = _integrals(face, outwards, basis.N)
    integral = np.zeros((3, basis.N, 3))
    integral[0, :, 0] = integral[2, :, 1] = area[0]
    integral[1, :, 1] = integral[2, :, 0] = area[1]
    return integral.reshape(3, -1)


def _side(points: np.ndarray, axis: int) -> np.ndarray:
    low, high = points[axis].min(), points[axis].max()
    near = 1e-9 * (high - low)
    return np.flatnonzero((points[axis] - low < near) | (high - points[axis] < near))


def _periodic_images(points: np.ndarray) -> np.ndarray:
    from scipy.spatial import KDTree

    low, high = points.min(axis=1), points.max(axis=1)
    size = high - low
    place = points.copy()
    for k in range(2):
        place[k, np.isclose(points[k], high[k], rtol=0.0, atol=1e-9 * size[k])] -= size[k]
    moved = np.flatnonzero(np.any(place != points, axis=0))
    image = np.arange(points.shape[1])
    distance, partner = KDTree(points.T).query(place[:, moved].T)
    apart = distance > 1e-6 * float(size.max())
    if np.any(apart):
        worst = int(np.argmax(distance))
        where = np.array2string(points[:, moved[worst]], precision=4)
        raise CaseError(
            f"the mesh is not periodic: {int(apart.sum())} of {len(moved)} nodes on the sides have "
            f"no partner on the opposite side, the worst at {where} m (nearest "
            f"{distance[worst]:.2g} m away); mesh opposite sides alike, or choose sides that are "
            f"not periodic"
        )
    image[moved] = partner
    return image


MOTION_TOLERANCE = 1e-3  # residual of the motion d, relative to its forces on the active set
SLOW = 40  # iterations on an active set, above which the next set gets a new cycle
FIRST = 0.1  # share of the nodes in the first active set under a load


@dataclass(eq=False)
class MultigridInverse:
    r"""Algebraic multigrid as the inverse of a large mesh in contact with a flat.

    On an active set A, displacements are :math:`v + \delta d` with a motion d that lowers A by a
    unit, and the inverse is approximately, with a cycle V of smoothed aggregation [2]_ on rigid
    motions,

    .. math:: V r + \frac{d\, d^t r}{d^t K d}.    \tag{2}

    .. [2] P. Vaněk, J. Mandel and M. Brezina, Computing 56 (1996) 179-196, doi:10.1007/BF02238511.
    """

    stiffness: sparse.csr_array  # (n, n), symmetric and positive definite, N/m
    modes: np.ndarray  # (n, 6), rigid motions
    place: np.ndarray  # (n,), place 3 a + i of every unknown among the components i of nodes a
    contact: np.ndarray  # (contacts,), unknown of every contact node along z; -1 if it cannot touch
    _cycle: Operator | None = None
    _fixed: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=bool))
    _lowered: np.ndarray | None = None  # d of the present solve
    _count: int = 0  # iterations on the last active set

    def guess(
        self,
        gap: np.ndarray,
        closing: np.ndarray,
        *,
        load: float | None,
        approach: float | None,
        start: ContactState,
    ) -> tuple[np.ndarray, float]:
        """Begin with the contact nodes of the previous step, else with the highest nodes."""
        self._lowered = None
        if start.active.any():
            return start.reference_force, start.approach if approach is None else approach
        able = self.contact >= 0
        delta = float(np.quantile(gap[able], FIRST)) if approach is None else approach
        touching = able & (gap <= delta)
        forces = np.where(touching, float(self.stiffness.diagonal().mean()), 0.0)
        forces *= np.maximum(delta - gap, 0.0) if load is None else load / forces.sum()
        return forces, delta if load is None else float(gap[touching].mean())

    def constrain(self, closing: np.ndarray, active: np.ndarray, *, loaded: bool) -> Constrained:
        """Return the inverse (2) on an active set, under a load or at a fixed approach."""
        K, at = self.stiffness, self.contact[active]
        free = np.ones(K.shape[0], dtype=bool)
        free[at] = False
        if self._cycle is None or self._count > SLOW:
            self._cycle, self._fixed = _cycle(self, free), ~free
        cycle, fixed, released = self._cycle, self._fixed, self._fixed & free
        diagonal = K.diagonal()
        self._count = 0

        def among_free(residual: np.ndarray) -> np.ndarray:
            moved = np.where(free, cycle(np.where(fixed, 0.0, residual)), 0.0)
            return np.asarray(np.where(released, residual / diagonal, moved))

        # motion d and its stiffness
        lowered, stiffness = np.zeros(K.shape[0]), np.inf
        if loaded:
            lowered = lowered if self._lowered is None else self._lowered
            lowered[at] = -1.0
            if self._lowered is None:  # solved once: accurate enough for the following active sets
                force = K @ lowered
                lowered += conjugate_gradients(
                    lambda y: np.where(free, K @ y, 0.0),
                    np.where(free, -force, 0.0),
                    among_free,
                    goal=MOTION_TOLERANCE * float(np.linalg.norm(force[at])),
                    limit=500,
                )[0]
                self._lowered = lowered
            stiffness = float(lowered @ (K @ lowered))

        def invert(
            out_of_balance: np.ndarray,
            missing: float,
            out: np.ndarray,
            distance: np.ndarray | None = None,
        ) -> tuple[np.ndarray, float]:
            self._count += 1
            moved, residual = np.zeros(K.shape[0]), out_of_balance
            if distance is not None:
                moved[at] = distance[active]
                residual = residual - K @ moved
                missing = missing + float((K @ moved)[at].sum())
            residual = np.where(free, residual, 0.0)
            shift = (missing + float(lowered @ residual)) / stiffness
            out[:] = moved + among_free(residual) + shift * lowered  # (2)
            return out, shift

        return invert


def _cycle(body: "MultigridInverse", free: np.ndarray) -> Operator:
    keep = sparse.diags_array(free.astype(float))
    matrix = sparse.csr_array(keep @ body.stiffness @ keep)
    return nodal_cycle(matrix, body.place, body.modes, POLYNOMIAL, free)
