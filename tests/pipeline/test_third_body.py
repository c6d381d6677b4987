"""Grains between plates as the law of an interface: from their response to joints that slide."""

import numpy as np
import pytest

from multiscale.errors import CaseError, MultiscaleError
from multiscale.io import save_law, write_dataset
from multiscale.macro import granulate
from multiscale.pipeline import run, run_macro
from multiscale.pipeline.plans.case_knobs import grain_knobs
from multiscale.pipeline.stage import Job
from multiscale.pipeline.stages.third_body import (
    THIRD_BODY_CELLS,
    THIRD_BODY_LAW,
    WIDER_CELLS,
    size_errors,
)
from multiscale.pipeline.verification import verify_run
from multiscale.schema import MICRO_RESPONSE
from multiscale.upscaling import at_speed, law_from_dataset
from multiscale.upscaling.branches import sliding_friction_at, take_sliding_friction
from tests.support import TWO_BLOCKS, case_of, joints_of

GRAINS = """title = "Grains"
[grains]
number = 100
radius = ["4 mm", "6 mm"]
friction = 0.5
compliance = 0.05
[third_body]
size = ["5 cm", "5 cm"]
pressures = ["0.5 kPa", "1 kPa", "2 kPa", "4 kPa", "8 kPa", "16 kPa"]
speed = "0.5 m/s"
realisations = 6
"""
JOINT = TWO_BLOCKS[TWO_BLOCKS.index("[structure]") :]
SPEED, DIAMETER, DENSITY = 0.5, 0.01, 2600.0
HEIGHT, DILATION = 0.03, 0.2  # m, and relative growth of the height with the inertial number


def exact(pressure, speed):
    """Height, m, and friction over the inertial number of a layer of this height."""
    number = speed / HEIGHT * DIAMETER * np.sqrt(DENSITY / pressure)
    return HEIGHT * (1.0 + DILATION * number), 0.2 + 0.3 * number / (number + 0.3)


def synthetic(pressure, noise=0.0, seed=2):
    """Response of six layers that follow the exact functions, each with its scatter."""
    height, friction = exact(pressure, SPEED)
    rng = np.random.default_rng(seed)
    direct = 1.0 + noise * rng.standard_normal((2, 6, 1))
    gap, mu = height * direct[0], friction * direct[1]
    traction = np.stack([-pressure + 0.0 * mu, mu * pressure, 0.0 * mu], axis=-1)
    values = {
        "displacement_jump": np.zeros_like(traction),
        "traction": traction,
        "mean_gap": gap,
        "contact_fraction": np.full(gap.shape, 0.3),
        "nominal_pressure": pressure,
        "sliding_speed": np.full(pressure.size, SPEED),
        "branch": np.zeros(pressure.size, int),
        "converged": np.ones(gap.shape, int),
        "active_set_iterations": np.zeros(gap.shape, int),
        "linear_iterations": np.zeros(gap.shape, int),
        "wall_time": np.zeros(gap.shape),
    }
    return MICRO_RESPONSE.build(values, grain_density=DENSITY, grain_diameter=DIAMETER, cautions="")


@pytest.fixture(scope="module")
def law(tmp_path_factory):
    case = case_of(tmp_path_factory.mktemp("grains"), GRAINS)
    return THIRD_BODY_LAW.run(
        case, {"micro_response": synthetic(np.geomspace(5e2, 3e4, 8), 1e-3)}, None
    )


def test_layers_of_all_realisations_have_the_mean_volume_of_many_grains(tmp_path):
    case = case_of(tmp_path, GRAINS)
    cells = [case.third_body.cell(case.grains, k)[0] for k in range(6)]
    many = granulate.draw_radii(400000, *case.grains.radius, seed=1)
    for radii in cells:
        assert np.mean(radii**3) == pytest.approx(np.mean(many**3), rel=3e-3)
    assert not np.allclose(cells[0], cells[1])


def test_pressures_without_steady_shear_are_named_and_one_layer_has_no_scatter(tmp_path):
    case = case_of(tmp_path, GRAINS)
    response = synthetic(np.geomspace(5e2, 3e4, 8), 1e-3)
    response["converged"][:, 0] = 0
    response["converged"][1:, -1] = 0
    law = THIRD_BODY_LAW.run(case, {"micro_response": response}, None)
    assert "no layer slides steadily at 500 Pa, where the law" in law.attrs["cautions"]
    taken = take_sliding_friction(at_speed(law, SPEED), 3e4)
    assert "the shear of too few layers of grains at 0.03 MPa" in taken.attrs["cautions"]
    assert "slide of one cell" not in taken.attrs["cautions"]


def test_the_unknown_size_of_the_cells_is_printed(law):
    assert "cell size" in law.attrs["unknown"].split(", ")
    assert law.attrs["how_cell_size"].endswith("give wider in [third_body]")
    assert "do not contain the size of its cells" in [*THIRD_BODY_LAW.answer(law)][-1]


def test_wider_cells_give_the_error_of_the_size_to_height_and_friction(tmp_path):
    p, case = np.geomspace(5e2, 3e4, 8), case_of(tmp_path, GRAINS + "wider = 3\n")
    assert [WIDER_CELLS.asked_for(each.tables) for each in (case, case.quick())] == [True, False]
    cells, growth = synthetic(p, 1e-3), np.array([1.0, 1.04, 1.0])  # of the tangential traction
    wider = cells.assign(
        mean_gap=0.99 * cells["mean_gap"], traction=growth * cells["traction"]
    ).isel(realisation=slice(3), step=slice(-1))
    narrow, wide = (
        THIRD_BODY_LAW.run(case, {"micro_response": cells, **more}, None)
        for more in ({}, {"control_response": wider})
    )
    size = wide["error_half_width"].sel(error_term="cell size", quantity="mean_gap")
    np.testing.assert_allclose(size, 0.02, rtol=0.05)  # twice the difference
    grown = wide["sliding_friction_error"] ** 2 - narrow["sliding_friction_error"] ** 2
    np.testing.assert_allclose(np.sqrt(grown), 0.08, rtol=0.05)
    assert "size of its cells" not in [*THIRD_BODY_LAW.answer(wide)][-1]


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("difference", [np.full(8, 0.08), 0.08 * (-1.0) ** np.arange(8)])
def test_errors_by_the_size_of_cells_do_not_cancel_over_the_pressures(tmp_path, difference, noise):
    """Of means over many draws, as the scatter counts once; nothing else differs by the size."""
    p, case, sizes = np.geomspace(5e2, 3e4, 8), case_of(tmp_path, GRAINS), []
    law = THIRD_BODY_LAW.run(case, {"micro_response": synthetic(p, 1e-3)}, None)
    for seed in range(40 if noise else 1):
        cells, wider = (synthetic(p, 0.0, seed) for _ in range(2))
        rng = np.random.default_rng(seed)
        for each, change in ((cells, 0.0), (wider, difference)):
            scatter = 1.0 + noise * rng.standard_normal((6, 8))
            each["traction"].values[..., 1] *= (1.0 + change) * scatter
        sizes.append(size_errors(cells, wider, law))
    gap, area, stiffness, friction = np.sqrt(np.mean(np.square(sizes), axis=0))
    assert max(gap, area, stiffness) < 1e-9
    assert friction == pytest.approx(0.16, rel=0.1)


def test_a_target_takes_more_or_wider_cells_of_grains_and_never_too_narrow_cells(tmp_path):
    case = case_of(tmp_path, GRAINS)
    cells, size = grain_knobs(case)
    assert cells.change(case, 1).third_body.realisations == 12
    larger = size.change(case, 1)
    assert (larger.grains.number, larger.third_body.size) == (400, (0.1, 0.1))
    assert size.lowest(case) == 0
    assert size.terms == ("cell size",)


@pytest.mark.parametrize("speed", [1e-6, 0.05, 0.5, 1e3])
def test_the_law_at_another_speed_has_the_inertial_number_of_its_cells(law, speed):
    scaled = at_speed(law, speed)
    factor = (speed / SPEED) ** 2
    p = factor * np.array([7e2, 3e3, 2e4])  # between the pressures of the cells
    height, friction = exact(p, speed)
    np.testing.assert_allclose(law_from_dataset(scaled).gap_at(p), height, rtol=3e-3)
    np.testing.assert_allclose(sliding_friction_at(scaled, p), friction, rtol=5e-3)
    assert law_from_dataset(scaled).pressure_range == pytest.approx((5e2 * factor, 3e4 * factor))
    K, exact_slope = law_from_dataset(scaled).stiffness(height), 2.0 * p / (height - HEIGHT)
    np.testing.assert_allclose(K, exact_slope, rtol=0.05)


def layers(tmp_path, pressures, realisations, seed):
    """Response of sheared layers of 60 spheres, and their case."""
    size, some = '["5 cm", "4 cm"]', ", ".join(f'"{p} Pa"' for p in pressures)
    text = GRAINS.replace("number = 100", f"number = 60\nseed = {seed}").replace(
        '["5 cm", "5 cm"]', size
    )
    start = text.index("pressures = ")
    text = text[:start] + f"pressures = [{some}]" + text[text.index("\n", start) :]
    case = case_of(tmp_path, text)
    third, p = case.third_body, np.array(pressures, dtype=float)
    cells = []
    for k in range(realisations):
        radii, options = third.cell(case.grains, k)
        speed = np.full(p.size, third.speed)
        cells.append(granulate.shear_cells(radii, third.size, p, speed, case.grains.law, **options))
    values = MICRO_RESPONSE.join(cells, "realisation").values
    attributes = {"grain_density": DENSITY, "grain_diameter": DIAMETER, "cautions": ""}
    return case, MICRO_RESPONSE.build(values, **attributes)


@pytest.mark.long
def test_other_layers_dilate_and_slide_as_the_law_between_its_pressures(tmp_path):
    case, response = layers(tmp_path, [500, 2000, 8000, 32000], 5, seed=0)
    law = THIRD_BODY_LAW.run(case, {"micro_response": response}, None)
    p = np.array([1000.0, 4000.0, 16000.0])
    _, other = layers(tmp_path, p.tolist(), 4, seed=100)
    spread = 3.18 / np.sqrt(4.0)  # Student's, of the mean of four layers
    gap, friction = (
        other["mean_gap"].values,
        -np.divide(other["traction"].values[..., 1], other["traction"].values[..., 0]),
    )
    for values, expected, half in (
        (gap, law_from_dataset(law).gap_at(p), law["error_total"].sel(quantity="mean_gap")),
        (friction, sliding_friction_at(law, p), law["sliding_friction_error"]),
    ):
        band = expected * np.interp(p, law["fit_pressure"], half)
        assert np.all(band < 0.2 * expected)
        assert np.all(
            np.abs(values.mean(axis=0) - expected)
            < np.hypot(band, spread * values.std(axis=0, ddof=1))
        )
    stiffness = law["error_total"].sel(quantity="stiffness").values
    fall = gap[:, 0] - gap[:, -1]  # a secant of the stiffness
    expected = -np.diff(law_from_dataset(law).gap_at(p[[0, -1]]))[0]
    band = stiffness.max() * expected, spread * fall.std(ddof=1)
    assert abs(fall.mean() - expected) < np.hypot(*band)


def test_intervals_of_the_stiffness_hold_it_and_are_not_much_wider_than_its_errors(tmp_path):
    case, p = case_of(tmp_path, GRAINS + "[law]\nsamples = 0\n"), np.geomspace(5e2, 3e4, 8)
    errors, halves = [], []
    for seed in range(24):
        response = synthetic(p, seed=seed)
        scatter = np.random.default_rng(seed).normal(1.0, 2e-3, response["mean_gap"].shape)
        law = THIRD_BODY_LAW.run(
            case, {"micro_response": response.assign(mean_gap=scatter * response["mean_gap"])}, None
        )
        normal, (height, _) = law_from_dataset(law), exact(p, SPEED)
        errors.append(
            normal.stiffness(normal.gap_at(p))[3] / (2.0 * p / (height - HEIGHT))[3] - 1.0
        )
        half = law["error_half_width"].sel(quantity="stiffness", error_term=["sampling", "fit"])
        halves.append(np.linalg.norm(half.isel(step=3)))
    held = np.mean(np.abs(errors) < halves)
    assert held > 0.8  # of 95 %, in 24
    assert np.mean(halves) < 2.0 * 1.96 * np.sqrt(np.mean(np.square(errors)))


def test_a_formula_that_the_layers_contradict_widens_the_interval(tmp_path):
    case, p = case_of(tmp_path, GRAINS), np.geomspace(5e2, 3e4, 8)
    response = synthetic(p, 1e-3)
    bent = response["mean_gap"] + 5e-4 * np.sin(np.log(p / 5e2))
    wrong = response.assign(mean_gap=bent.assign_attrs(response["mean_gap"].attrs))
    right, misfit = (
        THIRD_BODY_LAW.run(case, {"micro_response": each}, None)["error_half_width"].sel(
            error_term="fit", quantity="stiffness"
        )
        for each in (response, wrong)
    )
    assert np.all(right < 0.02)
    assert np.all(misfit > 5.0 * right + 0.02)


def joint(tmp_path, law, interface, preloads='"2 kPa", "8 kPa"'):
    """Case of two blocks with the law of a file."""
    save_law(law, tmp_path / "law.nc")
    text = JOINT.replace("friction = 0.2\nstiffness_ratio = 0.8\n", f'law = "law.nc"\n{interface}')
    text = text.replace('"5 MPa", "20 MPa"', preloads)
    return case_of(tmp_path, 'title = "Joint"\n' + text)


def test_a_joint_takes_friction_and_dilation_at_its_speed(law, tmp_path):
    case = joint(tmp_path, law, 'speed = "1 m/s"\nstiffness_ratio = 1.0\n')
    result = run_macro(case, tmp_path / "out.nc")
    p = result["preload"].to_numpy()
    height, _ = exact(p, 1.0)
    np.testing.assert_allclose(result["gap"].mean("point"), height, rtol=3e-3)
    np.testing.assert_allclose(
        result["interface_stiffness"], 2.0 * p / (height - HEIGHT), rtol=0.05
    )
    bodies, (taken,) = joints_of(case)
    (bed,) = bodies.sliders(case, [taken])
    assert bed.friction == pytest.approx(exact(8e3, 1.0)[1], rel=5e-3)  # at the last preload
    assert 0.0 < float(taken["shear_friction_error"]) < 5e-3
    assert "assumed" not in result.attrs["cautions"]


@pytest.mark.parametrize(
    ("interface", "preloads", "words"),
    [
        ("stiffness_ratio = 1.0\n", '"2 kPa"', "depends on the speed of sliding, 0.5 m/s .* give"),
        ('speed = "1 m/s"\n', '"2 kPa"', "law of grains has no stiffness_ratio"),
        ('speed = "1e-6 m/s"\nstiffness_ratio = 1.0\n', '"2 kPa"', "unknown at every step"),
        ('speed = "0 m/s"\nstiffness_ratio = 1.0\n', '"2 kPa"', "speed"),
    ],
)
def test_a_law_of_grains_is_refused_where_it_has_no_data(law, tmp_path, interface, preloads, words):
    with pytest.raises(MultiscaleError, match=words):
        run_macro(joint(tmp_path, law, interface, preloads), tmp_path / "out.nc")


def test_a_law_without_a_speed_refuses_a_speed(law, tmp_path):
    plain = law.copy()
    del plain.attrs["sliding_speed"]
    with pytest.raises(CaseError, match="to a law of grains, and this is another law"):
        at_speed(plain, 1.0)


@pytest.mark.slow
def test_a_layer_of_grains_sheared_again_agrees(tmp_path):
    few = GRAINS.replace("number = 100", "number = 50").replace("ns = 6", "ns = 1")
    few = few.replace('"2 kPa", ', "")
    case = case_of(tmp_path, few.replace('"0.5 kPa", "1 kPa", ', ""))
    (tmp_path / "case.toml").write_text(case.to_toml())
    cells = THIRD_BODY_CELLS.run(case, {}, Job(tmp_path))
    write_dataset(cells, tmp_path / THIRD_BODY_CELLS.file, MICRO_RESPONSE)
    assert verify_run(tmp_path).startswith("the first realisation computed again agrees")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('speed = "0.5 m/s"', 'speed = "1e-6 m/s"', "grains do not flow steadily before 20 diam"),
        (
            '"5 cm", "5 cm"',
            '"5 cm", "2.5 cm"',
            r"^\[third_body\] size has a period of 0.025",
        ),
        (
            GRAINS[GRAINS.index("[grains]") : GRAINS.index("[third_body]")],
            "",
            r"\[third_body\] needs \[grains\]",
        ),
        ('"0.5 kPa", "1 kPa"', '"1 kPa", "0.5 kPa"', "must rise"),
        ("realisations = 6\n", "realisations = 6\n" + JOINT, r"give speed in \[interface\]"),
        (
            "[third_body]",
            "[law]\nterms = 20\n[third_body]",
            r"terms in \[law\] fit cells of two sur",
        ),
    ],
)
def test_grains_that_do_not_flow_are_refused_before_a_run(tmp_path, old, new, words):
    with pytest.raises(CaseError, match=words):
        run(case_of(tmp_path, GRAINS.replace(old, new)), tmp_path / "out")
