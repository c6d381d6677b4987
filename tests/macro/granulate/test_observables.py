"""Neighbours, stress, coordination and solid fraction of grains with a known answer."""

import numpy as np
import pytest

from multiscale.macro import granulate
from multiscale.macro.granulate import ContactLaw, Grains, Model, PlaneWall, Solver, simulate_grains
from multiscale.macro.granulate.contacts import find_pairs
from multiscale.schema import MICRO_RESPONSE


def test_forces_and_branches_of_contacts_give_the_stress_under_a_loaded_lid():
    # four spheres in a square between two plates: the force of the lid over the area is the stress
    radius = 0.01
    centre = [(x, y, radius) for x in (0.012, 0.036) for y in (0.012, 0.036)]
    lid = PlaneWall((0, 0, 2.001 * radius), (0, 0, -1), mass=0.1, force=20.0)
    grains = Grains(np.array(centre), radius)
    model = Model(grains, (PlaneWall((0, 0, 0), (0, 0, 1)), lid), gravity=(0, 0, 0))
    result = simulate_grains(model, 0.05, 1e-3, solver=Solver(1e-9, 5000))
    _, force, branch = granulate.network(result)
    area = 0.048**2
    stress = -force.T @ branch / (area * 2.0 * radius)  # Love and Weber
    assert stress[2, 2] == pytest.approx(-20.0 / area, rel=1e-6)
    np.testing.assert_allclose(stress[:2, :2], 0.0, atol=1e-6 * 20.0 / area)


def test_unsupported_grains_are_taken_away_until_none_is_left():
    # a chain hangs off a tetrahedron: it unravels from its end
    ends = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3], [3, 4], [4, 5]])
    assert granulate.coordination(ends, 6, rattlers_below=2) == (3.0, 2)


def test_radii_share_the_volume_evenly():
    radii = granulate.draw_radii(200000, 1.0, 3.0, seed=1)
    share, _ = np.histogram(radii, bins=4, range=(1.0, 3.0), weights=radii**3)
    np.testing.assert_allclose(share / share.sum(), 0.25, atol=5e-3)


def test_neighbours_are_listed_in_a_cell_that_shrinks_with_grains_that_do_not_move_in_it():
    packing = granulate.compact(
        granulate.draw_radii(60, 0.01, 0.014), 1e3, ContactLaw(0.5), planar=True
    )
    assert packing.attrs["failure"] == ""
    assert packing.attrs["solid_fraction"] == pytest.approx(0.8, abs=0.05)
    assert packing.attrs["stress_error"] == pytest.approx(0.0, abs=1e-3)


def test_a_sheared_layer_is_a_response_of_a_joint():
    radii = np.full(16, 0.005)
    response = granulate.shear_response(
        radii, (0.06, 0.06), [1e3], [0.05], ContactLaw(0.3), n_realisations=1, n_steps=40
    )
    MICRO_RESPONSE.check(response)
    pressure, shear = -response["traction"].values[0, 0, 0], response["traction"].values[0, 0, 1]
    assert pressure == pytest.approx(1e3, rel=0.05)
    assert -1e-9 * pressure <= shear <= 0.3 * pressure * (1.0 + 1e-6)


def test_layers_that_are_sheared_differ_by_seeds_from_the_first_on():
    def gaps(n, seed):
        scene = (np.full(30, 0.005), (0.05, 0.05), [1e3], [0.05], ContactLaw(0.3))
        response = granulate.shear_response(*scene, n_realisations=n, n_steps=4, seed=seed)
        return response["mean_gap"].values[:, 0]

    first, second = gaps(2, seed=1)
    assert second == gaps(1, seed=2) != first


@pytest.mark.parametrize("ratio", [1.0, 3.0, 20.0])
@pytest.mark.parametrize(
    "period",
    [
        pytest.param((np.inf, np.inf, np.inf), id="open"),
        pytest.param((1.0, np.inf, 1.0), id="periodic"),
        pytest.param((0.45, 0.9, 0.7), id="few cells"),
    ],
)
def test_pairs_agree_with_all_distances(ratio, period):
    rng = np.random.default_rng(seed=4)
    radius = 0.1 * ratio ** -rng.uniform(size=300)
    position = rng.uniform(-0.7, 0.9, (300, 3))
    pairs = find_pairs(position, radius, 0.01, np.array(period))
    d = position[:, None] - position
    for a in np.flatnonzero(np.isfinite(period)):
        d[..., a] -= period[a] * np.round(d[..., a] / period[a])
    gap = np.linalg.norm(d, axis=-1) - radius[:, None] - radius
    expected = {tuple(pair) for pair in np.argwhere(np.triu(gap <= 0.01, 1))}
    results = {tuple(sorted(pair)) for pair in pairs.tolist()}
    assert results == expected
    assert len(pairs) == len(results), "a pair is listed twice"
