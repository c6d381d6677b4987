"""The bed of sliders: closed forms at constant pressure, balance of energy at any, resolvent."""

import numpy as np
import pytest

from multiscale.laws import (
    ConvexDecreasing,
    Exponential,
    HystereticLaw,
    ModifiedLaw,
    PowerLaw,
    Sliders,
)

MU, KAPPA, LOW, HIGH = 0.3, 0.8, 1e6, 1e8
NORMAL = Exponential(1e9, 0.2e-6)
SPLINE = ConvexDecreasing(
    np.array([0.0, 0.3e-6, 1e-6]), np.array([1e26, 2e26, 1e27]), pressure_range=(LOW, HIGH)
)
NORMALS = {
    "exponential": NORMAL,
    "exponential with a gap": Exponential(1e9, 0.2e-6, gap=0.3e-6),
    "power": PowerLaw(1e9, 1e-6, 2.5),
    "linear": PowerLaw(1e9, 1e-6, 1.0),
    "convex decreasing": SPLINE,
    "damaged": ModifiedLaw(SPLINE, 0.4),
    "stretched": ModifiedLaw(SPLINE, factor=1.02, centre=0.5e-6),
    "flows": HystereticLaw(NORMAL, 2.5, 1.6),
}


def bed(normal=NORMAL, slabs=32, friction=MU, pressures=(LOW, HIGH)):
    return Sliders(normal, friction, KAPPA, pressures=pressures, slabs=slabs)


def random_jumps(law, paths, steps, rng, *, plane=True):
    """Pressures over two decades, slip distances below and beyond the limit, (steps, 3, paths)."""
    first = law.normal.first_loading
    pressure = 10.0 ** rng.uniform(np.log10(LOW), np.log10(HIGH), (steps, paths))
    reach = MU / KAPPA * 0.2e-6 * 10.0 ** rng.uniform(-1.5, 1.0, (1, paths))
    shear = reach * rng.normal(size=(2, steps, paths))
    return np.stack([first.gap_at(pressure) - first.gap, shear[0], plane * shear[1]], axis=1)


def walked(law, seed=0, points=200, steps=3):
    """A jump and a state that a path has led to."""
    jumps = random_jumps(law, points, steps + 1, np.random.default_rng(seed))
    state = np.zeros((law.n_state, points))
    for jump in jumps[:-1]:
        state = law.respond(jump, state).state
    return jumps[-1], state


def pressed(law, pressure, shear):
    """Jumps of shears, m, at a pressure, and the state of rest before them."""
    shear = np.asarray(shear)
    gap = np.broadcast_to(law.normal.gap_at(np.array(pressure)) - law.normal.gap, shear.shape)
    jump = np.stack([gap, shear, 0.0 * shear])
    return jump, law.at_rest(jump * np.array([[1.0], [0.0], [0.0]]))


def first_loading(normal, pressure, shear):
    """The law of Jäger and Ciavarella, Pa."""
    gap = normal.gap_at(np.array(pressure))
    return MU * (pressure - normal.pressure(gap + KAPPA * shear / MU))


@pytest.mark.parametrize(
    ("slabs", "two", "four"),
    [(16, 0.033, 0.061), (24, 0.018, 0.033), (32, 0.011, 0.02), (48, 0.006, 0.011)],
)
@pytest.mark.parametrize("normal", [NORMAL, PowerLaw(1e9, 1e-6, 2.5), SPLINE])
def test_at_constant_pressure_it_is_the_law_of_jaeger_and_ciavarella(normal, slabs, two, four):
    for low, largest in ((1e6, two), (1e4, four)):
        law = bed(normal, slabs, pressures=(low, HIGH))
        for pressure in np.geomspace(low, HIGH, 41):
            length = pressure / normal.stiffness(normal.gap_at(np.array(pressure)))
            shear = MU / KAPPA * length * np.geomspace(0.01, 20.0, 100)
            jump, rest = pressed(law, pressure, shear)
            error = law.respond(jump, rest).traction[1] - first_loading(normal, pressure, shear)
            assert np.abs(error).max() <= largest * MU * pressure


@pytest.mark.parametrize("slabs", [1, 2, 5, 32])
@pytest.mark.parametrize("name", NORMALS)
def test_stiffness_without_slip_and_full_slip_are_exact_for_any_number_of_slabs(name, slabs):
    law = bed(NORMALS[name], slabs)
    gap = np.linspace(0.05e-6, 0.95e-6, 50) - law.normal.gap
    jump = np.stack([gap, np.full(50, 1e-3), np.full(50, 1e-3)])
    rest = law.at_rest(jump)
    normal = law.normal.respond(jump, rest[: law.normal.n_state])
    elastic = normal.tangent[0, 0]
    if name == "flows":
        elastic = 2.5 * elastic  # loaded once, sheared: with the stiffness of unloading
    tangent = law.respond(jump, rest).tangent
    np.testing.assert_allclose(tangent[1, 1], KAPPA * elastic, rtol=1e-9)
    np.testing.assert_allclose(tangent[2, 2], KAPPA * elastic, rtol=1e-9)
    slid = law.respond(jump + np.array([[0.0], [3.0], [4.0]]), rest).traction
    np.testing.assert_allclose(slid[1], -0.6 * MU * normal.traction[0], rtol=1e-9)
    np.testing.assert_allclose(slid[2], -0.8 * MU * normal.traction[0], rtol=1e-9)


def cycle(law, pressure, amplitude, steps):
    """Shear and traction of a closed cycle after the first loading."""
    rise = np.linspace(0.0, 1.0, steps + 1)
    way = amplitude * np.concatenate([rise, 1.0 - 2.0 * rise[1:], 2.0 * rise[1:] - 1.0])
    jumps, state = pressed(law, pressure, way)
    state, traction = state[:, :1], []
    for column in jumps.T:
        response = law.respond(column[:, None], state)
        state = response.state
        traction.append(response.traction[1, 0])
    return way[steps:], np.array(traction)[steps:]


@pytest.mark.parametrize("slabs", [1, 7, 32])
def test_reversals_follow_masing_and_the_branch_back_ends_where_it_began(slabs):
    law, pressure, amplitude, steps = bed(slabs=slabs), 2e7, 0.2e-6, 60
    shear, traction = cycle(law, pressure, amplitude, steps)

    def f(u):
        return law.respond(*pressed(law, pressure, u)).traction[1]

    down, up = slice(0, steps + 1), slice(steps, None)
    top = f(np.array([amplitude]))
    scale = 1e-12 * MU * pressure
    expected = top - 2.0 * f(0.5 * (amplitude - shear[down]))
    np.testing.assert_allclose(traction[down], expected, atol=scale)
    expected = -top + 2.0 * f(0.5 * (shear[up] + amplitude))
    np.testing.assert_allclose(traction[up], expected, atol=scale)
    assert traction[-1] == pytest.approx(traction[0], rel=1e-12)


@pytest.mark.parametrize(("amplitude", "largest"), [(0.5, 0.15), (1.0, 0.04), (2.0, 0.01)])
def test_a_cycle_has_the_loss_of_masing_and_the_error_is_of_second_order(amplitude, largest):
    r"""Loss of a cycle: 8 int_0^a f - 4 a f(a), f = mu p (1 - exp(-u/c)), c = mu u_0/kappa."""
    pressure, c = 2e7, MU * 0.2e-6 / KAPPA
    a = amplitude * c
    f = -np.expm1(-amplitude)
    expected = MU * pressure * (8.0 * (a - c * f) - 4.0 * a * f)
    error = []
    for slabs in (40, 160):
        shear, traction = cycle(bed(slabs=slabs), pressure, a, 300)
        error.append(abs(np.trapezoid(traction, shear) / expected - 1.0))
    assert error[0] <= largest
    assert error[1] <= error[0] / 4.0 + 1e-4


def least_dissipation(law, paths, steps, seed, *, plane):
    """Least dissipation of a step and least work of a closed path, by the largest energy stored."""
    jumps = random_jumps(law, paths, steps, np.random.default_rng(seed), plane=plane)
    jumps = np.concatenate([jumps, jumps[:1]])
    state = np.zeros((law.n_state, paths))
    least, most, work = np.inf, np.zeros(paths), np.zeros(paths)
    for count, jump in enumerate(jumps):
        account, response = law.sliding(jump, state), law.respond(jump, state)
        if count:
            work += np.sum(response.traction[1:] * (jump - jumps[count - 1])[1:], axis=0)
        else:
            before = account.stored
        most = np.maximum(most, account.stored)
        least = min(least, float(np.min(account.dissipated / np.maximum(most, 1e-300))))
        state = response.state
    return least, float(np.min((work + before) / most))


@pytest.mark.parametrize("plane", [False, True])
@pytest.mark.parametrize("slabs", [1, 24])
@pytest.mark.parametrize("name", ["exponential", "convex decreasing", "linear", "flows"])
def test_no_step_of_a_random_path_gains_energy(name, slabs, plane):
    least, closed = least_dissipation(bed(NORMALS[name], slabs), 300, 40, 1, plane=plane)
    assert least >= -1e-12
    assert closed >= -1e-12


@pytest.mark.slow
@pytest.mark.parametrize("name", NORMALS)
def test_no_step_of_ten_thousand_random_paths_gains_energy(name):
    least, closed = least_dissipation(bed(NORMALS[name], 24), 10_000, 40, 2, plane=True)
    assert least >= -1e-12
    assert closed >= -1e-12


def test_shear_at_a_high_pressure_and_back_at_a_low_pressure_dissipates_energy():
    """Of kappa K d^2 / 2 = .016 J/m2 stored at 100 MPa four fifths go with the springs that leave.

    One spring of stiffness kappa K(g) would give .0128 J/m2 more than it took.
    """
    law = Sliders(Exponential(1e9, 0.25e-6), 10.0, KAPPA, pressures=(LOW, HIGH))  # little slip
    rise, way = np.linspace(0.0, 1e-8, 41), np.zeros(1)
    jump, state = pressed(law, 1e8, way)
    work, last = 0.0, 0.0
    for pressure, path in ((1e8, rise), (2e7, rise[::-1])):
        for shear in path:
            jump, _ = pressed(law, pressure, way + shear)
            response = law.respond(jump, state)
            traction = float(response.traction[1, 0])
            work += 0.5 * (traction + last) * (shear - float(state[-2, 0]))
            last, state = traction, response.state
    assert work == pytest.approx(0.0128, rel=0.01)


@pytest.mark.parametrize("slabs", [1, 8, 24, 32])
def test_constant_shear_falls_once_when_the_pressure_swings_and_never_again(slabs):
    """A tenth of the springs leaves contact at .9 p and comes back without force."""
    law, shear = bed(slabs=slabs), 0.5 * MU * 0.2e-6 / KAPPA
    pressure = np.array([1.9e7, 2e7, 2.5e7, 3e7])
    _, state = pressed(law, pressure, np.zeros(4))
    fixed, _ = pressed(law, pressure, np.full(4, shear))
    first = law.respond(fixed, state)
    state, left = first.state, []
    for _ in range(100):
        for swing in (0.9, 1.1, 1.0):
            jump, _ = pressed(law, swing * pressure, np.full(4, shear))
            response = law.respond(jump, state)
            state = response.state
        left.append(response.traction[1] / first.traction[1])
    np.testing.assert_allclose(left[0], 0.9, atol=0.04)
    np.testing.assert_allclose(left[-1], left[0], rtol=1e-12)


def test_pressing_along_a_straight_path_in_one_direction_is_exact_in_one_step():
    law, rng = bed(), np.random.default_rng(4)
    end, state = walked(law, seed=4)
    end[2], state[-1] = 0.0, 0.0
    state[law.slabs : 2 * law.slabs] = 0.0
    end[0] = state[-3] - rng.uniform(0.0, 0.3e-6, end.shape[1])
    whole, start, fine = law.respond(end, state), state[-3:].copy(), state
    for share in np.linspace(0.0, 1.0, 401)[1:]:
        fine = law.respond(start + share * (end - start), fine).state
    expected = law.respond(end, fine).traction
    assert np.all(np.abs(whole.traction - expected) <= 1e-5 * MU * np.abs(expected[0]))


def test_springs_pressed_while_they_are_sheared_keep_all_the_work_of_shear():
    """Of new springs without force the old springs stay softer (d): no slip, no loss."""
    law = bed(friction=1e3)
    low, high = (float(NORMAL.gap_at(np.array(p))) for p in (1e7, 3e7))
    path = np.array([[low, 1e-9], [high, 1e-9], [high, 4e-9], [high, 9e-9]])
    state, computed = law.at_rest(np.array([[low], [0.0], [0.0]])), []
    for gap, shear in path:
        jump = np.array([[gap], [shear], [0.0]])
        account = law.sliding(jump, state)
        computed.append((float(law.respond(jump, state).traction[1, 0]), float(account.stored[0])))
        state = account.state
    traction, stored = np.array(computed[1:]).T
    work = 0.5 * (traction[1:] + traction[:-1]) * np.diff(path[1:, 1])
    np.testing.assert_allclose(np.diff(stored), work, rtol=1e-9)


def test_what_turns_the_path_turns_the_traction():
    law = bed()
    jump, state = walked(law)
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    turned, other = jump.copy(), state.copy()
    turned[1:], other[-2:] = turn @ jump[1:], turn @ state[-2:]
    first, second = (slice(k * law.slabs, (k + 1) * law.slabs) for k in (0, 1))
    other[first], other[second] = np.tensordot(turn, np.stack([state[first], state[second]]), 1)
    single, two = (law.respond(*item).traction for item in ((jump, state), (turned, other)))
    np.testing.assert_allclose(two[1:], turn @ single[1:], atol=1e-9 * np.abs(single).max())


def test_the_share_that_slips_is_the_load_of_the_springs_that_do():
    """Springs of heights up to g + kappa u / mu slip: p (1 - (1 + x) exp(-x)) of an exponential."""
    law, x = bed(slabs=200), np.linspace(0.2, 5.0, 25)
    jump, rest = pressed(law, 2e7, x * MU * 0.2e-6 / KAPPA)
    slipping = law.sliding(jump, rest).slipping
    np.testing.assert_allclose(slipping, 1.0 - (1.0 + x) * np.exp(-x), atol=0.03)


def test_without_friction_it_is_the_normal_law():
    law = bed(friction=0.0)
    jump, state = walked(law)
    expected = law.normal.respond(jump, state[:0]).traction
    np.testing.assert_array_equal(law.respond(jump, state).traction, expected)


def test_an_open_interface_forgets_and_carries_nothing():
    law = bed(PowerLaw(1e9, 1e-6, 2.5))
    jump, state = walked(law)
    away = law.respond(jump + np.array([[1e-5], [0.0], [0.0]]), state)
    assert not away.traction.any()
    assert not away.tangent.any()
    assert not away.state[:-3].any()


def test_metal_that_springs_back_has_the_bed_of_its_branch():
    """Below the largest pressure the law is elastic: the bed of that curve, step by step."""
    flows = HystereticLaw(Exponential(1e9, 0.2e-6, gap=0.1e-6), 2.5, 1.6)
    peak, rng = 5e7, np.random.default_rng(6)
    branch = flows.branch(np.array(peak))
    curve, corner = PowerLaw(peak, float(branch.support), 1.6, gap=float(branch.gap)), -branch.gap
    metal, elastic = (
        Sliders(normal, MU, KAPPA, pressures=(1e5, peak), slabs=24) for normal in (flows, curve)
    )
    start = np.tile(np.array([[corner], [0.0], [0.0]]), (1, 50))
    states = [metal.at_rest(start), elastic.at_rest(start)]
    assert np.all(states[0][0] == pytest.approx(peak))
    for _ in range(20):
        share = rng.uniform(0.01, 0.95, 50)
        shear = rng.normal(0.0, 0.1e-6, (2, 50))
        jump = np.stack([start[0] + share * branch.support, *shear])
        responses = [
            law.respond(jump, state) for law, state in zip((metal, elastic), states, strict=True)
        ]
        states = [response.state for response in responses]
        first, two = (response.traction for response in responses)
        np.testing.assert_allclose(first, two, atol=1e-9 * peak)


def test_a_bed_needs_no_pressures_where_its_law_has_data():
    first, two = Sliders(SPLINE, MU), Sliders(SPLINE, MU, pressures=(LOW, HIGH))
    jump, state = walked(two)
    np.testing.assert_array_equal(
        first.respond(jump, state).traction, two.respond(jump, state).traction
    )
