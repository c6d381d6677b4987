"""Cases of links from tables: paths past limit points, and refusals."""

import numpy as np
import pytest

from multiscale.io import open_dataset
from multiscale.schema import MACRO_RESULT

NODES = """x,y,z,fix_x,fix_y,fix_z,load_x,load_y,load_z
1,0,0,1,1,1,0,0,0
-0.5,0.8660254037844386,0,1,1,1,0,0,0
-0.5,-0.8660254037844386,0,1,1,1,0,0,0
0,0,0.2,0,0,0,0,0,-1000
"""
CASE = """title = "Dome under a weight"

[structure]
kind = "table"
nodes = "nodes.csv"
links = "links.csv"

[structure.laws.steel]
kind = "bar"
rigidity = "1 MN"

[statics]
load_factors = [6.0]
exact = true
past_limit = true
"""


@pytest.fixture
def run(command, tmp_path):
    """Run the case with a text replaced; return status, output, errors and the folder."""

    def run(old="", new=""):
        (tmp_path / "nodes.csv").write_text(NODES)
        (tmp_path / "links.csv").write_text("first,second,law\n0,3,steel\n1,3,steel\n2,3,steel\n")
        (tmp_path / "dome.toml").write_text(CASE.replace(old, new) if old else CASE)
        return *command("run", tmp_path / "dome.toml", "-o", tmp_path / "out"), tmp_path / "out"

    return run


def test_a_case_has_the_critical_load_with_a_caution_of_the_indefinite_tangent(run):
    status, said, warned, out = run()
    assert status == 0, warned
    start = np.hypot(1.0, 0.2)
    length = start ** (1.0 / 3.0)
    limit = 3e3 / start * (start - length) * np.sqrt(length**2 - 1.0) / length
    assert f"The links snap through at the load factor {limit:.4g}, where node 3" in said
    assert "the tangent is indefinite beyond the limit point" in said + warned
    solved = open_dataset(out / "macro_result.nc", MACRO_RESULT)
    assert float(solved.critical_factor) == pytest.approx(limit, rel=1e-8)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("[6.0]", "[1.0, 6.0]", "a single load factor that is not zero, got [1.0, 6.0]"),
        ("[6.0]", "[0.0]", "a single load factor that is not zero, got [0.0]"),
        ("exact = true\n", "", "set exact to true"),
        ("exact = true\n", "exact = true\nstability = true\n", "leave out stability"),
        ('"1 MN"', '"inextensible"', "needs extensible links"),
    ],
    ids=["two loads", "no load", "not exact", "stability", "inextensible"],
)
def test_a_path_that_does_not_fit_is_refused(run, old, new, sentence):
    status, _, refused, _ = run(old, new)
    assert status == 1
    assert sentence in " ".join(refused.split())
