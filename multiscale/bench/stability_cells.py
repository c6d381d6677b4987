"""Stiff and extreme cells and volumes, each with a residual verified in the answer only."""

from typing import TYPE_CHECKING, cast

import numpy as np

from multiscale.convergence import Status
from multiscale.errors import ConvergenceError

if TYPE_CHECKING:
    from functools import partial

    from multiscale.micro.path import ContactState
    from multiscale.surfaces.surface import Surface

YOUNG, POISSON = 210e9, 0.3  # Pa, 1
POINTS, LAYERS = 16, 6  # points along an edge and layers of the cells


def rough_cell(slope: float, relative_pressure: float, poissons_ratio: float) -> float:
    """Press an elastic cell: worst of balance, load and the conditions of contact."""
    from multiscale.laws.bulk import Elastic
    from multiscale.micro import GraphCell
    from multiscale.micro.elastic.elastic_cells import assemble_graph_cell

    cell = GraphCell(_surface(slope), 0.5, LAYERS, Elastic(YOUNG, poissons_ratio))
    problem = assemble_graph_cell(cell)
    body, gap, closing = cast("partial[ContactState]", problem.solve).args
    load = relative_pressure * slope * YOUNG / (1.0 - poissons_ratio**2)
    state = problem.solve(load=load)
    if state.status is not Status.CONVERGED:
        raise ConvergenceError(f"the cell stops: {state.status.value}")
    distance = gap - closing * state.approach - body.trace(state.displacement)
    balance = body.apply(state.displacement)
    body.add(balance, state.force)
    force, height = state.force / state.force.max(), np.ptp(gap)
    return float(
        max(
            np.linalg.norm(balance) / np.linalg.norm(state.force),
            abs(state.force.sum() / load - 1.0),
            -force.min(),
            force[~state.active].max(initial=0.0),
            -distance.min() / height,
            np.abs(distance[state.active]).max() / height,
        )
    )


def large_strain(material: str, slope: float, friction: float) -> float:
    """Press a cell, shear it and back: worst of balance, contact and Coulomb's law."""
    from multiscale.laws.bulk import J2, NeoHookean
    from multiscale.micro import FiniteCell
    from multiscale.micro.finite.cell_newton import walk_step
    from multiscale.micro.finite.finite_cell import make_scene
    from multiscale.micro.path import Target

    law: NeoHookean | J2 = NeoHookean(YOUNG, POISSON)
    load = 0.05 * slope * YOUNG
    if material == "steel":
        law, load = J2(YOUNG, POISSON, 1e-4 * YOUNG), 1e-4 * YOUNG
    surface = _surface(slope)
    cell = FiniteCell(surface, 0.5, LAYERS, law, friction_coefficient=friction)
    scene, away = make_scene(cell), 0.02 * np.ptp(surface.heights)
    state = scene.rest()
    faults = []
    for slide in np.array([[0.0, 0.0], [away, 0.0], [-away, 0.0]]):
        walk = walk_step(
            scene,
            state,
            Target(load, None, slide, 0.0),
            increments=1,
            tolerance=1e-8,
            largest_approach=cell.largest_approach(),
        )
        state = walk.state
        if walk.reached < 1.0:
            raise ConvergenceError(f"the path ends: {state.status.value}")
        # the flowed body has its stress without flowing again
        balance = scene.begin(state.material, 0.0)(state.displacement).force
        scene.surface(balance)[:] -= state.force
        meeting = scene.meet(state.displacement, state.approach, state.slide)
        pressure = -np.sum(state.force * meeting.normal, axis=1)
        shear = np.linalg.norm(state.force + pressure[:, None] * meeting.normal, axis=1)
        largest, height = pressure.max(), np.ptp(surface.heights)
        faults += [
            np.abs(balance).max() / largest,
            abs(pressure.sum() / load - 1.0),
            -pressure.min() / largest,
            (shear - friction * pressure).max() / largest,
            -meeting.gap.min() / height,
            np.abs(meeting.gap[state.active]).max() / height,
            np.abs(state.slide - slide).max() / away,
        ]
    return float(max(faults))


def _surface(slope: float) -> "Surface":
    from multiscale.micro import self_affine

    return self_affine(
        (POINTS, POINTS),
        (1.0, 1.0),
        1,
        hurst_exponent=0.8,
        long_cutoff=1.0,
        short_cutoff=0.5,
        rms_slope=slope,
    )


def voids(modulus: float, porosity: float) -> float:
    """Solve a volume with voids, filled or not: distance of its stiffness from a mesh of bricks."""
    from scipy.sparse import csr_array, diags_array, kron
    from scipy.sparse.linalg import cg
    from skfem import Basis, ElementHex1, MeshHex

    from multiscale.fe.elasticity import assemble_elasticity
    from multiscale.laws.bulk.bulk_law import VOIGT, lame_parameters
    from multiscale.micro.damage import effective_stiffness, random_spheres, voxelise

    n = 12
    image = voxelise(random_spheres((1.0, 1.0, 1.0), 0.13, porosity=porosity, seed=1), n)
    voxels = effective_stiffness(image, YOUNG, POISSON, void_modulus=modulus * YOUNG).unwrap()
    mesh = MeshHex.init_tensor(*[np.arange(n + 1) / n] * 3)
    place = np.floor(n * mesh.p[:, mesh.t].mean(axis=1)).astype(int)
    share = np.where(image.void[tuple(place)], modulus, 1.0)
    basis = Basis(mesh, ElementHex1())
    stiffness = assemble_elasticity(basis, *(v * share for v in lame_parameters(1.0, POISSON)))
    # periodic unknowns: nodes on opposite sides share a number
    number = np.ravel_multi_index(tuple(np.rint(n * basis.doflocs).astype(int) % n), (n, n, n))
    expand = csr_array(kron(csr_array((np.ones(basis.N), (np.arange(basis.N), number))), np.eye(3)))
    unit = np.zeros((6, 3, 3))  # mean strains; shear strains are angles
    for k, (i, j) in enumerate(VOIGT):
        unit[k, [i, j], [j, i]] = 1.0 if i == j else 0.5
    linear = np.stack([(strain @ basis.doflocs).T.ravel() for strain in unit], axis=1)
    matrix = csr_array(expand.T @ stiffness @ expand)
    diagonal = matrix.diagonal()
    precondition = diags_array(1.0 / np.where(diagonal > 0.0, diagonal, 1.0))
    for k, load in enumerate((expand.T @ (stiffness @ linear)).T):
        linear[:, k] -= expand @ cg(matrix, load, rtol=1e-13, maxiter=10_000, M=precondition)[0]
    exact = YOUNG * linear.T @ (stiffness @ linear)  # of 1 m3
    return float(np.abs(voxels - exact).max() / np.abs(exact).max())
