"""Flat cells next to conforming cells: same surfaces, their number, gain of the law, refusals."""

from shutil import copytree

import numpy as np
import pytest

from multiscale.pipeline import load_case, run
from multiscale.pipeline.case_cells import make_surfaces
from multiscale.pipeline.case_needs import requirements
from multiscale.pipeline.stage import Job
from multiscale.pipeline.stages.ensembles import CONTROL_CELLS, best_count
from multiscale.upscaling.response_observations import normal_observations
from tests.support import case_text, write_scene
from tests.upscaling.responses import DECAY, PRESSURE, SCALE, response_of

TEXT = case_text("control")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder of a case with twenty flat cells."""
    folder = tmp_path_factory.mktemp("control")
    run(load_case(write_scene(folder, TEXT, ("= 40", "= 20"))), folder / "out")
    return folder / "out"


@pytest.fixture(scope="module")
def written(folder):
    """When the files of the flat cells were written."""
    return {file: file.stat().st_mtime_ns for file in folder.glob("micro-control/*/cells-*.nc")}


@pytest.fixture(scope="module")
def found(folder, written):
    """Results of the case with forty."""
    return run(load_case(write_scene(folder.parent, TEXT)), folder)


def test_the_first_flat_cells_have_the_surfaces_of_the_cells(found, tmp_path):
    control, response = found["control_response"], found["micro_response"]
    assert control.sizes["realisation"] == 40
    assert control["converged"].all()
    np.testing.assert_array_equal(control["realisation"], range(40))
    dear, cheap = (answer["mean_gap"].to_numpy() for answer in (response, control))
    for step in range(5):
        assert np.corrcoef(dear[:, step], cheap[:5, step])[0, 1] > 0.99
    case = load_case(write_scene(tmp_path, TEXT))
    first, other = (make_surfaces(each)[4].heights for each in (case, case.control(40)))
    np.testing.assert_array_equal(first, other)


def test_the_law_is_surer_by_them_and_single_cells_are_not(found, folder, tmp_path):
    law = found["interface_law"]
    plain = write_scene(tmp_path, TEXT, ("control_realisations = 40", "control = false"))
    alone = run(load_case(plain), copytree(folder, tmp_path / "out"))
    assert "control_response" not in alone
    sure, unsure = (
        single_law["error_half_width"].sel(error_term="sampling").to_numpy()
        for single_law in (law, alone["interface_law"])
    )
    assert np.all(sure[0] < 0.5 * unsure[0])
    assert np.all(sure[2, 1:4] < 0.6 * unsure[2, 1:4])
    ratio = law["cell_scatter"] / alone["interface_law"]["cell_scatter"]
    assert 0.4 < float(ratio.sel(quantity="mean_gap").mean()) < 2.5
    assert "40 control cells" in law.attrs["how_sampling"]
    # the means differ by the scatter of five surfaces, which the bands contain
    apart = law["fit_mean_gap"] / alone["interface_law"]["fit_mean_gap"] - 1.0
    assert np.all(np.abs(apart) < 1.5 * unsure[0])


def test_existing_cells_are_reused_and_more_are_added(written, found):
    assert len(written) == 2  # of 16 cells each
    assert {file: file.stat().st_mtime_ns for file in written} == written
    (made,) = {file.parent for file in written}
    assert len(list(made.iterdir())) == 3


def test_dearer_cells_have_a_control_unless_it_is_turned_off(tmp_path):
    def controlled(*pairs):
        return load_case(
            write_scene(tmp_path, TEXT, ("control_realisations = 40\n", ""), *pairs)
        ).controlled

    assert controlled()
    assert not controlled(("layers = 4", 'layers = 4\ngeometry = "flat"'))
    assert not controlled(("realisations = 5", "realisations = 3"))
    assert not controlled(("realisations = 5", "realisations = 5\ncontrol = false"))
    needs = requirements(load_case(write_scene(tmp_path, TEXT)))
    assert needs.built["control cells"].startswith("40 flat cells on the surfaces of the 5 cells")


def test_cells_that_are_followed_only_by_chance_count_without_control_and_a_caution_reports_it(
    found, folder, tmp_path
):
    case, response = load_case(write_scene(tmp_path, TEXT)), found["micro_response"]
    gap = response["mean_gap"]
    mirrored = -gap + 2.0 * gap.mean("realisation")

    def cautions(gap):
        pressed = {"micro_response": response.assign(mean_gap=gap)}
        return CONTROL_CELLS.run(case, pressed, Job(folder)).attrs["cautions"]

    assert cautions(gap) == ""
    assert "law and intervals use only the latter" in cautions(mirrored)


def test_their_number_follows_from_the_correlation():
    """Where they follow well the time of the cells bounds it, where less the best split does."""

    def counted(noise, pairs=12):
        random = np.random.default_rng(5)
        scatter = 1.0 + 0.1 * random.standard_normal((pairs, 1))
        gap = DECAY * np.log(SCALE / PRESSURE)
        cheap = response_of(gap * scatter)
        dear = response_of(gap * (scatter + noise * random.standard_normal((pairs, 1))))
        return best_count(pairs, normal_observations(dear, cheap).control)

    count, text = counted(1e-4)
    assert count == 256  # and no more
    assert "a cost of 1/50 of a cell" in text
    assert 32 <= counted(0.1)[0] <= 128  # a correlation of .7, and a ratio of 7
    count, text = counted(10.0)
    assert count == 12
    assert "not significant" in text
