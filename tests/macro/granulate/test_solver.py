"""The contacts of a step against the solver for friction problems, and extremes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

from multiscale.macro.granulate import (
    ContactLaw,
    Grains,
    Model,
    PlaneWall,
    Solver,
    box,
    deposit,
    simulate_grains,
)
from multiscale.macro.granulate.contact_solver import solve_velocities
from multiscale.macro.granulate.contacts import Velocities
from multiscale.macro.granulate.grain_motion import initial_state, pairs_of_step, step_grains
from multiscale.nonsmooth import solve_friction

FLOOR = PlaneWall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
TIGHT = Solver(tolerance=1e-9, max_iterations=50000)


def heap(n=27, radius=0.01, seed=1, **changes):
    """Grains on a lattice just above the floor of a box, of which the lowest touch soon."""
    rng = np.random.default_rng(seed)
    k = np.arange(n)
    centre = np.column_stack([k % 3, k // 3 % 3, k // 9]) * 2.02 * radius + 1.005 * radius
    centre += rng.uniform(0.0, 0.01, (n, 3)) * radius
    edge = 6.1 * radius
    walls = box((0, 0, 0), (edge, edge, np.inf))
    velocity = rng.normal(scale=0.2, size=(n, 3))
    return Model(Grains(centre, radius, velocity=velocity, **changes), walls, ContactLaw(0.4))


def delassus(model, contacts):
    """W and the frames of the contacts, by assembling H."""
    n, m = model.grains.n, len(contacts.ends)
    H = np.zeros((6 * n, 3 * m))
    frames = []
    for c, (i, j) in enumerate(contacts.ends):
        normal = contacts.normal[c]
        other = np.eye(3)[np.argmin(np.abs(normal))]
        t1 = np.cross(normal, other)
        t1 /= np.linalg.norm(t1)
        frame = np.array([normal, t1, np.cross(normal, t1)])
        frames.append(frame)
        for body, sign in ((i, 1.0), (j, -1.0)):
            if body >= n:
                continue
            arm = -sign * model.grains.radius[body] * normal
            H[6 * body : 6 * body + 3, 3 * c : 3 * c + 3] = sign * frame.T
            H[6 * body + 3 : 6 * body + 6, 3 * c : 3 * c + 3] = sign * np.cross(arm, frame).T
    inverse = np.repeat(
        np.column_stack([1.0 / model.grains.mass, 1.0 / model.grains.inertia]), 3, axis=1
    ).ravel()
    return H, inverse, np.array(frames)


def test_a_step_agrees_with_the_friction_solver_on_the_assembled_operator():
    model = heap()
    state, h = initial_state(model), 1e-3
    new, step = step_grains(model, state, h, TIGHT)
    assert step["converged"]
    assert step["n_contacts"] > 10
    contacts = new.contacts
    H, inverse, frames = delassus(model, contacts)
    n = model.grains.n
    free = np.zeros((n, 6))
    free[:, :3] = model.grains.velocity + h * np.array(model.gravity)
    bias = np.zeros((len(frames), 3))
    bias[:, 0] = contacts.bias
    q = H.T @ free.ravel() + bias.ravel()
    solution = solve_friction(
        csr_array(H.T @ (inverse[:, None] * H)), q, contacts.coulomb[:, 1], tolerance=1e-9
    )
    velocity = (free.ravel() + inverse * (H @ solution.unwrap())).reshape(n, 6)
    np.testing.assert_allclose(new.velocity[:n, :3], velocity[:, :3], atol=1e-6)
    np.testing.assert_allclose(
        new.velocity[:n, 4:7], model.grains.radius[:, None] * velocity[:, 3:], atol=1e-6
    )


def test_conjugate_directions_carry_a_stack_in_few_sweeps():
    n, h = 40, 1e-3  # each contact bears what lies above it; plain sweeps are some 4000
    position = np.column_stack([np.zeros((n, 2)), 0.01 * (2.0 * np.arange(n) + 1.0)])[::-1]
    model = Model(Grains(position, 0.01), (FLOOR,), ContactLaw(0.4))
    new, step = step_grains(model, initial_state(model), h, Solver(1e-8, 20000, most_assembled=0))
    weight = 9.81 * float(model.grains.mass[0]) * h
    borne = np.sort(new.contacts.impulse[:, 2])
    np.testing.assert_allclose(borne, weight * np.arange(1, n + 1), rtol=1e-5)
    assert step["iterations"] < 1000


@pytest.mark.parametrize("compliance", [0.0, 0.05])
@pytest.mark.parametrize(
    "options",
    [
        pytest.param({}, id="sweeps"),
        pytest.param({"max_iterations": 1, "most_assembled": 1000}, id="assembled"),
    ],
)
def test_one_unknown_per_contact_leads_where_three_without_friction_do(options, compliance):
    base = heap(64)
    results = []
    for friction in (0.0, 1e-13):  # a trace of it has three unknowns
        model = Model(base.grains, base.walls, ContactLaw(friction, compliance=compliance))
        state = initial_state(model)
        for _ in range(3):
            solver = Solver(**({"tolerance": 1e-11, "max_iterations": 50000} | options))
            state, step = step_grains(model, state, 1e-3, solver)
            assert step["residual"] < 1e-9
        assert step["n_contacts"] > 20
        results.append((3 if model.frictional else 1, state.velocity[:, :3]))
    (first, scalar), (three, full) = results
    assert (first, three) == (1, 3)
    # the force of a spring turns with the normal, or decreases by the square of the angle
    np.testing.assert_allclose(scalar, full, atol=2e-5 if compliance else 1e-8)


@pytest.mark.parametrize("friction", [0.0, 1.5])
@pytest.mark.parametrize("step", [1e-4, 1e-3, 1e-2])
def test_friction_and_steps_at_their_ends_stay_sound(friction, step):
    base = heap()
    model = Model(base.grains, base.walls, ContactLaw(friction))
    result = simulate_grains(model, 10 * step, step, solver=Solver(max_iterations=5000))
    assert result["converged"].values.all()
    assert float(result["penetration"].max()) < 0.01
    total = (result["kinetic_energy"] - result["work"]).values
    assert np.diff(total).max() < 1e-9


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_a_heavy_grain_rests_on_a_light_grain(friction):
    # mass ratio 1e6: pure Gauss-Seidel needs about as many sweeps
    grains = Grains([[0.0, 0.0, 0.01], [0.0, 0.0, 0.03]], 0.01, [2.6, 2.6e6])
    model = Model(grains, (FLOOR,), ContactLaw(friction))
    result = simulate_grains(model, 0.02, 2e-3, solver=Solver(max_iterations=1000))
    assert result["converged"].values.all()
    force = result["wall_force"].values[-1, 0, 2]
    assert -force == pytest.approx(9.81 * float(grains.mass.sum()), rel=1e-3)


def test_sizes_of_ratio_twenty_are_borne():
    rng = np.random.default_rng(seed=2)
    small = np.stack(np.meshgrid(*[np.arange(12)] * 2, [0], indexing="ij"), axis=-1).reshape(-1, 3)
    small = small * 0.0025 + [0.0015, 0.0015, 0.0011] + rng.uniform(0.0, 1e-4, (144, 3))
    position = np.vstack([small, [[0.015, 0.015, 0.0235]]])
    radius = np.append(np.full(144, 0.001), 0.02)
    walls = box((-0.02, -0.02, 0.0), (0.05, 0.05, np.inf))
    result = simulate_grains(Model(Grains(position, radius), walls), 0.05, 1e-3)
    assert float(result["penetration"].max()) < 0.01
    assert np.isfinite(result["kinetic_energy"].values).all()
    # the small grains carry the large grain as balls of a bearing, which goes on rolling
    assert float(result["kinetic_energy"][-1]) < 0.05 * float(result["work"].max())
    assert float(result["converged"].mean()) >= 0.99


def test_a_wedge_that_jams_keeps_its_grain_and_reports_its_residual():
    # half-angle below atan(mu): the grain sticks whatever pushes it; impulses are not unique
    half = np.arctan(0.5) - 0.1
    planes = [
        PlaneWall((0, 0, 0), (np.cos(half), 0, np.sin(half)), friction=0.5),
        PlaneWall((0, 0, 0), (-np.cos(half), 0, np.sin(half)), friction=0.5),
    ]
    grain = Grains([[0.0, 0.0, 0.0101 / np.sin(half)]], 0.01, velocity=[[0, 0, -1.0]])
    result = simulate_grains(Model(grain, tuple(planes)), 0.1, 1e-3)
    assert result["converged"].values[-20:].all()
    assert float(np.linalg.norm(result["velocity"][-1])) < 1e-6
    assert float(result["penetration"].max()) < 0.01


def test_a_hyperstatic_pile_stays_at_rest():
    radius, n = 0.01, 6  # a pyramid of discs between its feet: more contacts than equations
    centre = [
        (2.0 * radius * (k + 0.5 * row), 0.0, radius * (1.0 + row * 3**0.5))
        for row in range(n)
        for k in range(n - row)
    ]
    walls = (FLOOR, *box((-radius, -np.inf, -np.inf), ((2 * n - 1) * radius, np.inf, np.inf)))
    grains = Grains(np.array(centre), radius, thickness=0.01)
    result = simulate_grains(Model(grains, walls), 0.1, 2e-3, solver=Solver(1e-6, 5000))
    moved = np.abs(result["position"].values[-1] - grains.position).max()
    assert moved < 1e-4 * radius
    weight = 9.81 * float(grains.mass.sum())
    assert -float(result["wall_force"][-1, :, 2].sum()) == pytest.approx(weight, rel=1e-3)


@pytest.mark.parametrize(("friction", "across"), [(0.5, 0.1), (0.0, 0.0)])
@pytest.mark.parametrize(
    ("spheres", "edge", "seconds"),
    [(120, 0.1, 0.2), pytest.param(1000, 0.2, 1.0, marks=pytest.mark.long)],
)
def test_a_dense_deposit_with_rigid_normals_is_solved(friction, across, spheres, edge, seconds):
    # pure sweeps meet 1e-4 of the rigid law in a third of the steps of 1000 spheres, or fewer
    law = ContactLaw(friction, tangential_compliance=across)
    model = deposit(np.full(spheres, 0.01), (edge, edge), law)
    result = simulate_grains(model, seconds, 2e-3, solver=Solver(most_assembled=100))
    assert float(result["converged"].mean()) >= 0.99
    assert float(result["penetration"].max()) < 1e-3
    energy = (result["kinetic_energy"] + result["elastic_energy"] - result["work"]).values
    assert np.diff(energy, prepend=0.0).max() < 1e-6 * float(result["work"].max())


def test_velocities_that_are_not_finite_are_never_solved():
    model = heap()
    new, _ = step_grains(model, initial_state(model), 1e-3, TIGHT)
    velocity = new.velocity.copy()
    velocity[0] = np.nan
    solver = Solver(most_assembled=1000)
    done, error = solve_velocities(solver, Velocities(velocity, model.mobility, None), new.contacts)
    assert (done, np.isnan(error)) == (0, True)
    assert not new.contacts.impulse.any()


def test_numbers_out_of_range_leave_the_answer_of_the_sweeps():
    # impulses of some 1e301 N s: the solver of the assembled problem refuses them
    base = heap(density=5e307)
    model = Model(base.grains, base.walls, ContactLaw(0.0))
    solver = Solver(1e-12, 1, most_assembled=1000)
    result = simulate_grains(model, 1e-3, 1e-3, solver=solver)
    np.testing.assert_array_equal(result["converged"].values, 0)
    assert np.isfinite(result["velocity"].values).all()
    assert result.attrs["failure"] == ""


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_a_step_without_a_solution_is_not_called_solved(friction):
    # a rigid grain between rigid plates that close: impulses rise until a difference is rounding
    lid = PlaneWall((0, 0, 0.02), (0, 0, -1), velocity=(0, 0, -1.0))
    model = Model(Grains([[0.0, 0.0, 0.01]], 0.01), (FLOOR, lid), ContactLaw(friction))
    _, step = step_grains(model, initial_state(model), 1e-3, Solver(max_iterations=20))
    assert not step["converged"]
    assert step["residual"] > 0.1


def test_a_step_without_a_solution_is_not_searched_for_its_reason(monkeypatch):
    def jamming(problem):
        raise AssertionError

    monkeypatch.setattr("multiscale.nonsmooth.friction.jamming", jamming)
    lid = PlaneWall((0, 0, 0.02), (0, 0, -1), velocity=(0, 0, -1.0))
    model = Model(Grains([[0.0, 0.0, 0.01]], 0.01), (FLOOR, lid))
    _, step = step_grains(model, initial_state(model), 1e-3, Solver(max_iterations=20))
    assert not step["converged"]
    W = np.array([[1.0, 0, -1, 0], [0, 1, 0, -1], [-1, 0, 1, 0], [0, -1, 0, 1]])
    with pytest.raises(AssertionError):
        solve_friction(W, np.array([-1.0, 0, -1, 0]), np.full(2, 0.3))


@pytest.mark.parametrize(("given", "across"), [(0.05, 0.0), (0.05, 0.01), (0.05, 0.2), (0.0, 0.1)])
def test_a_spring_has_its_displacement_after_its_contact_was_stiffened(given, across):
    # the displacement of a spring is a r / m, with the compliances used and then with those given
    base, used = heap(), 0.1 * given
    law = ContactLaw(0.4, compliance=given, tangential_compliance=across)
    model = Model(base.grains, base.walls, law)
    state, _ = step_grains(model, initial_state(model), 1e-3, TIGHT)
    coulomb = state.contacts.coulomb.copy()
    coulomb[:, 2] = max(across, used)
    stiff = state.contacts._replace(compliance=np.full(len(coulomb), used), coulomb=coulomb)
    anchor = pairs_of_step(model, replace(state, contacts=stiff), 1e-3).anchor[stiff.number]

    def parts(vector):
        along = np.sum(vector * stiff.normal, axis=1)[:, None] * stiff.normal
        return along, vector - along

    (along, turned), (normal, tangential) = parts(anchor), parts(stiff.impulse)
    least = 1e-12 * np.abs(normal).max()
    assert np.abs(tangential).max() > 1e3 * least
    np.testing.assert_allclose(given * along, used * normal, atol=least)
    np.testing.assert_allclose(
        max(given, across) * turned, max(across, used) * tangential, atol=least
    )
