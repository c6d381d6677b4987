"""Stacked blocks and lap joints as bodies: they vibrate, and take representative volumes."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.fe.faces import face_of
from multiscale.fe.mesh_file import box_mesh
from multiscale.io import open_dataset, write_dataset
from multiscale.laws.bulk import AnisotropicElastic
from multiscale.macro.bodies.builders import LapShape, lap_meshes
from multiscale.pipeline import load_case, run
from multiscale.pipeline.stage import Job
from multiscale.pipeline.stages.vibrating_bodies import VIBRATING_BODIES
from multiscale.schema import RVE
from tests.pipeline.test_intervals import ByPickle, write_cells
from tests.pipeline.test_representative_volume import RECIPE, TEXT
from tests.support import TWO_BLOCKS, case_of, case_text, write_body, write_law, write_scene

SHAPE = LapShape(0.1, 0.04, 0.008, 0.04, 0.009, 0.018, 0.02, 1)
LAP = case_text("lap")
PLATES = case_text("plates")
VIBRATION = """
[interface]
law = "law.nc"
friction = 0.2
stiffness_ratio = 0.8
extrapolate = true
[vibration]
modes = [1]
amplitudes = ["1 um"]
preload_friction = false
slabs = 128
"""
STIFF = (
    TWO_BLOCKS.replace('"10 mm"]', '"0.5 mm"]')
    .replace("210 GPa", "1e7 GPa")
    .replace('["5 MPa", "20 MPa"]', '["20 MPa"]')
    .replace("friction = 0.2", 'law = "law.nc"\nfriction = 0.2')
    .replace("poissons_ratio = 0", 'poissons_ratio = 0\ndensity = "8000 kg/m^3"')
)
EDGE, MASS = 0.02, 8000.0 * 0.02**2 * 0.5e-3  # of the upper block


@pytest.mark.slow
def test_a_lap_joint_has_the_modes_of_the_same_bodies(tmp_path):
    pytest.importorskip("gmsh", exc_type=Exception)
    write_law(tmp_path / "law.nc")
    for name, mesh in zip(("lower", "upper"), lap_meshes(SHAPE), strict=True):
        write_body(tmp_path / f"{name}.msh", mesh)
        meshed = np.linalg.norm(face_of(mesh, "washer").normals, axis=1).sum()  # a polygon
    pressed = LAP.replace('"25 MPa"', f'"{25.0 * meshed / SHAPE.ring:.12g} MPa"')
    lap, plates = (
        run(load_case(write_scene(tmp_path, text + VIBRATION)), tmp_path / name)["vibration"]
        for name, text in (("lap", pressed), ("plates", PLATES))
    )
    np.testing.assert_allclose(lap["mode_frequency"], plates["mode_frequency"], rtol=1e-6)
    np.testing.assert_allclose(lap["frequency"], plates["frequency"], rtol=1e-4)
    np.testing.assert_allclose(lap["damping"], plates["damping"], rtol=0.05)  # beds differ
    with pytest.raises(CaseError, match="body 0 has no density"):
        case_of(tmp_path, (LAP + VIBRATION).replace("density", "# density"))


@pytest.mark.slow
def test_frequencies_change_evenly_with_a_smooth_preload(tmp_path):
    """Rounding that moves a plate along its joint changes no frequency."""
    pytest.importorskip("gmsh", exc_type=Exception)
    write_law(tmp_path / "law.nc")
    frequency = []
    for preload in (20.0, 23.0, 26.0, 29.0):
        text = LAP.replace('"25 MPa"', f'"{preload} MPa"') + VIBRATION
        case = load_case(write_scene(tmp_path, text))
        frequency += run(case, tmp_path / f"{preload:g}")["vibration"][
            "mode_frequency"
        ].values.tolist()
    first, second = np.diff(frequency), np.diff(frequency, 2)
    assert np.all(np.abs(second) < 0.1 * np.abs(first[0]))


def test_a_block_that_slides_vibrates_with_stiffness_and_loss_of_its_cycles(tmp_path):
    """One degree of freedom: rigid blocks, of which the upper block has all the mass."""
    write_law(tmp_path / "law.nc")
    cycles = '[cycles]\nshear = "2 MPa"\ncycles = 1\nsteps = 4\n'
    pressed = run(case_of(tmp_path, STIFF + cycles), tmp_path / "cycles")["macro_result"]
    secant, loss = (float(pressed[name].squeeze()) for name in ("secant_stiffness", "cycle_loss"))
    moved = 2e6 / secant
    asked = f'[vibration]\namplitudes = ["{moved:.9g} m"]\npreload_friction = false\n'
    result = run(case_of(tmp_path, STIFF + asked), tmp_path / "vibration")["vibration"]
    k = secant * EDGE**2
    assert float(result["frequency"][0]) == pytest.approx(np.sqrt(k / MASS) / (2 * np.pi), rel=2e-3)
    assert float(result["damping"][0]) == pytest.approx(loss / (2 * np.pi * k * moved**2), rel=0.03)


@pytest.mark.slow
def test_workers_solve_the_changes_of_a_vibration(tmp_path):
    write_cells(tmp_path / "law.nc")
    asked = '[vibration]\namplitudes = ["20 nm"]\npreload_friction = false\nslabs = 16\n'
    case = case_of(tmp_path, STIFF + asked).from_structure(None)
    alone, shared = (VIBRATING_BODIES.run(case, {}, Job(tmp_path, e)) for e in (None, ByPickle()))
    np.testing.assert_allclose(alone["damping_mean_law"], shared["damping_mean_law"], rtol=1e-12)


@pytest.mark.slow
def test_blocks_of_a_volume_are_as_stiff_as_its_tensor_and_as_sure(tmp_path):
    write_law(tmp_path / "law.nc")
    pores = TEXT.replace("voxels = 10", "voxels = 6") + RECIPE.replace("= 3", "= 2")
    rve = run(case_of(tmp_path, pores), tmp_path / "pores")["rve"]
    write_dataset(rve, tmp_path / "pores.nc", RVE)
    text = TWO_BLOCKS.replace("friction = 0.2", 'law = "law.nc"\nfriction = 0.2')
    moduli = 'youngs_modulus = "210 GPa"\npoissons_ratio = 0\n'
    axes = "rve_axes = [[0, 0, 1], [0, 1, 0]]\n"
    porous = run(
        case_of(tmp_path, text.replace(moduli, f'rve = "pores.nc"\n{axes}')), tmp_path / "porous"
    )["macro_result"]
    x, y = np.eye(3)[[2, 1]]
    turned = AnisotropicElastic(rve["stiffness"].values).turned(np.stack([x, y, np.cross(x, y)], 1))
    of_tensor = RVE.assign(rve, {"stiffness": turned.stiffness})
    write_dataset(of_tensor, tmp_path / "tensor.nc", RVE)
    tensor = run(
        case_of(tmp_path, text.replace(moduli, 'rve = "tensor.nc"\n')), tmp_path / "tensor"
    )["macro_result"]
    np.testing.assert_allclose(porous["solid_stiffness"], tensor["solid_stiffness"], rtol=1e-6)
    # both blocks err together, so that the stiffness of the bodies errs as their modulus
    half = porous["error_half_width"].sel(quantity="solid_stiffness", error_term="sampling")
    largest = float(rve["modulus_error"].sel(rve_error="sampling").max())
    np.testing.assert_allclose(half, largest / 1.02, rtol=0.03)
    assert open_dataset(tmp_path / "pores.nc", RVE).attrs["poissons_ratio"] == 0.3


JOINT = '[interface]\nlaw = "law.nc"\nfriction = 0.9\nstiffness_ratio = 0.8\n'
BLOCKS = TWO_BLOCKS.replace('["5 MPa", "20 MPa"]', '["20 MPa"]').replace(
    "[interface]\nfriction = 0.2\nstiffness_ratio = 0.8\n", JOINT
)
BLOCKS += '[cycles]\nshear = "2 MPa"\ncycles = 2\nsteps = 2\n'
BODY = """
[[structure.bodies]]
name = "NAME"
mesh = "NAME.msh"
unit = "mm"
youngs_modulus = "210 GPa"
poissons_ratio = 0
supports = { HELD }
"""
LOADS = """
[[structure.interfaces]]
sides = ["lower.top", "upper.bottom"]
[[structure.loads]]
name = "press"
face = "upper.top"
pressure = "20 MPa"
[[structure.loads]]
name = "shear"
face = "upper.top"
traction = ["2 MPa", 0, 0]
[statics]
steps = [{ press = 1 }]
[cycles]
load = "shear"
cycles = 2
steps = 2
"""
PARTS = [("lower", 'bottom = "clamped"'), ("upper", 'front = "y"')]
BODIES = "".join(BODY.replace("NAME", name).replace("HELD", item) for name, item in PARTS)
BODIES = f'title = "Bodies"\n[structure]\nkind = "bodies"\n{BODIES}{LOADS}{JOINT}'
"""Two blocks, and the same bodies by their meshes under named loads."""


@pytest.fixture
def meshed(tmp_path):
    write_law(tmp_path / "law.nc")
    for name, z in (("lower", 0.0), ("upper", 0.01)):
        mesh = box_mesh((0.02, 0.02, 0.01), (2, 2, 1), origin=(0.0, 0.0, z))
        write_body(tmp_path / f"{name}.msh", mesh)
    return tmp_path


@pytest.mark.slow
def test_blocks_answer_as_the_same_bodies_under_named_loads(meshed):
    """The same quantities under two names; the beds of sliders differ."""
    blocks, bodies = (
        run(case_of(meshed, text.replace("= 0.9", "= 0.15")), meshed / name)["macro_result"]
        for text, name in ((BLOCKS, "blocks"), (BODIES, "bodies"))
    )
    area, pressed = 0.02**2, {"step": 0}
    for name, twin in (("joint_stiffness", "press"), ("tangential_stiffness", "shear")):
        stiffness = bodies["stuck_stiffness"].isel(pressed).sel(load=twin)
        np.testing.assert_allclose(area * blocks[name][0], stiffness, rtol=1e-3, err_msg=name)
    for name, twin in (("approach", "press"), ("shear_displacement", "shear")):
        size = float(np.abs(blocks[name]).max())
        apart = blocks[name].values - bodies["load_displacement"].sel(load=twin).values
        assert np.abs(apart).max() < 5e-3 * size, name
    for name in ("interface_pressure", "cycle_energy", "interface_energy"):
        np.testing.assert_allclose(blocks[name], bodies[name], rtol=0.02, err_msg=name)


def test_bodies_are_condensed_as_the_same_blocks(meshed):
    cut = "[substructures]\nparts = [1, 1]\nhomogenise = true\n"
    blocks, bodies = (
        run(
            case_of(meshed, text.replace("cycles = 2\nsteps = 2", "cycles = 1\nsteps = 1") + cut),
            out,
        )
        for text, out in ((BLOCKS, meshed / "blocks"), (BODIES, meshed / "bodies"))
    )
    stiffness = blocks["homogenised"]["stiffness"].values
    size = np.abs(stiffness).max()
    np.testing.assert_allclose(
        bodies["homogenised"]["stiffness"], stiffness, rtol=0.0, atol=1e-9 * size
    )


@pytest.mark.slow
def test_a_block_has_the_life_of_the_same_body(meshed):
    fatigue = """
[fatigue]
body = "BODY"
fatigue_limit = "1.5 MPa"
strength = "600 MPa"
damage_strength = "0.0002 MPa"
threshold = 0.0
feedback = false
"""
    lives = []
    for text, name in ((BLOCKS, "body 1"), (BODIES, "upper")):
        case = case_of(meshed, text + fatigue.replace("BODY", name))
        lives.append(float(run(case, meshed / name)["fatigue_life"]["cycles_to_first"]))
    assert np.isfinite(lives[0])
    assert lives[0] == pytest.approx(lives[1], rel=0.02)  # beds differ
    with pytest.raises(CaseError, match="there are body 0, body 1; name it by body"):
        case_of(meshed, BLOCKS + fatigue.replace('body = "BODY"\n', ""))
