"""One case for the whole chain: any prefix or suffix of it is a case, old files are read as new."""

import re

import numpy as np
import pytest

from multiscale.errors import CaseError, MultiscaleError
from multiscale.io import open_dataset, open_law
from multiscale.pipeline import load_sweep, requirements, run, run_macro
from multiscale.pipeline.case import shipped_cases
from multiscale.schema import MACRO_RESULT
from tests.support import TWO_BLOCKS, case_of, small_steel, write_scene

STEEL = small_steel(3)
CELLS, BLOCKS = STEEL[: STEEL.index("[structure]")], STEEL[STEEL.index("[structure]") :]
ROUGH = TWO_BLOCKS[TWO_BLOCKS.index("[structure]") :]
CYCLES = '[cycles]\nshear = "1 MPa"\ncycles = 1\nsteps = 2\n'
LAW_OF_CELLS = ("[interface]\n", '[interface]\nlaw = "cells.toml"\n')
CHAIN = CELLS + "[law]\nsamples = 10\n" + ROUGH + CYCLES


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    """Run cells, law and sheared blocks."""
    folder = tmp_path_factory.mktemp("chain")
    case = case_of(folder, CHAIN)
    return case, folder / "out", run(case, folder / "out")


def test_a_case_goes_from_two_surfaces_to_the_loss_of_a_cycle(chain):
    _, _, results = chain
    assert list(results) == ["micro_response", "interface_law", "macro_result"]
    assert results.macro_result["converged"].values.all()
    assert results.macro_result["cycle_energy"].values[0] > 0.0


def test_the_law_of_the_cells_is_the_law_of_the_interfaces(chain, tmp_path):
    case, out, results = chain
    alone = run_macro(case, tmp_path / "out.nc", law=out / "interface_law.nc")
    for name in ("joint_stiffness", "tangential_stiffness", "cycle_energy", "error_total"):
        np.testing.assert_array_equal(alone[name], results.macro_result[name])


@pytest.mark.slow
def test_joints_take_the_law_of_another_case_which_is_run_before_them(chain, tmp_path):
    _, _, results = chain
    write_scene(tmp_path, CELLS + "[law]\nsamples = 10\n").rename(tmp_path / "cells.toml")
    case = case_of(tmp_path, 'title = "Blocks"\n' + ROUGH + CYCLES, LAW_OF_CELLS)
    needs = requirements(case)
    stages = [cost.stage for cost in needs.costs]
    assert stages == ["micro_response of cells", "interface_law of cells", "macro_result"]
    result = run_macro(case, tmp_path / "found.nc")
    for name in ("joint_stiffness", "cycle_energy", "error_total"):
        np.testing.assert_array_equal(result[name], results.macro_result[name])
    (folder,) = (tmp_path / "laws").iterdir()
    assert folder.name.startswith("cells-")
    assert case.quick().interface.quick
    assert requirements(case.quick()).costs != needs.costs


@pytest.mark.parametrize(
    ("law", "sentence"),
    [
        ("tyre_on_road", "tyre_on_road.toml: the case has no cells, so it makes no law"),
        ("ground_stel", "ground_stel"),
    ],
)
def test_a_case_without_a_law_is_refused_before_anything_is_solved(tmp_path, law, sentence):
    case = case_of(
        tmp_path,
        'title = "Blocks"\n' + ROUGH,
        (LAW_OF_CELLS[0], f'{LAW_OF_CELLS[0]}law = "{law}"\n'),
    )
    with pytest.raises(MultiscaleError, match=sentence):
        run_macro(case, tmp_path / "found.nc")
    assert not (tmp_path / "laws").exists()


@pytest.mark.slow
def test_another_load_computes_no_cell_again_and_another_law_none_either(chain):
    case, out, _ = chain

    def written():
        return [(out / f"{name}.nc").stat().st_mtime_ns for name in run(case, out)]

    before = written()
    case = case.model_copy(update={"cycles": None})
    loaded = written()
    assert loaded[:2] == before[:2]
    assert loaded[2] > before[2]
    case = case.model_copy(update={"law": case.law.model_copy(update={"samples": 11})})
    fitted = written()
    assert fitted[0] == before[0]
    assert np.all(np.array(fitted[1:]) > loaded[1:])


@pytest.mark.slow
def test_cells_without_a_structure_are_a_case_and_describe_the_interface(command, tmp_path):
    path = write_scene(tmp_path, CELLS + "[law]\nsamples = 0\n")
    status, output, _ = command("run", path, "-o", "out", "--jobs", "1")
    assert status == 0
    line = output.splitlines()[2]
    law = open_law(tmp_path / "out" / "interface_law.nc")
    middle = law.isel(step=law.sizes["step"] // 2)
    assert line.startswith(f"At {1e-6 * float(middle['fit_pressure']):.4g} MPa the mean gap of ")
    gap = float(re.search(r"mean gap of the interface is ([\d.]+) µm", line)[1])
    assert gap == pytest.approx(1e6 * float(middle["fit_mean_gap"]), rel=0.01)
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert line in page


@pytest.mark.slow
def test_blocks_take_a_law_from_a_file(run_folder, tmp_path, command):
    """Only the last stage of a case, with the law of the whole case, gives the same joint."""
    law = run_folder / "interface_law.nc"
    whole = open_dataset(run_folder / "macro_result.nc", MACRO_RESULT)
    bodies = "".join(
        f'[body_{k}]\nyoungs_modulus = "210 GPa"\npoissons_ratio = 0.3\n' for k in (1, 2)
    )
    text = 'title = "Blocks"\n' + bodies + BLOCKS
    path = write_scene(tmp_path, text)
    status, output, _ = command("macro", path, "--law", law, "-o", "out.nc")
    assert status == 0
    assert output.splitlines()[0] == "Blocks"
    dataset = open_dataset(tmp_path / "out.nc", MACRO_RESULT)
    for name in ("joint_stiffness", "real_pressure", "error_total"):
        np.testing.assert_allclose(dataset[name], whole[name], rtol=1e-12)
    assert "A cell of 0.8 mm is 0.08 of the edge" in dataset.attrs["facts"]
    status, _, output = command("macro", path, "-o", "none.nc")
    assert status == 1
    assert "has joints but no law: name a case or a file by [interface] law, or a file" in output
    named = case_of(tmp_path, f'{text}[interface]\nlaw = "{law}"\n')
    np.testing.assert_array_equal(
        run(named, tmp_path / "run").macro_result["joint_stiffness"], dataset["joint_stiffness"]
    )


@pytest.mark.slow
@pytest.mark.usefixtures("without_pages")
def test_a_forced_run_computes_every_stage_and_cell_anew(tmp_path, command):
    changed = CELLS.replace("realisations = 3", "realisations = 1")
    path = write_scene(tmp_path, changed + "[law]\nsamples = 0\n" + BLOCKS)
    arguments = ("run", path, "-o", "out", "--jobs", "1")
    assert command(*arguments)[0] == 0
    files = [*(tmp_path / "out").glob("*.nc"), *(tmp_path / "out" / "micro").glob("*.nc")]
    before = np.array([file.stat().st_mtime_ns for file in files])
    assert command(*arguments)[0] == 0
    assert np.all(before == [file.stat().st_mtime_ns for file in files])
    assert command(*arguments, "--force")[0] == 0
    assert np.all(before < [file.stat().st_mtime_ns for file in files])
    status, _, output = command(*arguments, "--force", "--resume")
    assert status == 1
    assert "--resume keeps results that --force computes again" in output


def test_tables_of_earlier_versions_are_refused_in_sweeps(tmp_path):
    path = write_scene(tmp_path, CELLS + '[sweep.joint]\nheight = ["5 mm", "9 mm"]\n')
    with pytest.raises(CaseError, match=r"keys of \[joint\]"):
        load_sweep(path)


def test_the_chain_is_quick_at_every_scale(tmp_path):
    """As the shipped chain would be: fewer cells and cycles."""
    text = shipped_cases()["ground_steel"].read_text(encoding="utf-8")
    text = text[: text.index("[structure]")] + ROUGH + CYCLES.replace("= 1\n", "= 3\n")
    quick = case_of(tmp_path, text).quick()
    assert (quick.cell.points, quick.micro.realisations) == ((64, 64), 4)
    assert (quick.cycles.cycles, quick.cycles.steps) == (1, 2)
    assert case_of(tmp_path, quick.to_toml()) == quick
