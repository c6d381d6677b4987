"""Every method on every scene, with its history; the answers are judged here once more."""

import numpy as np
import pytest

from multiscale.bench import bench
from multiscale.bench.measure import Runner
from multiscale.bench.nonsmooth import FRICTION_SCENES, LCP_SCENES, judged, nonsmooth, problem_of
from multiscale.convergence import Solution, Status
from multiscale.nonsmooth import solve_friction, solve_lcp
from multiscale.nonsmooth.friction import FRICTION_METHODS
from multiscale.nonsmooth.lcp import LCP_METHODS
from multiscale.plotting.work_precision_figures import plot_history
from multiscale.schema import WORK_PRECISION
from tests.support import slow


@pytest.fixture(scope="module")
def lines():
    return []


@pytest.fixture(scope="module")
def found(lines):
    return bench("nonsmooth", quick=True, report=lines.append)


def runs(found, **labels):
    """Which runs carry the labels."""
    return np.all([found[name].values == label for name, label in labels.items()], axis=0)


def test_every_method_is_measured_on_every_scene(found, lines):
    WORK_PRECISION.check(found)
    asked = len(LCP_SCENES) * (1 + len(LCP_METHODS)) + len(FRICTION_SCENES) * (
        1 + len(FRICTION_METHODS)
    )
    assert found.sizes["run"] == len(lines) == asked
    assert not found.attrs.get("cautions")
    assert "peak_memory" not in found
    assert np.all(found["wall_time"] > 0.0)
    assert np.all(found["unknowns"] > 0)


def test_auto_solves_every_scene_and_the_verifier_decides(found):
    auto = found.isel(run=runs(found, method="auto"))
    assert auto.sizes["run"] == len(LCP_SCENES) + len(FRICTION_SCENES)
    assert np.all(auto["converged"] == 1)
    np.testing.assert_array_equal(found["converged"], found["error"] <= found["tolerance"])
    assert np.any(found["converged"] == 0), "what fails must stay in the table"


@pytest.mark.parametrize("name", LCP_SCENES)
@pytest.mark.parametrize("size", ["quick", *slow("full")])
def test_the_complementarity_answers_have_no_natural_map_left(name, size):
    make, full, quick = LCP_SCENES[name]
    matrix, vector = make(quick if size == "quick" else full)
    z = solve_lcp(matrix, vector).unwrap()
    scale = 1.0 / np.sqrt(matrix.diagonal())
    error = np.abs(np.minimum(z / scale, scale * (matrix @ z + vector)))
    data = np.max(np.abs(scale * vector))
    # with impulses 1e6 times the balanced loads, rounding in M z counts
    rounding = 64.0 * np.finfo(float).eps * scale * (abs(matrix) @ z)
    assert np.all(error <= 1e-10 * data + rounding)
    assert np.max(error) <= 1e-7 * data


@pytest.mark.parametrize("name", FRICTION_SCENES)
@pytest.mark.parametrize("size", ["quick", *slow("full")])
def test_the_friction_answers_keep_coulombs_law(name, size):
    make, full, quick = FRICTION_SCENES[name]
    W, q, mu = make(quick if size == "quick" else full).condensed()
    impulse = solve_friction(W, q, mu).unwrap()
    velocity = (W @ impulse + q).reshape(-1, 3)
    r, speed = impulse.reshape(-1, 3), np.linalg.norm(velocity[:, 1:], axis=1)
    pushed = np.linalg.norm(r[:, 1:], axis=1)
    u, size_r = np.linalg.norm(q), np.linalg.norm(r)
    assert np.min(velocity[:, 0]) >= -1e-7 * u
    assert np.min(r[:, 0]) >= -1e-12 * size_r
    assert np.all(pushed <= mu * r[:, 0] + 1e-12 * size_r)
    # power of normal and friction forces: no energy is dissipated but by the largest friction
    assert np.max(np.abs(r[:, 0] * velocity[:, 0])) <= 1e-7 * u * size_r
    power = np.sum(r[:, 1:] * velocity[:, 1:], axis=1)
    np.testing.assert_allclose(power, -mu * r[:, 0] * speed, rtol=0.0, atol=1e-7 * u * size_r)


def test_histories_go_forward_in_time_and_contain_every_state_reached(found):
    for k in range(found.sizes["run"]):
        mine = found["history_run"].values == k
        seconds, error = found["history_seconds"].values[mine], found["history_error"].values[mine]
        assert np.all(np.diff(seconds) >= 0.0)
        assert seconds[-1] <= float(found["wall_time"][k])
        assert error.size == int(found["iterations"][k]) + 1
        assert error[-1] == pytest.approx(float(found["error"][k]), rel=1e-6)


def test_lines_fall_end_at_the_error_and_show_zero_at_the_bottom(found):
    from matplotlib.figure import Figure

    scene = str(found["scene"].values[0])
    ax = plot_history(found, scene=scene, ax=Figure().add_subplot())
    methods, of_scene = ax.get_legend_handles_labels()[1], runs(found, scene=scene)
    assert methods == list(found["method"].values[of_scene])
    for handle, run in zip(
        ax.get_legend_handles_labels()[0], np.flatnonzero(of_scene), strict=True
    ):
        time, error = handle.get_data()
        assert np.all(np.diff(error[:-1]) <= 0.0)
        assert time[-1] == found["wall_time"].values[run]
        assert error[-1] == max(found["error"].values[run], 1e-17)
    assert ax.get_xlabel() == "time since the start (s)"
    assert ax.get_ylabel() == "relative error (1)"


def test_a_method_that_lies_is_not_called_converged():
    def lie(**options):
        return Solution(np.zeros(60), Status.CONVERGED, (1.0, 0.0), (0.0, 1e-9))

    dishonest = problem_of("not symmetric", quick=True)._replace(solve=lie)
    row = judged(dishonest, Runner(nonsmooth, print), "auto", quick=True)
    assert row["converged"] == 0
    assert row["error"] == pytest.approx(1.0)


def test_problems_are_named_after_their_size():
    assert problem_of("wedge that jams", quick=False).scene == "friction, wedge that jams, n = 24"
