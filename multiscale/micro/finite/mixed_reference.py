r"""The flat cell with the pressures of its elements as unknowns, as a preconditioner.

With the stiffness :math:`A` against shear, the changes :math:`B z` of the volumes :math:`V` and the
bulk modulus :math:`\kappa`, its unknowns are displacements and (tensile) pressures in

.. math::
    A z + B^t p = r, \qquad B z - \frac{V}{\kappa}\, p = g. \tag{1}

Slopes and deformation change :math:`B` by their size, whatever the bulk modulus is. Without the
pressures, forces would change by :math:`\kappa / \mu` times as much, and conjugate directions with
them.

References
----------
.. [1] M. Benzi, G. H. Golub and J. Liesen, Acta Numer. 14 (2005) 1-137,
   doi:10.1017/S0962492904000212: saddle points, section 10.1 for preconditioners of this form.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from multiscale.micro.cell import PeriodicLayer
from multiscale.micro.finite.batch import kernel
from multiscale.micro.finite.large_strain import pressure_scale
from multiscale.micro.flat_reference import Field, Reference, flat_inverse
from multiscale.micro.graph_mesh import GraphMesh

__all__ = ["MixedReference", "mixed_reference"]


@dataclass(frozen=True, eq=False, kw_only=True)
class MixedReference(Reference):
    """The flat cell of a body of shape (nx, layers, 4, ny), with pressures over a scale.

    Attributes
    ----------
    faces : ndarray, shape (3, layers)
        A quarter of the faces of an element across x, y and z, times the scale, N/m.
    give : ndarray, shape (layers,), V over kappa times the square of the scale, N/m
    """

    faces: np.ndarray
    give: np.ndarray

    def surface(self, vector: Field) -> Field:
        """Part of a field at the surface, as a view."""
        return np.asarray(vector[:, -1, :3])

    relative = surface

    def solve(
        self,
        force: Field | None,
        correct: Callable[[Field], Field] | None,
        out: Field | None = None,
    ) -> Field:
        """Solve (1), whose pressures are eliminated; ``correct`` adds forces on the surface."""
        assert force is not None
        z = np.empty_like(force) if out is None else out
        _push(self.faces, self.give, force, z)
        moved = z[:, :, :3]
        self.inverse.solve(moved, correct, moved)
        _widen(self.faces, self.give, force, z)
        return z


@kernel
def _push(faces, give, force, z):  # type: ignore[no-untyped-def]
    """Write the forces r + B^t g kappa / V without the pressures into ``z``."""
    nx, layers, _, ny = force.shape
    total, turned = np.empty(ny, force.dtype), np.empty(ny, force.dtype)
    for i in range(nx):
        for layer in range(layers):
            for k in range(3):
                for j in range(ny):
                    z[i, layer, k, j] = force[i, layer, k, j]
    for i in range(nx):
        for layer in range(layers):
            p = force[i, layer, 3]
            factor = 1.0 / give[layer]
            for j in range(1, ny):  # of both elements beside a node
                total[j], turned[j] = factor * (p[j - 1] + p[j]), factor * (p[j - 1] - p[j])
            total[0], turned[0] = factor * (p[ny - 1] + p[0]), factor * (p[ny - 1] - p[0])
            for a in range(2):
                for c in range(0 if layer > 0 else 1, 2):
                    row = z[(i + a) % nx, layer + c - 1]
                    x, y, up = (2 * a - 1) * faces[0, layer], faces[1, layer], faces[2, layer]
                    up *= 2 * c - 1
                    for j in range(ny):
                        row[0, j] += x * total[j]
                        row[1, j] += y * turned[j]
                        row[2, j] += up * total[j]


@kernel
def _widen(faces, give, force, z):  # type: ignore[no-untyped-def]
    """Write the pressures (B z - g) kappa / V into ``z``."""
    nx, layers, _, ny = force.shape
    across, along = np.empty(ny, force.dtype), np.empty(ny, force.dtype)
    for i in range(nx):
        for layer in range(layers):
            across[:], along[:] = 0.0, 0.0
            for a in range(2):
                for c in range(0 if layer > 0 else 1, 2):
                    row = z[(i + a) % nx, layer + c - 1]
                    x, y, up = (2 * a - 1) * faces[0, layer], faces[1, layer], faces[2, layer]
                    up *= 2 * c - 1
                    for j in range(ny):
                        across[j] += x * row[0, j] + up * row[2, j]
                        along[j] += y * row[1, j]
            g, p = force[i, layer, 3], z[i, layer, 3]
            factor = 1.0 / give[layer]
            for j in range(ny):
                after = j + 1 if j + 1 < ny else 0
                change = across[j] + across[after] + along[after] - along[j]
                p[j] = factor * (change - g[j])


def mixed_reference(
    layer: PeriodicLayer, mesh: GraphMesh, dtype: type[np.floating] = np.float64
) -> MixedReference:
    """Return the flat cell of a meshed layer at rest, with its pressures."""
    lame, shear = layer.layer_moduli
    dx, dy = mesh.surface.spacing
    heights, scale = np.diff(mesh.planes), pressure_scale(mesh, float(shear[0]))
    areas = np.array([dy * heights, dx * heights, np.full(len(heights), dx * dy)])
    return MixedReference(
        flat_inverse(layer, mesh, layer.surface, dtype),
        mesh.map_factor[1:],
        faces=scale * areas / 4.0,
        give=scale**2 * dx * dy * heights / (lame + 2.0 / 3.0 * shear),
    )
