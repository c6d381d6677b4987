"""Stiff and extreme cases, each with a residual that is verified in the answer alone."""

from typing import TYPE_CHECKING, cast

import numpy as np

from multiscale.convergence import Status
from multiscale.errors import ConvergenceError

if TYPE_CHECKING:
    from functools import partial

    import xarray as xr

    from multiscale.io.surfaces import Surface
    from multiscale.laws.bulk import BulkLaw
    from multiscale.macro import LinkSystem
    from multiscale.micro.contact_state import ContactState

__all__ = [
    "complementarity",
    "cut_structure",
    "friction",
    "grains",
    "joint",
    "large_strain",
    "motion",
    "rough_cell",
    "structure",
    "voids",
    "wedge",
]

MODULES = 8
"""Along an edge of the grids."""
REFERENCE_PRESTRESS, CABLE_RIGIDITY = 600.0, 4e6
"""Of the grids, N."""
YOUNG, POISSON = 210e9, 0.3  # Pa, 1
POINTS, LAYERS = 16, 6
"""Of the cells."""


def _grid(bar_over_cable: float, prestress: float) -> "LinkSystem":
    from multiscale.laws.link import Bar
    from multiscale.macro import tensegrity_grid

    return tensegrity_grid(
        MODULES,
        bar=Bar(CABLE_RIGIDITY * bar_over_cable),
        prestress=REFERENCE_PRESTRESS * prestress,
    )


def structure(bar_over_cable: float, prestress: float, load_factor: float) -> float:
    """Tensegrity grid at rest: distance from equilibrium and from the laws of its links."""
    from multiscale.bench.structures import Method, solve_grid, verify

    grid = _grid(bar_over_cable, prestress)
    return verify(grid, load_factor, solve_grid(grid, load_factor, Method("auto", MODULES)))


def motion(bar_over_cable: float, prestress: float, step: float) -> float:
    """Grid that is let go from under its load: energy that its account misses, over its largest."""
    from multiscale.macro import simulate, solve_static

    grid = _grid(bar_over_cable, prestress)
    loaded = solve_static(grid, 1.0)["displacement"].values
    result = simulate(
        grid,
        step * np.arange(21),
        2.0,
        load_factor=lambda t: 0.0,
        start=(loaded, np.zeros_like(loaded)),
    )
    parts = ("kinetic_energy", "elastic_energy", "numerical_dissipation", "link_dissipation")
    account = sum(result[name].values for name in parts) - result["work"].values
    return float(np.ptp(account) / np.abs(result["elastic_energy"].values).max())


def cut_structure(bar_over_cable: float, load_factor: float, parts: int) -> float:
    """Grid cut into substructures, by LATIN: distance of its tensions from those of the whole."""
    from multiscale.bench.structures import distance
    from multiscale.macro import cut_links, solve_latin, solve_static
    from multiscale.macro.substructures import split_grid

    grid = _grid(bar_over_cable, 1.0)
    cut = solve_latin(cut_links(grid, split_grid(grid, (parts, parts))), load_factor)
    _refuse_failure(cut)
    whole = solve_static(grid, load_factor)["tension"].values
    return distance(grid, cut["tension"].values.reshape(-1), whole.reshape(-1))


def joint(law_over_block: float, friction: float, parts: int) -> float:
    """Two blocks with a rough joint, by LATIN: distance of its tractions from the whole."""
    from multiscale.laws import Exponential, Sliders
    from multiscale.laws.bulk import Elastic
    from multiscale.macro.substructures import JointLoading, load_joint, stacked_blocks

    edge, pressure = 0.02, 20e6  # m, Pa
    decay = pressure * edge / (law_over_block * YOUNG)  # K = p / decay
    normal = Exponential(10.0 * pressure, decay)
    law = Sliders(normal, friction, pressures=(0.1 * pressure, 10.0 * pressure))
    blocks = stacked_blocks((edge, edge, edge), (2, 2, 2), [Elastic(YOUNG, POISSON)] * 2, [law])
    shear = min(0.5 * friction, 0.3) * pressure  # a half would tip the upper block
    loading = JointLoading((pressure,), shear=shear, cycles=1 if shear else 0, steps=2)
    cut, whole = (load_joint(blocks, loading, parts=(n, n)) for n in (parts, 1))
    for result in (cut, whole):
        _refuse_failure(result)
    mean = cut["traction"].values[0, :, 0] @ cut["point_area"].values / edge**2
    return float(abs(mean / -pressure - 1.0))


def friction(mass_ratio: float, coefficient: float, boxes: int) -> float:
    """Stack of boxes that is pushed: natural-map error of its impulses."""
    from multiscale.bench.friction_scenes import box_stack

    rng = np.random.default_rng(seed=1)
    return _impulses(box_stack(boxes, rng, mass_ratio=mass_ratio, friction=coefficient).condensed())


def wedge(coefficient: float) -> float:
    """Block between two slanted walls: natural-map error of its impulses."""
    from multiscale.bench.friction_scenes import wedged_block

    return _impulses(wedged_block(coefficient).condensed())


def _impulses(problem: tuple[np.ndarray, np.ndarray, np.ndarray]) -> float:
    from multiscale.nonsmooth import solve_friction, verify_friction

    return verify_friction(*problem, solve_friction(*problem).unwrap()).residual


def complementarity(contrast: float, points: int) -> float:
    """Membrane with an obstacle, of two stiffnesses: natural-map error."""
    from multiscale.bench.lcp_scenes import membrane
    from multiscale.nonsmooth import solve_lcp, verify_lcp

    matrix, vector = membrane(points, contrast=contrast)
    return verify_lcp(matrix, vector, solve_lcp(matrix, vector).unwrap()).residual


def rough_cell(slope: float, relative_pressure: float, poissons_ratio: float) -> float:
    """Elastic cell: worst of balance, load and the conditions of contact."""
    from multiscale.micro import Cell
    from multiscale.micro.graph_cell import assemble_graph_cell
    from multiscale.micro.needs import cell_needs

    cell = Cell(_surface(slope), 0.5, LAYERS, YOUNG, poissons_ratio)
    problem = assemble_graph_cell(cell, cell_needs(cell))
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
    """Cell pressed, sheared and sheared back: worst of balance, contact and Coulomb's law."""
    from multiscale.laws.bulk import J2, NeoHookean
    from multiscale.micro import Cell
    from multiscale.micro.finite.cell import make_scene
    from multiscale.micro.finite.follow import largest_approach
    from multiscale.micro.finite.history import rest_state, walk_step
    from multiscale.micro.finite.scene import Target

    law: BulkLaw = NeoHookean(YOUNG, POISSON)
    load = 0.05 * slope * YOUNG
    if material == "steel":
        law, load = J2(YOUNG, POISSON, 1e-4 * YOUNG), 1e-4 * YOUNG
    surface = _surface(slope)
    cell = Cell(surface, 0.5, LAYERS, YOUNG, POISSON, bulk=law, friction_coefficient=friction)
    scene, away = make_scene(cell), 0.02 * np.ptp(surface.heights)
    state = rest_state(scene)
    for slide in np.array([[0.0, 0.0], [away, 0.0], [-away, 0.0]]):
        walk = walk_step(
            scene,
            state,
            Target(load, None, slide, 0.0),
            increments=1,
            tolerance=1e-8,
            largest_approach=largest_approach(cell),
        )
        state = walk.state
        if walk.reached < 1.0:
            raise ConvergenceError(f"the path ends: {state.status.value}")
    # what a body has become gives its stress back without flowing again
    balance = scene.body.begin(state.material, 0.0).respond(state.displacement).force
    balance[:, -1] -= state.force
    meeting = scene.meet(state.displacement, state.approach, state.slide)
    pressure = -np.sum(state.force * meeting.normal, axis=1)
    shear = np.linalg.norm(state.force + pressure[:, None] * meeting.normal, axis=1)
    largest, height = pressure.max(), np.ptp(surface.heights)
    return float(
        max(
            np.abs(balance).max() / largest,
            abs(state.load / load - 1.0),
            -pressure.min() / largest,
            (shear - friction * pressure).max() / largest,
            -meeting.gap.min() / height,
            np.abs(meeting.gap[state.active]).max() / height,
        )
    )


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


def grains(friction: float, step: float, density_ratio: float) -> float:
    """Heap of spheres that falls: largest residual of a step, or overlap beyond 1 %."""
    from multiscale.macro.granulate import ContactLaw, Grains, Model, Solver, box, simulate

    places = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    position = (2.05 * places + 1.05) * 0.01
    density = np.full(len(position), 2600.0)
    density[-1] *= density_ratio
    model = Model(
        Grains(position, np.full(len(position), 0.01), density),
        box((0.0, 0.0, 0.0), (0.07, 0.07, np.inf)),
        ContactLaw(friction),
    )
    duration = max(20 * step, 0.04)  # s, in which the uppermost grain lands on the others
    result = simulate(model, duration, step, solver=Solver(max_iterations=5000))
    overlap = float(result["penetration"].max())
    return max(float(result["residual"].max()), overlap if overlap > 0.01 else 0.0)


def voids(modulus: float, porosity: float) -> float:
    """Volume with voids, filled or not: how far its stiffness is from symmetry and its bounds."""
    from multiscale.micro.damage import effective_stiffness, random_spheres, voxelise
    from multiscale.micro.damage.elasticity import isotropic_stiffness

    image = voxelise(random_spheres((1.0, 1.0, 1.0), 0.3, porosity=porosity, seed=1), 16)
    C = effective_stiffness(image, YOUNG, POISSON, void_modulus=modulus * YOUNG).unwrap()
    solid, share = isotropic_stiffness(YOUNG, POISSON), 1.0 - float(image.void.mean())
    voigt = (share + (1.0 - share) * modulus) * solid
    reuss = solid / (share + (1.0 - share) / modulus) if modulus > 0.0 else 0.0 * solid
    below, above = (np.linalg.eigvalsh(d + d.T).min() for d in (C - reuss, voigt - C))
    return float(max(np.abs(C - C.T).max(), -below, -above) / np.abs(C).max())


def _refuse_failure(result: "xr.Dataset") -> None:
    """Raise what a result says of a step that it could not take."""
    if not result["converged"].values.all():
        raise ConvergenceError(result.attrs.get("failure") or "a step did not converge")
