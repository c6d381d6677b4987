"""Time stepping against exact motions: falling, bouncing, hanging, hitting a wall."""

import numpy as np
import pytest

from multiscale.laws.link import Bar, Cable, Strut
from multiscale.macro import LinkSystem, simulate, solve_static, tensegrity_grid
from multiscale.macro.links.dynamics import mean_tension
from tests.support import observed_rate

GRAVITY = 9.81


def line(places, laws, free, weight=0.0, *, axis=2):
    """Nodes along an axis, links between neighbours, of one law or one each, and free nodes."""
    n = len(places)
    position, load, fixed = np.zeros((n, 3)), np.zeros((n, 3)), np.ones((n, 3), dtype=bool)
    position[:, axis], load[-1, axis], fixed[free, axis] = places, -weight, False
    kind = np.arange(n - 1) if len(laws) == n - 1 else np.repeat([0, 1], [1, n - 2])
    ends = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    return LinkSystem(position, ends, tuple(laws), kind, fixed, load)


def hanging(law, weight=GRAVITY):
    """A point of 1 kg under a cable of 1 m: node 1 hangs at the origin from node 0."""
    return line([1.0, 0.0], [law], [1], weight)


def lifted(height, nodes=2):
    """Start at rest with the last node lifted."""
    displacement = np.zeros((nodes, 3))
    displacement[-1, 2] = height
    return displacement, np.zeros((nodes, 3))


def energy_left(response):
    """Constant sum of the energy account, J."""
    parts = ("kinetic_energy", "elastic_energy", "numerical_dissipation", "link_dissipation")
    return sum(response[name].values for name in parts) - response["work"].values


def mass_on_cable(time, stiffness=1000.0, fall=0.1):
    """Exact height of 1 kg that falls into a cable, after one period at most."""
    frequency, speed = np.sqrt(stiffness), np.sqrt(2.0 * GRAVITY * fall)
    falling = np.sqrt(2.0 * fall / GRAVITY)
    fixed = 2.0 / frequency * (np.pi - np.arctan(speed * frequency / GRAVITY))
    if time < falling:
        return fall - 0.5 * GRAVITY * time**2
    if time < falling + fixed:
        s = frequency * (time - falling)
        return -GRAVITY / stiffness * (1.0 - np.cos(s)) - speed / frequency * np.sin(s)
    s = time - falling - fixed
    return speed * s - 0.5 * GRAVITY * s**2


@pytest.mark.slow
@pytest.mark.parametrize(("theta", "rate", "size"), [(1.0, 1.0, 2e-2), (0.5, 2.0, 5e-5)])
def test_a_mass_falls_into_an_elastic_cable(theta, rate, size):
    steps, errors = np.array([1e-3, 5e-4, 2.5e-4]), []
    for h in steps:
        times = np.arange(round(0.25 / h) + 1) * h
        response = simulate(hanging(Cable(1000.0)), times, 1.0, start=lifted(0.1), theta=theta)
        height = response["displacement"].values[:, 1, 2]
        errors.append(max(abs(z - mass_on_cable(t)) for z, t in zip(height, times, strict=True)))
        assert np.ptp(energy_left(response)) < 1e-12
    assert max(errors) < size
    # theta = 1/2: the moment of the impact falls anywhere in a step, so the rate is not smooth
    assert observed_rate(steps, errors) == pytest.approx(rate, abs=0.1 if theta == 1.0 else 0.7)


def test_a_mass_falls_into_an_inextensible_cable_and_hangs():
    times = np.linspace(0.0, 0.5, 501)
    response = simulate(hanging(Cable(np.inf)), times, 1.0, start=lifted(0.1))
    height = response["displacement"].values[:, 1, 2]
    assert np.all(height >= -1e-12)
    assert np.all(np.abs(height[times > 0.15]) < 1e-12)
    # all momentum that the weight gave is taken up by the cable
    assert response["impulse"].values.sum() == pytest.approx(GRAVITY * 0.5)
    np.testing.assert_allclose(response["impulse"].values[-10:, 0], GRAVITY * 1e-3)
    np.testing.assert_allclose(response["tension"].values[-10:, 0], GRAVITY)
    # the energy of the fall is gone, in part with the jump of velocity, in part in the cable
    lost = response["link_dissipation"].values[-1] + response["numerical_dissipation"].values[-1]
    assert lost == pytest.approx(GRAVITY * 0.1, rel=2e-2)
    assert response["smallest_link_dissipation"].values.min() > -1e-12


def test_stiffer_cables_tend_to_the_inextensible_cable():
    times = np.linspace(0.0, 0.2, 201)
    rigid = simulate(hanging(Cable(np.inf)), times, 1.0, start=lifted(0.1))
    distances = []
    for rigidity in (1e7, 1e9, 1e11):
        soft = simulate(hanging(Cable(rigidity)), times, 1.0, start=lifted(0.1))
        distances.append(np.abs(soft["displacement"] - rigid["displacement"]).values.max())
    # the impulse of the impact, spread over a step: m v / (h k)
    assert distances[2] == pytest.approx(np.sqrt(0.2 * GRAVITY) / (1e-3 * 1e11), rel=0.5)
    np.testing.assert_allclose(np.log10(np.divide(distances[:-1], distances[1:])), 2.0, atol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("h", "error"), [(1e-2, 2e-2), (1e-3, 2e-3)])
def test_a_bouncing_point_is_where_it_should_be(h, error):
    ground = line([0.0, 1.0], [Strut(np.inf)], [1], GRAVITY)
    times = np.linspace(0.0, 3.0, round(3.0 / h) + 1)
    response = simulate(ground, times, 1.0, start=lifted(1.0), theta=0.5, restitution=0.9)
    assert response["converged"].values.all()
    # h = 1 m, e = .9: height after 3 s from the exact sequence of impacts
    assert response["displacement"].values[-1, 1, 2] == pytest.approx(0.418352, abs=error)
    velocity = response["velocity"].values[:, 1, 2]
    first = times[np.argmax(velocity > 0.0)]
    assert first == pytest.approx(0.451524, abs=2.0 * h)


def bar_before_wall(elements):
    """Bar of 10 m, E A = 900 N, 1 kg/m; node 1 touches the wall when it has not moved."""
    places = [-1.0, *np.linspace(0.0, 10.0, elements + 1)]
    system = line(places, [Strut(np.inf), Bar(900.0)], range(1, elements + 2), axis=0)
    mass = np.full(elements + 2, 10.0 / elements)
    mass[[1, -1]] *= 0.5
    displacement, velocity = np.zeros((2, elements + 2, 3))
    displacement[1:, 0], velocity[1:, 0] = 5.0, -10.0
    return system, mass, (displacement, velocity)


@pytest.mark.slow
def test_a_bar_hits_a_wall_and_comes_back():
    system, mass, start = bar_before_wall(100)
    h = 1e-3
    times = np.arange(2001) * h
    response = simulate(system, times, mass, start=start)
    pressing = times[response["impulse"].values[:, 0] < -1e-9]
    assert pressing[0] == pytest.approx(0.5, abs=5e-3)
    assert pressing[-1] == pytest.approx(7.0 / 6.0, abs=7e-3)
    plateau = -response["impulse"].values[(times > 0.6) & (times < 1.1), 0] / h
    assert np.median(plateau) == pytest.approx(300.0, rel=1e-2)  # E v / c
    assert np.ptp(energy_left(response)) < 1e-9 * 500.0


@pytest.mark.slow
def test_the_bar_rebounds_with_the_speed_it_came_with():
    system, mass, start = bar_before_wall(100)
    response = simulate(system, np.arange(4001) * 4e-4, mass, start=start, theta=0.5)
    momentum = np.sum(mass[1:] * response["velocity"].values[-1, 1:, 0])
    assert momentum / 10.0 == pytest.approx(10.0, rel=2e-2)
    energy = response["kinetic_energy"].values[-1] + response["elastic_energy"].values[-1]
    assert energy == pytest.approx(500.0, rel=1e-2)


@pytest.mark.slow
def test_a_moving_support_carries_its_structure_and_its_work_is_accounted_for():
    def lift(time):
        return np.array([[0.0, 0.0, 0.5 * min(time, 1.0)], [0.0, 0.0, 0.0]])

    times = np.linspace(0.0, 8.0, 4001)
    response = simulate(hanging(Cable(1000.0)), times, 1.0, support_motion=lift)
    assert response["displacement"].values[-1, 0, 2] == 0.5
    # in the end the mass hangs .5 m higher, under its weight
    end = response["displacement"].values[-1, 1, 2]
    assert end == pytest.approx(0.5 - GRAVITY / 1000.0, abs=1e-3)
    assert np.ptp(energy_left(response)) < 1e-10


@pytest.mark.parametrize("theta", [0.5, 1.0])
@pytest.mark.parametrize("restitution", [0.5, 1.0])
def test_a_cable_with_a_support_that_runs_away_jerks_its_mass_to_the_speed_of_restitution(
    restitution, theta
):
    def run_away(time):
        return np.array([[0.0, 0.0, 2.0 * time], [0.0, 0.0, 0.0]])

    slack = hanging(Cable(np.inf), weight=0.0)
    times = np.linspace(0.0, 0.1, 21)  # of 5 ms, and taut in the middle of a step
    response = simulate(
        slack,
        times,
        1.0,
        start=lifted(0.105),
        support_motion=run_away,
        theta=theta,
        restitution=restitution,
    )
    speed = response["velocity"].values[:, 1, 2]
    np.testing.assert_allclose(speed[times < 0.05], 0.0, atol=1e-12)
    np.testing.assert_allclose(speed[times > 0.056], 2.0 * (1.0 + restitution), rtol=1e-9)


def test_a_grid_released_from_its_load_keeps_account_of_its_energy():
    grid = tensegrity_grid(8, prestress=640.0)
    loaded = solve_static(grid, 1.0)
    start = (loaded["displacement"].values, np.zeros((grid.n_nodes, 3)))
    times = np.arange(101) * 2e-3
    released = simulate(grid, times, 5.0, load_factor=lambda time: 0.0, start=start)
    assert released["converged"].values.all()
    energy = energy_left(released)
    assert np.ptp(energy) < 1e-12 * energy[0]
    assert released["smallest_link_dissipation"].values.min() > -1e-12 * energy[0]
    slack = (released["tension"].values[:, grid.kind == 0] <= 0.0).sum(axis=1)
    assert slack[0] == (loaded["tension"].values[grid.kind == 0] <= 0.0).sum() > 0
    assert np.any(np.diff(slack) < 0)  # cables run taut again
    assert np.any(np.diff(slack) > 0)  # and others go slack on the way back


@pytest.mark.slow
@pytest.mark.parametrize("theta", [0.5, 0.75, 1.0])
@pytest.mark.parametrize("step", [2e-3, 5e-3, 0.1])
def test_no_step_is_large_enough_to_gain_energy(theta, step):
    grid = tensegrity_grid(4, prestress=2550.0 / 16.0)
    loaded = solve_static(grid, 1.0)
    start = (loaded["displacement"].values, np.zeros((grid.n_nodes, 3)))
    times = np.arange(101) * step
    released = simulate(grid, times, 2.0, load_factor=lambda time: 0.0, start=start, theta=theta)
    assert released["converged"].values.all()
    assert np.any(np.diff((released["slack"].values > 0.0).sum(axis=1)) != 0)
    energy = (released["kinetic_energy"] + released["elastic_energy"]).values
    assert released["smallest_link_dissipation"].values.min() > -1e-12 * energy[0]
    assert np.all(np.diff(energy) < 1e-11 * energy[0])
    if theta == 0.5:
        np.testing.assert_allclose(energy, energy[0], rtol=1e-10)


def two_masses(stiffness, ratio):
    """1 kg on a cable from the left, another 1 kg on an inextensible cable from the right.

    A cable of another stiffness joins them; all run along z and are as long as they are.
    """
    laws = Cable(stiffness), Cable(ratio * stiffness), Cable(np.inf)
    return line(np.arange(4.0), laws, [1, 2])


@pytest.mark.parametrize("theta", [0.5, 0.75, 1.0])
@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
@pytest.mark.parametrize(("h", "ratio"), [(1e-2, 1e3), (1e-1, 1.0), (1.0, 1e-3)])
def test_extensible_links_gain_no_energy_next_to_inextensible_links(h, ratio, restitution, theta):
    displacement, velocity = np.zeros((2, 4, 3))
    displacement[1:3, 2], velocity[1:3, 2] = [0.1, 0.3], [2.0, -1.0]
    response = simulate(
        two_masses(1000.0, ratio),
        np.arange(41) * h,
        1.0,
        start=(displacement, velocity),
        theta=theta,
        restitution=restitution,
    )
    assert response["converged"].values.all()
    energy = (response["kinetic_energy"] + response["elastic_energy"]).values
    assert np.all(np.diff(energy) < 1e-10 * energy[0])
    assert np.ptp(energy_left(response)) < 1e-9 * energy[0]
    assert response["smallest_link_dissipation"].values.min() > -1e-10 * energy[0]
    assert response["impulse"].values.any()
    if theta == 0.5 and restitution == 1.0:
        np.testing.assert_allclose(energy, energy[0], rtol=1e-9)


def test_an_idle_inextensible_link_changes_nothing():
    joined = two_masses(1000.0, 0.1)
    joined.fixed[:, 2] = [True, False, True, False]  # 1 kg between cables, and a mass that rests
    lone = LinkSystem(
        *(joined.position[:3], joined.ends[:2], joined.laws[:2], np.arange(2)),
        *(joined.fixed[:3], joined.load[:3]),
    )
    velocity = np.zeros((4, 3))
    velocity[1, 2] = 0.1
    times = np.arange(41) * 0.1
    motions = [
        simulate(system, times, 1.0, start=(np.zeros((n, 3)), velocity[:n]), theta=0.5)
        for system, n in ((joined, 4), (lone, 3))
    ]
    pair = [motion["velocity"].values[:, :3] for motion in motions]
    np.testing.assert_allclose(*pair, atol=1e-10)
    energy = motions[0]["kinetic_energy"] + motions[0]["elastic_energy"]
    np.testing.assert_allclose(energy, 0.005, rtol=1e-10)


def test_the_mean_tension_is_the_quotient_of_energies_and_its_slope_the_derivative():
    rng = np.random.default_rng(3)
    before, after = rng.normal(size=(2, 400))
    lower = np.where(rng.random(400) < 0.3, -np.inf, rng.uniform(-0.5, 0.0, 400))
    upper = np.where(rng.random(400) < 0.3, np.inf, rng.uniform(0.0, 0.5, 400))

    def energy(elastic):
        carried = np.clip(elastic, lower, upper)
        return 0.5 * carried**2 + carried * (elastic - carried)

    mean, slope = mean_tension(before, after, lower, upper, 0.5)
    quotient = (energy(after) - energy(before)) / (after - before)
    np.testing.assert_allclose(mean, quotient, rtol=1e-10, atol=1e-12)
    change = mean_tension(before, after + 1e-6, lower, upper, 0.5)[0]
    change = (change - mean_tension(before, after - 1e-6, lower, upper, 0.5)[0]) / 2e-6
    np.testing.assert_allclose(slope, change, atol=1e-5)
