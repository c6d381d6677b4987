r"""Averages over the nominal area of the forces on a contact surface, and its contact spots.

A spot is a connected set of contact nodes. On a grid a point has four neighbours across its
periodic edges; on a mesh the nodes of a facet are neighbours. With the normal and tangential
tractions of spot i, projected on the mean plane :math:`n^0, a_a^0`,

.. math::
    \langle t_N \rangle_i = \frac{1}{\Gamma_c^0} \int_{\Gamma_c^i}
    (t_N^i n^i \cdot n^0 + t_T^i \cdot n^0)\, \mathrm{d}\Gamma, \qquad
    \langle t_T^a \rangle_i = \frac{1}{\Gamma_c^0} \int_{\Gamma_c^i}
    (t_N^i n^i \cdot a_a^0 + t_T^i \cdot a_a^0)\, \mathrm{d}\Gamma,    \tag{1}

the averages, eqs (2) and (3) of the source, are the sums over all spots. The integrals are sums of
nodal forces, which balance the stresses of the deformed body and are the coefficients of its
tractions in the dual basis.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.micro.contact_area import HALF_SPACE, EdgeLayer, contact_areas

if TYPE_CHECKING:
    from skfem import Element, Mesh

SPOTS = {"spot_area": (), "spot_traction": (3,), "spot_traction_by_normal": (3,)}
"""Variables of contact spots, and the shape of each variable for a single spot."""


@dataclass(frozen=True)
class Keep:
    """Variables of a response in addition to averages; see :func:`~multiscale.micro.solve_cell`."""

    fields: bool = False
    spots: bool = False
    flow: bool = False
    stress: bool = False


@dataclass(frozen=True, eq=False)
class ContactSurface:
    """Contact surface of a cell in equilibrium, with nodes in a grid, (nx, ny), or a list, (n,)."""

    force: np.ndarray  # (nx, 3, ny) or (n, 3), contact forces on the body, N
    normal: np.ndarray  # (nx, 3, ny) or (n, 3), unit normals into the obstacle
    pressing: np.ndarray  # force with which a node presses, N; 0 if it is free
    gap: np.ndarray  # vertical distance of each node to the obstacle, m
    node_area: np.ndarray  # nominal area of each node on the mean plane, m2
    weight: np.ndarray  # the same area in the current configuration, m2
    jump: np.ndarray  # (3,), mean displacement jump, normal component first, m
    mean_gap: float  # m
    edges: tuple[EdgeLayer, EdgeLayer] = (HALF_SPACE, HALF_SPACE)  # of contact, along x and y
    flowing: np.ndarray | bool = False  # nodes below which the material flows
    slip: tuple[float, float] | None = None  # share of slipping nodes, work of friction, J/m2
    flowing_share: float | None = None  # flowing over all points of a metal body
    recovered_force: np.ndarray | None = None  # (3,), contact force from the Cauchy stress, N
    neighbours: Callable[[], np.ndarray] | None = None  # pairs of nodes, (2, pairs), of a mesh
    to_grid: Callable[[np.ndarray], np.ndarray] = (
        np.asarray
    )  # nodal values to the grid of the fields

    def on_grid(self, node: np.ndarray, edges: tuple[EdgeLayer, EdgeLayer]) -> "ContactSurface":
        """Arrange the nodes of a list on a periodic grid; ``node`` has the shape (nx, ny)."""
        scalars = {
            name: getattr(self, name)[node] for name in ("pressing", "gap", "node_area", "weight")
        }
        vectors = {
            name: np.moveaxis(getattr(self, name)[node], 2, 1) for name in ("force", "normal")
        }
        return replace(self, **scalars, **vectors, edges=edges, neighbours=None, to_grid=np.asarray)


def average_surface(
    surface: ContactSurface, keep: Keep, spacing: tuple[float, float] | None = None
) -> dict[str, Any]:
    """Average a contact surface; add the requested spots, flow and fields (ny, nx)."""
    area = float(np.sum(surface.node_area))
    real = contact_areas(
        surface.pressing, surface.weight, edges=surface.edges, flowing=surface.flowing
    )
    step: dict[str, Any] = {
        "traction": average_traction(surface.force, area),
        "displacement_jump": surface.jump,
        "mean_gap": surface.mean_gap,
        "contact_fraction": max(float(np.sum(real)) / area, 0.0),
    }
    # force along the normal, for spots and friction
    if keep.spots or surface.slip is not None:
        along = np.sum(surface.force * surface.normal, axis=1, keepdims=True)
        by_normal = along * surface.normal
    if surface.slip is not None:
        step["traction_by_normal"] = average_traction(by_normal, area)
        step["slip_fraction"], step["friction_work"] = surface.slip
    if surface.flowing_share is not None:
        step["flowing_fraction"] = surface.flowing_share
    if surface.recovered_force is not None:
        step["recovered_traction"] = to_components(surface.recovered_force) / area
    if keep.spots:
        step |= _spot_averages(surface, by_normal, real, area)
    if keep.fields or keep.flow:
        # below overhangs the projected area is zero or negative
        pressure, closed = np.zeros_like(surface.gap), surface.pressing != 0.0
        np.divide(-surface.force[:, 2], surface.node_area, out=pressure, where=closed)
        pressure, gap = surface.to_grid(pressure), surface.to_grid(surface.gap)
        if keep.fields:
            step |= {"pressure": pressure.T, "gap": gap.T}
        if keep.flow and spacing is not None:
            from multiscale.micro.gap_flow import gap_flow, open_gap

            flows = [gap_flow(open_gap(gap, pressure), spacing, axis) for axis in (0, 1)]
            step["hydraulic_aperture"] = [flow.aperture for flow in flows]
            step["percolating_share"] = [flow.share for flow in flows]
    return step


def average_traction(force: np.ndarray, area: float) -> np.ndarray:
    """Average nodal forces, components along axis 1, over the nominal area: (2), (3)."""
    return to_components(np.sum(force, axis=(0, *range(2, force.ndim)))) / area


def to_components(vector: np.ndarray) -> np.ndarray:
    """Order components x, y, z along the last axis as normal, along x, along y."""
    return np.asarray(vector[..., [2, 0, 1]])


def _spot_averages(
    surface: ContactSurface, by_normal: np.ndarray, real: np.ndarray, area: float
) -> dict[str, np.ndarray]:
    """Share of every contact spot in the averages (2) and (3), largest spot first."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    # pairs of neighbouring nodes
    active = surface.pressing.ravel() > 0.0
    if surface.neighbours is None:
        number = np.arange(active.size).reshape(surface.pressing.shape)
        ahead = [np.roll(number, -1, axis).ravel() for axis in (0, 1)]
        first, second = np.tile(number.ravel(), 2), np.concatenate(ahead)
    else:
        first, second = surface.neighbours()
    # spots: connected components of the contact nodes, largest first
    joined = active[first] & active[second]
    links = coo_array(
        (joined[joined], (first[joined], second[joined])), shape=(active.size, active.size)
    )
    _, label = connected_components(links, directed=False)
    _, spot = np.unique(label[active], return_inverse=True)
    total = np.bincount(spot, real.ravel()[active]).astype(float)  # integer without spots
    order = np.argsort(-total, kind="stable")

    def share(forces: np.ndarray) -> np.ndarray:
        nodal = np.moveaxis(forces, 1, -1).reshape(-1, 3)[active]
        columns = [np.bincount(spot, column)[order] for column in nodal.T]
        return to_components(np.reshape(columns, (3, -1)).T) / area  # (1)

    return {
        "spot_area": total[order],
        "spot_traction": share(surface.force),
        "spot_traction_by_normal": share(by_normal),
    }


def pad_spots(values: list[np.ndarray], axis: int) -> list[np.ndarray]:
    """Extend arrays of spots along an axis to the length of the longest; new rows are NaN."""
    most = max(array.shape[axis] for array in values)
    padded = []
    for array in values:
        rows = [(0, 0)] * array.ndim
        rows[axis] = (0, most - array.shape[axis])
        padded.append(np.pad(array, rows, constant_values=np.nan))
    return padded


def recovered_force(
    mesh: "Mesh",
    element: "Element",
    displacement: np.ndarray,
    active: np.ndarray,
    lame: float | np.ndarray,
    shear: float | np.ndarray,
) -> np.ndarray:
    r"""Integrate :math:`\sigma n` over the contact spots from the Cauchy stress, N.

    The stress is the mean over the element behind a facet: without friction the normal derivative
    of the traction vanishes on the surface, while the strain of a linear element, evaluated at the
    facet, would mix values at the facet and at the centre of the element.
    """
    from skfem import CellBasis, FacetBasis

    top = mesh.boundaries["top"]
    facets = top[np.any(active[mesh.facets[:, top]], axis=0)]
    if not len(facets):
        return np.zeros(3)
    # mean stress of the elements behind the facets
    elements = mesh.f2t[0, facets]
    basis = CellBasis(mesh, element, elements=elements)
    gradient = np.array([basis.interpolate(component).grad for component in displacement])
    strain = np.sum(gradient * basis.dx, axis=-1) / np.sum(basis.dx, axis=-1)
    strain = 0.5 * (strain + np.swapaxes(strain, 0, 1))
    lame, shear = (np.broadcast_to(value, (mesh.nelements,))[elements] for value in (lame, shear))
    stress = 2.0 * shear * strain + lame * np.trace(strain) * np.eye(3)[:, :, None]
    # facet areas times outward normals
    facet_basis = FacetBasis(mesh, element, facets=facets)
    area = np.sum(np.asarray(facet_basis.normals) * facet_basis.dx, axis=-1)
    return np.asarray(np.einsum("ijf,jf->i", stress, area))
