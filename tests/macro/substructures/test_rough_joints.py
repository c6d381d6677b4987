"""Blocks and plates with rough joints: closed forms, equilibrium, friction and energy."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.laws import ConvexDecreasing, Exponential, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import LatinMethod
from multiscale.macro.bodies import LapShape, lap_joint, stacked_blocks
from multiscale.macro.bodies.builders import lap_meshes
from multiscale.macro.substructures import (
    PreparedStructure,
    cut_assembly,
    follow,
    joint_path,
    load_joint,
)
from tests.closed_forms.joint import joint_stiffness, series
from tests.support import keep_ignoring_broken_pipes

STEEL = Elastic(210e9, 0.3)
LAW = Sliders(Exponential(1e9, 0.18e-6), 0.2, pressures=(1e6, 1e8))
SHAPE = LapShape(0.1, 0.04, 0.008, 0.04, 0.009, 0.018, 0.01, layers=1)


@pytest.fixture(scope="module")
def gmsh():
    module = pytest.importorskip("gmsh", exc_type=Exception)
    yield module
    keep_ignoring_broken_pipes()


@pytest.mark.parametrize("parts", [(1, 1), (2, 2)])
def test_stacked_blocks_have_the_stiffness_and_approach_of_springs_in_series(parts):
    # frictionless platens and uniaxial stress: without lateral strain the clamp does not matter
    pressure = np.array([1e6, 10e6, 50e6])
    height, E, decay = 0.02, 210e9, 0.18e-6
    blocks = stacked_blocks((0.02, 0.03, height), (2, 2, 2), [Elastic(E, 0.0)] * 2, [LAW])
    result = load_joint(blocks, joint_path(tuple(pressure)), method=LatinMethod(parts=parts))
    assert result.converged.values.all()
    expected = joint_stiffness(pressure, decay, height / E, height / E)
    np.testing.assert_allclose(result.joint_stiffness, expected, rtol=1e-6)
    gap = decay * np.log(1e9 / pressure)
    approach = 2.0 * height * pressure / E - gap
    np.testing.assert_allclose(result.approach, approach, rtol=1e-6)
    np.testing.assert_allclose(-result.traction[..., 0], np.tile(pressure, (9, 1)).T, rtol=1e-6)
    assert np.all(result.stick_fraction == 1.0)
    # the tangents of the law do not slip: two blocks in shear and bending are softer still
    assert np.all(result.tangential_stiffness < 0.8 * pressure / decay)


def test_damage_softens_the_block_and_the_joint_that_have_it():
    height, E, pressure = 0.01, 70e9, 5e6
    materials = [Elastic(D * E, 0.0) for D in (1.0, 0.7, 1.0)]
    knot, c = np.array([0.0, 1e-6]), np.array([0.0, 1e25])
    sound = ConvexDecreasing(knot, c)
    damaged = ConvexDecreasing(knot, 0.6 * c)
    laws = [Sliders(normal, 0.2, pressures=(1e6, 1e8)) for normal in (sound, damaged)]
    blocks = stacked_blocks((0.02, 0.02, height), (2, 2, 1), materials, laws)
    result = load_joint(blocks, joint_path((pressure,)))
    interfaces = [law.stiffness(law.gap_at(np.array(pressure))) for law in (sound, damaged)]
    expected = series(E / height, 0.7 * E / height, E / height, *interfaces)
    np.testing.assert_allclose(result.joint_stiffness, expected, rtol=1e-6)
    np.testing.assert_array_equal(np.bincount(result.point_joint), [9, 9])


@pytest.fixture(scope="module")
def lap(gmsh):
    loading = joint_path((10e6, 50e6), shear=3e6, cycles=1, steps=4)
    return load_joint(lap_joint(SHAPE, (STEEL, STEEL), LAW), loading)


def test_plates_of_a_lap_joint_have_their_volume_and_matching_faces(gmsh):
    from skfem import Basis, ElementHex1

    meshes = lap_meshes(SHAPE)
    hole = np.pi / 4.0 * SHAPE.hole**2
    expected = (SHAPE.length * SHAPE.width - hole) * SHAPE.thickness
    faces = []
    for mesh in meshes:
        assert float(Basis(mesh, ElementHex1()).dx.sum()) == pytest.approx(expected, rel=2e-3)
        faces.append(mesh.p[:, np.unique(mesh.facets[:, mesh.boundaries["joint"]])])
        assert mesh.boundaries["end"].size > 0
    np.testing.assert_array_equal(*(face[:, np.lexsort(face)] for face in faces))
    assert meshes[0].p[2].max() == meshes[1].p[2].min() == 0.0


def test_the_tractions_of_a_lap_joint_carry_bolt_and_pull(lap):
    assert lap.converged.values.all()
    force = np.einsum("spd,p->sd", lap.traction.values, lap.point_area.values)
    ring = np.pi / 4.0 * (SHAPE.washer**2 - SHAPE.hole**2)
    # the guide of the end carries a little of the preload, all of the pull goes through the joint
    np.testing.assert_allclose(-force[:2, 0], lap.preload[:2] * ring, rtol=0.05)
    np.testing.assert_allclose(
        force[:, 1],
        lap.shear * SHAPE.width * SHAPE.thickness,
        atol=1e-6 * np.abs(force).max(),
    )


def test_a_cut_through_the_bolt_hole_names_the_divided_substructure(gmsh):
    with pytest.raises(CaseError, match=r"substructure \d of body 0 is in 2 pieces"):
        cut_assembly(lap_joint(SHAPE, (STEEL, STEEL), LAW), (1, 5))


def test_a_cut_lap_joint_equals_the_whole_joint(gmsh, lap):
    loading = joint_path((10e6, 50e6))
    cut = load_joint(
        lap_joint(SHAPE, (STEEL, STEEL), LAW), loading, method=LatinMethod(parts=(3, 1))
    )
    assert cut.attrs["substructures"] == 6
    np.testing.assert_allclose(cut.approach, lap.approach[:2], rtol=1e-6)
    np.testing.assert_allclose(cut.joint_stiffness, lap.joint_stiffness[:2], rtol=1e-6)


def test_no_point_of_a_joint_pulls_or_exceeds_friction_and_states_fill_the_area(lap):
    normal, shear = (
        lap.traction.values[..., 0],
        np.hypot(*np.moveaxis(lap.traction.values, 2, 0)[1:]),
    )
    assert np.all(normal <= 0.0)
    assert np.all(shear <= -0.2 * normal + 1e-12 * np.abs(normal).max())
    total = lap.open_fraction + lap.stick_fraction + lap.slip_fraction
    np.testing.assert_allclose(total, 1.0)
    slips = lap.contact_state.values == 2
    assert np.all(shear[slips] > -0.1 * normal[slips])  # most of the pressure is at its limit
    assert 0.0 < float(lap.slip_fraction[5]) < 1.0


def test_a_lap_joint_dissipates_energy_and_its_bolted_stiffness_grows_with_the_preload(lap):
    assert float(lap.cycle_energy[0]) > 0.0
    assert lap.joint_stiffness[1] > lap.joint_stiffness[0]
    assert np.isnan(lap.joint_stiffness[2:]).all()


def limited(*ends):
    """Law with data between two pressures."""
    cubic = ConvexDecreasing(np.array([0.0, 1e-6]), np.array([0.0, 1e25]), pressure_range=ends)
    return Sliders(cubic, 0.2)


def test_load_beyond_the_data_is_a_caution_and_far_beyond_them_unknown():
    materials = [Elastic(70e9, 0.0)] * 3
    laws = [limited(1e6, 100e6), limited(1e6, 4e6)]
    blocks = stacked_blocks((0.02, 0.02, 0.01), (2, 2, 1), materials, laws)
    loading = joint_path((3e6, 5e6, 9e6), shear=0.1e6, cycles=1, steps=1)
    result = load_joint(blocks, loading)
    np.testing.assert_allclose(result.load_above[:3], [[0, 0], [0, 1], [0, 1]], atol=1e-12)
    np.testing.assert_allclose(result.load_far[:3], [[0, 0], [0, 0], [0, 1]], atol=1e-12)
    np.testing.assert_array_equal(result.known[:4], [1, 1, 0, 0])
    far, near = result.attrs["cautions"].splitlines()
    assert (
        "100 % of the load lies more than a factor of 2 outside the pressures of the law of" in far
    )
    assert "interface 1, 1 MPa to 4 MPa" in far
    assert "at step 2 with the preload 9 MPa: the answer there is unknown" in far
    assert "100 % of the load lies above the pressures of the law of interface 1" in near
    for name in ("joint_stiffness", "approach", "displacement", "traction"):
        finite = np.isfinite(result[name].values.reshape(result.sizes["step"], -1))
        assert finite[:2].all()
        assert not finite[2:].any()
    assert np.isnan(result.cycle_energy).all()

    cut = load_joint(blocks, joint_path((9e6,)), method=LatinMethod(parts=(2, 1)))
    np.testing.assert_allclose(cut.load_above, [[0.0, 1.0]], atol=1e-12)  # of joints, not parts

    extended = load_joint(blocks, loading, extrapolate=True)
    np.testing.assert_array_equal(extended.known, result.known)
    np.testing.assert_array_equal(extended.joint_stiffness[:2], result.joint_stiffness[:2])
    assert np.isfinite(extended.joint_stiffness[2])
    assert np.isfinite(extended.cycle_energy).all()
    assert "extrapolated, and its error is unknown" in extended.attrs["cautions"]


def test_joint_and_bodies_in_series_are_the_whole(lap):
    """Springs for blocks, and for the lap joint the compliances of joint and bodies add up."""
    E, h, pressure = 70e9, 0.01, np.array([2e6, 20e6])
    blocks = stacked_blocks((0.02, 0.02, h), (2, 2, 1), [Elastic(E, 0.0)] * 3, [LAW, LAW])
    result = load_joint(blocks, joint_path(tuple(pressure)))
    of_law = LAW.normal.stiffness(LAW.normal.gap_at(pressure))
    np.testing.assert_allclose(result.interface_stiffness, 0.5 * of_law, rtol=1e-6)
    np.testing.assert_allclose(result.solid_stiffness, E / (3.0 * h), rtol=1e-6)
    whole = series(lap.interface_stiffness[:2].values, lap.solid_stiffness[:2].values)
    np.testing.assert_allclose(whole, lap.joint_stiffness[:2], rtol=1e-9)
    assert lap.interface_stiffness[1] > lap.interface_stiffness[0]


def test_a_load_that_slides_away_leaves_no_trace_in_the_next_path():
    blocks = stacked_blocks((0.02, 0.02, 0.01), (2, 2, 1), [STEEL] * 2, [LAW])
    problem, method = cut_assembly(blocks), LatinMethod(tolerance=1e-6)
    pressed = follow(PreparedStructure(problem, method), [[20e6, 0.0]]).end
    fresh, used = (PreparedStructure(problem, method) for _ in range(2))
    slid = follow(used, [[20e6, 6e6]], after=pressed)  # friction carries 4 MPa
    assert "slide" in slid.result.attrs["failure"]
    answers = [follow(each, [[20e6, 3e6]], after=pressed).result for each in (fresh, used)]
    assert answers[0].iterations[0] == answers[1].iterations[0]
    np.testing.assert_array_equal(*(answer.displacement for answer in answers))
