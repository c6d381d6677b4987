r"""Effective stiffness of a volume with cavities and cracks, on a mesh that follows them.

With the linear displacement of a mean strain, :math:`x \mapsto \bar\varepsilon x`, at all nodes and
a displacement of unknowns :math:`w` that is periodic, or zero at the sides of the box, the
displacement is :math:`u = u_\varepsilon + P w` and

.. math:: P^t K P\, w = -P^t K u_\varepsilon, \qquad
    V\, \bar\varepsilon_i : \bar C : \bar\varepsilon_j = u_i^t K u_j,    \tag{1}

V being the volume of the whole box. The error of the energy is quadratic in the error of u, and
the stiffness is an upper bound for the meshed cavities. Traction sides load the solid part of the
sides, as in eq (1) of :mod:`~.voxel_sides`.
"""

from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import qr
from scipy.sparse import coo_array, csr_array, kron
from scipy.sparse.csgraph import connected_components

from multiscale.convergence import Solution, Status
from multiscale.errors import CaseError, ConvergenceError
from multiscale.fe.elasticity import assemble_elasticity
from multiscale.laws.bulk.moduli import VOIGT, check_moduli, lame_parameters
from multiscale.micro.damage.cavities import Cavities
from multiscale.micro.damage.cavity_mesh import mesh_cavities
from multiscale.micro.damage.crack_faces import FACE_MARGIN, CrackedMesh
from multiscale.micro.damage.rve import LOST_STIFFNESS, check_sides, summarise_loads
from multiscale.micro.damage.shapes import Cylinders, Ellipsoids
from multiscale.numerics.factorisation import factorise

if TYPE_CHECKING:
    from skfem import CellBasis, MeshTet

__all__ = ["SideFields", "mesh_stiffness", "solve_sides"]

LARGEST_RESIDUAL = 1e-8
"""Residual of the direct solver, relative to the load, above which a solve counts as failed."""


def mesh_stiffness(
    rve: Cavities,
    youngs_modulus: float,
    poissons_ratio: float,
    *,
    element_size: float,
    sides: str = "periodic",
) -> Solution:
    """Effective stiffness of a periodic volume with cavities and traction-free cracks.

    Parameters
    ----------
    rve : Cavities, a periodic volume, see :func:`~.cavity_mesh.mesh_cavities`
    youngs_modulus, poissons_ratio : float, moduli of the solid, Pa and dimensionless
    element_size : float, edge of the elements, m
    sides : {"periodic", "displacement", "traction"}
        See :func:`~.rve.effective_stiffness`.

    Returns
    -------
    Solution
        ``value`` is the stiffness, shape (6, 6), Pa, in the order of ``STRAINS``. Both sides of a
        crack move freely, also into each other: it is the stiffness with open cracks.

    Raises
    ------
    CaseError
        If a modulus is outside its range, the sides have no such condition, or the volume cannot
        be meshed.
    ConvergenceError
        If traction sides would tear pieces of the solid apart.
    """
    from skfem import Basis, ElementTetP2, MeshTet

    begin = perf_counter()
    if not isinstance(rve, Cavities):
        raise CaseError(
            f"mesh_stiffness takes Cavities, got {type(rve).__name__}; effective_stiffness takes "
            f"voxel images"
        )
    check_sides(sides)
    check_moduli(youngs_modulus, poissons_ratio)
    lame, shear = map(float, lame_parameters(1.0, poissons_ratio))  # over Young's modulus
    if not rve.periodic:
        raise CaseError("the stiffness needs a periodic volume; set periodic=True")
    mesh = mesh_cavities(rve, element_size)
    tetrahedra = MeshTet(
        np.ascontiguousarray(mesh.points), np.ascontiguousarray(mesh.cells), validate=False
    )
    basis = Basis(_curved(tetrahedra, rve, mesh.front), ElementTetP2(), intorder=2)
    if sides == "traction":
        energy, residual = _solve_tractions(basis, np.array(rve.size), lame, shear)
    else:
        number = _unknowns(basis, mesh, np.array(rve.size))
        if sides == "displacement":
            place = basis.doflocs / np.array(rve.size)[:, None]
            held = np.min(np.minimum(place, 1.0 - place), axis=0) < FACE_MARGIN
            number = np.where(held, -1, np.cumsum(~held) - 1)
        fields = solve_sides(basis, number, lame, shear)
        energy, residual = fields.energy, fields.residual
    energy = energy / np.prod(rve.size)
    seconds = perf_counter() - begin
    solved = [Status.CONVERGED if one <= LARGEST_RESIDUAL else Status.STALLED for one in residual]
    loads = [Solution(energy[k], solved[k], (float(residual[k]),), (seconds,)) for k in range(6)]
    symmetric = 0.5 * youngs_modulus * (energy + energy.T)
    return summarise_loads(symmetric, loads, LOST_STIFFNESS * youngs_modulus)


@dataclass(frozen=True, eq=False)
class SideFields:
    """Six states of a volume, one for each mean strain.

    Attributes
    ----------
    displacement : ndarray, shape (3 nodes, 6), three components of the displacement of each node, m
    energy : ndarray, shape (6, 6), twice the energy of pairs of mean strains, J
    residual : ndarray, shape (6,)
        Residual of the direct solver, relative to the load; dimensionless.
    """

    displacement: np.ndarray
    energy: np.ndarray
    residual: np.ndarray


def solve_sides(
    basis: "CellBasis", number: np.ndarray, lame: float | np.ndarray, shear: float | np.ndarray
) -> SideFields:
    """Solve (1) by a factorisation for the six mean strains."""
    stiffness = assemble_elasticity(basis, lame, shear)
    count = int(number.max()) + 1
    own = np.flatnonzero(number >= 0)
    one = csr_array((np.ones(own.size), (own, number[own])), shape=(basis.N, count))
    place = csr_array(kron(one, np.eye(3)))
    at_nodes = stiffness[::3, ::3]
    joined = csr_array(one.T @ at_nodes @ one)
    joined.eliminate_zeros()  # voids without stiffness connect nothing
    piece = connected_components(joined)[1]
    held = piece[(one.T @ abs(at_nodes) @ (number < 0)) > 0.0]  # at the sides
    fixed = np.unique(piece, return_index=True)[1]
    fixed = fixed[~np.isin(piece[fixed], held)]
    pinned = (3 * fixed[:, None] + np.arange(3)).ravel()
    free = np.setdiff1d(np.arange(3 * count), pinned)  # no piece moves as a rigid body

    unit = np.zeros((6, 3, 3))  # strain number k as a tensor; shear strains are angles
    for k, (i, j) in enumerate(VOIGT):
        unit[k, i, j] += 0.5
        unit[k, j, i] += 0.5
    linear = np.stack([(strain @ basis.doflocs).T.ravel() for strain in unit], axis=1)
    periodic = csr_array(place.T @ stiffness @ place)
    load = -(place.T @ (stiffness @ linear))
    matrix = periodic[free][:, free]
    solve = factorise(matrix, name="the stiffness of the volume")
    w = np.zeros((3 * count, 6))
    w[free] = solve(load[free])
    u = linear + place @ w
    scale = np.linalg.norm(stiffness @ linear, axis=0)
    residual = np.linalg.norm(matrix @ w[free] - load[free], axis=0) / scale
    return SideFields(u, u.T @ (stiffness @ u), residual)


def _solve_tractions(
    basis: "CellBasis", size: np.ndarray, lame: float, shear: float
) -> tuple[np.ndarray, np.ndarray]:
    """Twice the energy of mean strains, shape (6, 6), J, with traction sides, and residuals."""
    from skfem import FacetBasis

    mesh, N = basis.mesh, basis.N
    K = assemble_elasticity(basis, lame, shear)
    _, piece = connected_components(K[::3, ::3])
    force, loaded = np.zeros((6, N, 3)), np.zeros(N, dtype=bool)
    middle = mesh.p[:, mesh.facets].mean(axis=1) / size[:, None]
    for axis in range(3):
        for end, sign in ((0.0, -1.0), (1.0, 1.0)):
            on = np.flatnonzero(np.abs(middle[axis] - end) < FACE_MARGIN)
            if not on.size:
                continue
            face = FacetBasis(mesh, basis.elem, facets=on, intorder=2, dofs=basis.dofs)
            share = np.zeros(N)
            for nodes, shape in zip(face.element_dofs, face.basis, strict=True):
                np.add.at(share, nodes, np.sum(face.dx * np.asarray(shape[0]), axis=1))
            loaded |= share != 0.0
            for k, (i, j) in enumerate(VOIGT):
                if axis in (i, j):
                    force[k, :, j if axis == i else i] += sign * share / (share.sum() * size[axis])
    largest = np.argmax(np.bincount(piece))
    if np.any(piece[loaded] != largest):
        raise ConvergenceError("the solid is cut through, and traction sides tear it apart")
    x = basis.doflocs.T - basis.doflocs.mean(axis=1)
    turns = np.cross(np.eye(3)[:, None], x / size.max())
    rigid = np.concatenate([np.broadcast_to(np.eye(3)[:, None], (3, N, 3)), turns])
    rigid = rigid * (piece == largest)[:, None]
    pinned = qr(rigid.reshape(6, -1), mode="r", pivoting=True)[1][:6]
    free = np.setdiff1d(np.flatnonzero(np.repeat(piece == largest, 3)), pinned)
    f = force.reshape(6, -1)[:, free].T
    carried = np.abs(f).max(axis=0) > 0.0  # nothing crosses the box along the other axes
    matrix = K[free][:, free]
    u = factorise(matrix, name="the stiffness of the volume")(f)
    scale = np.where(carried, np.linalg.norm(f, axis=0), 1.0)
    energy, kept = np.zeros((6, 6)), np.ix_(carried, carried)
    energy[kept] = np.linalg.inv((f.T @ u)[kept])
    return energy, np.linalg.norm(matrix @ u - f, axis=0) / scale


def _curved(mesh: "MeshTet", rve: Cavities, front: np.ndarray) -> "MeshTet":
    """Move middle nodes of edges onto the cavities, and to quarter points at fronts of cracks.

    With the middle node of an edge at a quarter of its length, displacements near the front can
    grow with the root of the distance: R. S. Barsoum, Int. J. Numer. Methods Eng. 10 (1976) 25-37.
    """
    from skfem import MeshTet2

    corners = mesh.p
    nodes = MeshTet2.from_mesh(mesh).doflocs.copy()
    edges = np.asarray(mesh.boundary_edges())
    for kind in rve.images:
        for k in range(len(kind.centre)):
            if isinstance(kind, Ellipsoids):
                inverse = np.linalg.inv(kind.root[k])
            elif isinstance(kind, Cylinders):
                across = np.eye(3) - np.outer(kind.axis[k], kind.axis[k])
                inverse = across / kind.radius[k]
            else:
                continue
            centre = kind.centre[k][:, None]
            distance = np.linalg.norm(inverse @ (corners - centre), axis=0)
            on = edges[np.all(np.abs(distance[mesh.edges[:, edges]] - 1.0) < 1e-6, axis=0)]
            place = corners.shape[1] + on
            away = nodes[:, place] - centre
            flat = away - across @ away if isinstance(kind, Cylinders) else 0.0
            nodes[:, place] = centre + flat + (away - flat) / np.linalg.norm(inverse @ away, axis=0)
    at_front = np.isin(mesh.edges, front)
    for end in range(2):
        leaves = np.flatnonzero(at_front[end] & ~at_front[1 - end])
        near, far = corners[:, mesh.edges[end, leaves]], corners[:, mesh.edges[1 - end, leaves]]
        nodes[:, corners.shape[1] + leaves] = 0.75 * near + 0.25 * far
    return MeshTet2(nodes, mesh.t, validate=False)


def _unknowns(basis: "CellBasis", mesh: CrackedMesh, size: np.ndarray) -> np.ndarray:
    """Return the number of the periodic unknown of every node.

    Nodes share an unknown if they have the same place in the periodic volume and lie between
    corners that move alike; a random coordinate of each corner distinguishes the sides of a crack.
    """
    from scipy.spatial import KDTree

    tag = np.random.default_rng(seed=0).uniform(size=mesh.periodic.max() + 1)[mesh.periodic]
    nodes = basis.doflocs.shape[1]
    between = np.zeros(nodes)
    corners = basis.mesh.t
    between[basis.element_dofs[:4]] = tag[corners]
    edges = basis.mesh.edges[:, basis.mesh.t2e]
    between[basis.element_dofs[4:]] = tag[edges].mean(axis=0)
    place = np.vstack([basis.doflocs / size[:, None], between])
    place[:3] -= place[:3] > 1.0 - 1e-7
    pairs = KDTree(place.T).query_pairs(1e-6, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(nodes, nodes))
    return np.asarray(connected_components(graph, directed=False)[1])
