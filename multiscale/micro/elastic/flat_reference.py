"""The flat elastic cell as a preconditioner of the rough cell."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from multiscale.micro.elastic.lateral_fft import LateralInverse, SurfaceFilter, factorise_flat_cell
from multiscale.micro.layer import GraphMesh, PeriodicLayer
from multiscale.surfaces.surface import Surface

__all__ = ["Field", "Reference", "flat_inverse", "flat_reference", "surface_slopes"]

Field = np.ndarray


@dataclass(frozen=True, eq=False)
class Reference:
    r"""The flat cell, tilted along the slopes of the rough cell if they are given.

    Attributes
    ----------
    inverse : LateralInverse, factorised stiffness of the flat cell
    map_factor : ndarray, shape (layers,)
        Displacement of each node plane relative to the height of the surface, dimensionless.
    slopes : tuple of ndarray, shape (nx, ny), optional
        Slopes of the surface in x and y, dimensionless.

    Notes
    -----
    In a nearly incompressible material, the divergence of the flat cell's field would be large
    where the divergence of the true cell is small: then :math:`K_0^{-1}` is replaced by
    :math:`T K_0^{-1} T^t` with the tilt of Piola's type
    :math:`(T u)_z = u_z + \varphi\, \nabla h \cdot u`, exact for isochoric fields to first order
    in the slopes.
    """

    inverse: LateralInverse
    map_factor: np.ndarray
    slopes: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def convolves(self) -> bool:
        """Whether the vertical compliance is a product for each wave."""
        return self.slopes is None

    def solve(
        self,
        force: Field | None,
        correct: Callable[[Field], Field] | None,
        out: Field | None = None,
    ) -> Field:
        """Solve for nodal forces; ``correct`` adds surface forces for the surface's motion."""
        if self.slopes is None:
            return self.inverse.solve(force, correct, out)

        def tilted_correct(moved: Field) -> Field:
            return self._tilt_force(correct(self._tilt(moved)))  # type: ignore[misc]

        tilted = force
        if force is not None:
            tilted = force.copy()
            for k, slope in enumerate(self.slopes):
                tilted[:, :, k] += slope[:, None] * self.map_factor[:, None] * force[:, :, 2]
        u = self.inverse.solve(tilted, tilted_correct if correct else None, out)
        for k, slope in enumerate(self.slopes):
            u[:, :, 2] += slope[:, None] * self.map_factor[:, None] * u[:, :, k]
        return u

    def compliance(self, force: Field) -> Field:
        """Motion of the surface under forces on it, shapes (nx, 3, ny)."""
        return self._tilt(self.inverse.surface_response(self._tilt_force(force)))

    def stiffness(self, moved: Field) -> Field:
        """Return the forces on the surface that cause its motion."""
        return self._tilt_force(self.inverse.surface_force(self._tilt(moved, -1.0)), -1.0)

    @cached_property
    def vertical(self) -> tuple[SurfaceFilter, SurfaceFilter]:
        """Vertical compliance and an approximate inverse."""
        symbol = self.inverse.surface_compliance[5]
        return SurfaceFilter(symbol), SurfaceFilter(1.0 / symbol)

    def _tilt(self, moved: Field, sign: float = 1.0) -> Field:
        if self.slopes is None:
            return moved
        tilted = moved.copy()
        for k, slope in enumerate(self.slopes):
            tilted[:, 2] += sign * slope * moved[:, k]
        return tilted

    def _tilt_force(self, force: Field, sign: float = 1.0) -> Field:
        if self.slopes is None:
            return force
        tilted = force.copy()
        for k, slope in enumerate(self.slopes):
            tilted[:, k] += sign * slope * force[:, 2]
        return tilted


def flat_inverse(
    layer: PeriodicLayer,
    mesh: GraphMesh,
    grid: Surface,
    dtype: type[np.floating] = np.float64,
) -> LateralInverse:
    """Factorise the flat cell of a meshed layer on the points of a surface."""
    return factorise_flat_cell(
        grid.heights.shape,
        grid.spacing,
        mesh.planes,
        *layer.layer_moduli,
        mean_dilatation=layer.mean_dilatation,
        dtype=dtype,
    )


def flat_reference(
    layer: PeriodicLayer, mesh: GraphMesh, dtype: type[np.floating] = np.float64
) -> Reference:
    """Return the flat cell of a meshed layer, tilted if it is nearly incompressible."""
    grid = layer.surface
    slopes = surface_slopes(grid.heights, grid.spacing) if layer.nearly_incompressible else None
    return Reference(flat_inverse(layer, mesh, grid, dtype), mesh.map_factor[1:], slopes)


def surface_slopes(
    heights: np.ndarray, spacing: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Periodic differences of fourth order: local, so that a kink stays a kink."""

    def slope(axis: int) -> np.ndarray:
        near = np.roll(heights, -1, axis) - np.roll(heights, 1, axis)
        far = np.roll(heights, -2, axis) - np.roll(heights, 2, axis)
        return np.asarray((8.0 * near - far) / (12.0 * spacing[axis]))

    return slope(0), slope(1)
