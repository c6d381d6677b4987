"""Cases of links from tables: paths past limit points, beams, and refusals."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar, root

from multiscale.io import open_dataset
from multiscale.schema import MACRO_RESULT
from tests.macro.test_limit_load import FORCE, resist
from tests.support import SCENES

DOME = {
    "nodes.csv": """x,y,z,fix_x,fix_y,fix_z,load_x,load_y,load_z
1,0,0,1,1,1,0,0,0
-0.5,0.8660254037844386,0,1,1,1,0,0,0
-0.5,-0.8660254037844386,0,1,1,1,0,0,0
0,0,0.2,0,0,0,0,0,-1000
""",
    "links.csv": "first,second,law\n0,3,steel\n1,3,steel\n2,3,steel\n",
    "case.toml": """title = "Dome under a weight"

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
""",
}
FRAME = {
    "nodes.csv": "x,y,z,fix_x,fix_y,fix_z,fix_rx,fix_ry,fix_rz,load_z\n"
    "0,0,0,1,1,1,1,1,1,0\n1,0,0,0,0,0,0,0,0,0\n2,0,0,0,0,0,0,0,0,-100\n2,0,3,1,1,1,1,1,1,0\n",
    "links.csv": "first,second,law\n0,1,beam\n1,2,beam\n2,3,rope\n",
    "case.toml": """title = "Bracket on a rope"
[structure]
kind = "table"
nodes = "nodes.csv"
links = "links.csv"
laws.rope = { kind = "cable", rigidity = "3 kN" }
[structure.laws.beam]
kind = "beam"
rigidity = "1 MN"
torsion = "1 kN*m^2"
bending_y = "2 kN*m^2"
bending_z = "1 kN*m^2"
[statics]
load_factors = [1.0]
""",
}


@pytest.fixture
def run(without_pages, command, tmp_path):
    """Run a case with a text replaced; return status, output, errors and the folder."""

    def run(files, old="", new=""):
        for name, text in files.items():
            (tmp_path / name).write_text(text.replace(old, new) if old else text)
        return *command("run", tmp_path / "case.toml", "-o", tmp_path / "out"), tmp_path / "out"

    return run


def test_a_case_has_the_critical_load_with_a_caution_of_the_indefinite_tangent(run):
    status, result, warned, out = run(DOME)
    assert status == 0, warned
    limit = resist(3, 0.2, np.hypot(1.0, 0.2) ** (1.0 / 3.0)) / FORCE
    assert f"The links snap through at the load factor {limit:.4g}, where node 3" in result
    assert "the tangent is indefinite beyond the limit point" in result + warned
    solved = open_dataset(out / "macro_result.nc", MACRO_RESULT)
    assert float(solved.critical_factor) == pytest.approx(limit, rel=1e-8)


def test_the_shipped_dome_follows_its_symmetric_path_and_draws_it(command, tmp_path):
    status, _, warned = command("run", SCENES / "shallow_dome.toml", "-o", tmp_path)
    assert status == 0, warned
    path = open_dataset(tmp_path / "macro_result.nc", MACRO_RESULT)

    # bars at the crown, in the ring and below it: unknowns are the height of the crown, the radius
    # of the ring and its height, in a frame that turns with the symmetry
    edge, count, place = 2.5, np.array([6, 6, 12]), np.array([0.8216, 2.5, 0.6216])

    def lengths(x):
        crown, r, z = x
        below = r**2 + 3.0 * edge**2 - 3.0 * edge * r + z**2
        return np.sqrt([r**2 + (crown - z) ** 2, r**2, below])

    rest = lengths(place)

    def force(x):  # gradient of the energy, N, by a complex step
        slope = [lengths(x + 1e-30j * unit).imag / 1e-30 for unit in np.eye(3)]
        return np.array(slope) @ (count * 100e6 / rest * (lengths(x) - rest))

    def pressed(crown, start):
        ring = root(lambda q: force([crown, *q])[1:] / 1e6, start, tol=1e-13).x
        return -force(np.array([crown, *ring]))[0] / 100e3, ring

    ring = place[1:]
    for moved, factor in zip(
        path.displacement.values[:, 0, 2], path.load_factor.values, strict=True
    ):
        carried, ring = pressed(place[0] + moved, ring)
        assert carried == pytest.approx(factor, abs=1e-8)
    top = minimize_scalar(
        lambda w: -pressed(place[0] - w, place[1:])[0], bounds=(0.0, 0.15), options={"xatol": 1e-7}
    )
    assert float(path.critical_factor) == pytest.approx(-top.fun, rel=1e-8)
    assert path.attrs["critical"] == "limit point"
    report = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "the tangent is indefinite beyond the limit point" in report
    assert {"load_factor.png", "critical_mode.png"} <= {
        file.name for file in (tmp_path / "figures").iterdir()
    }


def test_a_cantilever_and_a_rope_share_a_load_by_their_stiffness(run):
    status, _, warned, out = run(FRAME)
    assert status == 0, warned
    solved = open_dataset(out / "macro_result.nc", MACRO_RESULT).isel(step=0)
    bending, rope = 3.0 * 2000.0 / 2.0**3, 3000.0 / 3.0  # 3 EI / L^3 and EA / L, N/m
    assert float(-solved.displacement[2, 2]) == pytest.approx(100.0 / (bending + rope), rel=1e-9)
    assert float(solved.tension[2]) == pytest.approx(100.0 * rope / (bending + rope), rel=1e-9)


def test_tensions_of_links_that_turn_are_a_caution_with_their_work(run):
    """A hinged column under .4 of its buckling load bends 1 / (1 - .4) times as far as without."""
    n, length, bending = 20, 2.0, 2000.0
    rows = [
        f"{length * k / n},0,0,{int(k in (0, n))},1,{int(k in (0, n))},-9" for k in range(n + 1)
    ]
    force = -0.4 * bending * (np.pi / length) ** 2
    files = {
        "nodes.csv": "x,y,z,fix_x,fix_y,fix_z,load_z,fix_rx,fix_rz\n"
        + "".join(f"{row},1,1\n" for row in rows),
        "links.csv": "first,second,law,prestress\n"
        + "".join(f"{k},{k + 1},beam,{force}\n" for k in range(n)),
        "case.toml": FRAME["case.toml"].replace(
            'laws.rope = { kind = "cable", rigidity = "3 kN" }', ""
        ),
    }
    status, _, warned, _ = run(files)
    assert status == 0, warned
    assert "the work of tensions by rotation of links is 40 %" in warned


MOTION = """[dynamics]
step = "1 ms"
duration = "1 s"
mass = "1 kg"
load_history = [["0 s", 1.0]]"""


@pytest.mark.parametrize(
    ("files", "old", "new", "sentence"),
    [
        (DOME, "[6.0]", "[1.0, 6.0]", "a single load factor that is not zero, got [1.0, 6.0]"),
        (DOME, "[6.0]", "[0.0]", "a single load factor that is not zero, got [0.0]"),
        (DOME, "exact = true\n", "", "set exact to true"),
        (DOME, "exact = true\n", "exact = true\nstability = true\n", "leave out stability"),
        (DOME, '"1 MN"', '"inextensible"', "needs extensible links"),
        (FRAME, 'bending_y = "2 kN*m^2"', "", "a beam needs its section: give bending_y in N m^2"),
        (FRAME, '"3 kN" }', '"3 kN", torsion = "1 N*m^2" }', "a cable does not bend"),
        (FRAME, "[statics]\nload_factors = [1.0]", MOTION, "no rotary inertias"),
        (FRAME, "[statics]", "[substructures]\nparts = [2, 1]\n[statics]", "bars for the beams"),
    ],
    ids=[
        *("two loads", "no load", "not exact", "stability", "inextensible"),
        *("no section", "bent cable", "motion", "cut beams"),
    ],
)
def test_a_case_that_does_not_fit_is_refused(run, files, old, new, sentence):
    assert any(old in text for text in files.values())
    status, _, refused, _ = run(files, old, new)
    assert status == 1
    assert sentence in " ".join(refused.split())
