"""The flat elastic cell as a preconditioner of the rough cell."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from multiscale.micro.averages import EdgeLayer, edge_layer
from multiscale.micro.elastic.compliance import layered_compliance
from multiscale.micro.elastic.lateral_fft import LateralInverse, SurfaceFilter, factorise_flat_cell
from multiscale.micro.layer import GraphMesh, PeriodicLayer

EDGE_POINTS = 32  # points along the longest wavelength in the effect of elements at an edge

Field = np.ndarray


@dataclass(frozen=True, eq=False)
class Reference:
    """The flat cell, tilted along the slopes of the rough cell if slopes are given."""

    inverse: LateralInverse  # factorised stiffness of the flat cell
    map_factor: np.ndarray  # (layers,), share of the surface height in each node plane
    slopes: tuple[np.ndarray, np.ndarray] | None = None  # (nx, ny), of the surface, in x and y

    @property
    def convolves(self) -> bool:
        """Whether the vertical compliance is diagonal in Fourier space."""
        return self.slopes is None

    def solve(
        self,
        force: Field | None,
        correct: Callable[[Field], Field] | None,
        out: Field | None = None,
    ) -> Field:
        """Solve for nodal forces; ``correct`` returns additional forces from the surface motion."""
        if self.slopes is None:
            return self.inverse.solve(force, correct, out)

        def tilted_correct(moved: Field) -> Field:
            return self._tilt_force(correct(self._tilt(moved)))  # type: ignore[misc]

        tilted = force if force is None else self._tilt_force(force)
        u = self.inverse.solve(tilted, tilted_correct if correct else None, out)
        return self._tilt(u, out=u)

    def compliance(self, force: Field) -> Field:
        """Return the motion of the surface under surface forces, shapes (nx, 3, ny)."""
        return self._tilt(self.inverse.surface_response(self._tilt_force(force)))

    def stiffness(self, moved: Field) -> Field:
        """Return the surface forces that cause a motion of the surface."""
        return self._tilt_force(self.inverse.surface_force(self._tilt(moved, -1.0)), -1.0)

    @cached_property
    def vertical(self) -> tuple[SurfaceFilter, SurfaceFilter]:
        """Vertical compliance and an approximate inverse."""
        symbol = self.inverse.surface_compliance[5]
        return SurfaceFilter(symbol), SurfaceFilter(1.0 / symbol)

    def _shares(self, field: Field) -> list[Field]:
        """Slopes in x and y at the nodes of the surface, or scaled by height at all node planes."""
        slopes = self.slopes or ()
        if field.ndim == 3:
            return list(slopes)
        return [slope[:, None] * self.map_factor[:, None] for slope in slopes]

    # T K_0^-1 T^t with Piola's tilt (T u)_z = u_z + phi grad h · u, exact for isochoric fields to
    # first order in the slopes: in a nearly incompressible material the flat field would have a
    # divergence
    def _tilt(self, moved: Field, sign: float = 1.0, out: Field | None = None) -> Field:
        if self.slopes is None:
            return moved
        tilted = moved.copy() if out is None else out
        for k, share in enumerate(self._shares(moved)):
            tilted[..., 2, :] += sign * share * moved[..., k, :]
        return tilted

    def _tilt_force(self, force: Field, sign: float = 1.0) -> Field:
        if self.slopes is None:
            return force
        tilted = force.copy()
        for k, share in enumerate(self._shares(force)):
            tilted[..., k, :] += sign * share * force[..., 2, :]
        return tilted


def flat_inverse(
    layer: PeriodicLayer,
    shape: tuple[int, int],
    spacing: tuple[float, float],
    dtype: type[np.floating] = np.float64,
) -> LateralInverse:
    """Factorise the flat cell of a meshed layer on a grid of points."""
    dilatation = layer.mean_dilatation
    moduli = layer.layer_moduli
    return factorise_flat_cell(
        shape, spacing, layer.planes, *moduli, mean_dilatation=dilatation, dtype=dtype
    )


def element_edges(cell: PeriodicLayer) -> tuple[EdgeLayer, EdgeLayer]:
    """Effect of the elements of all bodies on an edge of contact along x and y."""
    n, edges = EDGE_POINTS, []
    for spacing in cell.surface.spacing:
        discrete, exact = np.zeros((2, n // 2 + 1))
        for body in cell.bodies:
            inverse = flat_inverse(body, (n, 1), (spacing, spacing))
            discrete += spacing**2 * inverse.surface_compliance[5][: n // 2 + 1, 0]
            size = (1.0, n * spacing)
            exact += layered_compliance((1, n), size, body.planes, *body.layer_moduli)[0]
        edges.append(edge_layer(discrete / exact))
    return edges[0], edges[1]


def flat_reference(
    layer: PeriodicLayer, mesh: GraphMesh, dtype: type[np.floating] = np.float64
) -> Reference:
    """Return the flat cell of a meshed layer, tilted if it is nearly incompressible."""
    heights, spacing = layer.surface.heights, layer.surface.spacing
    slopes = surface_slopes(heights, spacing) if layer.nearly_incompressible else None
    inverse = flat_inverse(layer, heights.shape, spacing, dtype)
    return Reference(inverse, mesh.map_factor[1:], slopes)


def surface_slopes(
    heights: np.ndarray, spacing: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return slopes by periodic differences of fourth order, which are local at kinks."""

    def slope(axis: int) -> np.ndarray:
        near = np.roll(heights, -1, axis) - np.roll(heights, 1, axis)
        far = np.roll(heights, -2, axis) - np.roll(heights, 2, axis)
        return np.asarray((8.0 * near - far) / (12.0 * spacing[axis]))

    return slope(0), slope(1)
