"""Modes, and frequency and damping against amplitude, against closed forms."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.sparse import csr_array
from skfem import ElementHex2

from multiscale.errors import CaseError
from multiscale.fe.mesh_file import box_mesh
from multiscale.laws import Exponential, HystereticLaw, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import Assembly, Body, Interface
from multiscale.macro.bodies.assembly import GROUND
from multiscale.macro.vibration import (
    Amplitudes,
    follow_backbone,
    press_structure,
    structure_mass,
    tangent_modes,
)

DENSITY, E = 7800.0, 210e9
STIFF = Elastic(1e13, 0.0)
PRESSURE, FRICTION, DECAY, RATIO = 10e6, 0.3, 1e-6, 0.02
AREA, HEIGHT = 1e-4, 4e-5


def block_between_friction(slabs, friction=FRICTION):
    """A rigid block on a frictional joint, under a cover on a joint that never slips."""
    block = Body(box_mesh((0.01, 0.01, HEIGHT), (1, 1, 1)), STIFF)
    lid = box_mesh((0.01, 0.01, HEIGHT), (1, 1, 1)).translated((0.0, 0.0, HEIGHT))
    cover = Body(lid, STIFF, {"top": (0.0, 0.0, None)}, {"top": (0.0, 0.0, -PRESSURE)})
    normal = Exponential(1e9, DECAY)
    slips = Sliders(normal, friction, RATIO, pressures=(1e5, 1e9), slabs=slabs)
    sticks = Sliders(normal, 100.0, RATIO, pressures=(1e5, 1e9), slabs=1)
    interfaces = (
        Interface((GROUND[0], 0), (GROUND[1], "bottom"), slips),
        Interface((0, 1), ("top", "bottom"), sticks),
    )
    return Assembly((block, cover), interfaces)


def first_mode(assembly, count=1):
    """The structure at rest, its modes, and the loads M phi."""
    rest = press_structure(assembly, np.array([[1.0]]))
    mass = structure_mass(rest.free, assembly.bodies, [DENSITY] * len(assembly.bodies))
    modes = tangent_modes(rest.free, rest.tangent(), mass, count)
    return rest, modes, mass @ modes.shape


def exact(slip, amplitude):
    """Frequency and damping of the block on a joint with the shear mu p slip(u / u of slip)."""
    mass, stiffness = DENSITY * AREA * HEIGHT, RATIO * PRESSURE / DECAY * AREA
    u = amplitude / np.sqrt(mass)
    unit, limit = FRICTION * DECAY / RATIO, FRICTION * PRESSURE * AREA
    force = stiffness * u + limit * slip(u / unit)
    area = np.array([np.trapezoid(slip(np.linspace(0, x, 20001)), dx=x / 20000) for x in u / unit])
    loss = 8.0 * limit * unit * area - 4.0 * limit * slip(u / unit) * u
    return np.sqrt(force / u / mass) / (2.0 * np.pi), loss / (2.0 * np.pi * force * u)


UNIT = FRICTION * DECAY / RATIO * np.sqrt(DENSITY * AREA * HEIGHT)  # amplitude of full slip
JENKINS = (1, lambda x: np.minimum(x, 1.0), np.array([0.5, 0.9]))
IWAN = (1024, lambda x: 1.0 - np.exp(-x), np.array([0.1, 0.5, 2.0]))


@pytest.mark.parametrize(("slabs", "slip", "sizes"), [JENKINS, IWAN], ids=["Jenkins", "Iwan"])
def test_one_slider_and_a_known_bed_follow_their_exact_curves(slabs, slip, sizes):
    """Beyond slip too; pressures lean by the height of the block over its length, 0.4 %."""
    rest, modes, load = first_mode(block_between_friction(slabs))
    assert modes.coinciding == ((0, 1),)
    for full, reached in ((False, UNIT * sizes), (True, UNIT * sizes[-1:])):
        frequency, damping = exact(slip, reached)
        backbone = follow_backbone(
            rest, modes, load, 0, Amplitudes(tuple(reached), full_cycle=full)
        )
        assert not backbone.failure
        np.testing.assert_allclose(backbone.frequency, frequency, rtol=2e-3)
        np.testing.assert_allclose(backbone.damping, damping, rtol=0.02, atol=2e-4)


def test_an_amplitude_at_which_a_block_slides_away_is_named():
    rest, modes, load = first_mode(block_between_friction(1))
    far = follow_backbone(rest, modes, load, 0, Amplitudes((0.5 * UNIT, 8.0 * UNIT)))
    assert np.isnan(far.damping[1])
    assert f"{8.0 * UNIT:.4g} kg^1/2 m on: more than 99 % of the load of interface 0" in far.failure


def test_metal_vibrates_on_its_curve_of_unloading():
    """Springs in series, 2.5 times as stiff as in loading; slips shear along the same bed."""
    block = Body(box_mesh((0.01, 0.01, HEIGHT), (1, 1, 1)), STIFF, tractions={"top": (0, 0, -1e7)})
    squares = {}
    for name, normal in (
        ("elastic", Exponential(1e9, DECAY)),
        ("flows", HystereticLaw(Exponential(1e9, DECAY), 2.5, 1.6)),
    ):
        law = Sliders(normal, FRICTION, RATIO, pressures=(1e5, 1e9), slabs=64)
        assembly = Assembly((block,), (Interface((None, 0), (None, "bottom"), law),))
        rest, modes, load = first_mode(assembly, 4)
        squares[name] = modes.square
        backbone = follow_backbone(rest, modes, load, 3, Amplitudes((1e-12, 2e-9)))
        assert not backbone.opens.any()
        np.testing.assert_allclose(backbone.frequency[0], modes.frequency[3], rtol=1e-4)
        fall = 1.0 - (backbone.frequency[1] / modes.frequency[3]) ** 2
        assert abs(fall) > 0.01  # elastic curvature, which dissipates nothing
        assert np.all(backbone.damping < 1e-5)
    np.testing.assert_allclose(squares["flows"][:2] / squares["elastic"][:2], 2.5, rtol=1e-6)
    expected = RATIO * PRESSURE / DECAY / (DENSITY * HEIGHT)
    np.testing.assert_allclose(squares["elastic"][0], expected, rtol=1e-2)


def timoshenko(length, depth, guess):
    """Frequency of a free bar of square section without Poisson's effect, nearest to a guess."""
    area, second, shear = depth**2, depth**4 / 12.0, 5.0 / 6.0 * 0.5 * E

    def condition(f):
        square = (2.0 * np.pi * f) ** 2
        A = np.zeros((4, 4))  # deflection, turning, moment, shear force along the bar
        A[0, 1], A[0, 3] = 1.0, 1.0 / (shear * area)
        A[1, 2] = 1.0 / (E * second)
        A[2, 3], A[2, 1] = -1.0, -DENSITY * second * square
        A[3, 0] = -DENSITY * area * square
        return np.linalg.det(expm(A * length)[2:, :2])

    return brentq(condition, 0.97 * guess, 1.01 * guess)


def test_a_free_bar_has_its_exact_frequencies_and_names_its_rigid_motions():
    """Of 1323 unknowns, by shift and invert; two bending modes coincide."""
    mesh = box_mesh((0.2, 0.01, 0.01), (24, 1, 1))
    bar = Body(mesh, Elastic(E, 0.0), element=ElementHex2())
    _, modes, _ = first_mode(Assembly((bar,)), 9)
    assert modes.rigid == ("along x", "along y", "along z", "about x", "about y", "about z")
    assert modes.coinciding == ((0, 1), (2, 3), (4, 5), (7, 8))
    for mode, beta, rtol in ((0, 4.730040745, 1e-3), (2, 7.853204624, 2.5e-3)):
        guess = beta**2 / 0.2**2 * np.sqrt(E * 0.01**2 / 12.0 / DENSITY) / (2.0 * np.pi)
        expected = timoshenko(0.2, 0.01, guess)
        np.testing.assert_allclose(modes.frequency[mode], expected, rtol=rtol)
    sideways = np.abs(modes.shape[:, :2]).reshape(-1, 3, 2).max(axis=0)
    assert sideways[2, 0] < 1e-3 * sideways[1, 0]  # the first moves along y, the second along z
    assert sideways[1, 1] < 1e-3 * sideways[2, 1]


def test_modes_that_do_not_exist_mass_that_lacks_and_unstable_rest_are_refused():
    bar = Body(box_mesh((0.2, 0.01, 0.01), (1, 1, 1)), Elastic(E, 0.0))
    rest = press_structure(Assembly((bar,)), np.array([[1.0]]))
    with pytest.raises(CaseError, match=r"density of body 0 must be positive \(kg/m3\), got 0"):
        structure_mass(rest.free, [bar], [0.0])
    mass, K = structure_mass(rest.free, [bar], [DENSITY]), rest.tangent()
    with pytest.raises(CaseError, match="mode 19 is requested, and the model has 18 modes"):
        tangent_modes(rest.free, K, mass, 19)
    with pytest.raises(CaseError, match="unstable: its tangent has the negative eigenvalue -"):
        tangent_modes(rest.free, csr_array(K - 1e11 * mass), mass, 1)


def test_too_many_points_are_refused_before_a_full_matrix_is_made(monkeypatch):
    monkeypatch.setattr("multiscale.macro.vibration.modes.LARGEST", 30)
    with pytest.raises(CaseError, match="too many of 40 unknowns to condense"):
        press_structure(block_between_friction(4), np.array([[1.0]]))


def test_a_frictionless_face_neither_holds_nor_damps_a_mode():
    rest, modes, load = first_mode(block_between_friction(16, friction=0.0))
    # small, since the face that sticks rocks, which costs it a little
    backbone = follow_backbone(rest, modes, load, 0, Amplitudes((0.1 * UNIT, 0.5 * UNIT)))
    fixed = RATIO * PRESSURE / DECAY * AREA  # the springs of the other face, N/m
    expected = np.sqrt(fixed / (DENSITY * AREA * HEIGHT)) / (2.0 * np.pi)
    assert not backbone.failure
    np.testing.assert_allclose(modes.frequency, expected, rtol=2e-3)
    np.testing.assert_allclose(backbone.frequency, expected, rtol=2e-3)
    np.testing.assert_allclose(backbone.damping, 0.0, atol=1e-4)
