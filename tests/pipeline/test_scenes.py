"""Scene files: reading, messages of refused files, and results of a run."""

import meshio
import numpy as np
import pytest
from typer.testing import CliRunner

from multiscale.cli import app
from multiscale.errors import CaseError, ConvergenceError
from multiscale.io import open_dataset
from multiscale.macro import cable_net, simulate, solve_static, tensegrity_grid
from multiscale.pipeline import load_case, run_macro
from multiscale.pipeline.stages import stages_of
from multiscale.pipeline.tables.settings import KINDS
from multiscale.schema import MACRO_RESULT
from tests.link_structures import free_module
from tests.support import SCENES, case_text, write_scene

STATIC = (SCENES / "tensegrity_grid.toml").read_text(encoding="utf-8")
MOVING = (SCENES / "sudden_unloading.toml").read_text(encoding="utf-8")

HANGING = case_text("hanging")
NODES = "x, y, z, fix_x, fix_y, fix_z, load_z\n0,0,2,1,1,1,0\n0,0,1,1,1,0,-50\n0,0,0,1,1,0,-30\n"
LINKS = "first,second,law\n0,1,cable\n1,2,cable\n"


@pytest.fixture
def hanging(tmp_path):
    (tmp_path / "nodes.csv").write_text(NODES, encoding="utf-8")
    (tmp_path / "links.csv").write_text(LINKS, encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize(
    ("arrow", "case", "table"),
    [
        ("macro", "tyre_on_road", "structure"),
        ("micro", "tyre_on_road", "micro"),
        ("micro", SCENES / "tensegrity_grid.toml", "micro"),
    ],
)
def test_an_arrow_takes_cases_that_have_its_tables(command, arrow, case, table):
    status, _, output = command(arrow, case)
    assert status == 1
    assert f"{case}: has no [{table}], at which the command begins; use multiscale run" in output


@pytest.mark.parametrize("name", sorted(SCENES.glob("*.toml")), ids=lambda path: path.stem)
def test_a_scene_written_in_si_is_the_same_scene(tmp_path, name):
    scene = load_case(name)
    assert load_case(write_scene(tmp_path, scene.to_toml())) == scene


def test_keys_of_a_scene_reach_the_structure(tmp_path):
    grid = load_case(
        write_scene(
            tmp_path, STATIC, ("n = 16", "n = 3\nm = 2"), ('"2550 N"', '"1 kN"'), ("80 M", "7 M")
        )
    )
    expected = tensegrity_grid(3, 2, prestress=1000.0)
    built = grid.structure.build()
    np.testing.assert_array_equal(built.position, expected.position)
    np.testing.assert_array_equal(built.prestress, expected.prestress)
    assert [law.rigidity for law in built.laws] == [4e6, 7e6]
    net = load_case(SCENES / "cable_net.toml").structure.build()
    expected = cable_net(12, 10, mesh=1.5, rise=2.0, nodal_load=1700.0)
    np.testing.assert_array_equal(net.position, expected.position)
    np.testing.assert_array_equal(net.load, expected.load)


def test_a_static_scene_is_the_result_of_solve_static_and_its_file_states_it(tmp_path):
    scene = load_case(SCENES / "tensegrity_grid.toml").quick()
    run_macro(scene, tmp_path / "new" / "grid.nc")
    result = open_dataset(tmp_path / "new" / "grid.nc", MACRO_RESULT)
    grid = tensegrity_grid(4, prestress=2550.0 / 16.0)
    expected = solve_static(grid, [0.0, 0.25, 0.5, 0.75, 1.0])
    np.testing.assert_array_equal(result["tension"], expected["tension"])
    assert (result["slack"].sel(step=4) > 0.0).any()
    assert result.attrs["title"] == "Tensegrity grid at rest (quick)"
    assert load_case(write_scene(tmp_path, result.attrs["case"])) == scene
    assert (tmp_path / "new" / "fields" / "grid.pvd").is_file()


def test_a_motion_starts_from_the_equilibrium_and_follows_its_history(tmp_path):
    history = ('[["0 s", 0.0]]', '[["0 s", 1.0], ["20 ms", 0.0]]')
    scene = load_case(write_scene(tmp_path, MOVING, history, ('"0.5 s"', '"52 ms"'))).quick()
    result = run_macro(scene, tmp_path / "motion.nc")
    grid = tensegrity_grid(4, prestress=2550.0 / 16.0)
    begin = solve_static(grid, 1.0)["displacement"].values
    expected = simulate(
        grid,
        np.linspace(0.0, 0.052, 12),  # 5 ms do not divide 52 ms
        2.0,
        load_factor=lambda time: max(0.0, 1.0 - time / 0.02),
        start=(begin, np.zeros_like(begin)),
        theta=0.5,
    )
    scale = float(np.abs(expected["displacement"]).max())
    np.testing.assert_allclose(
        result["displacement"], expected["displacement"], rtol=0.0, atol=1e-12 * scale
    )


def test_a_support_that_is_neither_fixed_nor_free_is_refused(hanging):
    nodes = hanging / "nodes.csv"
    nodes.write_text(NODES.replace("0,0,1,1,1,0", "0,0,1,1,2,0"), encoding="utf-8")
    with pytest.raises(CaseError, match=r"fix_y of node 1 must be 1 \(fixed\) or 0, got 2"):
        run_macro(load_case(write_scene(hanging, HANGING)), hanging / "out.nc")


def test_nodes_that_move_farther_than_the_structure_measures_are_a_caution(hanging):
    sound = run_macro(load_case(write_scene(hanging, HANGING)), hanging / "out.nc")
    assert sound.attrs["cautions"] == ""
    nodes = hanging / "nodes.csv"
    nodes.write_text(NODES.replace("-50", "-1e30"), encoding="utf-8")
    result = run_macro(load_case(write_scene(hanging, HANGING)), hanging / "out.nc")
    assert "nodes move by up to 1e+25 m, more than the structure measures (2 m)" in result.cautions


def test_a_motion_that_fails_reports_when_and_stores_its_steps(tmp_path, monkeypatch):
    monkeypatch.setattr("multiscale.macro.links.dynamics.MAX_ITERATIONS", 2)
    scene = load_case(
        write_scene(tmp_path, MOVING, ('"5 ms"', '"100 ms"'), ("= 1.0", "= 4.0"))
    ).quick()
    result = run_macro(scene, tmp_path / "motion.nc")
    assert result["converged"].values[0] == 1
    assert result["converged"].values[-1] == 0
    assert "the motion ends before" in result.attrs["failure"]
    done = CliRunner().invoke(
        app, ["macro", str(tmp_path / "scene.toml"), "--quick", "-o", str(tmp_path / "again.nc")]
    )
    assert done.exit_code == 1
    assert "the motion ends before" in str(done.exception)
    assert "not converged" in done.output


def test_a_structure_of_two_tables_carries_its_weights(hanging):
    result = run_macro(load_case(write_scene(hanging, HANGING)), hanging / "rope.nc")
    np.testing.assert_allclose(result["tension"].sel(step=1), [80.0, 30.0], rtol=1e-9)
    assert list(result["law"].values) == ["cable", "cable"]
    np.testing.assert_array_equal(result["ends"], [[0, 1], [1, 2]])


def test_an_inextensible_rope_needs_no_rigidity(hanging):
    path = write_scene(hanging, HANGING, ('"100 kN"', '"inextensible"'))
    result = run_macro(load_case(path), hanging / "rope.nc")
    np.testing.assert_allclose(result["tension"].sel(step=1), [80.0, 30.0], rtol=1e-6)
    assert load_case(write_scene(hanging, result.attrs["case"])) == load_case(path)


@pytest.mark.parametrize(
    ("file", "pair", "message"),
    [
        pytest.param("links.csv", ("1,2", "1,b"), "line 3: second should be a whole", id="text"),
        pytest.param("links.csv", ("1,2", "1.5,2"), "line 3: first should be a whole", id="half"),
        pytest.param("nodes.csv", ("-30", "-30,1"), "line 4: 8 entries for 7 columns", id="long"),
        pytest.param(
            "nodes.csv", ("load_z", "fix_z"), "two columns have the same name", id="twice"
        ),
        pytest.param(
            "nodes.csv", ("load_z", "loud_z"), "column loud_z; did you mean", id="unknown"
        ),
        pytest.param("links.csv", ("1,2,cable", "1,2,rope"), "'rope' of link 1", id="law"),
    ],
)
def test_a_refused_table_names_the_place(hanging, file, pair, message):
    path = hanging / file
    text = path.read_text(encoding="utf-8")
    assert pair[0] in text
    path.write_text(text.replace(*pair), encoding="utf-8")
    with pytest.raises(CaseError, match=message):
        load_case(write_scene(hanging, HANGING)).structure.build()


def test_a_faulty_entry_of_a_list_does_not_make_the_list_too_short(hanging):
    text = HANGING.replace("[0, 1]", '["once"]')
    with pytest.raises(CaseError, match=r"load_factors\[0\]") as refused:
        load_case(write_scene(hanging, text))
    _, line, carets = str(refused.value).split("\n")
    assert 'load_factors = ["once"]' in line
    assert set(carets.strip()) == {"^"}
    with pytest.raises(CaseError, match="load_factors should have at least 1 entries, got \\[\\]"):
        load_case(write_scene(hanging, HANGING.replace("[0, 1]", "[]")))


def test_a_structure_comes_from_the_lines_of_a_mesh_file(tmp_path):
    mesh = meshio.Mesh(
        np.array([[-1000.0, 0.0, 1000.0], [1000.0, 0.0, 1000.0], [0.0, 0.0, 0.0], [0, 900.0, 0]]),
        [("line", [[0, 2], [1, 2], [3, 2]]), ("vertex", [[0], [1], [3]])],
        cell_data={"gmsh:physical": [[1, 1, 1], [2, 2, 2]], "gmsh:geometrical": [[1] * 3, [2] * 3]},
        field_data={"bars": np.array([1, 1]), "held": np.array([2, 0])},
    )
    mesh.write(tmp_path / "bars.msh", file_format="gmsh22", binary=False)
    text = """
title = "Two bars and a stay"
[structure]
kind = "mesh"
file = "bars.msh"
unit = "1 mm"
supports = ["held"]
load = ["0 N", "0 N", "-1 kN"]
laws.bars = { kind = "bar", rigidity = "10 MN" }
[statics]
load_factors = [1]
"""
    result = run_macro(load_case(write_scene(tmp_path, text)), tmp_path / "bars.nc")
    np.testing.assert_allclose(
        result["tension"][0], [500.0 * 2**0.5, 500.0 * 2**0.5, 0.0], atol=1e-6
    )


def test_a_scene_without_any_solution_is_an_error_with_its_reason(hanging):
    loose = "0,0,0,0,1,0,-30\n"  # the lowest weight may now swing, and is pushed
    nodes = NODES.replace("load_z", "load_z,load_x").replace("0,0,2,1,1,1,0", "0,0,2,1,1,1,0,0")
    nodes = nodes.replace("-50\n", "-50,0\n").replace("0,0,0,1,1,0,-30\n", loose[:-1] + ",9\n")
    (hanging / "nodes.csv").write_text(nodes, encoding="utf-8")
    text = HANGING.replace("[0, 1]", "[1]")
    with pytest.raises(ConvergenceError, match="no step converged; load factor 1: "):
        run_macro(load_case(write_scene(hanging, text)), hanging / "rope.nc")
    assert open_dataset(hanging / "rope.nc")["converged"].values.tolist() == [0]


@pytest.mark.parametrize(("rigidity", "strain"), [("500 N", 80 / 500), ("1 kN", 0.0)])
def test_links_strained_beyond_their_linear_law_are_a_caution_with_the_worst(
    hanging, rigidity, strain
):
    """The upper link bears both weights: its strain is their sum over the rigidity."""
    pairs = (('"100 kN"', f'"{rigidity}"'), ("[statics]\n", "[statics]\nexact = true\n"))
    result = run_macro(load_case(write_scene(hanging, HANGING, *pairs)), hanging / "out.nc")
    sentence = f"link 0 has a strain of up to {strain:.2g}," if strain else ""
    assert result.attrs.get("cautions", "").startswith(sentence)
    assert bool(result.attrs.get("cautions")) == bool(strain)


def test_every_kind_of_structure_has_one_stage():
    for kind in KINDS.values():
        assert [stage.tables[1] for stage in stages_of({"structure", kind.stage})] == [kind.stage]


MODULE = case_text("module")


@pytest.fixture
def tables(tmp_path):
    """Writes a structure without its prestress as two tables."""

    def of(system):
        nodes = np.hstack([system.position, system.fixed, system.load])
        head = "x,y,z,fix_x,fix_y,fix_z,load_x,load_y,load_z"
        np.savetxt(tmp_path / "nodes.csv", nodes, "%.17g", ",", header=head, comments="")
        lines = (
            f"{first},{second},{('cable', 'bar')[kind]},{group}"
            for (first, second), kind, group in zip(
                system.ends, system.kind, system.group, strict=True
            )
        )
        text = "\n".join(["first,second,law,group", *lines])
        (tmp_path / "links.csv").write_text(text, encoding="utf-8")
        return tmp_path

    return of


def test_tables_without_prestress_get_their_state_of_self_stress(tables):
    module = free_module(prestress=1.0)
    result = load_case(write_scene(tables(module), MODULE)).structure.build()
    scaled = 1000.0 * module.prestress / np.abs(module.prestress).max()
    np.testing.assert_allclose(result.prestress, scaled, rtol=1e-9)


def test_of_several_states_the_state_with_the_largest_least_tension_is_taken(tables):
    """Four modules have a state each: all are stressed alike, as by the prestress of the grid."""
    grid = tensegrity_grid(2)
    folder = tables(grid)
    case = load_case(write_scene(folder, MODULE))
    outcome = case.structure.build()
    cable = outcome.kind == 0
    alike = 1000.0 * grid.prestress / np.abs(grid.prestress).max()
    assert np.abs(outcome.prestress).max() == pytest.approx(1000.0)
    assert outcome.prestress[cable].min() >= alike[cable].min() * (1.0 - 1e-9) > 0.0
    result = run_macro(case, folder / "out.nc")
    np.testing.assert_allclose(result["tension"][0], outcome.prestress, atol=1e-6)


@pytest.mark.parametrize(
    ("kinds", "message"),
    [
        (("strut", "strut"), "none of the 1 states of self-stress has all its cables"),
        (("cable", "cable"), "none of the 1 states of self-stress has all its cables"),
        (("bar", "bar"), "the state of self-stress is ambiguous"),
    ],
)
def test_a_self_stress_that_no_link_can_carry_is_refused(tables, kinds, message):
    cable, bar = kinds
    text = MODULE.replace('cable = { kind = "cable"', f'cable = {{ kind = "{cable}"')
    text = text.replace('bar = { kind = "bar"', f'bar = {{ kind = "{bar}"')
    with pytest.raises(CaseError, match=message):
        load_case(write_scene(tables(free_module()), text)).structure.build()


def test_a_self_stress_needs_a_size_and_a_structure_that_holds_itself(hanging):
    asked = ("[structure.laws", "self_stress = true\n[structure.laws")
    with pytest.raises(CaseError, match="give both self_stress = true and prestress, or neither"):
        load_case(write_scene(hanging, HANGING, asked))
    sized = ("[structure.laws", 'self_stress = true\nprestress = "1 kN"\n[structure.laws')
    with pytest.raises(CaseError, match="no state of self-stress"):
        load_case(write_scene(hanging, HANGING, sized)).structure.build()
