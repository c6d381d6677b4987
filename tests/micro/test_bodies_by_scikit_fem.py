"""Rough cells, coated or of two bodies, against their dense compliance only by scikit-fem."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from multiscale.fe.elasticity import assemble_elasticity, displacement_basis
from multiscale.laws.bulk import Elastic
from multiscale.laws.bulk.bulk_law import lame_parameters
from multiscale.micro import Cell, Coating, FlatCell, Path, SecondBody, Surface, solve_cell
from multiscale.micro.elastic.flat_contact import solve_flat
from multiscale.micro.elastic.flat_reference import surface_slopes
from multiscale.micro.layer import GraphMesh, PeriodicLayer, moduli_by_layer
from multiscale.numerics.factorisation import factorise
from tests.support import rough_square


def compliance(body, between):
    """Motions along the normals of a surface, and along z, under forces along them, m/N."""
    mesh, planes = GraphMesh(body.surface, body.planes).hexahedra(), body.planes
    (n, _), (spacing, _) = body.surface.heights.shape, body.surface.spacing
    i, j = (np.rint(mesh.p[k] / spacing).astype(int) % n for k in (0, 1))
    level = mesh.p[2] / (1.0 + body.surface.heights[i, j] / body.depth)
    node = (i * n + j) * planes.size + np.argmin(np.abs(level[:, None] - planes), axis=1)
    direct = (3 * node[:, None] + np.arange(3)).ravel()
    below = body.law.youngs_modulus, body.law.poissons_ratio
    middle = np.mean(level[mesh.t], axis=0)
    layer = np.searchsorted(planes, middle) - 1
    moduli = [value[layer] for value in moduli_by_layer(body.coating, below, planes)]
    fold = csr_array((np.ones(direct.size), (direct, np.arange(direct.size))))
    whole = assemble_elasticity(displacement_basis(mesh), *lame_parameters(*moduli))
    stiffness = fold @ whole @ fold.T
    fixed = np.arange(fold.shape[0]).reshape(-1, 3) // 3 % planes.size == 0
    free = np.flatnonzero(~fixed.ravel())
    slope_x, slope_y = surface_slopes(between, (spacing, spacing))
    normal = np.stack([-slope_x, -slope_y, np.ones((n, n))]) / np.sqrt(
        1.0 + slope_x**2 + slope_y**2
    )
    top = 3 * ((np.arange(n * n) + 1) * planes.size - 1)
    along, up = np.zeros((2, n * n, fold.shape[0]))
    for k in range(3):
        along[np.arange(n * n), top + k] = normal[k].ravel()
    up[np.arange(n * n), top + 2] = 1.0
    solve = factorise(csr_array(stiffness)[free][:, free])
    moved = np.stack([solve(row) for row in along[:, free]], axis=1)
    return along[:, free] @ moved, up[:, free] @ moved, normal[2]


def pressed_gap(bodies, between, load):
    """Mean gap of bodies in separate frames that touch on a surface between them."""
    results = [
        compliance(body, sign * between) for body, sign in zip(bodies, (1, -1), strict=False)
    ]
    (along, up), shape = np.sum([item[:2] for item in results], axis=0), between.shape
    gap = -np.sum([body.surface.heights for body in bodies], axis=0)
    gap -= gap.min()
    contact = solve_flat(
        lambda force: (along @ force.ravel()).reshape(shape),
        gap * results[0][2],
        results[0][2],
        load=load,
        max_iterations=20000,
        tolerance=1e-8,
    )
    return np.mean(gap.ravel() - contact.approach + up @ contact.unwrap().ravel())


def test_a_rough_coated_cell_has_the_gap_of_a_mesh_with_planes_at_its_faces():
    surface, film = rough_square(8, 1.0, 0.5, 0.3, seed=2), (Coating(0.1, 5.0, 0.2),)
    cell = Cell(surface, 1.0, 8, 1.0, 0.3, coating=film)
    mesh, bare = (
        pressed_gap((PeriodicLayer(surface, 1.0, 8, cell.law, coating=item),), np.zeros((8, 8)), f)
        for item, f in ((film, 0.02), ((), 0.02))
    )
    direct = solve_cell(cell, Path(pressure=(0.02,)), tolerance=1e-9)["mean_gap"].item()
    assert direct == pytest.approx(mesh, rel=1e-6)
    assert abs(bare - mesh) > 0.05 * mesh


@pytest.mark.slow
def test_two_rough_bodies_are_flat_bodies_to_second_order_in_the_slope():
    # alike: of others the motions in the plane need finer meshes than fit a dense compliance
    n, law, slopes = 12, Elastic(1.0, 0.3), np.array([1e-4, 0.05, 0.1])
    rows = []
    for slope in slopes:
        pair = [rough_square(n, 1.0, 0.5, slope, seed=seed) for seed in (3, 13)]
        heights = [surface.heights for surface in pair]
        between = 0.5 * (heights[0] - heights[1])
        bodies = [PeriodicLayer(surface, 1.0, 8, law) for surface in pair]
        under, second = Surface(-heights[1], (1.0, 1.0)), SecondBody(1.0, 8, law)
        rows.append([pressed_gap(bodies, between, 0.1 * slope) / slope])
        for order in (1, 2):
            cell = FlatCell(pair[0], 1.0, 8, law, under, slope_order=order, second=second)
            path = Path(pressure=(0.1 * slope,))
            rows[-1].append(solve_cell(cell, path, tolerance=1e-7)["mean_gap"].item() / slope)
    exact, first, second = (np.array(rows[1:]) / rows[0] - 1.0).T
    errors = np.abs([exact - first, exact - second])
    rates = np.log2(errors[:, 1] / errors[:, 0])
    assert rates[1] > 1.6 > 1.45 > rates[0], rates
    assert np.all(errors[1] < 0.8 * errors[0])
