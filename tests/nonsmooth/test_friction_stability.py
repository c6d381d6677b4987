"""Extreme and wrong problems: solved, or refused in one sentence; never wrongly called solved."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from multiscale.bench.nonsmooth_scenes import box_stack, sphere_pile, wedged_block
from multiscale.convergence import Status
from multiscale.errors import CaseError
from multiscale.nonsmooth.coulomb import verify_friction
from multiscale.nonsmooth.friction import solve_friction
from multiscale.nonsmooth.friction_problem import scale_friction
from tests.nonsmooth.friction_problems import random_problem, random_stack


@pytest.mark.parametrize("mass_unit", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("speed_unit", [1e-6, 1e6])
def test_units_change_nothing(mass_unit, speed_unit):
    W, q, mu = random_problem(15, np.random.default_rng(seed=1), friction=0.4)
    r = solve_friction(W, q, mu, tolerance=1e-11).unwrap()
    scaled = solve_friction(W / mass_unit, q * speed_unit, mu, tolerance=1e-10)
    np.testing.assert_allclose(scaled.unwrap() / (mass_unit * speed_unit), r, rtol=1e-6, atol=1e-9)


def test_an_immobile_contact_has_the_units_of_the_others():
    W, q, mu = random_problem(3, np.random.default_rng(seed=1), friction=0.4)
    W = W.toarray()
    W[:3], W[:, :3] = 0.0, 0.0
    unit, scaled = (scale_friction(factor * W, q, mu).reaction_unit for factor in (1.0, 1e12))
    np.testing.assert_allclose(1e12 * scaled, unit, rtol=1e-12)


@pytest.mark.parametrize("friction", [0.0, 0.5, 1.0, 1.5, 10.0])
def test_a_wedged_block_is_solved_for_any_friction(friction):
    assert solve_friction(*wedged_block(friction).condensed()).converged


def test_repeated_contacts_share_the_load():
    W, q, mu = random_problem(4, np.random.default_rng(seed=2))
    twice = np.tile(np.arange(12).reshape(4, 3), (3, 1)).ravel()  # every contact three times
    W3, q3 = W.toarray()[np.ix_(twice, twice)], q[twice]
    r = solve_friction(W, q, mu, tolerance=1e-10).unwrap()
    r3 = solve_friction(W3, q3, np.tile(mu, 3), tolerance=1e-10).unwrap()
    np.testing.assert_allclose(W @ r3.reshape(3, 12).sum(axis=0), W @ r, atol=1e-7)


def test_zero_load_and_opening_contacts_need_no_impulse():
    W, q, mu = random_problem(5, np.random.default_rng(seed=3))
    for velocity in (np.zeros_like(q), np.tile([1.0, 3.0, -2.0], 5)):
        solution = solve_friction(W, velocity, mu)
        assert solution.converged
        np.testing.assert_array_equal(solution.value, 0.0)


def test_no_contact_at_all_is_solved():
    assert solve_friction(np.zeros((0, 0)), np.zeros(0), np.zeros(0)).converged


def test_mixed_friction_with_frictionless_contacts_is_solved():
    W, q, mu = random_problem(20, np.random.default_rng(seed=4))
    mu[::2], mu[1::4] = 0.0, 3.0
    r = solve_friction(W, q, mu).unwrap().reshape(-1, 3)
    np.testing.assert_array_equal(r[::2, 1:], 0.0)


def test_the_verifier_rejects_wrong_answers():
    W, q, mu = random_problem(10, np.random.default_rng(seed=5))
    r = solve_friction(W, q, mu, tolerance=1e-11).unwrap()
    assert verify_friction(W, q, mu, r).accepted
    assert not verify_friction(W, q, mu, np.zeros_like(r)).accepted  # penetrates
    assert verify_friction(W, q, mu, np.zeros_like(r)).penetration > 1e-3
    assert not verify_friction(W, q, mu, 1.001 * r).accepted
    assert not verify_friction(W, q, mu, np.full_like(r, np.nan)).accepted
    outside = r.copy()
    outside[1] += 2.0 * mu[0] * max(r[0], np.max(r))
    assert verify_friction(W, q, mu, outside).cone_violation > 0.1
    pulling = r.copy()
    pulling[0] = -np.max(r)
    assert verify_friction(W, q, mu, pulling).cone_violation > 0.1


def test_the_verifier_is_not_fooled_by_units_or_by_a_fast_opening_contact():
    W, q, mu = random_problem(10, np.random.default_rng(seed=6))
    zero = np.zeros_like(q)
    # tiny impulses: with a unit step the natural map of r = 0 would be tiny too
    assert not verify_friction(1e15 * W, q, mu, zero).accepted
    heavy, sliding = 1e15 * np.eye(3), np.array([-1.0, 0.1, 0.0])
    frictionless = np.array([1e-15, 0.0, 0.0])  # no penetration, yet it should stick
    assert verify_friction(heavy, sliding, np.array([0.5]), frictionless).penetration == 0.0
    assert not verify_friction(heavy, sliding, np.array([0.5]), frictionless).accepted
    far = csr_array(np.block([[W.toarray(), np.zeros((30, 3))], [np.zeros((3, 30)), np.eye(3)]]))
    fast = np.concatenate([q, [1e12, 0.0, 0.0]])
    assert not verify_friction(far, fast, np.append(mu, 0.5), np.zeros(33)).accepted


def test_a_problem_that_was_cut_short_is_not_called_solved():
    W, q, mu = random_stack(3).condensed()
    solution = solve_friction(W, q, mu, method="gauss_seidel", max_iterations=5)
    assert solution.status is Status.MAX_ITERATIONS
    assert solution.residuals[-1] > 1e-8


def test_a_contact_that_nothing_can_move_makes_the_problem_infeasible():
    W = np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    solution = solve_friction(W, np.array([-1.0, 0.0, 0.0, -0.5, 0.0, 0.0]), np.array([0.3, 0.3]))
    assert solution.status is Status.INFEASIBLE
    assert "contact 1 closes at 0.5 m/s" in solution.detail


def wedge(angle, friction, closing, velocity):
    """1 kg between two rigid walls that close, inclined to its way out; W and q of two contacts.

    The walls lean by an angle, rad; the body moves out of the wedge at a velocity, m/s.
    """
    c, s = np.cos(angle), np.sin(angle)
    H = np.array([[c, s], [-s, c], [-c, s], [-s, -c]])  # normal and tangent of either wall
    return H @ H.T, H @ [0.0, velocity] - closing * np.array([1, 0, 1, 0]), np.full(2, friction)


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_parallel_walls_that_close_on_a_rigid_body_have_no_solution(friction):
    solution = solve_friction(*wedge(0.0, friction, 1.0, -1.0))
    assert solution.status is Status.INFEASIBLE
    assert "normal impulses at 2 contacts (0, 1)" in solution.detail
    assert solve_friction(*wedge(0.0, friction, 0.0, -1.0)).converged
    assert solve_friction(*wedge(0.0, friction, -1.0, -1.0)).converged


@pytest.mark.parametrize(
    ("friction", "closing", "velocity", "status"),
    [
        pytest.param(0.19, 1.0, 0.0, Status.CONVERGED, id="slips out"),
        pytest.param(0.21, 1.0, 0.0, Status.JAMMED, id="jams"),
        pytest.param(0.21, 1e-9, 0.0, Status.JAMMED, id="jams slowly"),
        pytest.param(0.21, 0.0, -1.0, Status.CONVERGED, id="walls at rest"),
        pytest.param(0.21, 1.0, 20.0, Status.CONVERGED, id="leaves by itself"),
    ],
)
def test_a_wedge_jams_where_friction_exceeds_its_slope(friction, closing, velocity, status):
    # walls that close push the body out if tan(angle) > friction; otherwise no impulse stops them
    solution = solve_friction(*wedge(np.arctan(0.2), friction, closing, velocity))
    assert solution.status is status
    assert ("impulses with friction at 2 contacts" in solution.detail) is (status is Status.JAMMED)


def instances(count):
    """Stacks and piles with a mass ratio of 1 to 1e8, and wedges of a block; friction .1 to 2."""
    for seed in range(count):
        rng = np.random.default_rng(seed=seed)
        ratio, friction = 10.0 ** rng.uniform(0.0, 8.0), 0.1 * 20.0 ** rng.uniform()
        if seed % 3 == 0:
            bodies = box_stack(int(rng.integers(2, 8)), rng, mass_ratio=ratio, friction=friction)
        elif seed % 3 == 1:
            bodies = wedged_block(friction, slope=rng.uniform(0.02, 0.5))
        else:
            number = int(rng.integers(4, 20))
            bodies = sphere_pile(number, rng, mass_ratio=ratio, friction=friction)
        yield bodies.condensed()


def independent_error(W, q, mu, r):
    """Violation of Coulomb's law at each contact over the closing velocities, by cases."""
    u, r = (W @ r + q).reshape(-1, 3), r.reshape(-1, 3)
    mass = 3.0 / W.diagonal().reshape(-1, 3).sum(axis=1)
    slip, shear = np.linalg.norm(u[:, 1:], axis=1), np.linalg.norm(r[:, 1:], axis=1)
    faults = [
        np.maximum(0.0, -u[:, 0]),  # closes
        np.maximum(0.0, -r[:, 0]) / mass,  # pulls
        np.maximum(0.0, shear - mu * r[:, 0]) / mass,  # leaves the cone
        np.minimum(np.abs(u[:, 0]), np.abs(r[:, 0]) / mass),  # opens under load
        # slips below the bound, or not against the shear
        np.minimum(slip, np.maximum(0.0, mu * r[:, 0] - shear) / mass),
        np.linalg.norm(u[:, 1:] * shear[:, None] + r[:, 1:] * slip[:, None], axis=1)
        / np.maximum(shear + mass * slip, 1e-300),
    ]
    closing = q.reshape(-1, 3)[q[::3] < 0.0]
    return float(np.max(faults)) / np.linalg.norm(closing)


@pytest.mark.parametrize(
    ("count", "solved"), [(12, 9), pytest.param(160, 145, marks=pytest.mark.slow)]
)
def test_no_instance_is_called_solved_that_is_not(count, solved):
    number = 0
    for W, q, mu in instances(count):
        solution = solve_friction(W, q, mu)
        if solution.converged:
            number += 1
            assert independent_error(W, q, mu, solution.value) < 1e-7
        else:
            assert solution.detail
    assert number >= solved


@pytest.mark.slow
def test_a_pile_that_friction_makes_unsolvable_is_refused_with_its_remedy():
    W, q, mu = sphere_pile(100, np.random.default_rng(seed=1)).condensed()
    solution = solve_friction(W, q, mu, max_iterations=60)
    assert not solution.converged
    assert "with 5% more mobility across the normals sweeps solve it" in solution.detail


def test_equal_masses_are_not_the_reason_of_a_failure():
    # 200 equal boxes, one upon another, and a contact that nothing moves and that opens
    n = 200
    chain = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    chain[0, 0] = 1.0
    W, q = np.zeros((3 * n + 3, 3 * n + 3)), np.zeros(3 * n + 3)
    W[: 3 * n, : 3 * n] = np.kron(chain, np.eye(3))
    q[0], q[3 * n] = -1.0, 1.0
    solution = solve_friction(W, q, np.full(n + 1, 0.5), method="gauss_seidel", max_iterations=20)
    assert solution.status is Status.MAX_ITERATIONS
    assert "lower the friction" in solution.detail
    assert "masses" not in solution.detail


def test_masses_that_leave_no_digits_are_named_with_their_rounding():
    W, q, mu = box_stack(3, np.random.default_rng(seed=1)).condensed()
    solution = solve_friction(W, q, mu, tolerance=1e-15)
    assert solution.status is Status.STALLED
    assert "rounding of W r + q is" in solution.detail


@pytest.mark.slow
@pytest.mark.parametrize("mobility", [1e-300, 1e-200, 1e-155, 1e-100, 1e100, 1e155, 1e200, 1e300])
@pytest.mark.parametrize("speed", [1e-250, 1e-160, 1.0, 1e160, 1e250])
def test_numbers_with_squares_that_underflow_or_overflow_are_solved_or_refused(mobility, speed):
    W, q, mu = np.eye(6), np.array([-1.0, 0.3, 0.1, -0.5, 1.0, 0.0]), np.array([0.5, 0.3])
    expected = solve_friction(W, q, mu).unwrap()
    if abs(np.log10(speed) - np.log10(mobility)) > 300.5:
        with pytest.raises(CaseError, match="outside of the floating-point numbers"):
            solve_friction(mobility * W, speed * q, mu)
        return
    impulses = solve_friction(mobility * W, speed * q, mu).unwrap()
    np.testing.assert_allclose(impulses / (speed / mobility), expected, atol=1e-8)
    assert not verify_friction(mobility * W, speed * q, mu, 0.9 * impulses).accepted
    assert not verify_friction(mobility * W, speed * q, mu, 0.0 * impulses).accepted


E3, Q3, MU1 = np.eye(3), np.array([-1.0, 0.0, 0.0]), np.array([0.5])


def test_an_indefinite_matrix_names_its_eigenvalue_and_contact():
    W, q, mu = random_problem(20, np.random.default_rng(seed=7))
    full = W.toarray()
    full[33:36, 33:36] -= 40.0 * np.diag(np.diag(full[33:36, 33:36]))
    with pytest.raises(CaseError, match=r"indefinite: .* eigenvalue -.*contact 11 carries"):
        solve_friction(full, q, mu)
