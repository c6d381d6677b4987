"""Requirements of a case, printed before it is run."""

from typer.testing import CliRunner

from multiscale.cli import app
from multiscale.pipeline import load_case, requirements
from tests.support import steel_text, write_scene

TEXT = steel_text()


def case_with(tmp_path, *pairs):
    return load_case(write_scene(tmp_path, TEXT, *pairs))


def test_a_plain_case_leaves_out_unused_parts():
    needs = requirements(load_case("ground_steel"))
    assert needs.unknowns_per_contact == 1
    assert needs.state_variables == ()
    assert "stiffness" in needs.built
    assert "mean dilatation" in needs.omitted
    assert "SurfaceTopography" not in needs.libraries
    assert "joint mesh" in needs.omitted  # a closed form


def test_a_nearly_incompressible_case_lists_its_additions():
    needs = requirements(load_case("road_texture"))
    assert "mean dilatation" in needs.built
    assert "tilt" in needs.built


def test_a_flat_case_with_a_hardness_needs_neither_mesh_nor_factors(tmp_path):
    case = case_with(
        tmp_path,
        ("[cell]", '[cell]\ngeometry = "flat"'),
        ("[body_1]", '[body_1]\nhardness = "2 GPa"'),
        ("[body_2]", '[body_2]\nhardness = "3 GPa"'),
    )
    needs = requirements(case)
    assert case.hardness == 2e9
    assert "hardness cap" in needs.built
    assert "stiffness" in needs.omitted
    assert needs.memory < 0.1 * requirements(load_case("ground_steel")).memory


def test_a_conforming_case_with_a_hardness_carries_plastic_state():
    needs = requirements(load_case("ground_steel_plastic"))
    assert "accumulated plastic strain" in needs.state_variables
    assert "tangent" in needs.built


def test_a_target_states_that_its_needs_are_of_the_cells_at_the_start(tmp_path):
    plain = requirements(load_case("ground_steel"))
    aimed = requirements(
        case_with(tmp_path, ("[statics]", '[accuracy]\ntarget = "5 %"\n[statics]'))
    )
    assert plain.built["cells"] == "5 of 128 x 128 points, each under 8 pressures"
    added = set(aimed.built) - set(plain.built)
    assert added == {"planner"}
    assert set(plain.built) - set(aimed.built) == {"coarser cells"}
    assert "cells, pressures, points of the cells, size of the cells" in aimed.built["planner"]


def test_explaining_a_case_prints_its_needs_and_runs_nothing(tmp_path):
    out = tmp_path / "out"
    result = CliRunner().invoke(app, ["run", "ground_steel", "-o", str(out), "--explain"])
    assert result.exit_code == 0
    assert "unknowns per contact         1" in result.output
    assert "leaves out tilt" in result.output
    assert not out.exists()


def test_explaining_a_sweep_lists_its_points_and_the_needs_of_the_largest(tmp_path):
    (tmp_path / "case.toml").write_text(TEXT + "[sweep]\ncell.layers = [8, 20, 14]\n")
    result = CliRunner().invoke(app, ["run", str(tmp_path / "case.toml"), "--explain"])
    assert result.exit_code == 0
    assert result.output.startswith("3 points; the largest:\n")
    largest = requirements(case_with(tmp_path, ("layers = 14", "layers = 20")))
    assert largest.explain() in result.output
