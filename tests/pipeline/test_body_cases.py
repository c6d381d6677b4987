"""Cases of bodies with meshes of the user: answers and refusals."""

import re

import meshio
import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation
from skfem import MeshTet

from multiscale.errors import CaseError, ConvergenceError
from multiscale.executors import process_pool
from multiscale.fe.mesh_file import box_mesh
from multiscale.io import save_law
from multiscale.laws import Asperities, AsperityLaw
from multiscale.laws.asperities import gaussian_asperities
from multiscale.pipeline import load_case, run, run_macro
from multiscale.pipeline.stages.loaded_bodies import LOADED_BODIES
from multiscale.plotting import load_pictures
from multiscale.upscaling import error_budget, fit_law, with_budget
from tests.support import case_text, refused_rows, small_steel, write_body, write_law, write_scene
from tests.upscaling.responses import response_of

LONG, WIDE, HIGH = 0.06, 0.04, 0.01

TEXT = case_text("bodies")

BOLT = """
[[structure.bolts]]
sides = ["cover.washer_0", "housing.washer_0"]
diameter = "8 mm"
preload = "20 kN"
"""
SIDE = ('bottom = "clamped"', 'left = "clamped"')
MIDDLES = np.array([[0.01, 0.02], [0.05, 0.01], [0.05, 0.03]])
"""Middles of the washers, m."""
TIGHTEN = ("{ press = 1 }", "{ preload = 1 }")


@pytest.fixture(scope="module")
def meshes(tmp_path_factory):
    """A folder with meshes, sound and not."""
    folder = tmp_path_factory.mktemp("meshes")
    size, above = (LONG, WIDE, HIGH), (0.0, 0.0, HIGH)
    housing, cover = box_mesh(size, (3, 2, 1)), box_mesh(size, (2, 3, 1), origin=above)
    write_body(folder / "housing.msh", housing)
    write_body(folder / "cover.msh", cover)
    for name, mesh, outer in (("base", housing, 0.0), ("plate", cover, 2.0 * HIGH)):
        fine = box_mesh(size, (12, 8, 1), origin=tuple(mesh.p.min(axis=1)))
        washers = {
            f"washer_{k}": lambda x, outer=outer, at=at: (
                (np.abs(x[2] - outer) < 1e-6) & (np.abs(x[:2] - at[:, None]).max(axis=0) < 4.9e-3)
            )
            for k, at in enumerate(MIDDLES)
        }
        write_body(folder / f"{name}.msh", fine.with_boundaries(washers))
    write_body(folder / "away.msh", cover.translated((0.0, 0.0, 0.005)))
    write_body(folder / "aside.msh", cover.translated((0.05, 0.0, 0.0)))
    write_body(folder / "nameless.msh", cover, names=())
    layers = box_mesh(size, (2, 3, 2), origin=above)
    for name, height in (("folded", 2.5 * HIGH), ("flat", HIGH)):  # of the middle plane
        p = layers.p.copy()
        p[2, np.abs(p[2] - 1.5 * HIGH) < 1e-6] = height
        write_body(folder / f"{name}.msh", type(layers)(p, layers.t), names=())
    meshio.Mesh(np.eye(3)[:, [0, 1]] @ np.eye(2, 3), [("triangle", [[0, 1, 2]])]).write(
        folder / "plane.vtk"
    )
    tets = MeshTet.init_tensor(*(np.linspace(0.0, n, 3) for n in (60.0, 40.0, 10.0)))
    tets = tets.translated((0.0, 0.0, 10.0)).with_boundaries(
        {"bottom": lambda x: x[2] == 10.0, "top": lambda x: x[2] == 20.0}
    )
    groups = {"solid": np.array([1, 3])} | {
        name: np.array([tag, 2]) for tag, name in ((2, "bottom"), (3, "top"))
    }
    blocks = [("tetra", tets.t.T)]
    blocks += [("triangle", tets.facets[:, tets.boundaries[name]].T) for name in ("bottom", "top")]
    tags = [np.full(len(block), tag) for tag, (_, block) in enumerate(blocks, start=1)]
    data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    meshio.Mesh(tets.p.T, blocks, cell_data=data, field_data=groups).write(
        folder / "tets.msh", file_format="gmsh22", binary=False
    )
    return folder


def solve(folder, *pairs, more=""):
    """Solve the case with some of its text replaced."""
    return run_macro(load_case(write_scene(folder, TEXT + more, *pairs)), folder / "found.nc")


COVER = 'mesh = "cover.msh"'
WASHERS = [
    ('mesh = "housing.msh"', 'mesh = "base.msh"'),
    (COVER, 'mesh = "plate.msh"'),
    SIDE,
    TIGHTEN,
]


@pytest.mark.parametrize(("base", "patches", "message"), refused_rows("bodies"))
def test_what_does_not_fit_is_refused_in_a_sentence(meshes, base, patches, message):
    with pytest.raises((CaseError, ConvergenceError), match=message) as refused:
        run_macro(load_case(write_scene(meshes, TEXT, *patches)), meshes / "found.nc")
    sentence, *excerpt = str(refused.value).split("\n")
    assert sentence
    # the line of the file with carets where a key is at fault, and no more
    assert not excerpt or (len(excerpt) == 2 and set(excerpt[1].strip()) == {"^"})


def test_a_patch_of_faces_that_do_not_match_is_even(meshes):
    """Springs in series: housing, interface, cover; see Exponential (1) for the interface."""
    even = [("poissons_ratio = 0.3", "poissons_ratio = 0")] * 2
    result = solve(meshes, *even)
    assert result.converged.values.all()
    np.testing.assert_allclose(result.traction[0, :, 0], -10e6, rtol=1e-6)
    np.testing.assert_allclose(result.interface_pressure[:, 0], 10e6, rtol=1e-6)
    area = LONG * WIDE
    springs = area * np.array([210e9 / HIGH, 10e6 / 0.3e-6, 210e9 / HIGH])
    stiffness = float(result.load_stiffness.sel(load="press")[0])
    assert stiffness == pytest.approx(1.0 / np.sum(1.0 / springs), rel=1e-6)
    share = stiffness / springs[1]
    assert float(result.interface_compliance.sel(load="press")[0]) == pytest.approx(share, rel=1e-6)
    secant = result.load_secant.sel(load="pull").values
    assert np.isnan(secant[0])
    stuck, slips = (
        float(result[name].sel(load="pull")[1]) for name in ("stuck_stiffness", "load_stiffness")
    )
    assert slips < secant[1] < stuck < 1.25 * secant[1]


def turned(folder, turn, elements):
    """Write meshes of bodies that are turned; give what changes in the text, the pull with them."""
    size, origins = (LONG, WIDE, HIGH), ((0.0, 0.0, 0.0), (0.0, 0.0, HIGH))
    for name, number, origin in zip(("lower", "upper"), elements, origins, strict=True):
        mesh = box_mesh(size, number, origin=origin)
        moved = type(mesh)(turn @ mesh.p, mesh.t).with_boundaries(mesh.boundaries)
        write_body(folder / f"{name}.msh", moved)
    along = ", ".join(f'"{value!r} kN"' for value in turn[:, 0].tolist())
    return [
        ('mesh = "housing.msh"', 'mesh = "lower.msh"'),
        (COVER, 'mesh = "upper.msh"'),
        ('force = ["1 kN", 0, 0]', f"force = [{along}]"),
    ]


def same_answers(item, other):
    """Loads and interfaces answer alike."""
    for name in ("load_stiffness", "load_displacement", "interface_pressure", "interface_slip"):
        scale = float(abs(item[name]).max())
        np.testing.assert_allclose(other[name], item[name], atol=1e-5 * scale, err_msg=name)


@pytest.mark.slow
def test_bodies_that_are_cut_answer_the_same(meshes):
    alike = turned(meshes, np.eye(3), [(4, 2, 1)] * 2)
    cut = solve(meshes, *alike, more="[substructures]\nparts = [2, 1]\n")
    same_answers(solve(meshes, *alike), cut)


def test_bodies_that_are_turned_answer_the_same(meshes):
    """An oblique interface with faces that do not match."""
    turn = Rotation.from_euler("xyz", [0.4, -0.3, 0.9]).as_matrix()
    result = solve(meshes, *turned(meshes, turn, [(3, 2, 1), (2, 3, 1)]))
    same_answers(solve(meshes), result)
    pictures = load_pictures(result)
    assert set(pictures) == {"loads", "contact_zones_0", "pressure_0"}
    ax = Figure().add_subplot()
    pictures["pressure_0"](ax=ax)
    assert ax.get_xlabel() == "along (mm)"


def test_a_load_beyond_friction_ends_the_path_with_its_capacity(meshes):
    result = solve(meshes, ("{ pull = 1 }", "{ pull = 4 }, { pull = 6 }"))
    np.testing.assert_array_equal(result.converged, [1, 1, 0])
    sentence = r"slide on interface 0 under a load of (\S+) N; friction carries about (\S+) N"
    load, carried = map(float, re.search(sentence, result.attrs["failure"]).groups())
    assert carried == pytest.approx(0.2 * 10e6 * LONG * WIDE, rel=0.01)  # they may turn a little
    assert carried < load <= 6e3


def test_a_bolt_that_the_load_opens_ends_the_path(meshes):
    squeezed = [
        ('face = "cover.right"', 'face = "housing.bottom"'),
        ('force = ["1 kN", 0, 0]', 'pressure = "10 MPa"'),
        ("{ pull = 1 }", "{ press = 1, pull = 1 }, { press = 20, pull = 20 }"),
    ]
    stiff = BOLT.replace('diameter = "8 mm"', 'stiffness = "3 kN/um"')
    result = solve(meshes, *WASHERS, *squeezed, more=stiff)
    np.testing.assert_array_equal(result.converged, [1, 1, 0])
    assert (
        "the force of the bolt from cover.washer_0 to housing.washer_0 falls to zero"
        in result.attrs["failure"]
    )
    assert result.bolt_force[0, 0] == pytest.approx(20e3)


STATED = TEXT[TEXT.index("[structure.interfaces.exponential]") : TEXT.index("[[structure.loads]]")]
"""The law that the text states."""


BEAM = case_text("cantilever")


@pytest.mark.parametrize(("order", "error"), [("order = 2\n", 0.02), ("", 0.04)])
def test_three_hexahedra_bend_as_a_beam(meshes, order, error):
    """Deflection of Timoshenko's beam; first order without further modes reaches a third of it."""
    case = load_case(write_scene(meshes, BEAM, ("order = 2\n", order)))
    result = run_macro(case, meshes / "found.nc")
    assert "the error of the meshes is unknown" in result.attrs["cautions"]
    inertia, area = WIDE * HIGH**3 / 12.0, WIDE * HIGH
    bent = 1e3 * (LONG**3 / (3.0 * 210e9 * inertia) + LONG / (5.0 / 6.0 * 105e9 * area))
    assert float(result["load_displacement"].values[-1, 0]) == pytest.approx(bent, rel=error)


def test_tetrahedra_are_of_second_order_and_a_quick_case_reports_that_they_are_not(meshes):
    text = BEAM.replace("order = 2\n", "").replace("housing.msh", "tets.msh")
    case = load_case(write_scene(meshes, text))
    (body,) = case.structure.bodies
    assert body.order_on(body.load()) == 2
    assert case.quick().title == "Cantilever (quick, elements of first order)"
    (first,) = case.quick().structure.bodies
    assert first.order_on(first.load()) == 1


@pytest.mark.parametrize("mesh", ["cover.msh", "tets.msh"])
@pytest.mark.parametrize("order", [1, 2])
def test_nodes_of_faces_of_any_order_are_counted_before_a_body_is_built(meshes, mesh, order):
    text = TEXT.replace('"cover.msh"', f'"{mesh}"\norder = {order}')
    _, body = load_case(write_scene(meshes, text)).structure.bodies
    loaded = body.load()
    built = body.build(loaded, {})
    assert body.count_nodes(loaded) == built.basis.N
    assert body.count_face_nodes(loaded, "bottom") == built.nodes("bottom").size


def test_a_coarser_mesh_gives_the_error_of_the_mesh_whatever_else_is_computed(meshes):
    write_body(meshes / "coarse.msh", box_mesh((LONG, WIDE, HIGH), (1, 1, 1)))
    given = ('"housing.msh"', '"housing.msh"\ncoarser = "coarse.msh"')
    result = run_macro(load_case(write_scene(meshes, BEAM, given)), meshes / "found.nc")
    half = result["error_half_width"].sel(quantity="load_stiffness lift").squeeze("step")
    assert 1e-3 < float(half.sel(error_term="macro discretisation")) < 0.5
    low, high = result["load_stiffness_mean_law"].values.ravel()
    assert low < float(result["load_stiffness"].squeeze()) < high
    assert "unknown" not in result.attrs.get("cautions", "")


def test_cycles_without_slip_dissipate_nothing_whatever_their_rounding(meshes):
    write_body(meshes / "coarse.msh", box_mesh((LONG, WIDE, HIGH), (1, 1, 1)))
    given = ('"housing.msh"', '"housing.msh"\ncoarser = "coarse.msh"')
    cycles = '[cycles]\nload = "lift"\ncycles = 2\nsteps = 3\n'
    result = run_macro(load_case(write_scene(meshes, BEAM + cycles, given)), meshes / "found.nc")
    np.testing.assert_array_equal(result["cycle_energy"], 0.0)
    assert "cycle 1: 0 mJ dissipated" in "\n".join(LOADED_BODIES.lines(result))

    linear = '[structure.interfaces.linear]\nstiffness = "1e13 Pa/m +- 10 %"\n'
    cycles = cycles.replace("lift", "pull")
    steps = ("{ press = 1 }, { pull = 1 }", "{ press = 1 }")
    strong = ("friction = 0.2", "friction = 9.0")
    result = solve(meshes, (STATED, linear), steps, strong, more=cycles)
    np.testing.assert_array_equal(result["interface_energy"], 0.0)
    assert np.isfinite(result["load_stiffness_mean_law"].sel(load="pull")).any()


def test_a_coarser_mesh_that_is_not_coarser_is_refused_with_both_numbers_of_elements(meshes):
    given = ('"housing.msh"', '"housing.msh"\ncoarser = "housing.msh"')
    with pytest.raises(CaseError, match="of housing has 6 elements and its mesh 6, and the error"):
        run_macro(load_case(write_scene(meshes, BEAM, given)), meshes / "found.nc")


def test_six_tetrahedra_count_as_one_hexahedron_of_a_coarser_mesh(meshes):
    size = (LONG, WIDE, HIGH)
    ends = {"left": lambda x: x[0] < 1e-9, "right": lambda x: x[0] > LONG - 1e-9}
    write_body(meshes / "fine.msh", box_mesh(size, (4, 2, 2)))  # 16 elements
    coarse = box_mesh(size, (2, 1, 1)).to_meshtet()  # 12 elements, twice as large
    write_body(meshes / "tetrahedra.msh", coarse.with_boundaries(ends))
    given = ('"housing.msh"', '"fine.msh"\ncoarser = "tetrahedra.msh"')
    bodies = load_case(write_scene(meshes, BEAM, given)).structure
    bodies.bodies[0].check_coarser()
    assert list(bodies.coarser()) == pytest.approx([2.0])

    other = [('"housing.msh"', '"tetrahedra.msh"\ncoarser = "fine.msh"')]
    with pytest.raises(CaseError, match=r"has 16 elements and its mesh 12, .* needs at most 1;"):
        load_case(write_scene(meshes, BEAM, *other)).structure.bodies[0].check_coarser()


ASPERITIES = """[structure.interfaces.asperities]
density = "1e9 m^-2"
radius = "0.1 mm"
rms_height = "1 um"
youngs_modulus = "210 GPa"
poissons_ratio = 0.3
yield_stress = "400 MPa"
"""


@pytest.mark.slow
def test_asperities_are_pressed_between_bodies_by_their_statistics(meshes):
    result = solve(meshes, (STATED, ASPERITIES))
    single_law = Asperities(*gaussian_asperities(1e-6, 1e9), 1e-4, 210e9, 0.3, 400e6)
    law = AsperityLaw(single_law, friction=0.2, stiffness_ratio=0.8)
    jump = np.moveaxis(result["jump"].values[0], 1, 0)
    traction = law.respond(jump, np.zeros((law.n_state, jump.shape[1]))).traction
    np.testing.assert_allclose(traction.T, result["traction"].values[0], rtol=1e-6, atol=1.0)
    assert result["interface_pressure"].values[0, 0] == pytest.approx(10e6, rel=1e-6)


@pytest.mark.slow
def test_a_table_gives_the_initial_gap_of_an_interface(meshes):
    rows = [f"{x},{y},{1e-4 * x}" for x in range(-2, 64, 2) for y in range(-2, 44, 2)]
    (meshes / "gap.csv").write_text("\n".join(["x,y,gap", *rows]), encoding="utf-8")
    stated = 'gap = { form = "map", file = "gap.csv", unit = "mm" }\n'
    result = solve(meshes, (STATED, stated + STATED))
    x = result["point_position"].values[:, 0]
    gap = result["jump"].values[0, :, 0] + 1e-4 * x
    expected = 1e9 * np.exp(-gap / 0.3e-6)
    np.testing.assert_allclose(-result["traction"].values[0, :, 0], expected, rtol=1e-6)
    with pytest.raises(CaseError, match=r"gap.csv covers 0 of the interface"):
        solve(meshes, (STATED, stated.replace('"mm"', '"m"') + STATED))


@pytest.mark.slow
def test_a_law_comes_from_a_dataset_or_from_the_folder_of_a_run(meshes):
    file = write_law(meshes / "interface_law.nc")  # in the folder of a run it has this name
    shared = f'[interface]\nlaw = "{file.name}"\n'
    results = [
        run_macro(load_case(write_scene(meshes, text)), meshes / "found.nc")
        for text in (TEXT.replace(STATED, 'law = "."\n'), TEXT.replace(STATED, "") + shared)
    ]
    np.testing.assert_array_equal(results[0].load_stiffness, results[1].load_stiffness)


@pytest.mark.slow
def test_a_law_comes_from_another_case_that_is_run_once(meshes):
    text = small_steel(2).replace("[36, 36]", "[72, 72]")
    (meshes / "flat.toml").write_text(text, encoding="utf-8")
    text = TEXT.replace(STATED, 'law = "flat.toml"\n')
    quick = load_case(write_scene(meshes, text)).quick()
    of_cells = run(quick, meshes / "run")["macro_result"]
    (folder,) = (meshes / "run" / "laws").iterdir()
    direct = load_case(write_scene(meshes, TEXT.replace(STATED, f'law = "{folder}"\n')))
    expected = run_macro(direct, meshes / "found.nc")
    np.testing.assert_array_equal(of_cells.load_stiffness, expected.load_stiffness)
    before = [file.stat().st_mtime_ns for file in folder.rglob("*.nc")]
    run(quick, meshes / "run", force=True)  # finds the other case finished
    assert [file.stat().st_mtime_ns for file in folder.rglob("*.nc")] == before


def test_a_changed_mesh_is_solved_again(meshes):
    """The stage belongs to the content of the mesh and of the law."""
    case = load_case(write_scene(meshes, TEXT))
    sums = [case.checksum()]
    file = meshes / "cover.msh"
    before = file.read_bytes()
    file.write_bytes(before + b"\n")
    sums.append(case.checksum())
    file.write_bytes(before)
    assert sums[0] != sums[1]
    assert case.checksum() == sums[0]


def test_the_run_refuses_meshes_before_it_solves_cells(meshes):
    cells = small_steel(2).replace("[structure]", "[old]")
    cells = cells[: cells.index("[old]")]
    text = cells + TEXT[TEXT.index("[structure]") :].replace(STATED, "")
    case = load_case(write_scene(meshes, text, (COVER, 'mesh = "away.msh"')))
    with pytest.raises(CaseError, match="do not touch face to face"):
        run(case, meshes / "early")
    assert not list((meshes / "early").rglob("*.nc"))


def write_scattered_law(file, samples=0):
    """Write a law with a budget, and return its pressures, Pa."""
    p = np.geomspace(1e6, 200e6, 9)
    spread = 1.0 + 0.04 * np.random.default_rng(3).standard_normal((6, 1))
    response = response_of(0.3e-6 * np.log(1e9 / p) * spread, p, area=p[None] / 5e9 * spread)
    law = fit_law(response, n_samples=samples)
    save_law(with_budget(law, error_budget(response, law)), file)
    return p


@pytest.mark.slow
def test_few_samples_of_a_law_give_named_loads_the_scatter_of_all(meshes):
    """Next to Student's interval of cells that scatter by a factor."""
    text, half = TEXT.replace(STATED, 'law = "law.nc"\n'), {}
    for samples in (0, 40):
        write_scattered_law(meshes / "law.nc", samples)
        result = run_macro(load_case(write_scene(meshes, text)), meshes / "found.nc")
        width = result["error_half_width"].sel(error_term="sampling", step=0)
        half[samples] = float(width.sel(quantity="load_stiffness press"))
        few = "4 of 40 bootstrap samples of the law, to first order"
        assert (few in result.attrs["how_sampling"]) == (samples == 40)
    assert half[40] == pytest.approx(half[0], rel=0.3)


@pytest.mark.slow
def test_independent_laws_err_less_than_one_law_of_both_interfaces(meshes):
    """Two alike interfaces in series: errors of one law add up, of two laws their squares."""
    for name in ("law.nc", "other.nc"):
        write_scattered_law(meshes / name)
    text = TEXT.replace(STATED, 'law = "law.nc"\n').replace(
        'supports = { bottom = "clamped" }\n', ""
    )
    below = (
        '[[structure.interfaces]]\nsides = ["ground", "housing.bottom"]\nlaw = "{}"\n'
        "friction = 0.2\nstiffness_ratio = 0.8\n"
    )
    results = {}
    for name in ("law.nc", "other.nc"):
        changed = text.replace("[[structure.loads]]", below.format(name) + "[[structure.loads]]", 1)
        even = [("poissons_ratio = 0.3", "poissons_ratio = 0")] * 2
        results[name] = run_macro(
            load_case(write_scene(meshes, changed, *even)), meshes / "found.nc"
        )
    together, apart = (
        value["error_half_width"].sel(quantity="load_stiffness press", step=0, error_term="fit")
        for value in results.values()
    )
    assert float(together / apart) == pytest.approx(np.sqrt(2.0), rel=0.01)  # differences
    real = results["other.nc"]
    half = real["error_half_width"].sel(error_term="fit", step=0)
    assert real["interface_real_pressure"][0].to_numpy() == pytest.approx(5e9, rel=0.1)
    changed, two = (float(half.sel(quantity=f"real pressure of interface {k}")) for k in (0, 1))
    assert changed == pytest.approx(two, rel=1e-6)  # each has only the error of its law
    low, high = real["interface_real_pressure_one_part"][:, 0, 1].to_numpy()
    assert low < float(real["interface_real_pressure"][0, 1]) < high
    compared = LOADED_BODIES.compared(real)
    assert set(LOADED_BODIES.answers) & set(compared) == {
        "load_stiffness",
        "interface_real_pressure",
        "slipping_load",
    }
    assert compared["load_stiffness"].values == pytest.approx(real["load_stiffness"].values[-1])


@pytest.mark.slow
def test_workers_solve_bodies_again_for_the_intervals_of_stated_values(meshes):
    """Interface and bodies are springs in series: the interface has its share of the change."""
    changes = [("poissons_ratio = 0.3", "poissons_ratio = 0")] * 2
    changes += [('"0.3 um"', '"0.3 um +- 4 %"'), (", { pull = 1 }", "")]
    case = load_case(write_scene(meshes, TEXT, *changes))
    with process_pool(2) as executor:
        result = run(case, meshes / "intervals", executor=executor)["macro_result"]
    half = result.error_half_width.sel(quantity="load_stiffness press", step=0)
    expected = np.log1p(0.04 * float(result.interface_compliance.sel(load="press")[0]))
    assert float(half.sel(error_term="stated values")) == pytest.approx(expected, rel=1e-4)


SMOOTH = case_text("block_on_ground")


def test_a_frictionless_ground_holds_no_push(tmp_path):
    """A bar along the ground; across it, a bar and the springs of the interface in series."""
    size = (0.03, 0.02, 0.01)
    write_body(tmp_path / "block.msh", box_mesh(size, (3, 2, 1)))
    (tmp_path / "case.toml").write_text(SMOOTH)
    result = run(load_case(tmp_path / "case.toml"), tmp_path / "results")["macro_result"]
    push, area = 70e9 * size[1] * size[2] / size[0], size[0] * size[1]
    press = 1.0 / (0.5e-6 / (10e6 * area) + size[2] / (70e9 * area))
    np.testing.assert_allclose(result.load_stiffness[1], [press, push], rtol=1e-6)
    np.testing.assert_allclose(result.stuck_stiffness[1], [press, push], rtol=1e-6)
    np.testing.assert_allclose(result.interface_compliance[1, 1], 0.0, atol=1e-6)
    sentence = "small increase of push at step 1 is 466.7 N/µm; 0 % of the"
    assert sentence in " ".join(LOADED_BODIES.summary(result).answer)


def test_vibration_on_a_frictionless_ground_has_an_answer_at_every_amplitude(tmp_path):
    write_body(tmp_path / "block.msh", box_mesh((0.03, 0.02, 0.01), (3, 2, 1)))
    vibrates = SMOOTH.replace("steps = [{ press = 1 }, { push = 1 }]", "steps = [{ press = 1 }]")
    vibrates += '[vibration]\nmodes = [1]\namplitudes = ["1 nm", "20 nm"]\n'
    (tmp_path / "case.toml").write_text(vibrates)
    result = run(load_case(tmp_path / "case.toml"), tmp_path / "results")["vibration"]
    assert result.converged.values.all()
    np.testing.assert_allclose(result.frequency, result.mode_frequency[0], rtol=1e-3)
    np.testing.assert_allclose(result.damping, 0.0, atol=1e-6)


STEPS = "steps = [{ press = 1 }, { pull = 1 }]"


def test_statics_choose_their_solver(meshes):
    answers = []
    for method, name in (("newton", "Newton's method on the whole"), ("latin", "LATIN")):
        result = solve(meshes, (STEPS, f'{STEPS}\nmethod = "{method}"'))
        assert f"Solved by {name}: it is the choice of the case." in result.attrs["facts"]
        answers.append(result)
    same_answers(*answers)


def test_the_time_of_all_load_steps_follows_from_the_first(meshes):
    lines = []
    case = load_case(write_scene(meshes, TEXT))
    run(case, meshes / "told", progress=lambda *one: lines.append(one))
    assert [line for line in lines if line[2] == "load steps"] == [
        (k, 2, "load steps") for k in range(3)
    ]


@pytest.mark.slow
def test_the_figure_and_the_answer_are_of_the_last_step_that_is_known(meshes, tmp_path):
    """The last step is far below the pressures of the law; in a linear law it has no load."""
    low = "{ press = 1 }, { pull = 1 }", "{ press = 1 }, { press = 0.001 }"
    result = solve(meshes, low)
    assert np.isnan(result["equivalent_stress"][-1]).all()
    sections = LOADED_BODIES.sections({LOADED_BODIES.name: result}, tmp_path)
    figures = {name: draw for section in sections for name, draw in section.figures.items()}
    figures["body_stress"](tmp_path / "stress.png")
    at_rest = low[0], "{ press = 1 }, { press = 0 }"
    law = TEXT[TEXT.index("[structure.interfaces.exp") : TEXT.index("[[structure.loads]]")]
    linear = '[structure.interfaces.linear]\nstiffness = "1e13 Pa/m"\n'
    lines = "\n".join(LOADED_BODIES.lines(solve(meshes, at_rest, (law, linear))))
    assert re.search(r"At step 1 the loaded faces have moved since step 0 by [\d.-]+ µm", lines)
    once = "\n".join(LOADED_BODIES.lines(solve(meshes, (low[0], "{ press = 1 }"))))
    assert re.search(
        r"At step 0 the largest mean stress .* \(von Mises\), in (housing|cover)\.", once
    )
    assert "or state a law for them" in result.attrs["cautions"]


@pytest.mark.slow
def test_slip_and_loss_of_a_stated_law_have_the_intervals_of_its_values(meshes):
    text = TEXT.replace("friction = 0.2", 'friction = "0.2 +- 10 %"').replace('"1 kN"', '"1.8 kN"')
    text += '[cycles]\nload = "pull"\ncycles = 1\nsteps = 4\n'
    result = run_macro(load_case(write_scene(meshes, text)), meshes / "found.nc")
    more = text.replace('"0.2 +- 10 %"', "0.22")
    changed = run_macro(load_case(write_scene(meshes, more)), meshes / "more.nc")
    terms = result["error_half_width"].isel(step=-1)
    for name in ("cycle_energy", "slipping_load"):
        below, above = result[f"{name}_mean_law"].values[..., -1]
        assert below < float(result[name][-1]) < above
        assert 0.0 < float(terms.sel(error_term="friction bed", quantity=name)) < 0.1
    change = abs(float(changed["cycle_energy"][-1] / result["cycle_energy"][-1]) - 1.0)
    stated = float(terms.sel(error_term="stated values", quantity="cycle_energy"))
    assert stated == pytest.approx(change, rel=0.1)  # of paths of fewer steps
