"""Plates equivalent to links: closed forms of truss plates, elements, slack cells, convergence."""

import numpy as np
import pytest

from multiscale.laws.link import Bar, Cable
from multiscale.macro import LinkSystem, solve_static, tensegrity_grid
from multiscale.macro.continuum.plate import plate_elements
from multiscale.macro.links import (
    EquivalentPlate,
    compare_with_links,
    natural_frequencies,
    plate_cell,
    solve_plate,
)

A, H = 0.8, 0.5  # edge and height of a truss plate, m
CHORD, BRACE, DIAGONAL, POST = 3e6, 1e6, 5e5, 2e6  # axial rigidities, N


def truss(*, left_out=(), law=Bar):
    """A cell of two square layers with crossed braces, posts, and a diagonal along x and y."""
    plan = np.array([[0.0, 0.0], [A, 0.0], [0.0, A], [A, A]])
    position = np.vstack([np.column_stack([plan, np.full(4, z)]) for z in (-0.5 * H, 0.5 * H)])
    parts = {
        "chord": [(0, 1), (0, 2), (4, 5), (4, 6)],
        "brace": [(0, 3), (1, 2), (4, 7), (5, 6)],
        "post": [(0, 4)],
        "diagonal": [(0, 5), (0, 6)],
    }
    rigidity = {"chord": CHORD, "brace": BRACE, "diagonal": DIAGONAL, "post": POST}
    taken = [name for name in parts if name not in left_out]
    ends = np.array([pair for name in taken for pair in parts[name]])
    used = np.unique(ends)
    number = np.full(8, -1)
    number[used] = np.arange(used.size)
    return LinkSystem(
        position[used],
        number[ends],
        tuple(law(rigidity[name]) for name in taken),
        np.repeat(np.arange(len(taken)), [len(parts[name]) for name in taken]),
        np.zeros((used.size, 3), dtype=bool),
        np.zeros((used.size, 3)),
    )


def test_a_truss_plate_has_its_closed_forms():
    """Chords and braces; diagonals and the post in series, about which the sections do not turn."""
    layers = np.zeros((3, 3))
    layers[:2, :2] = np.sqrt(2.0) * BRACE / A + 2.0 * CHORD / A * np.eye(2)
    layers[2, 2] = np.sqrt(2.0) * BRACE / A
    expected = np.zeros((8, 8))
    expected[:3, :3], expected[3:6, 3:6] = layers, layers * (0.5 * H) ** 2
    # elongation of the diagonals by extension and transverse shear, with the post in series
    length = np.hypot(A, H)
    k = DIAGONAL / length**3
    stretch = np.zeros((2, 8))
    stretch[[0, 1], [0, 1]], stretch[[0, 1], [6, 7]] = A**2, H * A
    series = k * (np.eye(2) - k * H**2 / (2.0 * k * H**2 + POST / H))
    expected += stretch.T @ series @ stretch / A**2
    found = plate_cell(truss(), (A, A)).stiffness
    np.testing.assert_allclose(found, expected, atol=1e-10 * expected.max())
    # with no transverse force the diagonals carry nothing
    free = found[:6, :6] - found[:6, 6:] @ np.linalg.solve(found[6:, 6:], found[6:, :6])
    assert free[0, 0] == pytest.approx(layers[0, 0], rel=1e-10)
    assert free[3, 3] == pytest.approx(layers[0, 0] * (0.5 * H) ** 2, rel=1e-10)


def test_a_cell_of_several_periods_has_the_stiffness_of_a_single_period():
    one = plate_cell(tensegrity_grid(1), (1.0, 1.0)).stiffness
    four = plate_cell(tensegrity_grid(2), (2.0, 2.0)).stiffness
    np.testing.assert_allclose(four[:6, :6], one[:6, :6], atol=1e-10 * one.max())


def test_slack_cells_have_resultants_of_an_energy_and_their_tangent():
    cell = plate_cell(tensegrity_grid(1, prestress=2550.0), (1.0, 1.0))
    rng = np.random.default_rng(seed=3)
    strain = rng.normal(scale=4e-4, size=(40, 8))
    response = cell.respond(strain)
    assert 0.02 < response.slack.mean() < 0.5
    np.testing.assert_allclose(response.tangent, response.tangent.swapaxes(1, 2), rtol=1e-9, atol=1)
    for j in range(8):
        step = 1e-9 * np.eye(8)[j]
        high, low = (cell.respond(strain + way * step) for way in (1.0, -1.0))
        same = np.all((high.slack == response.slack) & (low.slack == response.slack), axis=1)
        assert same.mean() > 0.9
        slope = (high.resultant - low.resultant)[same] / 2e-9
        np.testing.assert_allclose(slope, response.tangent[same, j], atol=2e-5 * 3e7)
    taut = cell.respond(1e-3 * strain)
    assert not taut.slack.any()
    np.testing.assert_allclose(taut.resultant, 1e-3 * strain @ cell.stiffness, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize(("count", "error"), [(2, 2e-3), (4, 2e-4), (8, 2e-5)])
def test_elements_bend_a_strip_between_hinges(count, error):
    """Middle of a strip under an even load: 5 q L^4 / 384 D + q L^2 / 8 S."""
    length, D, S, load = 10.0, 2e6, 1e7, 3.0
    C = np.diag([1e8, 1e8, 1e8, D, D, D, S, S])
    plate = plate_elements((length, 1.0), (count, 1), np.array([[0.5 * length], [0.5]]))
    x = plate.position[0]
    K = plate.assemble(np.broadcast_to(C, (plate.weight.size, 8, 8))).toarray()
    # the load is the divergence of the transverse force q (L / 2 - x), interpolated by the nodes
    force = np.zeros((x.size, 5))
    force[:, 0] = load * (0.5 * length * x - 0.5 * x**2)
    even = np.zeros((plate.weight.size, 8))
    even[:, 6] = plate.strain(force.ravel())[:, 0]
    f = plate.gather(even).reshape(-1, 5)
    f[:, 3:] = 0.0
    fixed = np.zeros((x.size, 5), dtype=bool)
    fixed[(x < 1e-9) | (x > length - 1e-9), :3] = True
    free = ~fixed.ravel()
    u = np.zeros(plate.n)
    u[free] = np.linalg.solve(K[np.ix_(free, free)], f.ravel()[free])
    deflection = float((plate.section_motion(np.zeros(1))[2] @ u)[0])
    exact = load * length**4 * 5.0 / 384.0 / D + load * length**2 / 8.0 / S
    assert deflection == pytest.approx(exact, rel=error)


@pytest.fixture(scope="module")
def grids():
    """Plates and their grids, taut and with slack cables, by modules across."""
    found = {}
    for n in (4, 8, 16):
        options = {"prestress": 2550.0 * (n / 16.0) ** 2}
        grid = tensegrity_grid(n, **options)
        cell = plate_cell(tensegrity_grid(1, **options), (1.0, 1.0))
        plate = EquivalentPlate(grid, cell, (n, n))
        result = solve_plate(plate, [0.1, 1.0], mass=2.0)
        links = natural_frequencies(grid, solve_static(grid, [0.1, 1.0]), 2.0)
        found[n] = compare_with_links(result, links)
    return found


def test_a_grid_tends_to_its_plate(grids):
    error = np.array([found["plate_error"].values for found in grids.values()])
    assert np.all(error[:-1, 0] / error[1:, 0] > 1.9)  # taut, of first order at least
    assert error[-1, 0] < 0.035
    assert np.all(np.diff(error[:, 1]) < 0.0)
    assert error[-1, 1] < 0.06  # every eighth cable is slack
    ratio = np.array(
        [found["first_frequency"] / found["links_frequency"] for found in grids.values()]
    )
    np.testing.assert_allclose(ratio[-1], 1.0, atol=0.03)
    assert np.all(np.abs(ratio[-1] - 1.0) < 0.3 * np.abs(ratio[0] - 1.0))
    # membrane compression between the fixed edges: without its stiffness the ratio is 1.43
    assert grids[16]["first_frequency"][1] < 0.5 * grids[16]["first_frequency"][0]


def test_a_plate_is_solved_to_its_rounding():
    cell = plate_cell(tensegrity_grid(1), (1.0, 1.0))
    result = solve_plate(EquivalentPlate(tensegrity_grid(8), cell, (8, 8)), [1.0], tolerance=1e-16)
    assert result["converged"].item() == 1
    assert 1e-16 < result["residual"].item() < 1e-9


def test_the_plate_counts_slack_cables(grids):
    found = grids[16]
    assert found["slack_links"].values[0] == 0.0
    assert found["slack_links"].values[1] == pytest.approx(434, rel=0.1)


@pytest.mark.parametrize(
    ("shape", "lifted"), [((1, 5), False), ((5, 1), False), ((1, 5), True), ((2, 3), True)]
)
def test_only_the_edges_with_fixed_nodes_are_fixed(shape, lifted):
    """Corners on two edges, and edges without a node at z = 0, fix no other edge."""
    grid, cell = tensegrity_grid(*shape), plate_cell(tensegrity_grid(1), (1.0, 1.0))
    if lifted:
        free_edge = np.isin(grid.position[:, 1], (0.0, float(shape[1]))) & ~grid.fixed.all(axis=1)
        grid.position[free_edge, 2] += 0.1
    plate = EquivalentPlate(grid, cell, shape)
    fixed = np.setdiff1d(np.arange(plate.plate.n), plate.free) // 5
    x = plate.plate.position[0]
    np.testing.assert_array_equal(
        np.unique(fixed), np.flatnonzero((x < 1e-9) | (x > shape[0] - 1e-9))
    )


def tiled(n, law):
    """A square plate of n by n cells of a truss on all of its edges, with a load downwards."""
    cell = truss(law=law)
    shift = A * np.stack(np.meshgrid(range(n), range(n), [0.0], indexing="ij"), axis=-1)
    place = (cell.position + np.array([0.0, 0.0, 0.5 * H]) + shift.reshape(-1, 1, 3)).reshape(-1, 3)
    _, first, node = np.unique(
        np.round(place / 1e-6).astype(int), axis=0, return_index=True, return_inverse=True
    )
    position, ends = place[first], node.reshape(n * n, -1)[:, cell.ends].reshape(-1, 2)
    edge = np.any((position[:, :2] < 1e-9) | (position[:, :2] > n * A - 1e-9), axis=1)
    fixed = np.repeat((edge & (position[:, 2] < 1e-9))[:, None], 3, axis=1)
    load = np.tile([0.0, 0.0, -10.0], (len(position), 1))
    return LinkSystem(position, ends, cell.laws, np.tile(cell.kind, n * n), fixed, load)


def test_a_load_that_no_cable_can_carry_is_refused():
    """A sheet of cables hangs like a net at large displacements, and not at small displacements."""
    cell = plate_cell(truss(law=Cable), (A, A))
    result = solve_plate(EquivalentPlate(tiled(3, Cable), cell, (3, 3)), [0.0, 1.0])
    np.testing.assert_array_equal(result["converged"], [1, 0])
    assert np.isnan(result["displacement"].values[1]).all()
    assert result.attrs["failure"].startswith("load factor 1: ")
