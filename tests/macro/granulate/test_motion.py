"""Grains that fall, bounce, roll and pile up, against closed forms."""

import numpy as np
import pytest

from multiscale.macro import granulate
from multiscale.macro.granulate import (
    ContactLaw,
    Grains,
    Model,
    PlaneWall,
    Solver,
    box,
    simulate_grains,
)
from multiscale.macro.granulate.grain_motion import initial_state, step_grains
from multiscale.macro.granulate.simulation import Record
from tests.support import slow

FLOOR = (PlaneWall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),)
TIGHT = Solver(tolerance=1e-10, max_iterations=20000)


def bouncing_point(restitution, time):
    """Height of a point that falls from 1 m, m."""
    g, t = 9.81, np.sqrt(2.0 / 9.81)
    if time < t:
        return 1.0 - 0.5 * g * time**2
    speed = g * t * restitution
    while time >= t + 2.0 * speed / g:
        t += 2.0 * speed / g
        speed *= restitution
    return speed * (time - t) - 0.5 * g * (time - t) ** 2


def bounce_errors(restitution, compliance, step, accuracy=None):
    """Motion of a grain that falls from 1 m, and its distance from the closed form by frame, m."""
    grain = Grains([[0.0, 0.0, 1.01]], 0.01)
    model = Model(grain, FLOOR, ContactLaw(restitution=restitution, compliance=compliance))
    result = simulate_grains(model, 1.2, step, accuracy=accuracy, n_frames=61)
    time = np.append(0.0, result["time"].values)[result["frame_step"].values + 1]
    exact = np.array([bouncing_point(restitution, t) for t in time])
    return result, time, np.abs(result["position"].values[:, 0, 2] - 0.01 - exact)


def lattice(n, layers, radius=0.01, seed=0):
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(*[np.arange(n)] * 2, np.arange(layers), indexing="ij"), axis=-1)
    spacing = np.array([2.2, 2.2, 2.3]) * radius
    centre = grid.reshape(-1, 3) * spacing + np.array([1.1, 1.1, 1.2]) * radius
    return centre + rng.uniform(-0.05, 0.05, centre.shape) * radius


def gained(result):
    """Energy of every step in excess of the work done, J, and the largest work, J."""
    energy = (result["kinetic_energy"] + result["elastic_energy"] - result["work"]).values
    return energy, float(np.abs(result["work"]).max())


def settled(law=None, seconds=0.3, n=5, layers=3, solver=None, **changes):
    """A small heap in an open box."""
    position = lattice(n, layers)
    edge = 2.2 * n * 0.01
    model = Model(
        Grains(position, 0.01, **changes), box((0, 0, 0), (edge, edge, np.inf)), law or ContactLaw()
    )
    return model, simulate_grains(model, seconds, 2e-3, solver=solver)


@pytest.mark.parametrize("restitution", [0.5, 0.9])
def test_the_error_of_a_bouncing_grain_is_below_the_accuracy_asked_for(restitution):
    for accuracy in (0.1, 0.01, 0.001):
        result, time, error = bounce_errors(restitution, 0.0, 1e-2, accuracy)
        lengths = result["time_step"].values
        np.testing.assert_allclose(np.cumsum(lengths), result["time"].values, rtol=1e-12)
        assert lengths.sum() == pytest.approx(1.2)
        assert result.sizes["step"] < 300, "steps of one length have more than 10 times the error"
        np.testing.assert_allclose(time, np.linspace(0.0, 1.2, 61), atol=1e-9)
        assert error.max() < accuracy * 0.01


def test_steps_by_accuracy_beat_steps_of_one_length_in_a_small_deposit():
    model = granulate.deposit(np.full(18, 0.01), (0.07, 0.07), ContactLaw(), seed=3)
    solver = Solver(1e-6, 3000)

    def places(step, accuracy=None):
        result = simulate_grains(model, 0.15, step, accuracy=accuracy, solver=solver)
        assert result["converged"].values.all()
        return result["position"].values[-1], result.sizes["step"]

    exact, _ = places(2e-4, 1e-4)
    fixed, many = places(1e-3)
    coarse, _ = places(1e-2, 0.1)
    fine, few = places(1e-2, 0.01)
    errors = [np.abs(x - exact).max() / 0.01 for x in (coarse, fine)]
    assert errors[1] < 0.01
    assert errors[1] < 0.5 * errors[0]
    assert errors[1] < 0.5 * np.abs(fixed - exact).max() / 0.01
    assert few < 0.6 * many


@pytest.mark.parametrize("friction", [*slow(0.0, 0.1), 0.5])
def test_a_sphere_that_slides_ends_up_rolling_at_five_sevenths(friction):
    # v = v0 - mu g t until v = R w: 5/7 of v0, reached at t = 2 v0 / (7 mu g)
    grain = Grains([[0.0, 0.0, 0.01]], 0.01, velocity=[[1.0, 0.0, 0.0]])
    model = Model(grain, FLOOR, ContactLaw(friction=friction))
    result = simulate_grains(model, 0.1, 1e-4, solver=TIGHT)
    slowed = max(1.0 - friction * 9.81 * 0.1, 5.0 / 7.0) if friction else 1.0
    assert float(result["velocity"][-1, 0, 0]) == pytest.approx(slowed, rel=2e-3)
    if slowed == 5.0 / 7.0:
        assert float(result["spin"][-1, 0, 1]) == pytest.approx(slowed / 0.01, rel=1e-6)


def test_a_disc_rolls_at_two_thirds_and_stays_in_its_plane():
    grain = Grains([[0.0, 0.3, 0.01]], 0.01, velocity=[[1.0, 0.0, 0.0]], thickness=0.1)
    result = simulate_grains(Model(grain, FLOOR), 0.15, 1e-4, solver=TIGHT)
    assert float(result["velocity"][-1, 0, 0]) == pytest.approx(2.0 / 3.0, rel=1e-3)
    assert np.all(result["position"].values[:, :, 1] == 0.3)


@pytest.mark.parametrize("restitution", [0.0, 0.4])
def test_energy_never_grows_without_work(restitution):
    model, result = settled(ContactLaw(restitution=restitution), seconds=0.2)
    # after impacts, work is measured in the middle of the steps, where their velocities belong
    way = result["position"].values[-1, :, 2] - model.grains.position[:, 2]
    if restitution > 0.0:
        way -= 1e-3 * result["velocity"].values[-1, :, 2]
    weight = 9.81 * model.grains.mass
    assert float(result["work"][-1]) == pytest.approx(-float(weight @ way), rel=1e-10)
    total = (result["kinetic_energy"] - result["work"]).values
    scale = float(np.abs(result["work"]).max())
    assert np.diff(total, prepend=0.0).max() < 1e-6 * scale
    lost = result["contact_dissipation"] + result["numerical_dissipation"]
    np.testing.assert_allclose(total, -lost, atol=1e-12 * scale)


@pytest.mark.parametrize("accuracy", [None, 0.1])
@pytest.mark.parametrize(("compliance", "grows"), [(0.02, 1e-6), (0.05, 2e-4)])
def test_overlaps_of_compliant_grains_return_the_stored_energy(compliance, grows, accuracy):
    model = granulate.deposit(np.full(75, 0.01), (0.11, 0.11), ContactLaw(compliance=compliance))
    result = simulate_grains(model, 0.4, 2e-3, accuracy=accuracy)
    energy, work = gained(result)
    assert np.diff(energy, prepend=0.0).max() < grows * work
    assert float(result["elastic_energy"].max()) > 1e-3 * work


@pytest.mark.parametrize("speed", [1.0, 5.0])
def test_compliant_grains_that_hit_each_other_overlap_by_less_than_a_hundredth(speed):
    position = lattice(4, 6)  # they rush down upon each other: impulses run through the heap
    down = np.tile([0.0, 0.0, -speed], (len(position), 1))
    edge = 2.2 * 4 * 0.01
    law = ContactLaw(compliance=0.05)
    walls = box((0, 0, 0), (edge, edge, np.inf))
    result = simulate_grains(Model(Grains(position, 0.01, velocity=down), walls, law), 0.1, 2e-3)
    assert result["converged"].values.all()
    assert float(result["penetration"].max()) < 0.01
    energy, _ = gained(result)
    kinetic = 0.5 * speed**2 * 4**2 * 6 * 2600.0 * 4.0 / 3.0 * np.pi * 0.01**3
    assert np.diff(energy, prepend=kinetic).max() < 1e-3 * kinetic


def verlet_energy(result, step):
    """Kinetic and potential energy of each unit of mass at the ends of the steps, J/kg."""
    velocity, height = result["velocity"].values[1:], result["position"].values[1:, :, 2]
    before, after = velocity[:-1], velocity[1:]
    return 0.5 * np.sum(before * after, axis=2) + 9.81 * height[:-1] + (9.81 * step) ** 2 / 8.0


@pytest.mark.parametrize("height", [1.0, 1.002, 1.004, 1.006])
def test_a_rebound_has_the_square_of_the_restitution_of_the_energy(height):
    # wherever in a step the impact falls; velocities belong to the middle of the steps
    grain, h = Grains([[0.0, 0.0, 0.01 + height]], 0.01), 2e-3
    model = Model(grain, FLOOR, ContactLaw(restitution=0.5))
    result = simulate_grains(model, 0.5, h, n_frames=251)
    energy = verlet_energy(result, h)[:, 0] - 9.81 * 0.01
    assert energy[-1] == pytest.approx(0.25 * energy[0], rel=1e-12)
    assert float(result["position"].values[:, 0, 2].min()) > 0.01 - 1e-12
    bounced = int(np.argmax(result["velocity"].values[:, 0, 2]))
    assert abs(h * (bounced - 0.5) - np.sqrt(2.0 * height / 9.81)) < 1.01 * h


def many(restitution, friction=0.0, seconds=0.2, accuracy=None):
    """Energy over the work of spheres that fall into a box and bounce, and their motion."""
    law = ContactLaw(friction, restitution)
    model = granulate.deposit(np.full(40, 0.01), (0.08, 0.08), law)
    result = simulate_grains(model, seconds, 2e-3, accuracy=accuracy)
    energy, work = gained(result)
    return energy / work, result


@pytest.mark.parametrize("accuracy", [None, *slow(0.05)])
def test_grains_without_loss_keep_their_energy(accuracy):
    energy, result = many(1.0, accuracy=accuracy)
    assert np.abs(energy).max() < 1e-10
    assert float(result["n_contacts"].sum()) > 200
    assert float(result["penetration"].max()) < 0.01


@pytest.mark.parametrize(
    ("restitution", "friction"),
    [(1.0, 0.5), *(pytest.param(0.9, friction, marks=pytest.mark.slow) for friction in (0.0, 0.5))],
)
def test_grains_that_bounce_never_gain_energy(restitution, friction):
    energy, _ = many(restitution, friction)
    assert np.diff(energy, prepend=0.0).max() < 1e-12
    assert energy[-1] < -0.1


@pytest.mark.parametrize("gap", [0.0, 1e-6, 1e-3])
def test_a_cradle_is_exact_in_a_single_step(gap):
    # five balls in a row, of which the gaps close in the step: one after another bounces
    place = np.column_stack([(0.02 + gap) * np.arange(5), np.zeros(5), np.zeros(5)])
    velocity = np.zeros((5, 3))
    velocity[0, 0] = 1.0
    grains, law = Grains(place, 0.01, velocity=velocity), ContactLaw(0.0, restitution=1.0)
    result = simulate_grains(Model(grains, law=law, gravity=(0.0, 0.0, 0.0)), 0.01, 0.01)
    np.testing.assert_allclose(result["velocity"][-1, :, 0], [0, 0, 0, 0, 1], atol=1e-14)
    # the last ball moves on as if it had left when the first would have reached its place
    way = 0.01 - 4.0 * gap
    np.testing.assert_allclose(result["position"][-1, -1, 0], place[-1, 0] + way, atol=1e-14)


def test_a_step_that_misses_its_tolerance_is_reported():
    _, result = settled(solver=Solver(max_iterations=5, most_assembled=0), seconds=0.1)
    missed = int((result["converged"] == 0).sum())
    assert missed > 0
    assert result.attrs["cautions"].startswith(f"{missed} of 50 steps missed the tolerance")
    assert np.all(result["residual"].values[result["converged"].values == 0] > 1e-4)


@pytest.mark.parametrize(
    ("errors", "words"),
    [
        ((0.25, np.nan, 0.125), "; the largest error is 2.5e-01 of the closing velocities"),
        ((np.nan,), ""),
    ],
)
def test_errors_that_are_not_finite_are_counted_apart(errors, words):
    model = Model(Grains([[0.0, 0.0, 0.01]], 0.01), FLOOR)
    record = Record(model)
    state, done = step_grains(model, initial_state(model), 1e-3, Solver())
    for error in errors:
        record.add(state, done | {"residual": error, "converged": 0})
    record.show(state)
    n = len(errors)
    assert record.dataset().attrs["cautions"] == (
        f"{n} of {n} steps missed the tolerance of their contacts{words}; "
        f"the errors of 1 of them are not finite"
    )


def test_impacts_that_a_step_leaves_are_counted():
    # 1e4 impacts in a step, between plates with a gap of 1 um
    grain = Grains([[0.0, 0.0, 0.01]], 0.01, velocity=[[0.0, 0.0, 1.0]])
    walls = (*FLOOR, PlaneWall((0.0, 0.0, 0.020001), (0.0, 0.0, -1.0)))
    model = Model(grain, walls, ContactLaw(0.0, restitution=1.0), gravity=(0.0, 0.0, 0.0))
    result = simulate_grains(model, 1e-2, 1e-2)
    np.testing.assert_array_equal(result["converged"].values, 0)
    assert "impacts are left after 1000 visits of the pairs in 1 of 1 steps" in result.cautions
    soon = simulate_grains(model, 1e-4, 1e-4)
    np.testing.assert_array_equal(soon["converged"].values, 1)
    assert soon.cautions == ""


def test_momentum_and_spin_are_conserved_in_a_collision():
    rng = np.random.default_rng(seed=3)
    position = np.array([[0.0, 0.0, 0.0], [0.021, 0.003, 0.002]])
    velocity = np.array([[1.0, 0.2, -0.1], [-0.5, 0.1, 0.3]])
    spin = rng.uniform(-10.0, 10.0, (2, 3))
    grains = Grains(position, 0.01, [1000.0, 4000.0], velocity, spin)
    result = simulate_grains(Model(grains, gravity=(0.0, 0.0, 0.0)), 5e-3, 1e-5, solver=TIGHT)

    def moments(frame):
        x, v, w = (result[name].values[frame] for name in ("position", "velocity", "spin"))
        m, inertia = grains.mass[:, None], grains.inertia[:, None]
        return (m * v).sum(axis=0), (m * np.cross(x, v) + inertia * w).sum(axis=0)

    assert not np.allclose(result["velocity"][0], result["velocity"][-1])
    np.testing.assert_allclose(moments(0)[0], moments(-1)[0], atol=1e-15)
    np.testing.assert_allclose(moments(0)[1], moments(-1)[1], rtol=2e-3)


def test_a_grain_too_fast_for_its_period_ends_the_motion():
    # two of its ways in a step leave the gap next to it, .076 m, at 3.8 m/s, which it has in .39 s
    model = Model(Grains([[0.0, 0.0, 0.0]], 0.01), gravity=(9.81, 0.0, 0.0), period=(0.2, 1.0, 1.0))
    result = simulate_grains(model, 1.0, 1e-2)
    assert "period along x is 0.2 m" in result.attrs["failure"]
    assert result.sizes["step"] == pytest.approx(38, abs=1)
    np.testing.assert_allclose(result["velocity"][-1, 0, 0], 9.81 * result["time"][-1])


def test_space_repeats_along_a_period():
    grains = Grains([[0.02, 0.0, 0.0], [0.08, 0.0, 0.0]], 0.01, velocity=[[-1.0, 0, 0], [0, 0, 0]])
    model = Model(grains, gravity=(0.0, 0.0, 0.0), period=(0.1, np.inf, np.inf))
    result = simulate_grains(model, 0.1, 1e-3, solver=TIGHT)  # they meet across the border
    np.testing.assert_allclose(result["velocity"][-1, :, 0], -0.5, atol=1e-9)


ONE = Grains([[0, 0, 1.0]], 0.01)


def fall(grains=ONE, walls=FLOOR, duration=1.0, step=1e-3, accuracy=None, **options):
    return simulate_grains(Model(grains, walls, **options), duration, step, accuracy=accuracy)


def plane(point=(0, 0, 0), normal=(0, 0, 1), **options):
    return PlaneWall(point, normal, **options)


def test_every_frame_is_stored_once():
    model = Model(Grains([[0.0, 0.0, 1.01]], 0.01), FLOOR, ContactLaw())
    result = simulate_grains(model, 4e-3, 1e-3, n_frames=9)  # more frames than steps
    np.testing.assert_array_equal(result["frame_step"], np.arange(-1, 4))
    fast = Grains([[0.0, 0.0, 1.01]], 0.01).moved([[0.0, 0.0, 1.01]], [[9.0, 0.0, 0.0]], None)
    ended = simulate_grains(
        Model(fast, (), ContactLaw(), (40.0, 0.0, 0.0), (1.0, 1.0, np.inf)), 1.0, 0.01, n_frames=101
    )
    assert "the motion ends at" in ended.attrs["failure"]
    assert np.all(np.diff(ended["frame_step"]) > 0)
