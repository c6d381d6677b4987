"""Cases with [fatigue]: life and place of cracks in bodies, and refusals."""

import meshio
import numpy as np
import pytest
from matplotlib.figure import Figure
from skfem import MeshHex

from multiscale.errors import CaseError
from multiscale.fe.mesh_file import box_mesh
from multiscale.io import open_dataset
from multiscale.micro.damage import (
    FatigueMaterial,
    local_fatigue,
    two_scale_fatigue,
)
from multiscale.pipeline import load_case, run
from multiscale.plotting import plot_element_field
from multiscale.schema import FATIGUE_LIFE
from tests.closed_forms.fatigue import damage_per_cycle, plastic_strain_per_cycle, reversed_life
from tests.pipeline.test_body_cases import write_scattered_law
from tests.support import case_text, refused_rows, write_body, write_scene

TEXT = case_text("fatigue")
MATERIAL = FatigueMaterial(200e9, 0.3, 200e6, 0.5e6, threshold=0.05, feedback=False)
RADIUS, HALF = 1e-3, 8e-3
"""Radius of a hole and half the edge of the plate around it, m."""


def holed_plate(around=10, along=12):
    """A quarter of a square plate with a hole, graded towards it."""
    share = np.linspace(0.0, 1.0, along + 1) ** 1.8
    angle = np.linspace(0.0, 0.5 * np.pi, around + 1)
    way = np.stack([np.cos(angle), np.sin(angle)])
    outer = HALF * way / np.abs(way).max(axis=0)
    flat = RADIUS * way[:, None] + share[:, None] * (outer - RADIUS * way)[:, None]
    mesh = MeshHex.init_tensor(share, angle, np.array([0.0, 1.0]))
    i = np.searchsorted(share, mesh.p[0] - 1e-9)
    j = np.searchsorted(angle, mesh.p[1] - 1e-9)
    points = np.stack([*flat[:, i, j], 0.5e-3 * mesh.p[2]])
    near = 1e-9
    return MeshHex(points, mesh.t).with_boundaries(
        {
            "left": lambda x: np.abs(x[0]) < near,
            "right": lambda x: np.abs(x[0] - HALF) < near,
            "front": lambda x: np.abs(x[1]) < near,
            "bottom": lambda x: np.abs(x[2]) < near,
        }
    )


def solve(folder, *pairs):
    return run(load_case(write_scene(folder, TEXT, *pairs)), folder / "out")[FATIGUE_LIFE.name]


def closed_life(amplitude, limit, modulus=200e9):
    plastic = plastic_strain_per_cycle(amplitude, modulus, 0.3, limit)
    damage = damage_per_cycle(amplitude, modulus, 0.3, limit, 0.5e6)
    return reversed_life(plastic, damage, 0.05, 0.3)


@pytest.fixture
def cube(tmp_path):
    write_body(tmp_path / "part.msh", box_mesh((0.01, 0.01, 0.01), (1, 1, 1)))
    return tmp_path


PAD = case_text("porous_pad")


def test_structures_that_are_solved_again_keep_the_volumes_of_their_other_bodies(cube, monkeypatch):
    """A porous pad bears its share of the load next to the body that tires, before and after."""
    write_body(cube / "pad.msh", box_mesh((0.01, 0.01, 0.01), (1, 1, 1), origin=(0.01, 0.0, 0.0)))
    asked = {}

    def follow(stress_of, elements, material, **options):
        asked["first"], asked["again"] = (
            stress_of(share * np.ones(elements)) for share in (0, 1e-12)
        )
        return local_fatigue(stress_of, elements, material, **options)

    monkeypatch.setattr("multiscale.pipeline.stages.body_fatigue.local_fatigue", follow)
    load = TEXT[TEXT.index("[[structure.loads]]") : TEXT.index("[statics]")]
    solve(cube, (load, PAD), ("[fatigue]", '[fatigue]\nbody = "part"'))
    np.testing.assert_allclose(asked["again"], asked["first"], rtol=1e-6, atol=1.0)


def test_one_element_has_the_closed_form_of_reversed_tension(cube):
    result = solve(cube)
    life = float(result["cycles_to_crack"])
    assert life == pytest.approx(closed_life(210e6, 200e6), rel=1e-3)
    np.testing.assert_allclose(result["crack_position"], 0.005)
    drawn = meshio.read(next((cube / "out" / "fields").glob("fatigue_life-*.vtu")))
    np.testing.assert_allclose(drawn.cell_data["damage"], 0.3)
    ax = plot_element_field(result, "equivalent_amplitude", ax=Figure().add_subplot())
    np.testing.assert_allclose(ax.collections[0].get_array(), 210.0)
    inner, outer = (result[f"cycles_to_crack_{kind}"].values for kind in ("mean_law", "one_part"))
    assert outer[0] < inner[0] < life < inner[1] < outer[1]
    # the limit 1.96 standard errors away has a closed form, too
    low = 200e6 * np.exp(-0.01 * 1.959964)
    assert inner[0] == pytest.approx(closed_life(210e6, low), rel=2e-3)


def test_a_stated_modulus_widens_the_intervals_of_the_life(cube):
    pairs = [
        ('"200 GPa"', '"200 GPa +- 5 %"'),
        ("limit_error = 0.01", "limit_error = 0.0"),
    ]
    result = solve(cube, *pairs)
    stiffer, life = closed_life(210e6, 200e6, 204e9), closed_life(210e6, 200e6)
    half = 0.05 * (stiffer / life - 1.0) / 0.02
    low, high = result["cycles_to_crack_mean_law"].to_numpy()
    assert 0.5 * np.log(high / low) == pytest.approx(half, rel=5e-3)


def test_a_plate_cracks_at_its_hole(tmp_path):
    """Place and life follow from Kirsch's stress in the element at the hole.

    The plate is finite: Heywood's factor of a strip with a hole, 2 + (1 - d/w)^3 over the net
    section, raises the stress by 1.7 % (R. B. Heywood, Designing by Photoelasticity, 1952).
    """
    write_body(tmp_path / "part.msh", holed_plate())
    result = solve(tmp_path, ('"210 MPa"', '"85 MPa"'))
    x, y, _ = result["crack_position"].values
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    assert radius < 1.1 * RADIUS
    assert angle > np.radians(80.0)
    a, two = (RADIUS / radius) ** 2, np.cos(2.0 * angle)
    hoop = 0.5 * ((1.0 + a) - (1.0 + 3.0 * a**2) * two)
    radial = 0.5 * ((1.0 - a) + (1.0 - 4.0 * a + 3.0 * a**2) * two)
    narrow = 1.0 - RADIUS / HALF
    width = (2.0 + narrow**3) / narrow / 3.0
    local = 85e6 * width * np.array([hoop, radial, 0.0, 0.0, 0.0, 0.0])
    estimate = float(two_scale_fatigue(np.stack([local, -local]), MATERIAL)["cycles_to_rupture"])
    assert float(result["cycles_to_crack"]) == pytest.approx(estimate, rel=0.12)


@pytest.mark.slow
def test_the_interval_of_a_plate_counts_its_mesh(tmp_path):
    """The change from twice the element size bounds the distance to half of it."""
    lives, changes = [], []
    for along in (12, 24, 48):
        folder = tmp_path / f"{along}"
        folder.mkdir()
        write_body(folder / "part.msh", holed_plate(5 * along // 6, along))
        write_body(folder / "coarse.msh", holed_plate(5 * along // 12, along // 2))
        mesh = ('unit = "mm"', 'unit = "mm"\ncoarser = "coarse.msh"')
        result = solve(folder, mesh, ('"210 MPa"', '"120 MPa"'))
        lives.append(float(result["cycles_to_crack"]))
        changes.append(float(result["mesh_error"]))
        low, high = result["cycles_to_crack_mean_law"].to_numpy()
        assert low < lives[-1] * np.exp(-changes[-1]) < lives[-1] * np.exp(changes[-1]) < high
    finer = np.abs(np.log(np.array(lives[1:]) / lives[:-1]))
    np.testing.assert_allclose(finer, changes[1:], rtol=1e-6)
    assert np.all(finer < changes[:-1])
    assert np.all(np.diff(changes) < 0.0)


def test_a_damaged_body_bears_its_stress_on_the_remaining_area(cube):
    pairs = ('"210 MPa"', '"105 MPa"'), ('bottom = "z" }', 'bottom = "z" }\ndamage = 0.5')
    life = float(solve(cube, *pairs)["cycles_to_crack"])
    assert life == pytest.approx(closed_life(210e6, 200e6), rel=1e-3)


@pytest.mark.slow
def test_the_rest_of_an_element_bears_the_whole_load(cube):
    """The structure is solved again with cracked elements; here that has a closed form."""
    pairs = (
        ("feedback = false", "feedback = false\nscatter = 0.04\ntolerance = 0.2"),
        ('"210 MPa"', '"225 MPa"'),
    )
    result = solve(cube, *pairs)
    assert int(result["solves"]) > 5
    cycle = 225e6 * np.array([1.0, -1.0])[:, None, None] * np.eye(6)[0]
    alone = local_fatigue(
        lambda cracked: cycle / (1.0 - cracked[:, None]), 1, MATERIAL, scatter=0.04, tolerance=0.2
    )
    for name in ("cycles_to_first", "cycles_to_crack"):
        assert float(result[name]) == pytest.approx(float(alone[name]), rel=1e-6)


@pytest.mark.slow
def test_the_error_of_the_law_widens_the_intervals_of_the_life(tmp_path):
    """A body on a rough interface with the ground, pressed and pulled."""
    write_body(tmp_path / "part.msh", box_mesh((0.02, 0.02, 0.01), (4, 4, 2)))
    write_scattered_law(tmp_path / "law.nc")
    joint = """[[structure.interfaces]]
sides = ["ground", "part.bottom"]
law = "law.nc"
friction = 0.5
stiffness_ratio = 0.8
[[structure.loads]]
name = "press"
face = "part.top"
pressure = "20 MPa"
[statics]"""
    pairs = [
        ('supports = { left = "x", front = "y", bottom = "z" }\n', ""),
        ("[statics]", joint),
        ("{ pull = 0 }", "{ press = 1 }"),
        ('traction = ["210 MPa", 0, 0]', 'traction = ["10 MPa", 0, 0]'),
        ('fatigue_limit = "200 MPa"', 'fatigue_limit = "6 MPa"'),
        ('damage_strength = "0.5 MPa"', 'damage_strength = "0.001 MPa"'),
        ("threshold = 0.05", "threshold = 0.0"),
        ("limit_error = 0.01", "limit_error = 0.0"),
    ]
    result = solve(tmp_path, *pairs)
    life, (low, high) = (result[f"cycles_to_crack{k}"].values for k in ("", "_mean_law"))
    assert np.isfinite(life)
    assert 0.8 * life < low < 0.9999 * life
    assert high == pytest.approx(life**2 / low)
    assert float(result["crack_distance"]) < 0.006  # the same element, or its neighbour


@pytest.mark.parametrize(("base", "pairs", "sentence"), refused_rows("fatigue"))
def test_loads_without_fatigue_are_refused(cube, base, pairs, sentence):
    with pytest.raises(CaseError, match=sentence):
        solve(cube, *pairs)


@pytest.mark.slow
def test_the_shipped_strip_cracks_at_its_hole_across_the_load(shipped_run):
    life = open_dataset(shipped_run("holed_strip")[0] / f"{FATIGUE_LIFE.name}.nc")
    x, y, _ = life["crack_position"].to_numpy()
    assert x < 1.5e-3
    assert 5e-3 < np.hypot(x, y) < 6e-3
    low, high = life["cycles_to_crack_one_part"].to_numpy()
    assert 0.5 < low / float(life["cycles_to_crack"]) < 1.0 < high / float(life["cycles_to_crack"])
    assert 0.0 < float(life["mesh_error"]) < 0.5
