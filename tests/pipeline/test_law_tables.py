"""Laws that a user states: tables of pressure and overclosure, and a constant stiffness."""

import numpy as np
import pytest

from multiscale.errors import CaseError, ConvergenceError
from multiscale.fe.mesh_file import box_mesh
from multiscale.io import save_law
from multiscale.pipeline import load_case, run_macro
from multiscale.pipeline.showing import tabulate_budget
from multiscale.pipeline.stages.joint import JOINT
from multiscale.upscaling import fit_law, law_from_dataset, read_observations
from multiscale.upscaling.tables import read_law
from tests.support import case_text, write_body, write_law, write_scene

TABLE = "pressure (MPa), overclosure (um)\n0, 0\n1, 0.1\n10, 0.5\n100, 1.2\n"
CHORDS = np.array([1e13, 9e6 / 0.4e-6, 90e6 / 0.7e-6])
"""Stiffness of the chords of the table, Pa/m."""

BLOCKS = case_text("blocks_of_table")

BODIES = case_text("bodies_of_table")

LINEAR = ('law = "table.csv"', 'linear = { stiffness = "1e13 Pa/m +- 10 %" }')


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a table and the meshes of two bodies, 0.02 m x 0.02 m in plan."""
    folder = tmp_path_factory.mktemp("tables")
    (folder / "table.csv").write_text(TABLE)
    size = (0.02, 0.02, 0.01)
    write_body(folder / "housing.msh", box_mesh(size, (2, 2, 1)))
    write_body(folder / "cover.msh", box_mesh(size, (2, 2, 1), origin=(0.0, 0.0, 0.01)))
    return folder


def solve(folder, text, *pairs):
    return run_macro(load_case(write_scene(folder, text, *pairs)), folder / "found.nc")


def test_the_law_of_a_table_is_linear_between_its_rows(folder):
    law = law_from_dataset(read_law(folder / "table.csv"))
    np.testing.assert_allclose(law.gap_at(np.array([0.5e6, 5.5e6, 55e6])), [-5e-8, -3e-7, -0.85e-6])
    np.testing.assert_allclose(law.stiffness(np.array([-5e-8, -3e-7, -0.85e-6])), CHORDS)
    assert law.pressure_range == (1e3, 100e6)
    # the last chord goes on
    np.testing.assert_allclose(law.pressure(np.array([-1.9e-6])), 190e6)


@pytest.mark.parametrize("digits", [3, 4])
def test_a_rounded_table_of_a_constant_stiffness_has_that_stiffness(tmp_path, digits):
    """Chords of 3 MPa/um between thirds: rounded, every third chord is softer than before."""
    closed = [f"{k / 3.0:.{digits}f}" for k in range(10)]
    rows = "\n".join(f"{k}, {item}" for k, item in enumerate(closed))
    (tmp_path / "rounded.csv").write_text(f"pressure (MPa), overclosure (um)\n{rows}\n")
    law = law_from_dataset(read_law(tmp_path / "rounded.csv"))
    p = np.linspace(0.1e6, 9e6, 50)
    np.testing.assert_allclose(law.stiffness(law.gap_at(p)), 3e12, rtol=2e-3)
    np.testing.assert_allclose(law.gap_at(p), -p / 3e12, rtol=2e-3)


def test_a_table_that_softens_little_by_little_is_refused(tmp_path):
    """The pressure is the square root of the overclosure, in rows of less than 1 % each."""
    p = np.append(0.0, np.geomspace(1.0, 2.0, 200))
    rows = "\n".join(f"{pressure:.9g}, {pressure**2:.9g}" for pressure in p)
    (tmp_path / "soft.csv").write_text(f"pressure (MPa), overclosure (um)\n{rows}\n")
    with pytest.raises(CaseError, match=r"row \d+: the stiffness falls from"):
        read_law(tmp_path / "soft.csv")


def test_a_quantity_missing_in_a_table_has_no_column_and_its_gap_is_the_overclosure(folder):
    result = solve(folder, BLOCKS)
    lines = "\n".join(JOINT.lines(result))
    assert "nan" not in lines
    assert "contact" not in lines.splitlines()[1]
    assert "it is the negative overclosure" in lines


def test_errors_of_a_table_and_of_a_body_share_the_rows_without_a_value(folder):
    modulus = ('name = "cover"', 'name = "cover"\nyoungs_modulus = "210 GPa +- 5 %"')
    cover = BODIES.index('name = "cover"')
    text = BODIES[:cover] + BODIES[cover:].replace('youngs_modulus = "210 GPa"\n', "", 1)
    stated = ('law = "table.csv"', 'law = "table.csv"\nlaw_error = "10 %"')
    result = solve(folder, text, modulus, stated)
    rows = tabulate_budget(result)[1]
    assert [row[0] for row in rows][:3] == ["stated values", "macro discretisation", "all others"]
    assert "law_error = 10 %" in rows[0][-1]


def test_a_table_without_units_is_read_in_si_and_cautioned(tmp_path):
    bare = tmp_path / "bare.csv"
    bare.write_text("pressure;overclosure\n0;0\n1e6;1e-7\n10e6;5e-7\n100e6;1,2e-6\n")
    law = read_law(bare)
    np.testing.assert_allclose(law["table_gap"], [0.0, -1e-7, -5e-7, -1.2e-6])
    assert "no unit of its pressure and overclosure and is read in SI" in law.attrs["cautions"]


def test_blocks_have_the_stiffness_of_a_table_and_its_stated_error(folder):
    """1/K = 1/K_i + 1/K_s, and K_i errs by 10 %."""
    result = solve(folder, BLOCKS)
    np.testing.assert_allclose(result["interface_stiffness"], CHORDS, rtol=1e-9)
    solid = result["solid_stiffness"].to_numpy()
    K = 1.0 / (1.0 / CHORDS + 1.0 / solid)
    np.testing.assert_allclose(result["joint_stiffness"], K, rtol=1e-9)
    low, high = result["joint_stiffness_mean_law"].to_numpy()
    np.testing.assert_allclose(high, 1.0 / (1.0 / (1.1 * CHORDS) + 1.0 / solid), rtol=2e-3)
    np.testing.assert_allclose(low, 1.0 / (1.0 / (0.9 * CHORDS) + 1.0 / solid), rtol=2e-3)
    assert result.attrs["how_stated_values"] == "law_error = 10 %"


def test_the_error_of_a_table_is_unknown_if_it_is_not_stated(folder):
    result = solve(folder, BLOCKS, ('law_error = "10 %"', ""))
    assert "joint_stiffness_mean_law" not in result
    assert "the error of a table is unknown" in result.attrs["cautions"]
    assert "not contain the error of the law of interface" not in result.attrs["cautions"]
    assert "cells" not in result.attrs["facts"]


def test_the_error_of_a_law_of_measurements_is_unknown_in_blocks(folder):
    rows = [f"{p}, {k * p**0.5}, {k}" for k in (3, 4) for p in (0.5, 1, 2, 4, 8, 16, 32)]
    text = "pressure (MPa), stiffness (MPa/um), specimen\n" + "\n".join(rows)
    (folder / "stiffness.csv").write_text(text)
    seen = read_observations(folder / "stiffness.csv", "normal_stiffness")
    save_law(fit_law(seen), folder / "measured.nc")
    result = solve(folder, BLOCKS, ('"table.csv"\nlaw_error = "10 %"', '"measured.nc"'))
    assert "joint_stiffness_mean_law" not in result
    assert (
        "not contain the error of the law of interface 0, which is unknown"
        in result.attrs["cautions"]
    )
    assert "cells" not in result.attrs["facts"]


def test_bodies_close_by_the_table(folder):
    """Without Poisson's effect the pressure of 4 MPa is even, which the table reaches at
    0.1 um + 3 MPa over the second chord.
    """
    result = solve(folder, BODIES)
    np.testing.assert_allclose(result["traction"][0, :, 0], -4e6, rtol=1e-6)
    np.testing.assert_allclose(result["jump"][0, :, 0], -(1e-7 + 3e6 / CHORDS[1]), rtol=1e-6)


def test_a_table_of_two_rows_is_a_constant_stiffness(folder):
    (folder / "two.csv").write_text("pressure (MPa), overclosure (um)\n0, 0\n10, 1\n")
    two = ("table.csv", "two.csv"), ('two.csv"', 'two.csv"\nlaw_error = 0.1')
    table, linear = solve(folder, BODIES, *two), solve(folder, BODIES, LINEAR)
    for name in ("jump", "load_stiffness", "load_stiffness_mean_law"):
        np.testing.assert_allclose(table[name], linear[name], rtol=2e-3, atol=1e-15)


def test_loads_far_beyond_a_table_are_refused_before_anything_is_solved(folder):
    with pytest.raises(CaseError, match=r"1 kPa to 100 MPa \(table.csv\), so all answers"):
        solve(folder, BODIES, ('"4 MPa"', '"400 MPa"'))
    assert solve(folder, BODIES, LINEAR, ('"4 MPa"', '"400 MPa"'))["converged"].all()


def test_a_constant_stiffness_is_stated_with_its_error(folder):
    """The compliance 1/K A in addition to the compliance 2 h / (E A) of both bodies."""
    result = solve(folder, BODIES, LINEAR)
    np.testing.assert_allclose(result["jump"][0, :, 0], -4e-7, rtol=1e-6)
    area, bodies = 4e-4, 2.0 * 0.01 / 210e9
    stiffness = area / (1e-13 + bodies)
    assert float(result["load_stiffness"][0, 0]) == pytest.approx(stiffness, rel=1e-6)
    low, high = result["load_stiffness_mean_law"][:, 0, 0].to_numpy()
    half = 0.1 * 1e-13 / (1e-13 + bodies) * stiffness
    np.testing.assert_allclose([low, high], [stiffness - half, stiffness + half], rtol=2e-3)


def test_a_stated_error_is_of_a_table_only(folder):
    write_law(folder / "law.nc")
    with pytest.raises(CaseError, match="law_error belongs to a table of pressure and overclosure"):
        solve(folder, BLOCKS, ("table.csv", "law.nc"))
    with pytest.raises(CaseError, match="law_error belongs to a table in law"):
        solve(folder, BODIES, ('law = "table.csv"', "law_error = 0.1"))


def test_a_structure_that_fails_at_once_reports_why_and_not_that_its_path_is_empty(folder):
    """A cover that is pulled off has no equilibrium, stated errors or not."""
    with pytest.raises(ConvergenceError, match="no step converged"):
        solve(folder, BODIES, LINEAR, ('"4 MPa"', '"-4 MPa"'))
