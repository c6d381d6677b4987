"""Stiff and extreme cases, each with a residual that is verified in the answer only."""

from typing import TYPE_CHECKING, cast

import numpy as np

from multiscale.bench.stability_faults import joint_faults, largest_overlap, unbalanced_share
from multiscale.convergence import Status
from multiscale.errors import ConvergenceError
from multiscale.schema import Dataset

if TYPE_CHECKING:
    from collections.abc import Callable
    from functools import partial

    from multiscale.laws import Sliders
    from multiscale.macro import Assembly, LinkSystem
    from multiscale.macro.substructures import Method
    from multiscale.macro.substructures.problem import CutProblem
    from multiscale.micro.path import ContactState
    from multiscale.surfaces.surface import Surface


MODULES = 8  # number of modules along an edge of the grids
REFERENCE_PRESTRESS, CABLE_RIGIDITY = 600.0, 4e6
"""Prestress and axial rigidity of the cables of the grids, N."""
YOUNG, POISSON = 210e9, 0.3  # Pa, 1
EDGE, PRESSURE = 0.02, 20e6  # of blocks, m, and on them, Pa
SHORT = 4.0 * np.finfo(float).eps / 1e-9
"""Stretch over the largest displacement, with a rounding of 1e-9 by the displacements, which is the
tolerance of ``motion``: where links are that stiff, stretches are judged instead of forces."""
POINTS, LAYERS = 16, 6  # points along an edge and layers of the cells


def _grid(bar_over_cable: float, prestress: float) -> "LinkSystem":
    from multiscale.laws.link import Bar
    from multiscale.macro import tensegrity_grid

    return tensegrity_grid(
        MODULES, bar=Bar(CABLE_RIGIDITY * bar_over_cable), prestress=REFERENCE_PRESTRESS * prestress
    )


def structure(bar_over_cable: float, prestress: float, load_factor: float) -> float:
    """Solve a tensegrity grid at rest: distance from equilibrium and from the laws of its links."""
    from multiscale.bench.structures import GridMethod, solve_grid, verify

    grid, method = _grid(bar_over_cable, prestress), GridMethod("auto", MODULES, pardiso=True)
    return verify(grid, load_factor, solve_grid(grid, load_factor, method))


def equivalent_plate(bar_over_cable: float, prestress: float, load_factor: float) -> float:
    """Solve the plate equivalent to a grid: distance of its motion by one load step and by two.

    Its energy is convex, so that the path does not matter.
    """
    from multiscale.laws.link import Bar
    from multiscale.macro import tensegrity_grid
    from multiscale.macro.links import EquivalentPlate, plate_cell, solve_plate

    bar, tension = Bar(CABLE_RIGIDITY * bar_over_cable), REFERENCE_PRESTRESS * prestress
    cell = plate_cell(tensegrity_grid(1, bar=bar, prestress=tension), (1.0, 1.0))
    plate = EquivalentPlate(_grid(bar_over_cable, prestress), cell, (MODULES // 2,) * 2)
    ends = []
    for path in ([load_factor], [0.5 * load_factor, load_factor]):
        result = solve_plate(plate, path)
        _refuse_failure(result)
        ends.append(result["displacement"].to_numpy()[-1])
    direct, stepped = ends
    return float(np.linalg.norm(direct - stepped) / np.linalg.norm(stepped))


def _dome(rise: float, bars: int) -> "tuple[LinkSystem, Callable[[float], float]]":
    """Return a dome of bars under its critical load, and the force that it bears at a height."""
    from multiscale.laws.link import Bar
    from multiscale.macro import LinkSystem

    angle = 2.0 * np.pi * np.arange(bars) / bars
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(bars)])
    start = np.hypot(1.0, rise)

    def bears(height: float) -> float:
        length = np.hypot(1.0, height)
        return float(bars / start * (start - length) * height / length)

    fixed, load = np.ones((bars + 1, 3), dtype=bool), np.zeros((bars + 1, 3))
    # critical where the bars are (L0 / b)^(1/3) long
    fixed[-1, 2], load[-1, 2] = False, -bears(np.sqrt(start ** (2.0 / 3.0) - 1.0))
    ends = np.column_stack([np.arange(bars), np.full(bars, bars)])
    nodes = np.vstack([ring, [0.0, 0.0, rise]])
    return LinkSystem(nodes, ends, (Bar(1.0),), np.zeros(bars, int), fixed, load), bears


def limit_load(rise: float, bars: int) -> float:
    """Press the apex of a dome past its limit: error of the critical load."""
    from multiscale.macro import solve_past_limit

    path = solve_past_limit(_dome(rise, bars)[0], 1.2)
    _refuse_failure(path)
    return abs(float(path["critical_factor"]) - 1.0)


def near_limit(share: float, rise: float) -> float:
    """Press the apex of a dome by a share of its critical load: error of the force it bears."""
    from multiscale.macro import solve_static

    dome, bears = _dome(rise, 6)
    rest = solve_static(dome, [share], exact=True)
    _refuse_failure(rest)
    borne = bears(rise + float(rest["displacement"][-1, -1, 2]))
    return float(abs(borne / (-share * dome.load[-1, 2]) - 1.0))


def loose_links(scene: str, load: float, solver: str) -> float:
    """Load mechanisms and slack links: distance from the balance of forces, or of momentum."""
    from multiscale.laws.link import Bar, Cable
    from multiscale.macro import LinkSystem, simulate, solve_static

    law, corners = (Cable if scene == "slack cables" else Bar)(1e6), np.eye(4, 3)
    position = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    fixed, force = np.zeros((4, 3), dtype=bool), 0.0 * corners
    if scene == "flat square":  # a corner is pushed across the plane of its bars
        fixed[:3], force[3, 2] = True, -load
    else:  # along the motion of a square with hinges, or towards the supports of cables
        fixed[:2], fixed[2:, 2] = True, True
        force[2:, 0 if scene == "hinged square" else 1] = -load
    ends = np.array(
        [[1, 2], [2, 3], [3, 0], [0, 2], [1, 3]][: 3 if scene == "hinged square" else 5]
    )
    links = LinkSystem(position, ends, (law,), np.zeros(len(ends), int), fixed, force)
    if solver == "motion":
        h, mass = 1e-3, 2.0
        result = simulate(links, h * np.arange(21), mass)
        _refuse_failure(result)
        v, tension = result["velocity"].to_numpy(), result["tension"].to_numpy()
        pull = np.zeros((len(tension), 4, 3))
        for (i, j), t, e in zip(ends, tension.T, links.direction, strict=True):
            pull[:, i] += t[:, None] * e
            pull[:, j] -= t[:, None] * e
        change = mass * np.diff(v, axis=0) / h - force - pull[1:]
        return float(np.abs(change[:, ~fixed]).max() / (load + np.abs(pull).max()))
    result = solve_static(links, [1.0], exact=solver == "exact")
    _refuse_failure(result)
    place = position + result["displacement"].to_numpy()[-1] * (solver == "exact")
    balance = force.copy()
    for (i, j), t in zip(ends, result["tension"].to_numpy()[-1], strict=True):
        way = place[j] - place[i]
        balance[i] += t * way / np.linalg.norm(way)
        balance[j] -= t * way / np.linalg.norm(way)
    return float(np.abs(balance[~fixed]).max() / load)


def motion(bar_over_cable: float, prestress: float, step: float) -> float:
    """Release a grid from its load: worst of momentum, motion, link laws and energy."""
    from multiscale.macro import simulate, solve_static
    from multiscale.macro.links.link_equations import compatibility

    grid, mass = _grid(bar_over_cable, prestress), 2.0
    loaded = solve_static(grid, 1.0)["displacement"].values
    result = simulate(
        grid,
        step * np.arange(21),
        mass,
        load_factor=lambda t: 0.0,
        start=(loaded, np.zeros_like(loaded)),
    )
    _refuse_failure(result)
    B, free = compatibility(grid), ~grid.fixed
    u, v = (result[name].values[:, free] for name in ("displacement", "velocity"))
    tension = result["tension"].values
    force = (B.T @ tension.T).T
    momentum = mass * np.diff(v, axis=0) / step + force[1:]  # (7) with inertia
    lawful = np.clip(grid.prestress + grid.stiffness * (B @ u.T).T, *grid.bounds)  # (14), (15)
    # a stretch is the difference of displacements, with their rounding
    short = SHORT * grid.stiffness * np.abs(u).max()
    moved = np.diff(u, axis=0) - step * v[1:]  # the scheme with theta = 1
    terms = ("kinetic_energy", "elastic_energy", "numerical_dissipation", "link_dissipation")
    balance = sum(result[name].values for name in terms) - result["work"].values
    kinetic = 0.5 * mass * np.sum(v**2, axis=1) - result["kinetic_energy"].values
    energy = np.abs(result["elastic_energy"].values).max()
    return float(
        max(
            np.abs(momentum).max() / (np.abs(force).max() + short.max()),
            np.abs(moved).max() / np.abs(u).max(),
            np.max(np.abs(tension - lawful) / (np.abs(tension).max() + short)),
            np.abs(kinetic).max() / energy,
            np.ptp(balance) / energy,
        )
    )


def cut_structure(bar_over_cable: float, load_factor: float, parts: int, method: str) -> float:
    """Solve a cut grid: distance of its tensions from the uncut grid."""
    solver = _method(method, parts)
    return _distance_of_cut(
        bar_over_cable, load_factor, parts, lambda problem: solver.solve(problem, load_factor)
    )


def homogenised(bar_over_cable: float, load_factor: float, parts: int) -> float:
    """Solve a grid by homogenised substructures, resolved with slack: distance of its tensions."""
    from multiscale.macro import NewtonSchur
    from multiscale.macro.substructures import solve_homogenised

    newton = NewtonSchur(tolerance=1e-8)

    def solve(problem: "CutProblem") -> Dataset:
        return solve_homogenised(problem, lambda problem: newton.solve(problem, load_factor))

    return _distance_of_cut(bar_over_cable, load_factor, parts, solve)


def joint(law_over_block: float, friction: float, parts: int, method: str = "LATIN") -> float:
    """Cycle two blocks with a rough joint: distance of all steps from bodies and law."""
    from multiscale.laws.bulk import Elastic
    from multiscale.macro.bodies import stacked_blocks
    from multiscale.macro.substructures import joint_path, load_joint

    blocks = stacked_blocks(
        (EDGE,) * 3, (2, 2, 2), [Elastic(YOUNG, POISSON)] * 2, [_bed(law_over_block, friction)]
    )
    shear = min(0.5 * friction, 0.3) * PRESSURE  # a half would tip the upper block
    loading = joint_path((PRESSURE,), shear=shear, cycles=1, steps=2)
    cut = load_joint(blocks, loading, method=_method(method, parts))
    return _fault_of_path(blocks, loading.factors(), cut, law_over_block, parts)


def joint_path(scene: str, law_over_block: float, friction: float, method: str) -> float:
    """Load blocks that match or not, and open, slip or slide away: distance as of ``joint``."""
    from multiscale.fe.mesh_file import box_mesh
    from multiscale.laws.bulk import Elastic
    from multiscale.macro import Assembly, Body, Interface, solve_assembly

    tilt, shear = (1.5, 0.1) if scene == "opens" else (0.0, 0.5)
    if scene == "slides away":
        shear = 1.1
    steel, elements = Elastic(YOUNG, POISSON), (3, 2, 1) if scene == "does not match" else (2, 2, 2)
    lower = Body(box_mesh((EDGE,) * 3, (2, 2, 2)), steel, supports={"bottom": (0.0, 0.0, 0.0)})
    upper = Body(
        box_mesh((EDGE,) * 3, elements, origin=(0.0, 0.0, EDGE)),
        steel,
        supports={"front": (None, 0.0, None)},
        tractions={
            "top": (
                lambda x, t: PRESSURE * min(friction, 0.4) * shear * (t == 1.0),
                0.0,
                lambda x, t: -PRESSURE * (1.0 + tilt * (2.0 * x[0] / EDGE - 1.0)) * (t == 0.0),
            )
        },
    )
    face = Interface((0, 1), ("top", "bottom"), _bed(law_over_block, friction))
    blocks = Assembly((lower, upper), (face,), (0.0, 1.0))
    factors = np.array([[1.0, 0.0], [1.0, 0.5], [1.0, 1.0], [0.6, 0.5], [1.0, -1.0]])
    cut = solve_assembly(blocks, factors, method=_method(method, 1))
    return _fault_of_path(blocks, factors, cut, law_over_block, 1)


def large_blocks(
    law_over_block: float, friction: float, elements: int, *, matching: bool = True
) -> "Assembly":
    """Two blocks of a number of elements along an edge, pressed, then sheared, by load cases."""
    from multiscale.fe.mesh_file import box_mesh
    from multiscale.laws.bulk import Elastic
    from multiscale.macro import Assembly, Body, Interface

    steel, coarse = Elastic(YOUNG, POISSON), elements if matching else elements - 2
    shear = min(0.5 * friction, 0.3) * PRESSURE
    load = {"top": (lambda x, t: shear * t, 0.0, lambda x, t: PRESSURE * (t - 1.0))}
    lower, upper = (
        Body(
            box_mesh((EDGE, EDGE, 0.5 * EDGE), (count, count, count // 2), origin=(0.0, 0.0, z)),
            steel,
            supports={"bottom": (0.0, 0.0, 0.0)} if z == 0.0 else {"front": (None, 0.0, None)},
            tractions={} if z == 0.0 else load,
        )
        for z, count in ((0.0, elements), (0.5 * EDGE, coarse))
    )
    face = Interface((0, 1), ("top", "bottom"), _bed(law_over_block, friction))
    return Assembly((lower, upper), (face,), (0.0, 1.0))


def large_bodies(law_over_block: float, friction: float, matching: str) -> float:
    """Press and shear blocks of 2000 unknowns or more by multigrid: distance as of ``joint``."""
    from multiscale.macro import MultigridNewton, solve_assembly

    blocks = large_blocks(law_over_block, friction, 9, matching=matching == "yes")
    factors = np.array([[1.0, 0.0], [1.0, 1.0], [1.0, -1.0]])
    result = solve_assembly(blocks, factors, method=MultigridNewton())
    return _fault_of_path(blocks, factors, result, law_over_block, 1)


def bolts(pull: float, law_over_block: float, method: str) -> float:
    """Pull bolted blocks and release them: errors of the balance and of the initial state."""
    from multiscale.fe.mesh_file import box_mesh
    from multiscale.laws.bulk import Elastic
    from multiscale.macro import Assembly, Body, Bolt, Interface, solve_assembly

    steel, supports = Elastic(YOUNG, 0.0), {"left": (0.0, None, None), "front": (None, 0.0, None)}
    corners = [(0.0, 0.0, 0.0), (0.0, EDGE, 0.0), (EDGE, 0.0, 0.0)]
    lower, upper = (
        Body(
            box_mesh((EDGE,) * 3, (2, 2, 2), origin=(0.0, 0.0, bottom)),
            steel,
            supports=supports,
            tractions={face: (0.0, 0.0, sign * PRESSURE)},
            pins={} if bottom else dict.fromkeys(corners, (None, None, 0.0)),
        )
        for bottom, face, sign in ((-EDGE, "bottom", -1.0), (0.0, "top", 1.0))
    )
    preload = PRESSURE * EDGE**2
    bolt = Bolt((1, 0), ("top", "bottom"), 0.1 * YOUNG * EDGE, preload)
    face = Interface((0, 1), ("top", "bottom"), _bed(law_over_block, 0.2))
    blocks = Assembly((lower, upper), (face,), bolts=(bolt,))
    pulls = pull * np.array([0.0, 0.5, 1.0, 0.5, 0.0])
    path = np.stack([np.ones(5), pulls], axis=1)
    result = solve_assembly(blocks, path, method=_method(method, 1))
    _refuse_failure(result)
    carried = result["bolt_force"].values[:, 0] / preload
    clamp = -result["traction"].values[..., 0] @ result["point_area"].values / preload
    faults = [carried - clamp - pulls, carried - carried[::-1]]
    return float(np.abs(faults).max())


def _distance_of_cut(
    bar_over_cable: float,
    load_factor: float,
    parts: int,
    solve: "Callable[[CutProblem], Dataset]",
) -> float:
    """Return the distance of the tensions of a cut grid from the uncut grid."""
    from multiscale.bench.structures import distance
    from multiscale.macro import cut_links, solve_static
    from multiscale.macro.substructures import split_grid

    grid = _grid(bar_over_cable, 1.0)
    cut = solve(cut_links(grid, split_grid(grid, (parts, parts))))
    _refuse_failure(cut)
    whole = solve_static(grid, load_factor)["tension"].values
    return distance(grid, cut["tension"].values.reshape(-1), whole.reshape(-1))


def _bed(law_over_block: float, friction: float) -> "Sliders":
    """Return a law with a multiple of the stiffness of a block at the pressure."""
    from multiscale.laws import Exponential, Sliders

    decay = PRESSURE * EDGE / (law_over_block * YOUNG)  # K = p / decay
    normal = Exponential(10.0 * PRESSURE, decay)
    return Sliders(normal, friction, pressures=(0.1 * PRESSURE, 10.0 * PRESSURE))


def _method(name: str, parts: int) -> "Method":
    """Build a solver of assemblies by name, with ``parts`` substructures along a body's edge."""
    from multiscale.macro import AssembledNewton, LatinMethod, NewtonSchur

    cut = (parts, parts)
    methods: dict[str, Method] = {
        "whole": AssembledNewton(),
        "LATIN": LatinMethod(cut),
        "Schur": NewtonSchur(cut),
    }
    return methods[name]


def _fault_of_path(
    blocks: "Assembly", factors: np.ndarray, result: Dataset, law_over_block: float, parts: int
) -> float:
    """Return the largest fault of the steps of a path, over the pressure; refuse a failed path."""
    from multiscale.macro.substructures import assemble, cut_assembly

    _refuse_failure(result)
    cut = (parts, parts) if result.attrs["substructures"] > len(blocks.bodies) else (1, 1)
    steps = (factors, result["jump"].values, result["traction"].values)
    series = YOUNG / EDGE / (1.0 / law_over_block + 1.0)  # of law and bodies, Pa/m
    whole = assemble(cut_assembly(blocks, cut))
    law = cast("Sliders", blocks.interfaces[0].law)
    return joint_faults(whole, law, zip(*steps, strict=True), series) / PRESSURE


def friction(mass_ratio: float, coefficient: float, boxes: int) -> float:
    """Push a stack of boxes: natural-map error of its impulses."""
    from multiscale.bench.nonsmooth_scenes import box_stack

    rng = np.random.default_rng(seed=1)
    return _impulses(box_stack(boxes, rng, mass_ratio=mass_ratio, friction=coefficient).condensed())


def wedge(coefficient: float) -> float:
    """Press a block between two slanted walls: natural-map error of its impulses."""
    from multiscale.bench.nonsmooth_scenes import wedged_block

    return _impulses(wedged_block(coefficient).condensed())


def pile(spheres: int, mass_ratio: float, coefficient: float) -> float:
    """Push a regular packing of spheres: natural-map error of its impulses."""
    from multiscale.bench.nonsmooth_scenes import sphere_pile

    rng = np.random.default_rng(seed=1)
    bodies = sphere_pile(spheres, rng, mass_ratio=mass_ratio, friction=coefficient)
    return _impulses(bodies.condensed())


def _impulses(problem: tuple[np.ndarray, np.ndarray, np.ndarray]) -> float:
    from multiscale.nonsmooth import solve_friction, verify_friction

    return verify_friction(*problem, solve_friction(*problem).unwrap()).residual


def complementarity(contrast: float, points: int) -> float:
    """Solve a membrane of two stiffnesses with an obstacle: natural-map error."""
    from multiscale.bench.nonsmooth_scenes import membrane
    from multiscale.nonsmooth import solve_lcp, verify_lcp

    matrix, vector = membrane(points, contrast=contrast)
    return verify_lcp(matrix, vector, solve_lcp(matrix, vector).unwrap())


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


def grains(friction: float, step: float, density_ratio: float) -> float:
    """Drop a heap of spheres: worst of contact, momentum, Coulomb's cone and overlap."""
    from multiscale.macro.granulate import ContactLaw, Grains, Model, Solver, box, simulate_grains

    places = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    position = (2.05 * places + 1.05) * 0.01
    density = np.full(len(position), 2600.0)
    density[-1] *= density_ratio
    model = Model(
        Grains(position, np.full(len(position), 0.01), density),
        box((0.0, 0.0, 0.0), (0.07, 0.07, np.inf)),
        ContactLaw(friction),
    )
    steps = round(max(20 * step, 0.04) / step)  # until the uppermost grain lands on the others
    result = simulate_grains(
        model, steps * step, step, solver=Solver(max_iterations=5000), n_frames=steps + 1
    )
    overlap = largest_overlap(result["position"].values, model.grains.radius)
    return max(
        float(result["residual"].max()),
        overlap if overlap > 0.01 else 0.0,
        unbalanced_share(result, friction),
    )


def deposit(friction: float, spheres: int) -> float:
    """Drop spheres with rigid normals into a box: largest error of the contacts in a step."""
    from multiscale.macro import granulate

    law = granulate.ContactLaw(friction, tangential_compliance=0.1)
    model = granulate.deposit(np.full(spheres, 0.01), (0.1, 0.1), law)
    return float(granulate.simulate_grains(model, 0.3, 2e-3)["residual"].max())


def bounce(friction: float, restitution: float, step: float) -> float:
    """Drop spheres that bounce: largest gain of energy in a step, and change of it without loss."""
    from multiscale.macro import granulate

    law = granulate.ContactLaw(friction, restitution)
    model = granulate.deposit(np.full(30, 0.01), (0.07, 0.07), law)
    result = granulate.simulate_grains(model, 0.2, step)
    energy = (result["kinetic_energy"] - result["work"]).values / float(result["work"].max())
    gain = float(np.diff(energy, prepend=0.0).max())
    return max(gain, -energy.min()) if restitution == 1.0 and friction == 0.0 else gain


def impact(speed: float, friction: float, restitution: float) -> float:
    """Shoot two heaps of spheres at each other: lost momentum, and gain of energy in a step."""
    from multiscale.macro.granulate import ContactLaw, Grains, Model, simulate_grains

    radius, side = 0.01, np.arange(2)
    places = np.stack(np.meshgrid(side, side, np.arange(4), indexing="ij"), axis=-1).reshape(-1, 3)
    towards = np.where(places[:, 2] < 2, 1.0, -1.0)
    velocity = speed * np.column_stack([0.0 * towards + 0.1, 0.0 * towards, towards])
    grains = Grains(2.1 * radius * places, np.full(16, radius), velocity=velocity)
    model = Model(grains, (), ContactLaw(friction, restitution), (0.0, 0.0, 0.0))
    step = 0.02 * radius / speed
    result = simulate_grains(model, 50 * step, step)
    energy = result["kinetic_energy"].to_numpy() / (0.505 * speed**2 * grains.mass.sum())
    after = result["velocity"].to_numpy()[-1]
    lost = (grains.mass @ (after - velocity)) / (speed * grains.mass.sum())
    return float(max(np.abs(lost).max(), np.diff(energy, prepend=1.0).max()))


def third_body(speed: float, pressure: float) -> float:
    """Shear grains between two plates at two speeds: change of traction over pressure.

    The second has twice the speed and four times the pressure, and the same inertial number.
    """
    from multiscale.macro.granulate import ContactLaw, Solver, shear_cells

    radii, size = np.full(30, 0.005), (0.04, 0.04)
    law, solver = ContactLaw(0.5, compliance=0.05), Solver(1e-2, 300, 0)
    p, v = pressure * np.array([1.0, 4.0]), speed * np.array([1.0, 2.0])
    cell = shear_cells(radii, size, p, v, law, distance=6.0, solver=solver)
    if not cell.values["converged"].all():
        raise ConvergenceError(cell.attributes["ended"])
    return float(np.abs(np.diff(cell.values["traction"][0] / p[:, None], axis=0)).max())


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


def _refuse_failure(result: Dataset) -> None:
    """Raise the failure of a result if its path ended early."""
    if not result["converged"].values.all():
        raise ConvergenceError(result.attrs.get("failure") or "a step did not converge")
