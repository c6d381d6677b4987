"""Structures of links: data, refusals, builders, tables, self-stress, factors of the tangent."""

from dataclasses import replace

import meshio
import numpy as np
import pytest

from multiscale.errors import CaseError, MultiscaleError
from multiscale.io.mesh_groups import named_mesh
from multiscale.laws.link import Bar, Beam, Cable
from multiscale.macro import (
    LinkSystem,
    cable_net,
    self_stress,
    solve_static,
    system_from_mesh,
    system_from_table,
    tensegrity_grid,
)
from multiscale.macro.links.link_equations import compatibility, equations
from multiscale.macro.links.mechanisms import smallest_eigenvalue
from multiscale.numerics import factorisation
from multiscale.schema import MACRO_RESULT
from tests.link_structures import free_module, structure, truss


def pendulum(**changes):
    """Two cables that meet in one free node."""
    parts = {
        "position": np.array([[-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 0.0, 0.0]]),
        "ends": np.array([[0, 2], [1, 2]]),
        "laws": (Cable(1e6),),
        "kind": np.zeros(2, dtype=int),
        "fixed": np.array([[True] * 3, [True] * 3, [False, True, False]]),
        "load": np.array([[0.0] * 3, [0.0] * 3, [0.0, 0.0, -1e3]]),
    }
    return LinkSystem(**(parts | changes))


# --- compatibility ---------------------------------------------------------------------------


def test_compatibility_is_the_derivative_of_the_lengths():
    grid = tensegrity_grid(2, 3)
    move = np.random.default_rng(seed=1).standard_normal(grid.position.shape)
    move[grid.fixed] = 0.0
    step = 1e-6
    there, back = (
        replace(grid, position=grid.position + sign * step * move, balanced=False).length
        for sign in (1.0, -1.0)
    )
    elongation = compatibility(grid) @ move[~grid.fixed]
    np.testing.assert_allclose(elongation, (there - back) / (2.0 * step), atol=1e-8)


def test_no_beam_deforms_in_a_rigid_motion():
    rng = np.random.default_rng(seed=2)
    position = rng.standard_normal((4, 3))
    laws = (Beam(1.0, 1.0, 1.0, 1.0, up=(0.3, -1.0, 0.2)), Bar(1.0))
    ends = [[0, 1], [1, 2], [2, 3], [3, 0]]
    frame = structure(position, ends, *laws, kind=[0, 0, 0, 1], held={})
    turn, shift = rng.standard_normal(3), rng.standard_normal(3)
    motion = np.hstack([shift + np.cross(turn, position), np.tile(turn, (4, 1))])
    unit = np.repeat([1.0, frame.length.mean()], 3)
    deformation = compatibility(frame) @ (motion * unit).ravel()
    assert deformation.shape == (4 + 3 * 5,)
    np.testing.assert_allclose(deformation, 0.0, atol=1e-14)


# --- bad input -------------------------------------------------------------------------------


def test_an_unsupported_part_is_named():
    two = pendulum(
        position=np.vstack([pendulum().position, [[5.0, 0, 0], [6.0, 0, 0]]]),
        ends=np.array([[0, 2], [1, 2], [3, 4]]),
        kind=np.zeros(3, dtype=int),
        fixed=np.vstack([pendulum().fixed, np.zeros((2, 3), dtype=bool)]),
        load=np.zeros((5, 3)),
    )
    with pytest.raises(CaseError, match=r"the component with node 3 \(2 nodes\) is not supported"):
        solve_static(two)


# --- builders --------------------------------------------------------------------------------


def test_grid_counts_equal_the_source():
    grid = tensegrity_grid(16)
    assert (grid.n_nodes, np.sum(grid.kind == 0), np.sum(grid.kind == 1)) == (833, 3072, 1024)
    assert np.count_nonzero(grid.fixed.all(axis=1)) == 34


@pytest.mark.parametrize("shape", [{}, {"size": 3.0, "height": 0.4}])
def test_the_prestress_of_a_grid_of_any_shape_holds_itself_at_every_node(shape):
    grid = replace(tensegrity_grid(3, 2, **shape), fixed=np.zeros((29, 3), dtype=bool))
    unbalanced = compatibility(grid).T @ grid.prestress
    assert np.abs(unbalanced).max() < 1e-12 * np.abs(grid.prestress).max()


def test_the_net_is_balanced_and_its_edge_holds_it():
    net = cable_net(6, 4, rise=2.0)
    assert np.abs(compatibility(net).T @ net.prestress).max() < 1e-9
    assert np.all(net.prestress > 0.0)


def test_the_truss_carries_the_forces_of_the_method_of_sections():
    # 8 panels of 1 m, 1 kN per inner node: reactions 3.5 kN, moment 8 kN m at mid-span
    result = solve_static(truss(8))
    lower, upper = result.tension.values[:8], result.tension.values[8:14]
    np.testing.assert_allclose(lower, [3500, 3500, 6000, 7500, 7500, 6000, 3500, 3500])
    np.testing.assert_allclose(upper, [-6000, -7500, -8000, -8000, -7500, -6000])


def test_a_table_and_a_line_mesh_build_the_same_structure():
    laws = {"rope": Cable(1e6), "rod": Bar(2e6)}
    points = np.array([[0.0, 0, 0], [2.0, 0, 0], [2.0, 2, 0], [0.0, 2, 0], [1.0, 1, 1.0]])
    nodes = {"x": points[:, 0], "y": points[:, 1], "z": points[:, 2]}
    nodes |= {f"fix_{axis}": [1, 1, 1, 1, 0] for axis in "xyz"}
    nodes["load_z"] = [0.0, 0.0, 0.0, 0.0, 70.0]
    links = {
        "first": [0, 1, 2, 3],
        "second": [4, 4, 4, 4],
        "law": ["rope", "rope", "rope", "rod"],
    }
    table = system_from_table(nodes, links, laws)
    mesh = meshio.Mesh(
        points,
        [("line", [[0, 4], [1, 4], [2, 4], [3, 4]])],
        cell_sets={"rope": [np.array([0, 1, 2])], "rod": [np.array([3])]},
        point_sets={"base": [0, 1, 2, 3]},
    )
    lines = system_from_mesh(named_mesh(mesh), laws, supports=("base",), load=(0.0, 0.0, 70.0))
    first, other = solve_static(table), solve_static(lines)
    assert first.converged == 1
    np.testing.assert_allclose(first.tension, other.tension)
    np.testing.assert_allclose(first.displacement, other.displacement)


def test_physical_groups_of_gmsh_name_laws_and_supports():
    mesh = named_mesh(
        meshio.Mesh(
            np.array([[0.0, 0, 1], [0.0, 0, 0]]),
            [("vertex", [[0]]), ("line", [[0, 1]])],
            cell_data={"gmsh:physical": [np.array([7]), np.array([8])]},
            field_data={"hook": np.array([7, 0]), "rope": np.array([8, 1])},
        )
    )
    rope = system_from_mesh(mesh, {"rope": Cable(1e5)}, supports=("hook",))
    np.testing.assert_array_equal(rope.fixed.all(axis=1), [True, False])
    with pytest.raises(CaseError, match="no lines in a set named 'bar'"):
        system_from_mesh(mesh, {"bar": Bar(1.0)}, supports=("hook",))
    with pytest.raises(CaseError, match="no points in a set named 'wall'"):
        system_from_mesh(mesh, {"rope": Cable(1e5)}, supports=("wall",))


NODES = {"x": [0.0, 1.0], "y": [0.0, 0.0], "z": [0.0, 0.0]}
LINKS = {"first": [0], "second": [1], "law": ["rope"]}
SHIFTED = {"X": [0.0, 1.0], "y": [0.0, 0.0], "z": [0.0, 0.0], "load": [0.0, 1.0]}


# --- modes ----------------------------------------------------------------------------------


def test_a_module_has_one_self_stress_and_three_mechanisms():
    module = free_module()
    stress = self_stress(module)
    assert stress.shape == (1, 16)
    np.testing.assert_allclose(stress[0] / stress[0, 4], module.prestress / 2550.0)
    free = 24 - np.linalg.matrix_rank(compatibility(module).toarray())
    assert free == 6 + 3  # rigid motions, and mechanisms


def test_results_follow_the_schema_with_and_without_steps():
    steps = solve_static(tensegrity_grid(2), [0.0, 1.0])
    MACRO_RESULT.check(steps)
    assert steps.tension.dims == ("step", "link")
    assert list(steps.component.values) == ["x", "y", "z"]
    result = solve_static(tensegrity_grid(2))
    assert result.tension.dims == result.slack.dims == ("link",)
    assert result.displacement.dims == ("node", "component")
    np.testing.assert_allclose(result.tension, steps.tension.sel(step=1), rtol=1e-9)


# --- tangent ---------------------------------------------------------------------------------


@pytest.fixture(params=["pardiso", "superlu"])
def factors(request, monkeypatch):
    """Tangent of a grid, its entries and its matrix, by either library."""
    if request.param == "superlu":
        monkeypatch.setattr(factorisation, "new_pardiso", lambda kind: None)
    elif factorisation.new_pardiso(factorisation.POSITIVE_DEFINITE) is None:
        pytest.skip("needs pypardiso")
    system = tensegrity_grid(3)
    model = equations(system)
    tangent = model.tangent
    entries = tangent.entries(model.stiffness)
    return tangent, entries, tangent.matrix(entries).toarray()


def test_factors_solve_and_serve_again(factors):
    tangent, entries, matrix = factors
    exact = np.random.default_rng(seed=0).standard_normal((len(matrix), 2))
    for factor in (1.0, 3.0):
        solve = tangent.factorise(factor * entries)
        np.testing.assert_allclose(solve(factor * matrix @ exact), exact, rtol=1e-8)


def test_the_sign_of_a_pivot_shows_an_indefinite_matrix(factors):
    tangent, entries, _ = factors
    tangent.factorise(entries, signs=True)
    for factor in (-1.0, 0.0):
        with pytest.raises(MultiscaleError, match=r"singular|not positive definite"):
            tangent.factorise(factor * entries, signs=True)


def test_the_smallest_eigenvalue_agrees_with_the_dense_matrix_also_if_negative(factors):
    tangent, entries, matrix = factors
    assert len(matrix) > 20
    shifted = entries.copy()
    shifted[tangent.diagonal] -= 1e-3 * entries.max()
    for some, shift in ((entries, 0.0), (shifted, 1e-3 * entries.max())):
        expected = np.linalg.eigvalsh(matrix)[0] - shift
        assert smallest_eigenvalue(tangent, some) == pytest.approx(expected, rel=1e-6)
