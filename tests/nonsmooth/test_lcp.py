"""Linear complementarity problems: every method against Lemke and itself."""

from itertools import islice

import numpy as np
import pytest
from scipy.sparse import csr_array

from multiscale.bench.nonsmooth_scenes import (
    condensed,
    granular,
    loaded_column,
    membrane,
    p_matrix,
    tensegrity,
)
from multiscale.errors import CaseError, ConvergenceError
from multiscale.nonsmooth.lcp import LCP_METHODS, solve_lcp
from multiscale.nonsmooth.lcp_methods import iterate_newton_min
from multiscale.nonsmooth.lcp_problem import scale_lcp, verify_lcp


def grains(count, **options):
    mass, directions, vector = granular(count, **options)
    return condensed(mass, directions), vector


def column(bodies, **options):
    mass, directions, vector = loaded_column(bodies, **options)
    return condensed(mass, directions), vector


FAMILIES = [
    pytest.param(lambda: grains(100), id="granular"),
    pytest.param(lambda: grains(100, mass_ratio=1e6), id="granular, mass ratio 1e6"),
    pytest.param(lambda: grains(100, contacts_per_grain=5.5), id="granular, hyperstatic"),
    pytest.param(lambda: column(50, mass_ratio=1e6), id="stack, mass ratio 1e6"),
    pytest.param(lambda: column(50, mass_ratio=1e8), id="stack, mass ratio 1e8"),
    pytest.param(lambda: membrane(20), id="membrane"),
    pytest.param(lambda: membrane(20, contrast=1e8), id="membrane, contrast 1e8"),
    pytest.param(lambda: tensegrity(8), id="tensegrity"),
    pytest.param(lambda: tensegrity(8, contrast=1e8), id="tensegrity, contrast 1e8"),
    pytest.param(lambda: p_matrix(60), id="nonsymmetric P-matrix"),
]


def natural_error(matrix, vector, value):
    """Unscaled natural-map error, written without the package."""
    error = np.abs(np.minimum(value, matrix @ value + vector))
    return np.max(error) / np.max(np.abs(vector))


def tied_integers(seed):
    """A monotone matrix and a vector of small integers."""
    rng = np.random.default_rng(seed)
    root, skew = rng.integers(-1, 2, (2, 12, 12)).astype(float)
    matrix = root @ root.T + skew - skew.T + np.eye(12)
    return matrix, rng.integers(-1, 1, 12).astype(float)


@pytest.mark.parametrize("problem", FAMILIES)
def test_every_family_converges_and_two_verifiers_agree(problem):
    matrix, vector = problem()
    solution = solve_lcp(matrix, vector)
    assert solution.status.name == "CONVERGED"
    assert verify_lcp(matrix, vector, solution.value) <= 1e-10
    assert natural_error(matrix, vector, solution.value) <= 1e-6
    assert np.min(solution.value) >= 0.0


@pytest.mark.parametrize("method", ["auto", *LCP_METHODS])
def test_every_method_finds_the_same_point_and_keeps_its_history(method):
    root = np.random.default_rng(seed=3).standard_normal((30, 40))
    matrix, vector = root @ root.T, np.random.default_rng(seed=4).standard_normal(30)
    oracle = solve_lcp(matrix, vector, method="pivoting").unwrap()

    seen = []
    solution = solve_lcp(
        matrix, vector, method=method, callback=lambda iteration, error: seen.append(error)
    )
    np.testing.assert_allclose(solution.unwrap(), oracle, atol=1e-8 * np.max(oracle))
    assert solution.residuals == tuple(seen)
    assert solution.residuals[-1] == verify_lcp(matrix, vector, solution.value)
    assert len(solution.seconds) == len(solution.residuals)
    assert list(solution.seconds) == sorted(solution.seconds)
    assert method == "auto" or solution.trail == (method,)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("method", ["auto", "newton_min", "interior_point"])
def test_random_p_matrices_agree_with_pivoting(seed, method):
    matrix, vector = p_matrix(25, seed=seed)
    oracle = solve_lcp(matrix, vector, method="pivoting").unwrap()
    np.testing.assert_allclose(
        solve_lcp(matrix, vector, method=method).unwrap(), oracle, atol=1e-8 * np.max(oracle)
    )


def test_newton_min_leaves_a_cycle():
    # on this P-matrix the full step goes round the sets {0}, {1}, {2} for ever
    matrix = np.array([[1.0, 0.0, 2.0], [2.0, 1.0, 0.0], [0.0, 2.0, 1.0]])
    problem = scale_lcp(matrix, np.ones(3))
    active = np.array([True, False, False])
    iterates = list(islice(iterate_newton_min(problem, np.zeros(3), active), 20))
    assert 3 < len(iterates) < 10, "the cycle must be seen when it closes"
    assert not iterates[-1].any()


TIED = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 2.0], [2.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("matrix", "vector"),
    [
        pytest.param(TIED, -np.ones(3), id="degenerate: cycles without a rule"),
        pytest.param(TIED.T, -np.ones(3), id="degenerate, transposed"),
        pytest.param(np.ones((12, 12)), np.full(12, -1.0), id="all ratios equal, one row counts"),
        pytest.param(np.array([[1.0, 3.0], [3.0, 1.0]]), -np.array([1.0, 2.0]), id="copositive"),
        *(pytest.param(*tied_integers(seed), id=f"integers {seed}") for seed in range(20)),
    ],
)
def test_pivoting_solves_problems_full_of_ties(matrix, vector):
    value = solve_lcp(matrix, vector, method="pivoting").unwrap()
    assert natural_error(matrix, vector, value) < 1e-12
    assert value.min() >= 0.0


def game(seed, players=8, strategies=4):
    """Equilibrium of players with integer costs against each other: ties in every pivot."""
    n = players * strategies
    owner = np.arange(n) // strategies
    cost = np.random.default_rng(seed).integers(1, 251, (n, n)).astype(float)
    cost[owner[:, None] == owner] = 1.0
    plays = (owner == np.arange(players)[:, None]).astype(float)
    matrix = np.block([[cost, -plays.T], [plays, np.zeros((players, players))]])
    return matrix, np.append(np.zeros(n), -np.ones(players))


@pytest.mark.parametrize("seed", range(4))
def test_pivoting_finds_the_equilibrium_of_a_game(seed):
    # what rounding leaves of a zero hides a tie, and the path goes round without end
    matrix, vector = game(seed)
    value = solve_lcp(matrix, vector, method="pivoting").unwrap()
    assert natural_error(matrix, vector, value) < 1e-9
    np.testing.assert_allclose(value[:32].reshape(8, 4).sum(axis=1), 1.0, atol=1e-9)


@pytest.mark.parametrize("name", ["enum_fails", "exp_murty", "mmc", "ortiz", "tobenna"])
def test_public_problems_are_solved(reference_data, name):
    lines = (reference_data / "lcp" / f"lcp_{name}.dat").read_text().splitlines()
    numbers = np.array(" ".join(line.partition("#")[0] for line in lines).split(), dtype=float)
    n = int(numbers[0])
    matrix, vector = numbers[-n * (n + 1) : -n].reshape(n, n).T, numbers[-n:]  # by columns
    assert natural_error(matrix, vector, solve_lcp(matrix, vector).unwrap()) < 1e-10


def test_redundant_constraints_share_one_load():
    mass, directions, vector = loaded_column(20)
    twice = csr_array(directions[:, np.repeat(np.arange(20), 2)])
    matrix = condensed(mass, twice)
    value = solve_lcp(matrix, np.repeat(vector, 2)).unwrap()
    single = solve_lcp(condensed(mass, directions), vector).unwrap()
    np.testing.assert_allclose(value.reshape(20, 2).sum(axis=1), single, rtol=1e-8)


@pytest.mark.parametrize("length", [1e-9, 2.0**-30, 1.0, 1e3, 2.0**10])
@pytest.mark.parametrize("stress", [1.0, 1e9, 2.0**30])
def test_units_change_nothing_but_the_units(length, stress):
    matrix, vector = grains(50)
    reference = solve_lcp(matrix, vector)
    force = stress * length**2
    solution = solve_lcp((length / force) * matrix, length * vector)
    if np.frexp([length, stress])[0].tolist() == [0.5, 0.5]:  # powers of two round nothing
        assert solution.trail == reference.trail
    np.testing.assert_allclose(
        solution.unwrap() / force, reference.unwrap(), atol=1e-8 * np.max(reference.value)
    )


@pytest.mark.parametrize("base", [2.0, 10.0], ids=["exact", "rounded"])
def test_a_scaling_of_the_unknowns_changes_nothing_but_the_unknowns(base):
    matrix, vector = grains(50)
    rng = np.random.default_rng(seed=1)
    exact = base == 2.0  # powers of two round nothing: every iteration is the same, bit for bit
    power = rng.integers(-13, 14, vector.size) if exact else rng.uniform(-4.0, 4.0, vector.size)
    scale, reference = base**power, solve_lcp(matrix, vector)
    solution = solve_lcp(csr_array(scale[:, None] * matrix.toarray() * scale), scale * vector)
    assert solution.residuals == reference.residuals or not exact
    within = 0.0 if exact else 1e-8 * np.max(reference.value)
    np.testing.assert_allclose(solution.unwrap() * scale, reference.unwrap(), rtol=0, atol=within)


def test_the_solution_itself_is_accepted_as_a_start():
    matrix, vector = membrane(20)
    start = solve_lcp(matrix, vector).unwrap()
    assert len(solve_lcp(matrix, vector, start=start).residuals) == 1


def test_a_warm_start_saves_iterations():
    matrix, vector = membrane(20)
    start = solve_lcp(matrix, vector, tolerance=1e-12).unwrap()
    cold = solve_lcp(matrix, 1.0001 * vector, method="newton_min")
    warm = solve_lcp(matrix, 1.0001 * vector, method="newton_min", start=start)
    assert cold.converged
    assert warm.converged
    assert len(warm.residuals) < len(cold.residuals)


def test_no_constraints_no_load_and_no_contact():
    assert solve_lcp(np.zeros((0, 0)), np.zeros(0)).unwrap().size == 0
    assert not solve_lcp(np.eye(3), np.zeros(3)).unwrap().any()
    assert not solve_lcp(np.zeros((2, 2)), np.array([0.0, 1.0])).unwrap().any()
    assert not solve_lcp(np.eye(3), np.array([1.0, 2.0, 3.0])).unwrap().any()


def test_a_zero_on_the_diagonal_is_not_an_obstacle():
    # min x^2/2 - x with x <= 1/4: a multiplier without stiffness
    matrix = np.array([[1.0, 1.0], [-1.0, 0.0]])
    value = solve_lcp(matrix, np.array([-1.0, 0.25])).unwrap()
    np.testing.assert_allclose(value, [0.25, 0.75])


def infeasible(bodies):
    """A column of bodies between two walls that come closer than it is long."""
    directions = np.zeros((bodies, bodies + 1))
    directions[np.arange(bodies), np.arange(bodies)] = 1.0
    directions[np.arange(bodies), np.arange(bodies) + 1] = -1.0
    vector = np.full(bodies + 1, 0.1 / bodies)
    vector[bodies // 2] = -1.0
    return directions.T @ directions, vector


@pytest.mark.parametrize("method", ["auto", *LCP_METHODS])
def test_an_infeasible_problem_is_named_with_its_certificate(method):
    matrix, vector = infeasible(5)
    solution = solve_lcp(matrix, vector, method=method, tolerance=1e-8)
    assert solution.status.name == "INFEASIBLE"
    with pytest.raises(ConvergenceError, match=r"constraint \d carries .* Farkas certificate"):
        solution.unwrap()


def test_a_large_infeasible_problem_is_detected_without_a_linear_program():
    matrix, vector = infeasible(2500)
    solution = solve_lcp(csr_array(matrix), vector, tolerance=1e-8)
    assert solution.status.name == "INFEASIBLE"


def test_the_limit_of_iterations_is_respected_and_reported():
    matrix, vector = membrane(20)
    solution = solve_lcp(matrix, vector, max_iterations=1)
    assert solution.status.name == "MAX_ITERATIONS"
    assert solution.residuals[-1] == verify_lcp(matrix, vector, solution.value)


def indefinite(large):
    """A matrix with a negative eigenvalue that two rows carry."""
    matrix, vector = membrane(20) if large else (csr_array(np.eye(4)), -np.ones(4))
    i, j = (7, 200) if large else (1, 2)
    matrix = matrix.tolil()
    matrix[i, j] = matrix[j, i] = -1.0 if large else 1.5
    matrix[i, i] = matrix[j, j] = 0.3 if large else 1.0
    return csr_array(matrix), vector


@pytest.mark.parametrize(
    ("large", "sentence"),
    [
        (False, r"eigenvalue.* is -0\.5, and constraint [12] carries 50%"),
        (True, r"symmetric but indefinite.* constraint (7|200) carries"),
    ],
)
def test_an_indefinite_matrix_is_refused_with_its_eigenvalue(large, sentence):
    with pytest.raises(CaseError, match=sentence):
        solve_lcp(*indefinite(large))


def test_a_known_error_is_measured():
    # min(z, w) = min(1.1, 0.2) in the first row of scale 1/sqrt(2); data 2 / sqrt(2)
    residual = verify_lcp(np.diag([2.0, 1.0]), np.array([-2.0, 1.0]), np.array([1.1, 0.0]))
    assert residual == pytest.approx(0.1)


@pytest.mark.parametrize("huge", [-1e10, 1e10])
def test_a_huge_entry_does_not_hide_a_wrong_entry(huge):
    value = np.array([max(0.0, -huge), 0.0])  # right in the first row, wrong in the second
    assert verify_lcp(np.eye(2), np.array([huge, -1.0]), value) >= 5e-5
    value[1] = 1.0
    assert verify_lcp(np.eye(2), np.array([huge, -1.0]), value) == 0.0


def test_a_solution_that_runs_away_cannot_pass():
    matrix, vector = np.array([[1.0, -1.0], [-1.0, 1.0]]), np.array([-1.0, -1.0])
    for size in 10.0 ** np.arange(0, 30, 2):
        assert verify_lcp(matrix, vector, np.full(2, size)) >= 0.99


def test_values_that_are_not_finite_cannot_pass():
    assert verify_lcp(np.eye(2), -np.ones(2), np.array([1.0, np.nan])) == np.inf


def test_the_error_is_the_same_in_all_units_and_scales():
    mass, directions, vector = granular(30)
    matrix = condensed(mass, directions).toarray()
    rng = np.random.default_rng(seed=5)
    value = rng.uniform(0.0, 1.0, vector.size)
    error = verify_lcp(matrix, vector, value)
    scale = 10.0 ** rng.uniform(-6.0, 6.0, vector.size)
    scaled = verify_lcp(scale[:, None] * matrix * scale, scale * vector, value / scale)
    assert scaled == pytest.approx(error)
    assert verify_lcp(1e-9 * matrix, vector, 1e9 * value) == pytest.approx(error)


def test_pure_rounding_is_not_an_error():
    mass, directions, vector = loaded_column(100, mass_ratio=1e8)
    weight = 9.81e-3 * np.cumsum(mass.diagonal()[::-1])[::-1]  # weight above each contact
    matrix = condensed(mass, directions)
    assert verify_lcp(matrix, vector, weight) <= 1e-10
    assert verify_lcp(matrix, vector, weight * (1.0 + 1e-4)) >= 5e-5


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_an_error_above_the_largest_rounding_counts_in_all_units(unit):
    matrix, vector = np.array([[1.0, -1.0], [-1.0, 1.0]]), np.array([-1.0, 1.0])
    far = np.full(2, 1e12)  # rounding of the terms exceeds the millionth of the data
    error = verify_lcp(matrix, unit * vector, unit * far)
    assert error == pytest.approx(1.0 - 1e-6, rel=1e-9)
