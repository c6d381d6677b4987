"""Factors and smallest eigenvalue of a tangent, with and without PARDISO."""

import numpy as np
import pytest

from multiscale.errors import MultiscaleError
from multiscale.macro import tensegrity_grid
from multiscale.macro.discrete.compatibility import equations
from multiscale.macro.discrete.link_stability import smallest_eigenvalue
from multiscale.macro.discrete.link_tangent import prepare_tangent
from multiscale.numerics import cholesky


@pytest.fixture(params=["pardiso", "superlu"])
def grid(request, monkeypatch):
    """Tangent of a grid, its entries and its matrix, by either library."""
    if request.param == "superlu":
        monkeypatch.setattr(cholesky, "new_pardiso", lambda kind: None)
    elif cholesky.new_pardiso(cholesky.POSITIVE_DEFINITE) is None:
        pytest.skip("needs pypardiso")
    system = tensegrity_grid(3)
    model = equations(system)
    tangent = prepare_tangent(system, model)
    entries = tangent.entries(model.stiffness)
    return tangent, entries, tangent.matrix(entries).toarray()


def test_factors_solve_and_serve_again(grid):
    tangent, entries, matrix = grid
    exact = np.random.default_rng(seed=0).standard_normal((len(matrix), 2))
    for factor in (1.0, 3.0):
        solve = tangent.factorise(factor * entries)
        np.testing.assert_allclose(solve(factor * matrix @ exact), exact, rtol=1e-8)


def test_the_sign_of_a_pivot_shows_what_is_not_definite(grid):
    tangent, entries, _ = grid
    tangent.factorise(entries, signs=True)
    for factor in (-1.0, 0.0):
        with pytest.raises(MultiscaleError, match=r"singular|not positive definite"):
            tangent.factorise(factor * entries, signs=True)


def test_the_smallest_eigenvalue_is_that_of_the_dense_matrix_also_if_negative(grid):
    tangent, entries, matrix = grid
    assert len(matrix) > 20
    shifted = entries.copy()
    shifted[tangent.diagonal] -= 1e-3 * entries.max()
    for some, shift in ((entries, 0.0), (shifted, 1e-3 * entries.max())):
        expected = np.linalg.eigvalsh(matrix)[0] - shift
        assert smallest_eigenvalue(tangent, some) == pytest.approx(expected, rel=1e-6)
