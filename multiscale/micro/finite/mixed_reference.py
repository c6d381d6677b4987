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
        moved, pressure = z[:, :, :3], z[:, :, 3]
        wanted, give = force[:, :, 3].copy(), self.give[:, None]
        moved[:] = force[:, :, :3]
        _push(self.faces, wanted / give, moved)
        self.inverse.solve(moved, correct, moved)
        _widen(self.faces, moved, pressure)
        pressure -= wanted
        pressure /= give
        return z


@kernel
def _push(faces, pressure, force):  # type: ignore[no-untyped-def]
    """Add the nodal forces B^t p of the pressures of the elements."""
    nx, layers, ny = pressure.shape
    for i in range(nx):
        for layer in range(layers):
            x, y, z = faces[:, layer]
            for a in range(2):
                for c in range(0 if layer > 0 else 1, 2):
                    row = force[(i + a) % nx, layer + c - 1]
                    for b in range(2):
                        for j in range(ny):
                            p = pressure[i, layer, j]
                            to = j + b if j + b < ny else 0
                            row[0, to] += (2 * a - 1) * x * p
                            row[1, to] += (2 * b - 1) * y * p
                            row[2, to] += (2 * c - 1) * z * p


@kernel
def _widen(faces, moved, change):  # type: ignore[no-untyped-def]
    """Write the changes B z of the volumes."""
    nx, layers, ny = change.shape
    for i in range(nx):
        for layer in range(layers):
            change[i, layer] = 0.0
            x, y, z = faces[:, layer]
            for a in range(2):
                for c in range(0 if layer > 0 else 1, 2):
                    row = moved[(i + a) % nx, layer + c - 1]
                    for b in range(2):
                        for j in range(ny):
                            at = j + b if j + b < ny else 0
                            change[i, layer, j] += (
                                (2 * a - 1) * x * row[0, at]
                                + (2 * b - 1) * y * row[1, at]
                                + (2 * c - 1) * z * row[2, at]
                            )


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
