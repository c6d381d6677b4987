"""Condensed stiffness of substructures: closed forms, kernel, order."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from multiscale.errors import CaseError
from multiscale.fe.mesh_file import box_mesh
from multiscale.laws.bulk import Elastic
from multiscale.macro import Assembly, Body, solve_static, tensegrity_grid
from multiscale.macro.substructures import (
    CutProblem,
    Links,
    Substructure,
    cut_assembly,
    cut_links,
    homogenise,
    split_grid,
)
from multiscale.macro.substructures.problem import expand_numbers
from multiscale.schema import HOMOGENISED
from tests.cut_methods import solve_schur


@pytest.fixture(scope="module")
def grid():
    return tensegrity_grid(12, prestress=2550.0 / 2.0)


@pytest.fixture(scope="module")
def problem(grid):
    return cut_links(grid, split_grid(grid, (3, 3)))


@pytest.fixture(scope="module")
def dataset(problem):
    return homogenise(problem, solve_schur(problem, 1.0))


def blocks(dataset, part):
    """Stiffness of a substructure, taut and slackened, and its rigid motions."""
    n = int((dataset.coarse_unknown[part] >= 0).sum())
    taut, slackened = dataset.stiffness.values[:, part, :n, :n]
    return taut, slackened, dataset.rigid_motion.values[part, :n]


def test_the_stiffness_is_symmetric_and_semidefinite_and_softer_after_slackening(dataset):
    HOMOGENISED.check(dataset)
    assert (dataset.slack_links > 0).any()
    for part in range(9):
        taut, slackened, _ = blocks(dataset, part)
        size = np.abs(taut).max()
        for matrix in (taut, slackened):
            np.testing.assert_array_equal(matrix, matrix.T)
            assert np.linalg.eigvalsh(matrix)[0] > -1e-10 * size
        change = np.linalg.eigvalsh(taut - slackened)  # Loewner order
        assert change[0] > -1e-10 * size
        assert (change[-1] > 1e-6 * size) == (dataset.slack_links[part] > 0)


def test_a_floating_tensegrity_moves_freely_as_a_rigid_body_and_in_its_mechanisms(problem, dataset):
    taut, _, rigid = blocks(dataset, 4)
    values = np.linalg.eigvalsh(taut)
    assert np.abs(taut @ rigid).max() < 1e-9 * values[-1]
    operator = problem.substructures[4].links.operator.toarray()
    free = operator.shape[1] - np.linalg.matrix_rank(operator)
    assert free == 7  # six rigid motions and a mechanism
    assert np.count_nonzero(values < 1e-9 * values[-1]) == free


def test_no_motion_takes_less_energy_than_the_condensed_motion(problem, dataset):
    taut, _, _ = blocks(dataset, 4)
    part = problem.substructures[4]
    K = (part.links.operator.T * part.links.stiffness) @ part.links.operator
    coarse = coarse_of(problem, 4)
    rng = np.random.default_rng(seed=5)
    for u in rng.standard_normal((20, part.n)):
        w = coarse @ u
        assert w @ taut @ w <= u @ K @ u
    # and it is reached: stationary energy with fixed w, by the saddle-point system
    w = rng.standard_normal(len(coarse))
    regular = K.toarray() + 1e-9 * K.diagonal().max() * np.eye(part.n)
    saddle = np.block([[regular, coarse.T], [coarse, np.zeros((len(coarse), len(coarse)))]])
    u = np.linalg.solve(saddle, np.append(np.zeros(part.n), w))[: part.n]
    assert u @ K @ u == pytest.approx(w @ taut @ w, rel=1e-6)


def coarse_of(problem, part):
    """Coarse motions of a substructure from its displacement."""
    from multiscale.macro.substructures.coarse import coarse_basis

    basis, first, rows = coarse_basis(problem), 0, 0.0
    for face in problem.interfaces:
        if part in face.sides:
            direct = basis[first : first + face.size].T @ face.trace[face.sides.index(part)]
            rows = rows + direct.toarray()
        first += face.size
    return rows[np.abs(rows).max(axis=1) > 0.0]


def springs(count, stiffness):
    """Three substructures in a row, each of some springs in series along x."""
    unknown = np.arange(3 * count + 1)
    parts = []
    for part in range(3):
        mine = unknown[part * count : (part + 1) * count + 1]
        rows = np.arange(count)
        entries = (np.append(-np.ones(count), np.ones(count)),)
        places = (np.append(rows, rows), np.append(rows, rows + 1))
        links = Links(
            csr_array((entries[0], places), shape=(count, count + 1)),
            np.full(count, stiffness),
            np.full(count, 1.0),
            np.zeros(count),
            np.full(count, np.inf),
            part * count + rows,
        )
        position = np.zeros((count + 1, 3))
        position[:, 0] = mine
        zeros = np.zeros(count + 1, dtype=int)
        nothing = csr_array((count + 1, count + 1))
        parts.append(Substructure(nothing, np.zeros((count + 1, 1)), mine, position, zeros, links))
    position = np.zeros((unknown.size, 3))
    position[:, 0] = unknown
    number = np.stack([unknown, np.full(unknown.size, -1), np.full(unknown.size, -1)], axis=1)
    return CutProblem(tuple(parts), position, expand_numbers(number))


def test_springs_in_series_are_combined_and_vanish_when_a_spring_is_slack():
    import xarray as xr

    slack = np.zeros(12)
    slack[5] = 1e-3
    result = xr.Dataset({"slack": ("link", slack)})
    dataset = homogenise(springs(4, 1e5), result)
    taut, slackened, _ = blocks(dataset, 1)
    expected = 1e5 / 4 * np.array([[1.0, -1.0], [-1.0, 1.0]])  # EA / L
    np.testing.assert_allclose(np.abs(taut), np.abs(expected), rtol=1e-9)
    assert np.linalg.eigvalsh(taut)[0] == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(slackened, 0.0, atol=1e-9 * 1e5)


def test_a_bar_of_elastic_body_has_its_axial_stiffness():
    length, edge, modulus = 4.0, 1.0, 210e9
    errors = []
    for fine in (2, 4):
        bar = Body(
            box_mesh((3 * length, edge, edge), (12 * fine, fine, fine)), Elastic(modulus, 0.0)
        )
        problem = cut_assembly(Assembly((bar,)), (3, 1))
        taut, _, _ = blocks(homogenise(problem), 1)
        part = problem.substructures[1]
        stretch = np.where(part.component == 0, part.position[:, 0] / length, 0.0)
        w = coarse_of(problem, 1) @ stretch
        errors.append(1.0 - w @ taut @ w / (modulus * edge**2 / length))
    assert 0.0 < errors[1] < errors[0] < 0.1  # softer: forces at nodes, not over the section
    assert errors[1] < 0.06


def test_results_of_another_structure_or_without_a_solution_are_refused(grid, problem):
    with pytest.raises(CaseError, match="slack"):
        homogenise(problem)
    with pytest.raises(CaseError, match="links of the problem"):
        homogenise(problem, solve_static(tensegrity_grid(4), 0.0))
    with pytest.raises(CaseError, match="did not converge"):
        homogenise(problem, solve_schur(problem, 1.0, max_iterations=1))
