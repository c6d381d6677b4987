"""Figures of joints: the data in the axes equal the dataset."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.integrate import simpson

from multiscale.errors import CaseError
from multiscale.laws import Exponential, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import LatinMethod
from multiscale.macro.bodies import add_body_fields, stacked_blocks
from multiscale.macro.substructures import joint_path, load_joint
from multiscale.pipeline.showing import list_cycles
from multiscale.pipeline.stages.loaded_bodies import LOADED_BODIES
from multiscale.plotting import joint_pictures, plot_hysteresis, plot_joint_plan


@pytest.fixture(scope="module")
def blocks():
    law = Sliders(Exponential(1e9, 0.2e-6), 0.2, pressures=(1e6, 1e8))
    return stacked_blocks((0.03, 0.02, 0.01), (3, 2, 1), [Elastic(70e9, 0.3)] * 2, [law])


@pytest.fixture(scope="module")
def meshed(blocks, result):
    return add_body_fields(result, blocks.bodies)


@pytest.fixture(scope="module")
def result(blocks):
    loading = joint_path((2e6, 10e6), shear=1.5e6, cycles=1, steps=3)
    return load_joint(blocks, loading, method=LatinMethod(tolerance=1e-6))


def test_discs_stand_at_points_in_millimetres_where_the_faces_of_bodies_are_not_known(result):
    ax = plot_joint_plan(result, step=4, ax=Figure().add_subplot())
    position = 1e3 * result["point_position"].values[:, :2]
    np.testing.assert_allclose(ax.collections[0].get_offsets(), position)


def test_zones_cover_the_joint_in_millimetres_and_name_their_share(result, meshed):
    ax = plot_joint_plan(meshed, step=4, ax=Figure().add_subplot())
    (parts,) = ax.collections
    area = np.zeros(3)
    for path, state in zip(parts.get_paths(), parts.get_array(), strict=True):
        (x, y), (x1, y1) = path.vertices[:-1].T, path.vertices[1:].T
        area[int(state)] += 0.5 * abs(np.sum(x * y1 - x1 * y))
    state, weight = result["contact_state"].values[4], result["point_area"].values
    each = [1e6 * weight[state == k].sum() for k in range(3)]
    np.testing.assert_allclose(area, each, rtol=1e-9, atol=1e-9)  # mm2
    shares = [100.0 * float(result[f"{name}_fraction"][4]) for name in ("open", "stick", "slip")]
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == [
        f"{name}, {share:.3g} %"
        for name, share in zip(("open", "stick", "sliding"), shares, strict=True)
    ]
    assert "10 MPa, shear 1.5 MPa" in ax.get_title()


def test_picture_sentence_and_dataset_have_one_measure_of_slip(result):
    ax = joint_pictures(result)["contact_zones"](ax=Figure().add_subplot())
    end = result.isel(step=-1)
    assert 0.0 < float(end["slipping_load"]) < 1.0
    names = ("slipping_load", "slip_fraction")
    force, area = (f"{100.0 * float(end[name]):.3g} %" for name in names)
    assert f"{force} of the contact force at sliding" in ax.get_title()
    assert ax.get_legend().get_texts()[2].get_text() == f"sliding, {area}"
    sentence = (
        f"{force} of the contact force is at sliding, and more than half of the local force on"
    )
    assert f"{sentence} {area} of the nominal area" in list_cycles(result)[-1]


def test_the_pressure_is_drawn_from_the_points_in_megapascal(result):
    ax = plot_joint_plan(result, quantity="pressure", step=4, ax=Figure().add_subplot())
    np.testing.assert_allclose(
        ax.collections[0].get_array(), -1e-6 * result["traction"].values[4, :, 0]
    )


def test_the_loop_encloses_the_energy_per_area_of_the_cycle(result):
    ax = plot_hysteresis(result, ax=Figure().add_subplot())
    slip, shear = ax.lines[0].get_data()
    assert shear[0] == 0.0
    np.testing.assert_allclose(shear[1:], 1e-6 * result["shear"].values[2:])
    back, forth = (simpson(slip[at : at + 7], x=shear[at : at + 7]) for at in (3, 9))
    area = -(back + forth) + shear[3] * (slip[-1] - slip[3])  # MPa um = J/m2
    np.testing.assert_allclose(area * 0.03 * 0.02, float(result["cycle_energy"][0]), rtol=1e-9)


def test_all_figures_of_a_joint_are_written(result, tmp_path):
    files = LOADED_BODIES.draw(result, tmp_path / "figures")
    assert [file.stem for file in files] == [
        "contact_zones",
        "pressure",
        "hysteresis",
        "loss",
        "joint_stiffness",
    ]
    assert all(file.read_bytes().startswith(b"\x89PNG") for file in files)


def test_a_joint_that_slid_away_at_once_is_refused_with_the_reason(result, tmp_path):
    failed = result.assign(slip_fraction=result["slip_fraction"] * np.nan)
    with pytest.raises(CaseError, match=r"no step has an answer, .* can be drawn: it slides away"):
        LOADED_BODIES.draw(failed.assign_attrs(failure="it slides away"), tmp_path / "figures")
    assert not (tmp_path / "figures").exists()
