"""The joint of a case: basis and unknown parts of its answer."""

import numpy as np
import pytest

from multiscale.io import open_law
from multiscale.macro import Block, RoughJoint, press_joint
from multiscale.pipeline import load_case
from multiscale.pipeline.showing import list_facts, round_by
from multiscale.pipeline.stages.joint import JOINT, JOINT_TABLE, solve_joint
from multiscale.schema import INTERFACE_LAW
from multiscale.upscaling import assume_shear, hysteretic_from_dataset, with_intervals
from multiscale.upscaling.budget import MACRO

PRELOADS = (5e6, 40e6, 400e6, 600e6)  # of cells up to 240 MPa


def case_of(run_folder, **law):
    case = load_case(run_folder / "case.toml")
    statics = case.statics.model_copy(update={"preloads": PRELOADS})
    return case.model_copy(update={"statics": statics, "law": case.law.model_copy(update=law)})


def solve(run_folder, **law):
    return solve_joint(case_of(run_folder, **law), open_law(run_folder / "interface_law.nc"))


@pytest.fixture(scope="module")
def result(run_folder):
    return solve(run_folder)


def test_the_print_names_the_errors_that_are_not_counted(result):
    sentence = "Error terms that are unknown and not included (+ ?): "
    assert f"{sentence}cell size, micro discretisation." in list(JOINT.lines(result))


def test_interface_and_bodies_stand_next_to_the_joint_each_with_its_error(result):
    """At a given pressure dk/k = (k/K) dK/K, and nothing of the law is in the bodies."""
    known = result.isel(step=slice(2))
    k, K, solid = (known[f"{name}_stiffness"].values for name in ("joint", "interface", "solid"))
    np.testing.assert_allclose(1.0 / k, 1.0 / K + 1.0 / solid, rtol=1e-12)
    terms = known["error_half_width"].sel(error_term=["fit", "scale separation"])
    shares = terms.sel(quantity="joint_stiffness") / terms.sel(quantity="interface_stiffness")
    np.testing.assert_allclose(shares, np.broadcast_to(k / K, (2, 2)), rtol=0.05)
    total = known["error_total"]
    np.testing.assert_array_equal(total.sel(quantity="solid_stiffness"), 0.0)
    assert np.all(total.sel(quantity="interface_stiffness") > total.sel(quantity="joint_stiffness"))


@pytest.mark.parametrize(("mesh", "moved"), [(0.0, 0.3), (0.2, 0.3), (0.2, 5.0)])
@pytest.mark.parametrize("error", [0.01, 0.6, 1.3])
def test_ends_of_an_interval_are_springs_in_series_too(result, error, mesh, moved):
    """No joint is stiffer than its bodies by its interface; the mesh is an error of the bodies."""
    known = result.isel(step=slice(2))
    joint, K, solid = (known[f"{name}_stiffness"] for name in ("joint", "interface", "solid"))
    half = 0.0 * known["error_half_width"]
    half.loc[{"quantity": "interface_stiffness", "error_term": "fit"}] = error
    half.loc[{"quantity": "joint_stiffness", "error_term": "fit"}] = error * joint / K
    half.loc[{"quantity": "joint_stiffness", "error_term": MACRO}] = mesh
    half.loc[{"quantity": "interface_stiffness", "error_term": MACRO}] = moved * mesh
    known = with_intervals(known.assign(error_half_width=half))
    ends = K.values * np.maximum([[1.0 - error], [1.0 + error]], 0.0)
    series = ends * solid.values / (ends + solid.values) / joint.values - 1.0
    expected = 1.0 + np.sign(series) * np.hypot(series, mesh)
    ratios = known["joint_stiffness_one_part"] / joint.values
    np.testing.assert_allclose(ratios, np.maximum(expected, 0.0), atol=1e-12)


def test_a_joint_of_an_interface_without_known_errors_has_the_interval_of_its_mesh(result):
    known = result.isel(step=slice(2))
    half, total = (np.nan * known[f"error_{name}"] for name in ("half_width", "total"))
    half.loc[{"error_term": MACRO}] = 0.1
    known = with_intervals(known.assign(error_half_width=half, error_total=total))
    ends = known["joint_stiffness_one_part"] / known["joint_stiffness"]
    np.testing.assert_allclose(ends.transpose("limit", "step"), [[0.9, 0.9], [1.1, 1.1]])


def test_the_table_shows_the_parts_their_errors_and_the_real_pressure(result):
    head, rows = JOINT_TABLE.rows(result)
    row = dict(zip(head, rows[1], strict=True))
    error = 100.0 * float(result["error_total"].sel(quantity="interface_stiffness")[1])
    K = 1e-12 * float(result["interface_stiffness"][1])
    assert row["interface (MPa/µm)"] == f"{round_by(K, 0.01 * error * K)} ± {error:.2g} % + ?"
    assert row["bodies (MPa/µm)"] == "21"  # a closed form
    real = 40.0 / float(result["contact_fraction"][1])
    assert float(row["real pressure (MPa)"].split(" ± ")[0]) == pytest.approx(real, rel=1e-2)
    assert list_facts(result) == [
        "The answer is elastic, as no body has a hardness.",
        "A cell of 0.8 mm is 0.08 of the edge of the interface, 10 mm.",
    ]


def test_blocks_are_sheared_in_series_with_the_tangential_branch_of_their_law(run_folder, result):
    """At a given pressure dk_T/k_T = k_T/(kappa K) dK/K; a ratio that is assumed adds nothing."""
    law = assume_shear(open_law(run_folder / "interface_law.nc"), stiffness_ratio=0.8)
    case = case_of(run_folder)
    text = solve_joint(case, law)
    K = result["interface_stiffness"].values[:3]
    body, height = case.body_1, case.structure.height
    shear_modulus = body.youngs_modulus / 2.0 / (1.0 + body.poissons_ratio)
    expected = 1.0 / (1.0 / (0.8 * K) + 2.0 * height / shear_modulus)
    np.testing.assert_allclose(text["tangential_stiffness"][:3], expected, rtol=1e-12)
    assert np.isnan(text["tangential_stiffness"][3])
    known = text["error_half_width"].isel(step=slice(2)).sel(error_term="fit")
    shares = known.sel(quantity="tangential_stiffness") / known.sel(quantity="interface_stiffness")
    np.testing.assert_allclose(shares, (expected / (0.8 * K))[:2], rtol=0.05)
    head, rows = JOINT_TABLE.rows(text)
    assert " ± " in rows[1][head.index("tangential, no slip (MPa/µm)")]
    assert "shear branch of the law: assumed, stiffness ratio 0.8" in list_facts(text)[-1]
    assert "tangential_stiffness" not in result


def test_a_measured_stiffness_ratio_adds_its_error(run_folder, result):
    law = open_law(run_folder / "interface_law.nc")
    spread = 1.0 + 0.05 * np.linspace(-1.0, 1.0, 401)
    values = {
        "shear_stiffness_ratio": [0.8, 0.8],
        "shear_friction": 0.2,
        "shear_stiffness_ratio_sample": 0.8 * spread[:, None] * np.ones(2),
        "shear_friction_sample": 0.2 * spread,
    }
    law = INTERFACE_LAW.assign(law, values).assign_attrs(n_sheared=9, branches="shear: measured")
    half = solve_joint(case_of(run_folder), law)["error_half_width"].sel(error_term="sampling")
    assumed = assume_shear(open_law(run_folder / "interface_law.nc"), stiffness_ratio=0.8)
    text = solve_joint(case_of(run_folder), assumed)
    without = text["error_half_width"].sel(error_term="sampling")
    name, at = "tangential_stiffness", slice(2)
    share = text[name].values / (0.8 * text["interface_stiffness"].values)  # of the compliance
    added = np.sqrt(half.sel(quantity=name) ** 2 - without.sel(quantity=name) ** 2)[at]
    np.testing.assert_allclose(added, 0.05 * 0.95 * share[at], rtol=1e-6)
    np.testing.assert_array_equal(
        half.sel(quantity="joint_stiffness")[at], without.sel(quantity="joint_stiffness")[at]
    )


def test_a_preload_far_beyond_the_cells_has_no_answer_and_no_error(result):
    np.testing.assert_array_equal(result["known"], [1, 1, 1, 0])
    for name in ("joint_stiffness", "mean_gap", "contact_fraction", "real_pressure"):
        np.testing.assert_array_equal(np.isfinite(result[name]), [True, True, True, False])
    assert np.isnan(result["error_total"].values[:, -1]).all()
    assert np.isfinite(result["error_total"].values[:, :-1]).all()
    _, rows = JOINT_TABLE.rows(result)
    assert rows[-1][:3] == ("600", "unknown", "")
    far, near = result.attrs["cautions"].splitlines()
    assert "at step 3 with the preload 600 MPa: the answer there is unknown" in far
    assert (
        "100 % of the load lies above the pressures of the law, 2 MPa to 240 MPa, at step 2" in near
    )


def test_an_answer_extrapolated_on_demand_has_no_error(run_folder, result):
    outcome = solve(run_folder, extrapolate=True)
    np.testing.assert_array_equal(outcome["joint_stiffness"][:3], result["joint_stiffness"][:3])
    assert np.isfinite(outcome["joint_stiffness"][3])
    assert np.isnan(outcome["error_total"].values[:, -1]).all()
    _, rows = JOINT_TABLE.rows(outcome)
    assert rows[-1][4] == "unknown"


@pytest.mark.parametrize("extrapolate", [False, True])
def test_a_preload_that_begins_to_fall_meets_the_unloading_branch(run_folder, extrapolate):
    law = open_law(run_folder / "interface_law.nc")
    spread = np.linspace(0.9, 1.1, law.sizes["sample"] - 3)  # some fits did not settle
    values = {"unloading_stiffness_ratio": 1.4, "unloading_exponent": 2.0}
    values |= {f"{name}_sample": value * spread for name, value in values.items()}
    law = INTERFACE_LAW.assign(law, values)
    case = case_of(run_folder, extrapolate=extrapolate)
    result = solve_joint(case, law)
    blocks, body = case.structure, case.bodies[0]
    block = Block(blocks.height, body.youngs_modulus, body.poissons_ratio)
    joint = RoughJoint((blocks.width, blocks.width), block, block)
    mean, *samples = (hysteretic_from_dataset(law, k) for k in (None, *range(spread.size)))
    pressed = press_joint(joint, mean, PRELOADS, samples=samples, extrapolate=extrapolate)
    assert np.isfinite(pressed["unloading_stiffness_sample"][:, :3]).all()
    for name in ("unloading_stiffness", "unloading_stiffness_sample"):
        np.testing.assert_allclose(result[name], pressed[name], rtol=1e-12)
