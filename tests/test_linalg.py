"""Factorisation and static condensation."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from multiscale.errors import MultiscaleError
from multiscale.linalg import factorise


def chain(n, contrast=1.0):
    """Stiffness of n masses in a row on springs, the first one held."""
    k = np.where(np.arange(n) % 2, contrast, 1.0)
    matrix = np.diag(k + np.append(k[1:], 0.0))
    return matrix - np.diag(k[1:], 1) - np.diag(k[1:], -1)


FORM = [pytest.param(csr_array, id="sparse"), pytest.param(np.asarray, id="dense")]


@pytest.mark.parametrize("form", FORM)
@pytest.mark.parametrize("columns", [None, 3])
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
    matrix[5, 5] -= 1.0  # the second chain loses its support
    with pytest.raises(MultiscaleError, match=r"the chain is singular: unknown [5-8] can move"):
        factorise(form(unit * matrix), name="the chain")


@pytest.mark.parametrize("form", FORM)
def test_an_unknown_without_stiffness_is_named(form):
    matrix = np.diag([1.0, 1.0, 0.0, 1.0])
    with pytest.raises(MultiscaleError, match="unknown 2 can move without force"):
        factorise(form(matrix))


@pytest.mark.parametrize("form", FORM)
def test_contrast_alone_is_not_taken_for_singularity(form):
    matrix = np.diag([1e-20, 1.0, 1e20])
    np.testing.assert_allclose(factorise(form(matrix))(np.ones(3)), [1e20, 1.0, 1e-20])


def test_entries_that_are_not_finite_are_refused():
    with pytest.raises(MultiscaleError, match="NaN or infinite"):
        factorise(np.array([[np.nan]]))


def test_a_matrix_that_is_not_square_is_refused():
    with pytest.raises(ValueError, match=r"must be square, got shape \(2, 3\)"):
        factorise(np.zeros((2, 3)))
