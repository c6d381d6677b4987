"""Figures of structures: the data in the axes equal the dataset."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from multiscale.laws.link import Cable
from multiscale.macro import (
    simulate,
    solve_past_limit,
    solve_static,
    system_from_table,
    tensegrity_grid,
)
from multiscale.plotting import (
    plot_deformed_links,
    plot_energies,
    plot_past_limit,
    plot_sorted_tensions,
)
from tests.macro.test_limit_load import dome


@pytest.fixture(scope="module")
def result():
    return solve_static(tensegrity_grid(2), [0.0, 1.0, 40.0])


def test_sorted_tensions_belong_to_the_cables_in_kilonewton(result):
    ax = plot_sorted_tensions(result, ax=Figure().add_subplot())
    assert len(ax.lines) == 3
    for k, line in enumerate(ax.lines):
        cables = result["tension"].values[k, result["law"].values == "cable"]
        np.testing.assert_allclose(line.get_ydata(), 1e-3 * np.sort(cables)[::-1])
        assert np.all(np.diff(line.get_ydata()) <= 0.0)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["α = 0", "α = 1", "α = 40"]
    assert "kN" in ax.get_ylabel()


def test_steps_that_failed_are_left_out(result):
    failed = result.copy(deep=True)
    failed["converged"][1] = 0
    failed["tension"][1] = np.nan
    ax = plot_sorted_tensions(failed, ax=Figure().add_subplot())
    assert [line.get_label() for line in ax.lines] == ["α = 0", "α = 40"]


def test_a_path_is_dashed_where_it_is_not_stable():
    path = solve_past_limit(dome(3, 0.2), 6.0)
    ax = plot_past_limit(path, ax=Figure().add_subplot())
    stable, unstable, limit = ax.lines
    depth, below = -1e3 * path.displacement.values[:, -1, 2], path.stability_eigenvalue.values < 0.0
    np.testing.assert_allclose(stable.get_xdata(), depth)
    np.testing.assert_array_equal(np.isnan(stable.get_ydata()), below)
    np.testing.assert_allclose(unstable.get_ydata()[below], path.load_factor.values[below])
    assert limit.get_ydata()[0] == pytest.approx(float(path.critical_factor))
    assert (limit.get_label(), limit.get_xdata()[0] > 0.0) == ("limit point", True)


def test_the_deformed_structure_has_its_links_in_colour_and_the_slack_cables_dashed(result):
    ax = plot_deformed_links(result, step=2, scale=3.0, ax=Figure().add_subplot(projection="3d"))
    taut, slack = ax.collections
    part = result.isel(step=2)
    loose = part["slack"].values > 0.0
    assert 0 < loose.sum() < loose.size
    moved = (part["position"] + 3.0 * part["displacement"]).values[part["ends"].values]
    np.testing.assert_allclose(taut._segments3d, moved[~loose])
    np.testing.assert_allclose(slack._segments3d, moved[loose])
    np.testing.assert_allclose(taut.get_array(), 1e-3 * part["tension"].values[~loose])
    assert slack.get_linestyle()[0][1] is not None
    assert taut.get_clim()[0] == -taut.get_clim()[1]
    assert "α = 40" in ax.get_title()


def test_a_plane_structure_is_drawn_in_true_proportions_without_a_warning():
    """The lamp of two ropes in the plane y = 0."""
    nodes = {"x": [-1.0, 0.0, 1.0], "y": [0.0] * 3, "z": [0.0, -0.5, 0.0]}
    nodes |= {f"fix_{axis}": [1.0, 0.0, 1.0] for axis in "xz"} | {"fix_y": [1.0] * 3}
    nodes |= {"load_z": [0.0, -100.0, 0.0]}
    links = {"first": [0, 1], "second": [1, 2], "law": ["rope", "rope"]}
    lamp = system_from_table(nodes, links, {"rope": Cable(2e5)})
    ax = plot_deformed_links(solve_static(lamp, [1.0]), ax=Figure().add_subplot(projection="3d"))
    edges = np.ptp([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()], axis=1)
    np.testing.assert_allclose(edges / edges[0], ax._box_aspect / ax._box_aspect[0])


def test_energies_belong_to_the_motion_and_their_sum_is_conserved():
    grid = tensegrity_grid(2)
    begin = solve_static(grid, 1.0)["displacement"].values
    motion = simulate(
        grid,
        np.linspace(0.0, 0.05, 21),
        2.0,
        load_factor=lambda time: 0.5,
        start=(begin, np.zeros_like(begin)),
    )
    ax = plot_energies(motion, ax=Figure().add_subplot())
    lines = {line.get_label(): line.get_ydata() for line in ax.lines}
    np.testing.assert_allclose(lines["kinetic energy"], motion["kinetic_energy"])
    np.testing.assert_allclose(lines["elastic energy"], motion["elastic_energy"])
    np.testing.assert_allclose(lines["work, negative"], -motion["work"])
    np.testing.assert_allclose(lines["sum"], lines["sum"][0], rtol=1e-9)
    np.testing.assert_allclose(ax.lines[0].get_xdata(), motion["time"])
