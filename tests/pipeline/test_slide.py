"""Cases of sliding bodies: both rough and deformable, friction against pressure and distance."""

from shutil import copytree

import numpy as np
import pytest

from multiscale.io import open_dataset
from multiscale.laws.bulk import J2, NeoHookean
from multiscale.micro import Path, solve_cell
from multiscale.micro.slide import slide_cell
from multiscale.pipeline import make_cells, requirements, run
from multiscale.pipeline.case import shipped_cases
from multiscale.pipeline.stages.ensembles import make_pair
from multiscale.schema import SLIDING_RESPONSE
from tests.support import case_of, slow

SLIDE = """
[slide]
distance = "100 um"
friction_coefficient = 0.1
pressures = ["20 MPa", "80 MPa"]
steps = 2
"""
ELASTIC = (
    shipped_cases()["ground_steel_plastic"]
    .read_text(encoding="utf-8")
    .replace('hardness = "1.6 GPa"\n', "")
    .replace('hardening_modulus = "1 GPa"\n', "")
    .replace("unload = true\n", "")
    .replace("[64, 64]", "[12, 12]")
    .replace("layers = 8", "layers = 4")
    .replace('short_cutoff = "50 um"', 'short_cutoff = "133 um"')
    .replace("realisations = 6", "realisations = 3")
)


@pytest.fixture(scope="module", params=slow("slide"))
def finished(request, text_run):
    case, out, results = text_run(request.param, ELASTIC + SLIDE)
    return case, out, results["sliding_response"]


def test_the_two_bodies_have_the_gaps_of_their_composite_surface(tmp_path):
    case = case_of(tmp_path, ELASTIC + SLIDE)
    pair, first = make_pair(case), make_cells(case)[0]
    np.testing.assert_allclose(
        pair.surface.heights - pair.obstacle.heights, first.surface.heights, rtol=0.0, atol=1e-18
    )
    assert pair.second is not None
    assert isinstance(pair.law, NeoHookean)
    # at small slopes two bodies press as one equivalent body
    path = Path(pressure=(20e6, 80e6))
    gaps = [solve_cell(cell, path)["mean_gap"].values[0] for cell in (pair, first)]
    np.testing.assert_allclose(*gaps, rtol=0.02)


def test_only_the_body_with_a_hardness_flows(tmp_path):
    text = ELASTIC.replace("[body_2]", '[body_2]\nhardness = "2.8 GPa"') + SLIDE
    case = case_of(tmp_path, text)
    pair = make_pair(case)
    assert isinstance(pair.law, NeoHookean)
    assert isinstance(pair.second.law, J2)
    assert pair.second.law.yield_stress == pytest.approx(1e9)


def test_a_run_leaves_friction_against_pressure_and_distance(finished):
    case, _, response = finished
    assert response["converged"].values.all()
    np.testing.assert_allclose(response["nominal_pressure"], [20e6, 80e6])
    np.testing.assert_allclose(response["sliding_distance"], [0.0, 50e-6, 100e-6])
    expected = slide_cell(make_pair(case), (20e6, 80e6), 100e-6, steps=2, tolerance=1e-6)
    np.testing.assert_array_equal(response["effective_friction"], expected["effective_friction"])
    # elastic bodies resist with the friction of their points, but for the slopes they climb
    friction = response["effective_friction"].values[:, 1:]
    assert np.all(np.abs(friction - 0.1) < 0.05)
    assert np.all(response["slip_fraction"].values[:, 1:] == 1.0)


@pytest.mark.slow
def test_a_second_run_keeps_the_sliding_and_another_distance_is_slid_anew(finished, tmp_path):
    case, out, _ = finished
    out = copytree(out, tmp_path / "again")
    file = out / "sliding_response.nc"
    before, cells = file.stat().st_mtime_ns, (out / "micro" / "realisation-0000.nc").stat()
    run(case, out)
    assert file.stat().st_mtime_ns == before
    shorter = case.slide.model_copy(update={"distance": 20e-6, "pressures": (20e6,), "steps": 1})
    run(case.model_copy(update={"slide": shorter}), out)
    dataset = open_dataset(file, SLIDING_RESPONSE)
    assert float(dataset["sliding_distance"][-1]) == pytest.approx(20e-6)
    assert (out / "micro" / "realisation-0000.nc").stat().st_mtime_ns == cells.st_mtime_ns
    run(case, out)


def test_the_needs_of_sliding_are_listed_and_quick_takes_less(tmp_path):
    case = case_of(tmp_path, ELASTIC + SLIDE)
    assert "both bodies" in requirements(case).built["slide"]
    assert requirements(case).memory > requirements(case_of(tmp_path, ELASTIC)).memory
    quick = case_of(tmp_path, ELASTIC.replace("133 um", "150 um") + SLIDE).quick()
    assert quick.slide.pressures == (80e6,)
    assert quick.slide.distance == pytest.approx(100e-6)
    again = case_of(tmp_path, quick.to_toml())
    assert again == quick
