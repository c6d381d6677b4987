"""Elements of plates with membrane, bending and transverse shear: any law of the resultants."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array, kron

if TYPE_CHECKING:
    from skfem import Basis

UNKNOWNS = 5
"""Unknowns of a node of a plate: displacements along x, y and z, and rotations of the section."""


@dataclass(frozen=True, eq=False)
class PlateElements:
    r"""Plate of quadrilaterals with nine nodes, with Reissner's and Mindlin's kinematics.

    Sections move by :math:`u_\alpha + z \theta_\alpha` and w. The strains are

    .. math::
        \varepsilon_{\alpha\beta} = u_{(\alpha,\beta)}, \quad
        \kappa_{\alpha\beta} = \theta_{(\alpha,\beta)}, \quad
        \gamma_\alpha = w_{,\alpha} + \theta_\alpha,    \tag{1}

    in the order of :data:`~multiscale.macro.links.plate_cells.STRAINS`, with doubled shears.

    Attributes
    ----------
    operator : ndarray, shape (elements, points, 8, 45), of the strains (1)
    slope : ndarray, shape (elements, points, 2, 45), of the slopes of w along x and y
    weight : ndarray, shape (elements, points), area of the points, m²
    unknown : ndarray of int, shape (elements, 45)
    position : ndarray, shape (2, nodes), m
    values : csr_array, shape (places, nodes), of the shapes of the nodes at some places
    """

    operator: np.ndarray
    slope: np.ndarray
    weight: np.ndarray
    unknown: np.ndarray
    position: np.ndarray
    values: csr_array

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return UNKNOWNS * int(self.position.shape[1])

    def strain(self, u: np.ndarray) -> np.ndarray:
        """Return the strains (1) at all points, shape (points, 8)."""
        local = self.operator @ u[self.unknown][:, None, :, None]
        return np.asarray(local.reshape(-1, 8))

    def gather(self, resultant: np.ndarray) -> np.ndarray:
        """Return the forces of resultants, shape (points, 8), on the unknowns, N and N m."""
        weighted = self.weight[..., None] * resultant.reshape(*self.weight.shape, 8)
        local = np.einsum("eqi,eqia->ea", weighted, self.operator, optimize=True)
        return np.bincount(self.unknown.ravel(), local.ravel(), self.n)

    def assemble(self, tangent: np.ndarray) -> csr_array:
        """Assemble the stiffness of tangents of shape (points, 8, 8)."""
        return self._assemble(self.operator, tangent)

    def geometric(self, resultant: np.ndarray) -> csr_array:
        """Assemble the geometric stiffness of the membrane forces of resultants (points, 8)."""
        return self._assemble(self.slope, resultant[:, [[0, 2], [2, 1]]])

    def _assemble(self, operator: np.ndarray, tangent: np.ndarray) -> csr_array:
        rows = operator.shape[2]
        C = self.weight[..., None, None] * tangent.reshape(*self.weight.shape, rows, rows)
        blocks = np.sum(operator.swapaxes(2, 3) @ (C @ operator), axis=1)
        row, column = np.broadcast_arrays(self.unknown[:, :, None], self.unknown[:, None, :])
        entries = (blocks.ravel(), (row.ravel(), column.ravel()))
        return csr_array(coo_array(entries, shape=(self.n, self.n)))

    def section_motion(self, height: np.ndarray) -> list[csr_array]:
        """Return operators to displacements x, y and z of the places, at heights of theirs, m."""
        u, v, w, turn_x, turn_y = (csr_array(kron(self.values, row)) for row in np.eye(UNKNOWNS))
        z = diags_array(height)
        return [csr_array(u + z @ turn_x), csr_array(v + z @ turn_y), w]


def plate_elements(
    size: tuple[float, float], elements: tuple[int, int], places: np.ndarray
) -> PlateElements:
    """Mesh a rectangular plate with a corner at the origin; places, (2, n), m, are probed."""
    basis = _basis(size, elements)
    shapes = [basis.basis[i][0] for i in range(basis.Nbfun)]
    value = np.stack([np.broadcast_to(shape, basis.dx.shape) for shape in shapes], axis=-1)
    dx, dy = (np.stack([shape.grad[k] for shape in shapes], axis=-1) for k in range(2))
    S = np.zeros((*basis.dx.shape, 8, basis.Nbfun, UNKNOWNS))
    for first, moved in ((0, (0, 1)), (3, (3, 4))):  # (1)
        x, y = moved
        S[:, :, first, :, x], S[:, :, first + 1, :, y] = dx, dy
        S[:, :, first + 2, :, x], S[:, :, first + 2, :, y] = dy, dx
    S[:, :, 6, :, 2], S[:, :, 7, :, 2] = dx, dy
    slope = S[:, :, 6:].copy()
    S[:, :, 6, :, 3] = S[:, :, 7, :, 4] = value
    for row, along in ((6, 1), (7, 0)):  # axis 1 of an element is along x
        projection = _linear_along(basis.X, basis.W, along)
        S[:, :, row] = np.einsum("qp,epia->eqia", projection, S[:, :, row], optimize=True)
    unknown = UNKNOWNS * basis.element_dofs.T[:, :, None] + np.arange(UNKNOWNS)
    count = UNKNOWNS * basis.Nbfun
    return PlateElements(
        S.reshape(*basis.dx.shape, 8, count),
        slope.reshape(*basis.dx.shape, 2, count),
        basis.dx,
        unknown.reshape(-1, count),
        basis.doflocs,
        csr_array(basis.probes(places)),
    )


def smooth_at(
    size: tuple[float, float], elements: tuple[int, int], places: np.ndarray
) -> csr_array:
    """Return the operator from values at all points of a plate to places, (places, points).

    Values are fitted in every element by bilinear functions, since strains at points oscillate with
    the transverse shear, which is right in the mean of an element.

    Parameters
    ----------
    size, elements : tuple, as of :func:`plate_elements`
    places : ndarray, shape (2, places), m
    """
    basis = _basis(size, elements)
    element = basis.mesh.element_finder(basis.mapping)(*places)
    local = basis.mapping.invF(places[:, :, None], tind=element)[..., 0]
    fit = _bilinear(local) @ np.linalg.pinv(_bilinear(basis.X))
    column = fit.shape[1] * element[:, None] + np.arange(fit.shape[1])
    first = fit.shape[1] * np.arange(element.size + 1)
    return csr_array((fit.ravel(), column.ravel(), first), shape=(element.size, basis.dx.size))


def _basis(size: tuple[float, float], elements: tuple[int, int]) -> "Basis":
    from skfem import Basis, ElementQuad2, MeshQuad

    edges = (np.linspace(0.0, length, n + 1) for length, n in zip(size, elements, strict=True))
    return Basis(MeshQuad.init_tensor(*edges), ElementQuad2(), intorder=4)


def _bilinear(x: np.ndarray) -> np.ndarray:
    return np.stack([np.ones(x.shape[1]), x[0], x[1], x[0] * x[1]], axis=1)


def _linear_along(points: np.ndarray, weight: np.ndarray, axis: int) -> np.ndarray:
    """Return the projection of values at points of an element on functions linear along an axis."""
    # both terms of the transverse shear then have the same degree, so that thin plates do not lock:
    # K. J. Bathe and E. N. Dvorkin, Int. J. Numer. Methods Eng. 22 (1986) 697-722,
    # doi:10.1002/nme.1620220312
    V = np.stack([points[axis] ** i * points[1 - axis] ** j for i in range(2) for j in range(3)], 1)
    return np.asarray(V @ np.linalg.solve((V.T * weight) @ V, V.T * weight))
