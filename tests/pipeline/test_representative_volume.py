"""Representative volumes of cases: their answers, and how bodies and interfaces take them."""

import numpy as np
import pytest
from typer.testing import CliRunner

from multiscale.cli import app
from multiscale.errors import CaseError
from multiscale.fe.mesh_file import box_mesh
from multiscale.io import open_dataset
from multiscale.micro.damage import youngs_modulus_along
from multiscale.pipeline import load_case, run
from multiscale.pipeline.stages.volumes import is_representative
from multiscale.report import open_finished
from multiscale.schema import RVE
from tests.support import case_text, write_body, write_scene

TEXT = """
title = "Pores"
[rve]
youngs_modulus = "70 GPa"
poissons_ratio = 0.3
size = "1 mm"
voxels = 10
level = 0
sections = 5
"""
RECIPE = """
[rve.recipe]
porosity = 0.12
pore_radius = "140 um"
realisations = 3
"""
CRACK = """
[[rve.cracks]]
centre = ["0.5 mm", "0.5 mm", "0.5 mm"]
normal = [1, 0, 0]
radius = "0.4 mm"
"""
CRACKED = ("pore_radius", 'crack_density = 0.1\ncrack_radius = "140 um"\npore_radius')
BAR = case_text("porous_bar")


@pytest.fixture(scope="module")
def pores(tmp_path_factory):
    """Datasets of volumes from a recipe, and the folder of their run."""
    folder = tmp_path_factory.mktemp("pores")
    return run(load_case(write_scene(folder, TEXT + RECIPE)), folder / "out")["rve"], folder / "out"


def test_sides_bound_the_stiffness_and_intervals_hold_it(pores):
    rve, _ = pores
    soft, periodic, stiff = np.moveaxis(rve["apparent_modulus"].to_numpy(), 1, 0)
    assert np.all(soft < periodic)
    assert np.all(periodic < stiff)
    low, high = rve["modulus_mean_law"].to_numpy()
    further_low, further_high = rve["modulus_one_part"].to_numpy()
    assert np.all((further_low < low) & (high < further_high))
    error = rve["modulus_error"].to_numpy()
    whole = rve["share"].to_numpy() == 1.0
    gap = (periodic - soft)[whole].mean(axis=0), (stiff - periodic)[whole].mean(axis=0)
    np.testing.assert_allclose(error[1], np.maximum(*gap) / rve["modulus"], rtol=1e-9)
    np.testing.assert_allclose(
        (high - low) / 2.0, rve["modulus"] * np.sqrt((error**2).sum(axis=0)), rtol=1e-9
    )


def test_smaller_volumes_have_wider_bounds_and_worse_sections(pores):
    rve, _ = pores
    E = rve["apparent_modulus"].to_numpy().mean(axis=2)
    whole = rve["share"].to_numpy() == 1.0
    gap = E[:, 2] - E[:, 0]
    assert gap[whole].mean() < 0.8 * gap[~whole].mean()
    worst = rve["largest_damage"].to_numpy().max(axis=1)
    assert worst[whole].mean() < worst[~whole].mean()
    assert "not representative within 5 %" in is_representative(rve)
    wide = rve.assign_attrs(accept=0.9)
    assert "is representative within 90 %" in is_representative(wide)
    few = wide.assign_attrs(limits="a volume has 2 pores")
    assert is_representative(few) == "The volume is not representative: a volume has 2 pores."


# spheres of radius r in a cube of edge L: each is 4/3 pi (r/L)^3 of it
@pytest.mark.parametrize(
    ("pairs", "porosity", "sentence"),
    [
        pytest.param([], 0.115, [], id="enough"),
        pytest.param([], 0.105, ["porosity of 10.5 % instead of 12 %"], id="too sound"),
        pytest.param([CRACKED], 0.16, [], id="voxels of cracks"),
        pytest.param([CRACKED], 0.105, ["porosity of 10.5 %"], id="too sound, with cracks"),
        pytest.param(
            [("140 um", "200 um"), ("0.12", "0.05")],
            4.0 / 3.0 * np.pi * 0.2**3,
            ["a volume has 1.5 pores, and 10 need edges of about 1.89 mm", "porosity of 3.35 %"],
            id="one of one and a half",
        ),
        pytest.param(
            [('size = "1 mm"', 'size = ["0.7 mm", "2 mm", "2 mm"]')],
            0.12,
            ["pores are 0.4 of the shortest edge across"],
            id="thin",
        ),
    ],
)
def test_volumes_that_differ_from_the_request_are_not_representative(
    tmp_path, pairs, porosity, sentence
):
    rve = load_case(write_scene(tmp_path, TEXT + RECIPE, *pairs)).rve
    limits = list(rve.limits(porosity))
    assert len(limits) == len(sentence)
    assert all(part in limit for part, limit in zip(sentence, limits, strict=True))


def test_a_size_study_reports_which_of_its_volumes_hold_no_pore(tmp_path):
    pairs = ("140 um", "200 um"), ("sections = 5", "sections = 2\nparts = [0.4, 0.6]")
    text = (TEXT + RECIPE).replace("realisations = 3", "realisations = 2")
    rve = run(load_case(write_scene(tmp_path, text, *pairs)), tmp_path / "out")["rve"]
    cautions = rve.attrs["cautions"]
    assert "a volume has 3.6 pores, and 10 need edges of about 1.41 mm" in cautions
    assert (
        "volumes of 0.6 of the size and less in the size study contain fewer than one" in cautions
    )
    lines = list(open_finished(tmp_path / "out").lines(details=True))
    assert any("3.6 pores" in line for line in lines)
    assert any("0.77 pores" in line for line in lines)


# validation 3.1: one sphere in a cube of edge L has D = pi r^2 / L^2 normal to its edges
def test_a_listed_pore_has_the_damage_of_its_section(tmp_path):
    pore = '[[rve.pores]]\ncentre = ["0.2 mm", "0 mm", "0.7 mm"]\nradius = "0.3 mm"\n'
    text = TEXT.replace("sections = 5", "sections = 10\nparts = []") + pore
    rve = run(load_case(write_scene(tmp_path, text)), tmp_path / "out")["rve"]
    along_x = int(np.argmax(np.abs(rve["normal"].to_numpy()[:, 0])))
    # the nearest of ten sections lies at 50 um from the centre
    assert float(rve["damage"][along_x]) == pytest.approx(np.pi * (0.3**2 - 0.05**2), rel=1e-9)
    assert np.isnan(rve["scatter"]).all()
    assert "a single volume has no scatter" in rve.attrs["cautions"]


@pytest.mark.parametrize(("edge", "known"), [(0.5, True), (0.6, False)])
def test_only_parts_that_do_not_overlap_give_the_scatter_of_one_volume(edge, known, tmp_path):
    pores = "".join(
        f'[[rve.pores]]\ncentre = ["{x} mm", "{y} mm", "0.4 mm"]\nradius = "0.15 mm"\n'
        for x, y in ((0.2, 0.3), (0.7, 0.6))
    )
    text = TEXT.replace("sections = 5", f"sections = 2\nparts = [{edge}]") + pores
    rve = run(load_case(write_scene(tmp_path, text)), tmp_path / "out")["rve"]
    assert np.isfinite(rve["scatter"]).all() == known
    assert np.isfinite(rve["modulus_mean_law"]).all() == known
    assert ("a single volume has no scatter" in rve.attrs["cautions"]) != known


# validation 3.1: through cylinders along n have D(n) = porosity and E (1 - D) exactly
def channel(floating):
    """Pages z, y, x of a void channel along z, maybe with a cube of solid that floats in it."""
    void = np.zeros((8, 8, 8), dtype=np.uint8)
    void[:, 2:6, 2:6] = 1
    if floating:
        void[3:5, 3:5, 3:5] = 0
    return void


def test_solid_that_floats_in_voids_is_void(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    tifffile.imwrite(tmp_path / "channel.tif", channel(floating=True))
    text = TEXT.replace('size = "1 mm"\n', "") + '[rve.image]\nfile = "channel.tif"\n'
    path = write_scene(tmp_path, text + 'void_value = 1\nvoxel_size = "5 um"\n')
    rve = load_case(path).rve
    assert rve.first().porosity == 0.25
    assert rve.image.read().porosity == 0.25 - 8 / 512


@pytest.mark.slow
@pytest.mark.parametrize("floating", [False, True])
def test_an_image_with_channels_is_softer_by_their_section(tmp_path, monkeypatch, floating):
    tifffile = pytest.importorskip("tifffile")
    void = channel(floating)
    tifffile.imwrite(tmp_path / "channel.tif", void)
    monkeypatch.chdir(tmp_path)
    command = ["damage", "channel.tif", "--youngs-modulus", "70 GPa", "--void-value", "1"]
    command += ["--voxel-size", "5 um", "--poissons-ratio", "0", "--quick", "--quiet", "--jobs=1"]
    assert CliRunner().invoke(app, command).exit_code == 0
    rve = open_dataset(tmp_path / "damage" / "rve.nc", RVE)
    z = int(np.argmax(np.abs(rve["normal"].to_numpy()[:, 2])))
    assert float(rve["damage"][z]) == pytest.approx(0.25, rel=1e-12)
    whole = rve["share"].to_numpy() == 1.0
    moduli = rve["apparent_modulus"].to_numpy()[whole][0, :, z]
    np.testing.assert_allclose(moduli, 0.75 * 70e9, rtol=1e-6)  # whatever the sides
    assert ("1e+03 µm³, 2 % of it, is not connected" in rve.attrs["cautions"]) == floating


@pytest.fixture(scope="module")
def bar(tmp_path_factory):
    """Bar along z of a solid with a crack normal to its local x, which lies along z."""
    folder = tmp_path_factory.mktemp("bar")
    write_body(folder / "bar.msh", box_mesh((4e-3, 3e-3, 9e-3), (1, 1, 2)))
    case = load_case(write_scene(folder, TEXT + CRACK + BAR))
    return case, run(case, folder / "out")


def test_a_bar_has_the_stiffness_of_its_volume_along_the_turned_axis(bar):
    _, computed = bar
    C = computed["rve"]["stiffness"].to_numpy()
    along_x, along_z = youngs_modulus_along(C, np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    assert along_x < 0.8 * along_z
    stiffness = float(computed["macro_result"]["load_stiffness"][-1, 0])
    assert stiffness == pytest.approx(along_x * 12e-6 / 9e-3, rel=1e-9)


def test_the_errors_of_the_volume_reach_the_bar(bar):
    _, computed = bar
    rve, result = computed["rve"], computed["macro_result"]
    budget = result["error_half_width"].isel(quantity=0, step=-1)
    largest = rve["modulus_error"].max("direction")
    for term, cause in (
        ("sampling", "sampling"),
        ("scale separation", "sides"),
        ("micro discretisation", "elements"),
    ):
        expected = float(largest.sel(rve_error=cause)) / 1.02  # of a secant over 2 %
        assert float(budget.sel(error_term=term)) == pytest.approx(expected, rel=0.03)
    low, high = result["load_stiffness_mean_law"].to_numpy()[:, -1, 0]
    assert low < float(result["load_stiffness"][-1, 0]) < high


def test_sections_next_to_an_interface_damage_it(tmp_path):
    write_body(tmp_path / "bar.msh", box_mesh((4e-3, 3e-3, 9e-3), (1, 1, 2)))
    law = """
[[structure.interfaces]]
sides = ["ground", "bar.bottom"]
friction = 0.2
stiffness_ratio = 0.8
surface_damage = true
[structure.interfaces.exponential]
pressure_scale = "1 GPa"
decay_length = "0.3 um"
pressures = ["0.1 MPa", "100 MPa"]
"""
    text = TEXT + "parts = []" + RECIPE + BAR.replace('bottom = "z", ', "") + law
    text = text.replace('[0, 0, "1 kN"]', '[0, 0, "-1 kN"]')
    case = load_case(write_scene(tmp_path, text))
    result = run(case, tmp_path / "out")
    rve = result["rve"]
    known = case.structure.with_volumes(case, result, lambda file, quick: rve)
    whole = rve["share"].to_numpy() == 1.0
    along_x = int(np.argmax(np.abs(rve["normal"].to_numpy()[:, 0])))  # which is along z
    damage = rve["mean_damage"].to_numpy()[whole, along_x].mean()
    assert known.interfaces[0].damage == pytest.approx(damage, rel=1e-12)
    assert float(result["macro_result"]["point_damage"].mean()) == pytest.approx(damage)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        pytest.param(
            TEXT + RECIPE.replace("0.12", "0.6"), "too large for random addition", id="packing"
        ),
        pytest.param(
            TEXT.replace('size = "1 mm"', "") + '[rve.image]\nfile = "no.tif"\n',
            "no such file",
            id="no image",
        ),
    ],
)
def test_an_impossible_volume_is_refused_before_anything_is_computed(tmp_path, text, sentence):
    case = load_case(write_scene(tmp_path, text))
    with pytest.raises(CaseError, match=sentence):
        run(case, tmp_path / "out")


def test_a_body_with_a_volume_that_is_cut_through_is_refused(tmp_path):
    write_body(tmp_path / "bar.msh", box_mesh((4e-3, 3e-3, 9e-3), (1, 1, 2)))
    whole = "parts = []" + CRACK.replace("0.4 mm", "2 mm")
    case = load_case(write_scene(tmp_path, TEXT + whole + BAR))
    with pytest.raises(CaseError, match="cut through, D = 1"):
        run(case, tmp_path / "out")


def test_a_volume_larger_than_its_body_is_reported(tmp_path):
    write_body(tmp_path / "bar.msh", box_mesh((4e-4, 3e-4, 9e-4), (1, 1, 2)))
    case = load_case(write_scene(tmp_path, TEXT + "parts = []" + CRACK + BAR))
    result = run(case, tmp_path / "out")
    assert "is larger than the body is thick" in result["macro_result"].attrs["cautions"]
