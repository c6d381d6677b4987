"""Scenes of substructures and rough joints: reports, solutions and refusals."""

import re

import meshio
import numpy as np
import pytest
import xarray as xr
from typer.testing import CliRunner

from multiscale.cli import app
from multiscale.errors import CaseError, SchemaError
from multiscale.io import open_dataset, open_law, save_law, write_dataset
from multiscale.io.images import VoxelImage
from multiscale.laws import Exponential, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import solve_static, tensegrity_grid
from multiscale.micro.damage.rve import measure_volume, represent
from multiscale.pipeline import load_case, run, run_macro
from multiscale.pipeline.tables.link_settings import TensegrityGrid
from multiscale.schema import HOMOGENISED, MACRO_RESULT, RVE
from multiscale.upscaling import error_budget, fit_law, law_from_dataset, with_budget
from tests.closed_forms.joint import series
from tests.support import SCENES, TWO_BLOCKS, write_law, write_scene
from tests.upscaling.responses import response_of

GRID = (SCENES / "tensegrity_substructures.toml").read_text(encoding="utf-8")
PLATE = (SCENES / "plate.toml").read_text(encoding="utf-8")
MOVING = (SCENES / "sudden_unloading.toml").read_text(encoding="utf-8")
MESHED = (("thin", 1, 1), ("thick", 2, 1), ("held", 3, 0))  # sets of lines and points
BLOCKS = TWO_BLOCKS.replace("friction", 'law = "law.nc"\nfriction')


@pytest.fixture
def blocks(tmp_path):
    write_law(tmp_path / "law.nc")
    return write_scene(tmp_path, BLOCKS)


def expected_stiffness(path, pressure, damage=(0.0, 0.0, 0.0)):
    """Springs in series: lower block, joint, upper block."""
    law = law_from_dataset(open_law(path))
    lower, joint, upper = (1.0 - D for D in damage)
    gap = law.gap_at(np.asarray(pressure) / joint)
    block = 210e9 / 0.01
    return series(lower * block, joint * law.stiffness(gap), upper * block)


def test_a_cut_grid_has_the_tensions_of_the_whole_grid(tmp_path):
    scene = load_case(write_scene(tmp_path, GRID, ("[4, 4]", "[2, 3]"), ("n = 16", "n = 6")))
    run_macro(scene, tmp_path / "grid.nc")
    result = open_dataset(tmp_path / "grid.nc", MACRO_RESULT)
    expected = solve_static(tensegrity_grid(6), [0.25, 0.5, 1.0])
    scale = np.abs(expected.tension.values).max()
    np.testing.assert_allclose(result.tension, expected.tension, rtol=0.0, atol=1e-7 * scale)
    np.testing.assert_array_equal(result.ends, expected.ends)
    assert result.attrs["substructures"] == 6
    assert (tmp_path / "fields" / "grid.pvd").is_file()


def test_a_cut_grid_moves_like_the_whole_grid(tmp_path):
    pairs = [
        ("n = 16", 'n = 4\nprestress = "160 N"'),
        ('"0.5 s"', '"0.05 s"'),
        ("theta = 0.5", "theta = 1"),
    ]
    whole = run_macro(load_case(write_scene(tmp_path, MOVING, *pairs)), tmp_path / "whole.nc")
    pairs.append(("[dynamics]", "[substructures]\nparts = [2, 1]\n[dynamics]"))
    run_macro(load_case(write_scene(tmp_path, MOVING, *pairs)), tmp_path / "cut.nc")
    cut = open_dataset(tmp_path / "cut.nc", MACRO_RESULT)
    assert cut["converged"].values.all()
    for name in ("displacement", "tension"):
        scale = np.abs(whole[name].values).max()
        np.testing.assert_allclose(cut[name], whole[name], rtol=0.0, atol=1e-5 * scale)
    assert (tmp_path / "fields" / "cut.pvd").is_file()


def test_homogenised_substructures_of_a_case_at_rest_and_in_motion(tmp_path):
    cut = ("[4, 4]", '[2, 2]\nmodel = "adaptive"')
    scene = write_scene(tmp_path, GRID, cut, ("n = 16", 'n = 8\nprestress = "640 N"'))
    result = run_macro(load_case(scene), tmp_path / "grid.nc")
    expected = solve_static(tensegrity_grid(8, prestress=640.0), [0.25, 0.5, 1.0])
    assert result.attrs["resolved"] == 4
    assert result["slack_links"][-1] > 0
    scale = np.abs(expected.tension.values).max()
    np.testing.assert_allclose(result.tension, expected.tension, rtol=0.0, atol=1e-6 * scale)
    pairs = [
        ("n = 16", "n = 8"),
        ('"0.5 s"', '"0.05 s"'),
        ("theta = 0.5", "theta = 1"),
        ("[dynamics]", '[substructures]\nparts = [2, 2]\nmodel = "adaptive"\n[dynamics]'),
    ]
    moved = run_macro(load_case(write_scene(tmp_path, MOVING, *pairs)), tmp_path / "moved.nc")
    pairs[-1] = ("[dynamics]", "[substructures]\nparts = [2, 2]\n[dynamics]")
    whole = run_macro(load_case(write_scene(tmp_path, MOVING, *pairs)), tmp_path / "whole.nc")
    assert moved["converged"].values.all()
    for name, error in (("displacement", 5e-3), ("tension", 3e-2)):  # near corners
        scale = np.abs(whole[name].values).max()
        np.testing.assert_allclose(moved[name], whole[name], rtol=0.0, atol=error * scale)


def test_homogenised_substructures_with_slack_links_follow_the_law_of_their_modules(tmp_path):
    cut = ("[4, 4]", '[4, 4]\nmodel = "homogenised"')
    result = run_macro(load_case(write_scene(tmp_path, GRID, cut)), tmp_path / "grid.nc")
    assert result["converged"].values.all()
    expected = solve_static(tensegrity_grid(16), [0.25, 0.5, 1.0])
    off = np.abs(result["tension"] - expected["tension"])
    assert np.all((off < result["tension_error"]).mean("link") > 0.95)
    slack = (expected["slack"] > 0.0).sum("link")
    assert np.all(np.abs(result["slack_links"] - slack) <= result["slack_links_error"])
    cut = ("[4, 4]", '[4, 4]\nmodel = "adaptive"')
    whole = run_macro(load_case(write_scene(tmp_path, GRID, cut)), tmp_path / "whole.nc")
    assert (whole.attrs["resolved"], whole.attrs["unknowns"]) == (16, 2397)
    np.testing.assert_array_equal(whole["tension"], expected["tension"])
    cut = ("[4, 4]", '[4, 4]\nmodel = "homogenised"')
    few = ("n = 16", "n = 12")  # too few for a specimen: links must not slacken
    refused = run_macro(load_case(write_scene(tmp_path, GRID, cut, few)), tmp_path / "few.nc")
    assert "use the model adaptive" in refused.attrs["failure"]


@pytest.mark.slow
def test_intervals_by_modules_of_elements_that_are_not_square_cover(tmp_path):
    uneven = [("n = 16", "n = 32"), ("[4, 4]", '[4, 8]\nmodel = "homogenised"')]
    factors = [0.03, 0.04, 0.1, 1.0]
    expected = solve_static(tensegrity_grid(32), factors)
    steps = {}
    for given in (factors, [0.04]):
        pairs = [*uneven, ("[0.25, 0.5, 1.0]", str(given))]
        case = load_case(write_scene(tmp_path, GRID, *pairs))
        steps[len(given)] = run_macro(case, tmp_path / f"{len(given)}.nc")
    result = steps[4]
    pull, pulled = (data["tension"].max("link") for data in (result, expected))
    assert np.all(np.abs(pull - pulled) < result["largest_tension_error"] * pull)
    slack, slackened = ((data["slack"] > 0.0).sum("link") for data in (result, expected))
    assert np.all(np.abs(slack - slackened) <= result["slack_links_error"])
    # a step has the same law whatever the others are
    np.testing.assert_allclose(steps[1]["tension"][0], result["tension"][1], rtol=1e-4, atol=0.1)


@pytest.mark.parametrize(
    ("n", "m", "parts"),
    [(32, 8, [4, 4]), (64, 16, [8, 2]), (32, 16, [4, 8]), (32, 32, [2, 8]), (32, 32, [2, 16])],
)
def test_too_few_elements_or_modules_have_no_law_of_modules(n, m, parts):
    assert TensegrityGrid(kind="tensegrity_grid", n=n, m=m).modules(parts) == ()


def test_specimens_have_whole_modules_in_every_element():
    grid = TensegrityGrid(kind="tensegrity_grid", n=48, m=24, prestress="9000 N")
    plate, specimen = grid.modules((6, 4))
    assert (plate.size, specimen.size, specimen.elements) == ((48, 24), (24, 12), (6, 4))
    np.testing.assert_allclose(specimen.system.prestress.max(), plate.system.prestress.max() / 4.0)


def test_homogenised_substructures_of_links_from_tables(tmp_path):
    grid = tensegrity_grid(8)
    nodes = [f"{axis}" for axis in "xyz"] + [f"fix_{axis}" for axis in "xyz"] + ["load_z"]
    values = np.column_stack([grid.position, grid.fixed, grid.load[:, 2]])
    rows = [",".join(f"{value!r}" for value in row) for row in values.tolist()]
    (tmp_path / "nodes.csv").write_text("\n".join([",".join(nodes), *rows]), encoding="utf-8")
    names = np.array(["rope", "tube"])[grid.kind]
    columns = zip(*grid.ends.T, names, grid.prestress.tolist(), grid.group, strict=True)
    links = ["first,second,law,prestress,group"]
    links += [f"{a},{b},{name},{force!r},{group}" for a, b, name, force, group in columns]
    (tmp_path / "links.csv").write_text("\n".join(links), encoding="utf-8")
    table = """kind = "table"
nodes = "nodes.csv"
links = "links.csv"
laws.rope = {kind = "cable", rigidity = "4e6 N"}
laws.tube = {kind = "bar", rigidity = "8e7 N"}"""
    cut = ("[4, 4]", '[2, 2]\nmodel = "adaptive"')
    scene = write_scene(tmp_path, GRID, cut, ('kind = "tensegrity_grid"\nn = 16', table))
    result = run_macro(load_case(scene), tmp_path / "grid.nc")
    expected = solve_static(grid, [0.25, 0.5, 1.0])
    size = np.abs(expected.displacement.values).max()
    np.testing.assert_allclose(
        result["displacement"], expected["displacement"], rtol=0.0, atol=1e-3 * size
    )
    assert result.attrs["unknowns"] <= np.count_nonzero(~grid.fixed)


def test_a_cut_net_resists_by_its_prestress(tmp_path):
    net = (SCENES / "cable_net.toml").read_text(encoding="utf-8")
    scene = net[: net.index("[statics]")].replace('"1.7 kN"', '"20 N"')
    scene += '[substructures]\nparts = [2, 2]\nmodel = "adaptive"\n[statics]\nload_factors = [1]\n'
    case = load_case(write_scene(tmp_path, scene))
    result = run_macro(case, tmp_path / "net.nc")
    exact = solve_static(case.structure.build(), [1.0], exact=True)["displacement"]
    size = np.abs(exact.values).max()
    np.testing.assert_allclose(result["displacement"], exact, rtol=0.0, atol=0.01 * size)
    assert not result.attrs["cautions"]  # the prestress is counted


@pytest.mark.parametrize("model", ["homogenised", "adaptive"])
def test_homogenised_substructures_of_the_lines_of_a_mesh(tmp_path, model):
    grid = tensegrity_grid(8)
    held = np.flatnonzero(grid.fixed.all(axis=1))
    count, points = grid.n_links, np.arange(held.size)
    mesh = meshio.Mesh(
        1e3 * grid.position,
        [("line", grid.ends), ("vertex", held[:, None])],
        cell_data={
            "gmsh:physical": [np.where(grid.kind == 0, 1, 2), 0 * points + 3],
            "gmsh:geometrical": [np.ones(count, int), 0 * points + 3],
        },
        field_data={name: np.array([k, d]) for name, k, d in MESHED},
    )
    mesh.write(tmp_path / "grid.msh", file_format="gmsh22", binary=False)
    table = """kind = "mesh"
file = "grid.msh"
unit = "1 mm"
supports = ["held"]
load = ["0 N", "0 N", "-40 N"]
laws.thin = { kind = "bar", rigidity = "4 MN" }
laws.thick = { kind = "bar", rigidity = "80 MN" }"""
    cut = ("[4, 4]", f'[2, 2]\nmodel = "{model}"')
    scene = write_scene(tmp_path, GRID, cut, ('kind = "tensegrity_grid"\nn = 16', table))
    case = load_case(scene)
    result = run_macro(case, tmp_path / "grid.nc")
    assert result.attrs["resolved"] == 0  # bars never slacken
    expected = solve_static(case.structure.build(), case.statics.load_factors)
    size = np.abs(expected["displacement"].values).max()
    np.testing.assert_allclose(
        result["displacement"], expected["displacement"], rtol=0.0, atol=5e-3 * size
    )


def test_homogenised_plates_are_refused(tmp_path):
    plate = (SCENES / "plate.toml").read_text(encoding="utf-8")
    scene = write_scene(
        tmp_path, plate, ("[substructures]", '[substructures]\nmodel = "homogenised"')
    )
    with pytest.raises(CaseError, match="consist of links, unlike a structure of kind 'plate'"):
        load_case(scene)


def test_condensed_substructures_are_written_next_to_the_result(tmp_path, blocks):
    grid = ("n = 16", 'n = 4\nprestress = "160 N"')
    scene = write_scene(tmp_path, GRID, grid, ("[4, 4]", "[2, 2]\nhomogenise = true"))
    out = tmp_path / "grid.nc"
    done = CliRunner().invoke(app, ["macro", str(scene), "-o", str(out)])
    assert done.exit_code == 0, done.output
    file = tmp_path / "grid-homogenised.nc"
    assert f"homogenised: {file}" in done.output
    dataset = open_dataset(file, HOMOGENISED)
    assert dataset.sizes["substructure"] == 4
    slack = open_dataset(out, MACRO_RESULT)["slack"].values[-1] > 0.0
    assert dataset["slack_links"].sum() == np.count_nonzero(slack) > 0
    taut, slackened = dataset["stiffness"].values
    assert np.trace(slackened[0]) < np.trace(taut[0])

    text = BLOCKS + "[substructures]\nparts = [1, 1]\nhomogenise = true\n"
    run_macro(load_case(write_scene(tmp_path, text)), tmp_path / "blocks.nc")
    condensed = open_dataset(tmp_path / "blocks-homogenised.nc", HOMOGENISED)
    assert condensed.sizes["substructure"] == 2


def test_the_plate_has_16_substructures_and_its_24_edge_interfaces(tmp_path):
    result = run_macro(load_case(write_scene(tmp_path, PLATE)), tmp_path / "plate.nc")
    whole = run_macro(
        load_case(write_scene(tmp_path, PLATE, ("[4, 4]", "[1, 1]"))), tmp_path / "one.nc"
    )
    assert result.attrs["substructures"] == 16
    assert result.attrs["interfaces"] == 24 + 9  # nine lines where four meet
    scale = np.abs(whole.displacement.values).max()
    np.testing.assert_allclose(result.displacement, whole.displacement, atol=1e-8 * scale)


def test_a_plate_bends_and_vibrates_as_a_clamped_beam(tmp_path):
    """The deflection of Timoshenko's beam, p L^4 / 32 E h^3 + p L^2 / 8 k G h, and Euler's mode."""
    narrow = [
        ('["4 m", "4 m", "0.2 m"]', '["1 m", "5 cm", "2 cm"]\ndensity = "2700 kg/m^3"'),
        ("[16, 16, 1]", "[40, 2, 2]"),
        ("poissons_ratio = 0.3", "poissons_ratio = 0"),
        ("[substructures]\nparts = [4, 4]\n", ""),
    ]
    case = load_case(write_scene(tmp_path, PLATE, *narrow))
    bent = run_macro(case, tmp_path / "bent.nc")
    E, h, p = 70e9, 0.02, 1e3
    deflection = p / (32.0 * E * h**3) + p / (8.0 * 5.0 / 6.0 * 0.5 * E * h)
    np.testing.assert_allclose(bent["largest_displacement"], deflection, rtol=5e-3)
    modes = write_scene(tmp_path, PLATE, *narrow, ("", '[vibration]\namplitudes = ["1 um"]\n'))
    result = run(load_case(modes), tmp_path / "modes")["vibration"]
    first = 22.3733 / (2.0 * np.pi) * np.sqrt(E * h**2 / 12.0 / 2700.0)
    np.testing.assert_allclose(result["mode_frequency"][0], first, rtol=5e-3)


def test_a_law_from_a_file_gives_springs_in_series_and_stays_as_it_is(blocks, tmp_path):
    before = (tmp_path / "law.nc").read_bytes()
    result = run_macro(load_case(blocks), tmp_path / "blocks.nc")
    expected = expected_stiffness(tmp_path / "law.nc", [5e6, 20e6])
    np.testing.assert_allclose(result.joint_stiffness, expected, rtol=1e-6)
    assert (tmp_path / "law.nc").read_bytes() == before


def test_the_law_of_the_command_comes_before_the_law_of_the_scene(blocks, tmp_path):
    scene = write_scene(tmp_path, BLOCKS, ('law = "law.nc"\n', ""))
    out = tmp_path / "blocks.nc"
    done = CliRunner().invoke(app, ["macro", str(scene), "-o", str(out)])
    assert done.exit_code == 1
    assert "no law: name a case or a file" in str(done.exception)
    law = str(tmp_path / "law.nc")
    done = CliRunner().invoke(app, ["macro", str(scene), "-o", str(out), "--law", law])
    assert done.exit_code == 0, done.output
    expected = expected_stiffness(law, [5e6, 20e6])
    rows = [line.split() for line in done.output.splitlines()]
    last = next(row for row in rows if row[:1] == ["20"])
    assert float(last[1]) == pytest.approx(1e-12 * expected[1], rel=1e-3)


@pytest.mark.slow
def test_blocks_have_the_tensor_of_a_representative_volume(blocks):
    along_z = 0.4 * 210e9
    solid, folder = VoxelImage(np.zeros((2, 2, 2)), (1.0, 1.0, 1.0)), blocks.parent
    volumes = measure_volume(solid, 210e9, 0.0, voxels=2, level=0, sections=1)
    rve = represent(volumes, solid, 210e9, 0.0, level=0)
    tensor = np.diag([150e9, 120e9, along_z, 60e9, 50e9, 40e9])
    write_dataset(RVE.assign(rve, {"stiffness": tensor}), folder / "rve.nc", RVE)
    moduli = 'youngs_modulus = "210 GPa"\npoissons_ratio = 0\n'
    given = 'rve = "rve.nc"\ndamage = [0.3, 0]\n'
    scene = load_case(write_scene(folder, BLOCKS, (moduli, given)))
    run_macro(scene, folder / "out.nc")
    dataset = open_dataset(folder / "out.nc", MACRO_RESULT)
    expected = expected_stiffness(folder / "law.nc", [5e6, 20e6], (0.72, 0.0, 0.6))
    np.testing.assert_allclose(dataset["joint_stiffness"], expected, rtol=1e-6)


def test_damage_of_blocks_and_joints_enters_their_springs(tmp_path):
    write_law(tmp_path / "law.nc")
    scene = write_scene(
        tmp_path,
        BLOCKS,
        ("poissons_ratio = 0", "poissons_ratio = 0\ndamage = [0.3, 0]"),
        ("friction = 0.2", "friction = 0.2\ndamage = [0.5]"),
    )
    result = run_macro(load_case(scene), tmp_path / "blocks.nc")
    expected = expected_stiffness(tmp_path / "law.nc", [5e6, 20e6], (0.3, 0.5, 0.0))
    np.testing.assert_allclose(result.joint_stiffness, expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("highest", "more", "status", "sentence"),
    [
        (10e6, "", 0, "the law extrapolates: up to 100 % of the load lies above the pressures"),
        (8e6, "", 0, "     20          unknown"),
        (8e6, "extrapolate = true\n", 0, "only extrapolated, and its error is unknown"),
        (2e6, "", 1, "preloads in [statics] press the joints by about 5 MPa to 20 MPa, more"),
    ],
)
def test_load_beyond_the_law_is_reported_on_the_command_line(
    tmp_path, highest, more, status, sentence
):
    law = write_law(tmp_path / "law.nc", (1e5, highest))
    scene = write_scene(tmp_path, BLOCKS, ("friction = 0.2\n", f"friction = 0.2\n{more}"))
    arguments = ["macro", str(scene), "-o", str(tmp_path / "blocks.nc"), "--law", str(law)]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == status
    assert sentence in f"{done.output}{done.exception}"


@pytest.mark.long
def test_the_shipped_lap_joint_is_known_with_the_shipped_law(run_folder, tmp_path):
    scene = load_case(SCENES / "lap_joint.toml").model_copy(update={"cycles": None})
    result = run_macro(scene, tmp_path / "lap.nc", law=run_folder / "interface_law.nc")
    assert result["known"].values.tolist() == [1, 1, 1]


def test_a_bolt_of_a_lap_joint_has_the_stiffness_of_its_shank(tmp_path):
    pytest.importorskip("gmsh", exc_type=Exception)
    text = (SCENES / "lap_joint.toml").read_text()
    bolt = ('washer = "18 mm"', 'washer = "18 mm"\nbolt = "8 mm"')
    structure = load_case(write_scene(tmp_path, text, bolt)).structure
    law = Sliders(Exponential(1e9, 0.2e-6), 0.2, pressures=(1e6, 1e8))
    steel = [Elastic(210e9, 0.3)] * 2
    (shank,) = structure.build(steel, [law]).bolts
    assert shank.stiffness == pytest.approx(210e9 * 0.25 * np.pi * 8e-3**2 / 16e-3)
    assert shank.preload == pytest.approx(0.25 * np.pi * (18e-3**2 - 9e-3**2), rel=0.05)  # of 1 Pa
    assert structure.model_copy(update={"bolt": None}).build(steel, [law]).bolts == ()
    wide = ('washer = "18 mm"', 'washer = "18 mm"\nbolt = "10 mm"')
    with pytest.raises(CaseError, match="bolt of 10 mm does not go through a hole of 9 mm"):
        load_case(write_scene(tmp_path, text, wide))


def test_a_lap_joint_with_small_elements_at_its_hole_reports_no_error_of_the_mesh():
    pytest.importorskip("gmsh", exc_type=Exception)
    joint = load_case(SCENES / "lap_joint.toml").structure
    ((ratio, larger),) = joint.model_copy(update={"element": 4e-3}).coarser().items()
    assert 1.2 < ratio < 1.6
    assert larger.element == 8e-3
    assert larger.coarser() == {}  # the same mesh: its answers would err by nothing


def test_a_scene_reports_its_real_pressure_and_the_size_of_its_cells(blocks, tmp_path):
    law = open_law(tmp_path / "law.nc")
    law = law.assign_attrs(cell_size=1e-3, behaviour="The answer is elastic.")
    save_law(law, tmp_path / "law.nc")
    result = run_macro(load_case(blocks), tmp_path / "blocks.nc")
    np.testing.assert_allclose(result.contact_fraction, [5e6 / 5e9, 20e6 / 5e9], rtol=1e-5)
    np.testing.assert_allclose(result.real_pressure, 5e9, rtol=1e-5)
    facts = result.attrs["facts"].splitlines()
    assert facts[0] == "The answer is elastic."
    assert facts[1] == "A cell of 1 mm is 0.05 of the edge of the interface, 20 mm."


@pytest.mark.slow
def test_blocks_that_slide_away_keep_their_steps_and_exit_with_capacity_and_load(tmp_path, blocks):
    scene = write_scene(tmp_path, BLOCKS + '[cycles]\nshear = "4.4 MPa"\ncycles = 1\nsteps = 2\n')
    out = tmp_path / "slid.nc"
    done = CliRunner().invoke(app, ["macro", str(scene), "-o", str(out), "--details"])
    assert done.exit_code == 1
    match = re.search(r"load of (\S+) N; .* carries about (\S+) N", str(done.exception))
    np.testing.assert_allclose(
        [float(group) for group in match.groups()], [1760.0, 1600.0], rtol=0.05
    )
    assert "cycle 0: not closed" in done.output
    assert "nan" not in done.output
    result = open_dataset(out, MACRO_RESULT)
    np.testing.assert_array_equal(result["converged"], [1, 1, 1] + 9 * [0])
    assert "the steps end before step 3: there is no equilibrium" in result.attrs["failure"]
    expected = expected_stiffness(tmp_path / "law.nc", [5e6, 20e6])
    np.testing.assert_allclose(result.joint_stiffness[:2], expected, rtol=1e-6)


@pytest.mark.slow
def test_steps_before_a_step_that_slides_away_keep_their_errors_in_the_print(tmp_path):
    p = np.geomspace(1e6, 2e8, 9)
    response = response_of(
        np.array([[0.98], [1.0], [1.03]]) * 0.2e-6 * np.log(2e9 / p), p, contact_modulus=115e9
    )
    law = fit_law(response, n_samples=0)
    save_law(with_budget(law, error_budget(response, law)), tmp_path / "law.nc")
    printed = []
    for shear in ("1 MPa", "4.4 MPa"):
        scene = write_scene(
            tmp_path, BLOCKS + f'[cycles]\nshear = "{shear}"\ncycles = 1\nsteps = 2\n'
        )
        arguments = ["macro", str(scene), "-o", str(tmp_path / "blocks.nc"), "--details"]
        done = CliRunner().invoke(app, arguments)
        printed.append(done.stdout.splitlines()[:5])
    assert done.exit_code == 1
    assert "±" in printed[0][3]
    assert printed[0] == printed[1]  # the preloads have not slid


def test_laws_of_other_units_or_kinds_are_refused(blocks, tmp_path):
    scene = load_case(blocks)
    law = open_law(tmp_path / "law.nc")
    wrong = law.assign(knot=law["knot"].assign_attrs(units="um"))
    wrong.to_netcdf(tmp_path / "units.nc", engine="h5netcdf")
    with pytest.raises(SchemaError, match="knot: units 'um', expected 'm'"):
        run_macro(scene, tmp_path / "out.nc", law=tmp_path / "units.nc")
    save_law(law.assign_attrs(family="tabulated"), tmp_path / "family.nc")
    with pytest.raises(CaseError, match="family 'tabulated', which is not built in"):
        run_macro(scene, tmp_path / "out.nc", law=tmp_path / "family.nc")
    xr.Dataset(attrs={"schema": "macro_result", "schema_version": 1}).to_netcdf(
        tmp_path / "kind.nc", engine="h5netcdf"
    )
    with pytest.raises(SchemaError, match="schema 'macro_result', expected a 'interface_law'"):
        run_macro(scene, tmp_path / "out.nc", law=tmp_path / "kind.nc")
    with pytest.raises(CaseError, match="has no joint for the law"):
        run_macro(
            load_case(write_scene(tmp_path, PLATE)), tmp_path / "out.nc", law=tmp_path / "law.nc"
        )
