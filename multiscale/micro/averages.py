"""From local fields on a representative surface element to averages over its nominal area."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from skfem import Element, Mesh

__all__ = ["average_traction", "mean_gap", "recovered_force", "to_components"]


def average_traction(force: np.ndarray, nominal_area: float) -> np.ndarray:
    r"""Average local contact forces over the nominal area, eqs (2) and (3) of the source."""
    return to_components(np.sum(force, axis=0)) / nominal_area  # (2), (3)


def to_components(vector: np.ndarray) -> np.ndarray:
    """Order components x, y, z along the last axis as normal, along x, along y."""
    return np.asarray(vector[..., [2, 0, 1]])


def mean_gap(obstacle_height: np.ndarray, surface_height: np.ndarray, weight: np.ndarray) -> float:
    """Nominal-area mean of obstacle height minus deformed surface height, m."""
    return float(np.sum(weight * (obstacle_height - surface_height)) / np.sum(weight))


def recovered_force(
    mesh: "Mesh",
    element: "Element",
    displacement: np.ndarray,
    active: np.ndarray,
    lame: float | np.ndarray,
    shear: float | np.ndarray,
) -> np.ndarray:
    r"""Integrate :math:`\sigma n` over the contact spots from the Cauchy stress.

    Notes
    -----
    The stress is the mean over the element behind a facet: without friction the normal derivative
    of the traction vanishes on the surface, while the strain of a linear element, taken at the
    facet, would mix values of the facet and of the element's middle.
    """
    from skfem import CellBasis, FacetBasis

    top = mesh.boundaries["top"]
    facets = top[np.any(active[mesh.facets[:, top]], axis=0)]
    if not len(facets):
        return np.zeros(3)
    elements = mesh.f2t[0, facets]
    basis = CellBasis(mesh, element, elements=elements)
    gradient = np.array([basis.interpolate(component).grad for component in displacement])
    strain = np.sum(gradient * basis.dx, axis=-1) / np.sum(basis.dx, axis=-1)
    strain = 0.5 * (strain + np.swapaxes(strain, 0, 1))
    lame, shear = (np.broadcast_to(value, (mesh.nelements,))[elements] for value in (lame, shear))
    stress = 2.0 * shear * strain + lame * np.trace(strain) * np.eye(3)[:, :, None]
    facet_basis = FacetBasis(mesh, element, facets=facets)
    area = np.sum(np.asarray(facet_basis.normals) * facet_basis.dx, axis=-1)
    return np.asarray(np.einsum("ijf,jf->i", stress, area))
