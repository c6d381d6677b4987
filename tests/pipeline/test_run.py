"""The main job, from a case to its run folder, in Python and on the command line."""

import errno
import os
import subprocess
from shutil import copytree, which

import numpy as np
import pytest
import xarray as xr
from matplotlib.image import imread

from multiscale.io import open_law, open_run
from multiscale.pipeline import load_case, run, run_macro
from multiscale.upscaling import law_from_dataset
from tests.closed_forms import joint as closed_form
from tests.support import TWO_BLOCKS, slow, steel_text, write_scene

FLAT = steel_text().replace("[128, 128]", '[128, 128]\ngeometry = "flat"')


@pytest.fixture(scope="module", params=["flat_cells", *slow("ground_steel")])
def finished(request, shipped_run):
    """Folder and print of the shipped case, or of flat cells on its surfaces, which take less."""
    out, output, cautions = shipped_run(request.param, FLAT if "flat" in request.param else None)
    # a caution with a semicolon is one caution
    assert "caution: the shortest wavelength of body_1 has 4.0 points; gap and contact" in cautions
    return out, output


def test_the_run_folder_holds_everything(finished):
    out, table = finished
    for name in (
        "case.toml",
        "log.txt",
        "report.html",
        "micro_response.nc",
        "interface_law.nc",
        "macro_result.nc",
        "micro/realisation-0000.nc",
        "fields/contact-0000.vtu",
        "figures/surface.png",
        "figures/contact_map.png",
        "figures/gap_law.png",
        "figures/area_law.png",
        "figures/joint_stiffness.png",
        "figures/error_budget.png",
    ):
        assert (out / name).stat().st_size > 0, name
    assert "preload  joint stiffness" in table
    assert "realisation 3: 4 of 4" in (out / "log.txt").read_text(encoding="utf-8")


@pytest.mark.skipif(which("chromium") is None, reason="needs the browser chromium")
@pytest.mark.parametrize("width", [360, 1200])
def test_a_browser_opens_the_report_without_a_word(finished, tmp_path, width):
    page, picture = finished[0] / "report.html", tmp_path / "page.png"
    command = [
        "chromium",
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-background-networking",
        f"--user-data-dir={tmp_path / 'profile'}",
        f"--window-size={width},2000",
        f"--screenshot={picture}",
        "--enable-logging=stderr",
        page.resolve().as_uri(),
    ]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    assert "CONSOLE" not in shown.stderr
    pixels = imread(picture)
    assert pixels.shape[1] == width
    assert np.ptp(pixels) > 0.9  # ink on paper


def test_the_datasets_open_as_one_tree_and_agree(finished):
    tree = open_run(finished[0])
    response, law, result = (
        tree[name].to_dataset() for name in ("micro_response", "interface_law", "macro_result")
    )
    assert response["converged"].values.all()
    carried = -response["traction"].sel(component="n").values
    assert carried == pytest.approx(
        np.broadcast_to(response["nominal_pressure"].values, carried.shape)
    )
    # uniform pressure: the joint is blocks and interface in series
    normal = law_from_dataset(law)
    gap = normal.gap_at(result["preload"].values)
    expected = closed_form.series(normal.stiffness(gap), result["solid_stiffness"].values)
    np.testing.assert_allclose(result["joint_stiffness"], expected, rtol=1e-7)
    np.testing.assert_allclose(result["mean_gap"], gap, rtol=1e-7)
    known = result["error_half_width"].sel(quantity="joint_stiffness").dropna("error_term")
    assert list(known["error_term"].values) == [
        "sampling",
        "fit",
        "increments",
        "small slopes",
        "surface",
        "scale separation",
        "few cells",
        "model discrepancy",
        "macro discretisation",
    ]
    # even pressure: a closed form, without a mesh
    assert np.all(known.sel(error_term="macro discretisation") == 0.0)
    low, high = np.percentile(result["joint_stiffness_sample"], (2.5, 97.5), axis=0)
    assert np.all(
        (low <= result["joint_stiffness"].values) & (result["joint_stiffness"].values <= high)
    )


def test_fields_belong_to_the_contact(finished):
    import meshio

    fields = xr.load_dataset(finished[0] / "fields" / "fields.nc", engine="h5netcdf")
    np.testing.assert_allclose(fields["pressure"].mean(("x", "y")), fields["nominal_pressure"])
    mesh = meshio.read(finished[0] / "fields" / "contact-0003.vtu")
    np.testing.assert_allclose(
        mesh.point_data["pressure"], fields["pressure"].values[3].ravel(), rtol=1e-12
    )


@pytest.mark.slow
@pytest.mark.usefixtures("without_pages")
def test_a_second_run_keeps_the_cells_and_gives_the_same_law(shipped_run, command, tmp_path):
    out = copytree(shipped_run("ground_steel")[0], tmp_path / "again")
    before = (out / "micro" / "realisation-0002.nc").stat().st_mtime_ns
    law = open_law(out / "interface_law.nc")
    status, _, output = command(
        "run", "ground_steel", "-o", out, "--quick", "--jobs", "1", "--resume"
    )
    assert status == 0, output
    assert "0 of 4 realisations" not in output
    assert (out / "micro" / "realisation-0002.nc").stat().st_mtime_ns == before
    xr.testing.assert_equal(law, open_law(out / "interface_law.nc"))


@pytest.mark.slow
def test_micro_and_fit_do_only_the_first_half(command, tmp_path):
    small = FLAT.replace("[128, 128]", "[64, 64]").replace("realisations = 5", "realisations = 2")
    (tmp_path / "small.toml").write_text(small, encoding="utf-8")
    status, _, output = command("micro", "small.toml", "-o", "a/response.nc", "--jobs", "1")
    assert status == 0, output
    status, _, output = command("fit", "a/response.nc", "-o", "law.nc")
    assert status == 0, output
    assert open_law(tmp_path / "law.nc").attrs["n_realisations"] == 2


@pytest.mark.slow
def test_a_disk_that_fills_in_mid_run_deletes_nothing(tmp_path, monkeypatch):
    from multiscale.errors import MultiscaleError

    (tmp_path / "case.toml").write_text(FLAT, encoding="utf-8")
    case = load_case(tmp_path / "case.toml").quick()
    room, fsync = [3], os.fsync  # the case and two cells

    def full(descriptor):
        if room[0] == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        room[0] -= 1
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(MultiscaleError, match="no space left on device; finished results stay"):
        run(case, tmp_path / "out")
    files = sorted(path.name for path in (tmp_path / "out" / "micro").iterdir())
    assert files == ["realisation-0000.nc", "realisation-0001.nc"]
    monkeypatch.undo()
    counts = []
    run(case, tmp_path / "out", progress=lambda *told: counts.append(told))
    assert counts[0] == (2, case.micro.realisations, "realisations")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "size", "detrend"), [("tmd-1.tmd", "9 mm", 2), ("al3d-1.al3d", "60 um", 2)]
)
def test_the_whole_chain_runs_on_measured_files(reference_data, tmp_path, file, size, detrend):
    text = steel_text()
    start, end = text.index("rms_height"), text.index("\n\n[body_2]")
    source = reference_data / "topography" / file
    text = text[:start] + f'file = "{source}"\ndetrend_order = {detrend}' + text[end:]
    second = text.index("[body_2.surface]")
    text = text[:second] + text[text.index("[cell]") :]
    text = text.replace('"800 um", "800 um"', f'"{size}", "{size}"').replace(
        "[128, 128]", "[64, 64]"
    )
    text = text.replace("realisations = 5", "realisations = 3")
    (tmp_path / "case.toml").write_text(text, encoding="utf-8")
    results = run(load_case(tmp_path / "case.toml"), tmp_path / "out")
    assert results.micro_response["converged"].values.all()
    assert results.macro_result["converged"].values.all()
    assert np.all(np.diff(results.macro_result["joint_stiffness"]) > 0.0)


@pytest.mark.slow
def test_a_rough_joint_takes_the_law_of_a_run_as_it_is(finished, tmp_path):
    file, E, height = finished[0] / "interface_law.nc", 210e9, 0.01
    before = file.read_bytes()
    write_scene(tmp_path, TWO_BLOCKS, ('"20 MPa"', '"20 MPa", "80 MPa"'))
    result = run_macro(load_case(tmp_path / "scene.toml"), tmp_path / "blocks.nc", law=file)
    law = law_from_dataset(open_law(file))
    interface = law.stiffness(law.gap_at(result["preload"].values))
    expected = closed_form.series(E / height, interface, E / height)
    np.testing.assert_allclose(result["joint_stiffness"], expected, rtol=1e-6)
    np.testing.assert_allclose(-result["traction"][:, 0, 0], result["preload"], rtol=1e-6)
    of_law = open_law(file).attrs["cautions"].splitlines()
    *of_structure, of_mesh = result.attrs["cautions"].splitlines()
    assert of_structure == [f"its law: {item}" for item in of_law]
    assert of_mesh.startswith("the error of the mesh is unknown")  # one element a block
    # one cell of .8 mm in a joint of 20 mm, and the parts of the law that are computed in a run
    total = result["error_total"].drop_sel(quantity="solid_stiffness")  # hangs on no law
    # few coarse samples may differ by more than first order holds: the interval is not known there
    known = total.notnull()
    assert known.drop_sel(quantity="interface_stiffness").all()
    assert known[:, -1].all()
    assert np.all((total > 0.0) & (total < 1.0) | ~known)
    assert "cell 0.04 of the interface" in result.attrs["how_scale_separation"]
    # one layer of elements cannot be made coarser
    unknown = ["cell size", "micro discretisation", "macro discretisation"]
    of_law = open_law(file)["error_half_width"].sel(quantity="stiffness", error_term="sampling")
    if np.isnan(of_law).all():
        unknown.insert(0, "sampling")
    assert result.attrs["unknown"] == ", ".join(unknown)
    assert file.read_bytes() == before
