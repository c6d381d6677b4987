"""Stiff and extreme rigid bodies and grains, each with a residual verified in the answer only."""

import numpy as np

from multiscale.errors import ConvergenceError
from multiscale.schema import Dataset


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
    overlap = _largest_overlap(result["position"].values, model.grains.radius)
    return max(
        float(result["residual"].max()),
        overlap if overlap > 0.01 else 0.0,
        _unbalanced_share(result, friction),
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
    """Shear grains at a speed, and at twice with 4 times the pressure: change of the friction."""
    from multiscale.macro.granulate import ContactLaw, Solver, shear_cells

    radii, size = np.full(30, 0.005), (0.04, 0.04)
    law, solver = ContactLaw(0.5, compliance=0.05), Solver(1e-2, 300, 0)
    p, v = pressure * np.array([1.0, 4.0]), speed * np.array([1.0, 2.0])
    cell = shear_cells(radii, size, p, v, law, distance=6.0, solver=solver)
    if not cell.values["converged"].all():
        raise ConvergenceError(cell.attributes["ended"])
    return float(np.abs(np.diff(cell.values["traction"][0] / p[:, None], axis=0)).max())


def _largest_overlap(position: np.ndarray, radius: np.ndarray) -> float:
    """Return the largest overlap over the radius, m, of equal grains (frames, grains, 3)."""
    away = np.linalg.norm(position[:, :, None] - position[:, None], axis=-1)
    away[:, np.arange(len(radius)), np.arange(len(radius))] = np.inf
    return float(2.0 - away.min() / radius[0])


def _unbalanced_share(result: Dataset, friction: float) -> float:
    """Return the largest fault in momentum and in Coulomb's cone, over the largest force."""
    mass, n = result["mass"].values, result.sizes["grain"]
    ends, force = result["contact_ends"].values, result["contact_force"].values
    normal = result["branch"].values / np.linalg.norm(result["branch"], axis=1)[:, None]
    pressing = np.sum(force * normal, axis=1)
    shear = np.linalg.norm(force - pressing[:, None] * normal, axis=1)
    gain = np.diff(result["velocity"].values, axis=0) * mass[:, None]
    gain /= result["time_step"].values[:, None, None]
    gain[..., 2] += 9.81 * mass
    after = result["contact_frame"].values > 0
    frame, at = result["contact_frame"].values[after] - 1, ends[after]
    np.subtract.at(gain, (frame, at[:, 0]), force[after])
    inner = at[:, 1] < n
    np.add.at(gain, (frame[inner], at[inner, 1]), force[after][inner])
    largest = max(float(np.abs(force).max(initial=0.0)), float(9.81 * mass.max()))
    faults = (
        np.abs(gain).max(),
        -pressing.min(initial=0.0),
        (shear - friction * pressing).max(initial=0.0),
    )
    return float(max(faults)) / largest
