"""Factorisation and static condensation."""

import numpy as np
import pytest
from scipy.sparse import block_array, csc_array, csr_array, eye_array, kron
from scipy.sparse.linalg import splu

from multiscale.errors import MultiscaleError
from multiscale.fe.elasticity import compliances, condense_body
from multiscale.numerics import factorisation
from multiscale.numerics.factorisation import factorise, on_diagonal
from multiscale.numerics.krylov import minimal_residual


def chain(n, contrast=1.0):
    """Stiffness of n masses in a row on springs, the first mass fixed."""
    k = np.where(np.arange(n) % 2, contrast, 1.0)
    matrix = np.diag(k + np.append(k[1:], 0.0))
    return matrix - np.diag(k[1:], 1) - np.diag(k[1:], -1)


FORM = [pytest.param(csr_array, id="sparse"), pytest.param(np.asarray, id="dense")]


@pytest.mark.parametrize("form", FORM)
@pytest.mark.parametrize("columns", [None, 0, 3])
def test_the_solution_solves_the_system(form, columns):
    matrix = chain(30)
    size = 30 if columns is None else (30, columns)
    exact = np.random.default_rng(seed=1).normal(size=size)
    solution = factorise(form(matrix))(matrix @ exact)
    np.testing.assert_allclose(solution, exact, atol=1e-12)


@pytest.mark.parametrize("form", FORM)
@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e12])
def test_a_floating_part_is_refused_in_any_unit(form, unit):
    matrix = np.zeros((9, 9))
    matrix[:5, :5] = chain(5)
    matrix[5:, 5:] = chain(4)
    matrix[5, 5] -= 1.0  # the second chain is unsupported
    with pytest.raises(MultiscaleError, match=r"the chain is singular: unknown [5-8] can move"):
        factorise(form(unit * matrix), name="the chain")


@pytest.mark.parametrize("form", FORM)
def test_an_unknown_without_stiffness_is_named(form):
    matrix = np.diag([1.0, 1.0, 0.0, 1.0])
    with pytest.raises(MultiscaleError, match="unknown 2 can move without force"):
        factorise(form(matrix))


@pytest.mark.parametrize("form", FORM)
def test_a_matrix_without_entries_is_refused(form):
    with pytest.raises(MultiscaleError, match="unknown 0 can move without force"):
        factorise(form(np.zeros((4, 4))))


@pytest.mark.parametrize("form", FORM)
def test_pure_contrast_is_not_taken_for_singularity(form):
    matrix = np.diag([1e-20, 1.0, 1e20])
    np.testing.assert_allclose(factorise(form(matrix))(np.ones(3)), [1e20, 1.0, 1e-20])


def plane(n):
    """Laplacian of n times n masses, the outer masses tied to the ground."""
    line = csr_array(chain(n) + np.diag([0.0] * (n - 1) + [1.0]))
    return csr_array(kron(line, eye_array(n)) + kron(eye_array(n), line))


def tie(n, stiffness, rows):
    """Saddle point: a plane with some motions prescribed by multipliers."""
    K = stiffness * plane(n)
    B = eye_array(n * n, format="csr")[rows]
    return csr_array(block_array([[K, B.T], [B, None]]))


@pytest.mark.parametrize("stiffness", [1e-9, 1.0, 1e9])
def test_a_saddle_point_without_a_diagonal_is_solved(stiffness):
    matrix = tie(12, stiffness, np.arange(0, 144, 5))
    exact = np.random.default_rng(seed=2).normal(size=(matrix.shape[0], 2))
    exact[:144] /= stiffness
    solution = factorise(matrix)(matrix @ exact)
    for part in (slice(144), slice(144, None)):
        scale = np.abs(exact[part]).max()
        np.testing.assert_allclose(solution[part], exact[part], atol=1e-9 * scale)


def test_a_pattern_that_is_not_symmetric_is_solved():
    rng = np.random.default_rng(seed=3)
    matrix = csr_array(np.triu(rng.normal(size=(40, 40))) + 10.0 * np.eye(40))
    assert not factorisation._has_symmetric_pattern(csc_array(matrix))
    exact = rng.normal(size=40)
    np.testing.assert_allclose(factorise(matrix)(matrix @ exact), exact, rtol=1e-9)


def test_pivots_with_cancelled_digits_are_not_reused(monkeypatch):
    monkeypatch.setattr(factorisation, "SMALL_PIVOT", 0.0)  # takes any pivot of the diagonal
    n = 60
    matrix = csr_array(1e-14 * np.eye(n) + np.diag(np.ones(n - 1), 1) + np.diag(np.ones(n - 1), -1))
    exact = np.random.default_rng(seed=4).normal(size=n)
    solution = factorisation._superlu_factors(matrix, np.ones(n))(matrix @ exact)
    np.testing.assert_allclose(solution, exact, atol=1e-10)


def test_the_order_for_symmetric_patterns_has_less_fill(monkeypatch):
    fills = []

    def watch(matrix, **options):
        factors = splu(matrix, **options)
        fills.append(factors.nnz)
        return factors

    monkeypatch.setattr(factorisation, "splu", watch)
    monkeypatch.setattr(factorisation, "new_pardiso", lambda: None)
    factorise(plane(60))
    monkeypatch.setattr(factorisation, "LARGEST_ASYMMETRY", -1.0)
    factorise(plane(60))
    assert len(fills) == 2
    assert fills[0] < 0.8 * fills[1]


def test_minimal_residuals_solve_a_nonsymmetric_system():
    rng = np.random.default_rng(2)
    matrix = np.eye(30) + 0.1 * rng.standard_normal((30, 30))
    b = rng.standard_normal(30)
    x, count = minimal_residual(lambda v: matrix @ v, b, np.copy, goal=1e-10, room=60)
    assert count <= 30
    np.testing.assert_allclose(matrix @ x, b, atol=1e-9)


def test_bodies_side_by_side_have_the_compliance_of_each_body():
    rng = np.random.default_rng(seed=3)
    springs = [csr_array(a @ a.T) for a in (rng.normal(size=(n, n)) for n in (4, 90))]
    faces = [rng.normal(size=(m, n)) for m, n in ((2, 4), (70, 90))]  # more than one block
    compliance = compliances(
        factorise(on_diagonal(springs)),
        on_diagonal(faces),
        np.array([0, 2, 72]),
    )
    for soft, K, F in zip(compliance, springs, faces, strict=True):
        np.testing.assert_allclose(soft, F @ np.linalg.solve(K.toarray(), F.T), rtol=1e-8)
        np.testing.assert_array_equal(soft, soft.T)


def test_a_condensed_body_answers_to_retained_displacements_and_loads_like_the_whole():
    rng = np.random.default_rng(seed=4)
    a = rng.normal(size=(7, 7))
    K, force = a @ a.T, rng.normal(size=7)
    condensed = condense_body(csr_array(K), np.array([5, 1]))
    edge = np.linalg.solve(condensed.blocks[0], condensed.reduce(force))
    np.testing.assert_allclose(condensed.expand(force, edge), np.linalg.solve(K, force), rtol=1e-8)
