"""Structures in contact against closed forms: validation plan, sections 0 and 5."""

from functools import cache

import numpy as np
import pytest
from skfem import MeshHex, MeshQuad, MeshTri

from multiscale.laws.bulk import J2, Elastic, NeoHookean
from multiscale.laws.bulk.bulk_law import contact_modulus
from multiscale.macro import Body, Contact, FiniteAssembly, RigidPlane, solve_contact
from tests import contact_scenes as scenes
from tests.closed_forms import hertz, mindlin, spence
from tests.contact_scenes import CONTACT_RADIUS, FORCE, FRICTION, LIMIT, PEAK, near
from tests.support import observed_rate


@pytest.mark.slow
def test_a_ball_on_a_half_space_is_hertzs():
    force, peak, radius, _ = scenes.ball_on_half_space(6)
    assert force == pytest.approx(FORCE, rel=0.02)
    assert peak == pytest.approx(PEAK, rel=0.02)
    assert radius == pytest.approx(CONTACT_RADIUS, rel=0.02)


@pytest.mark.parametrize("sides", ["cylinder first", "block first"])
def test_the_cylinder_on_a_block_of_nafems(sides):
    step = scenes.cylinder_on_block(0.4e-3, swapped=sides == "block first")
    surface = step.contact["joint"]
    peak, half_width = scenes.fitted_ellipse(surface.position[0], surface.pressure)
    assert half_width == pytest.approx(6.2146e-3, rel=0.03)
    assert peak == pytest.approx(3585.4e6, rel=0.03)
    assert surface.pressure.max() == pytest.approx(3585.4e6, rel=0.03)
    assert abs(surface.force[1]) == pytest.approx(17.5e6, rel=1e-8)


@pytest.mark.parametrize(
    ("kind", "within"), [(MeshQuad, 0.01), (MeshTri, 0.03)], ids=["quad", "tri"]
)
def test_nested_rings_converge_to_their_closed_form(kind, within):
    sizes = [8, 16, 32]
    pressure, displacement = np.array([scenes.nested_rings(n, kind) for n in sizes]).T
    h = 1.0 / np.array(sizes)
    assert observed_rate(h, displacement) == pytest.approx(2.0, abs=0.15)
    # the multipliers are linear, the stress behind them constant or little more
    assert observed_rate(h, pressure) > 0.8
    assert pressure[-1] < within
    assert displacement[-1] < 0.015


@cache
def flat_punch(points, friction=0.0):
    """A rigid flat disc on half of a half-space: force over the closed form, and pressure."""
    a, length, depth = 1e-3, 12e-3, 1e-6
    material = (210e9, 0.3)
    modulus = contact_modulus(material)
    force = hertz.punch_force(depth, a, modulus)
    rings = a * np.sin(np.linspace(0.0, np.pi / 2.0, points + 1))[1:]  # finer at the edge
    outer = [rings[-1], rings[-1] + 2.0 * (rings[-1] - rings[-2])]
    while outer[-1] < 0.7 * length:
        outer.append(outer[-1] + 1.5 * (outer[-1] - outer[-2]))
    first = 2
    corners, quads = scenes.half_disc(4, np.r_[rings[first:], outer[1:-1], length])
    levels = -scenes.graded(0.03 * a, 0.1 * a, length, 1.45)[::-1]
    mesh = scenes.extruded(corners, quads, levels).with_boundaries(
        {
            "contact": lambda x: near(0.0)(x[2]) & (np.hypot(x[0], x[1]) < a),
            "plane": lambda x: near(0.0)(x[1]),
            "far": lambda x: near(-length)(x[2]) | (np.hypot(x[0], x[1]) > 0.98 * length),
        }
    )
    far = [
        scenes.far_field(i, -1, material, lambda t: (t * force, 0.0), lambda t: (0.0, 0.0))
        for i in range(3)
    ]
    body = Body(mesh, Elastic(*material), {"far": far, "plane": (None, 0.0, None)})
    punch = RigidPlane((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), motion=(0.0, 0.0, -depth))
    contact = Contact(("base", "contact"), punch, friction)
    problem = FiniteAssembly({"base": body}, {"punch": contact})
    surface = solve_contact(problem)[-1].unwrap().contact["punch"]
    r = np.hypot(*surface.position[:2])
    inner = r < 0.7 * a
    ratio = surface.pressure[inner] / hertz.punch_pressure(r[inner], force, a)
    return 2.0 * surface.force[2] / force, ratio


@pytest.mark.slow
def test_a_flat_punch_has_its_closed_form():
    force, ratio = flat_punch(12)
    assert force == pytest.approx(1.0, rel=0.02)
    np.testing.assert_allclose(np.mean(ratio), 1.0, rtol=0.02)
    np.testing.assert_allclose(ratio, 1.0, rtol=0.06)


@pytest.mark.slow
def test_a_flat_punch_that_sticks_carries_more():
    # 1.02863 in the validation plan
    smooth, stuck = flat_punch(12)[0], flat_punch(12, friction=100.0)[0]
    assert stuck / smooth == pytest.approx(mindlin.full_stick_load_ratio(0.3), rel=0.01)


def billet(friction, law, *, squeeze=0.35, steps=10, elements=(3, 4)):
    """An eighth of a round billet between plates; returns its steps and its mesh."""
    radius, height = 10e-3, 15e-3
    n, layers = elements
    axes = [np.linspace(0.0, 1.0, k + 1) for k in (n, n, layers)]
    unit = MeshHex.init_tensor(*axes).with_boundaries(
        {
            "x": lambda x: near(0.0)(x[0]),
            "y": lambda x: near(0.0)(x[1]),
            "middle": lambda x: near(0.0)(x[2]),
            # the upper part of the side may fold onto the plate
            "upper": lambda x: (
                near(1.0)(x[2]) | ((near(1.0)(x[0]) | near(1.0)(x[1])) & (x[2] > 0.7))
            ),
        }
    )
    s, t, z = unit.p
    place = [radius * s * np.sqrt(1 - t**2 / 2), radius * t * np.sqrt(1 - s**2 / 2), height * z]
    mesh = scenes.moved(unit, place)
    fixed = {"x": (0.0, None, None), "y": (None, 0.0, None), "middle": (None, None, 0.0)}
    plate = RigidPlane((0, 0, height), (0, 0, -1), motion=(0.0, 0.0, -squeeze * height))
    contact = Contact(("billet", "upper"), plate, friction, finite_sliding=True)
    problem = FiniteAssembly({"billet": Body(mesh, law, fixed)}, {"plate": contact})
    times = np.linspace(0.0, 1.0, steps + 1)[1:]
    return [step.unwrap() for step in solve_contact(problem, times, tolerance=1e-8)], mesh


METAL = J2(200e9, 0.3, 700e6, 300e6)


def volume(mesh, displacement):
    from multiscale.fe.elasticity import prepare_elements

    return prepare_elements(scenes.moved(mesh, mesh.p + displacement)).weight.sum()


def test_upsetting_without_friction_follows_the_hardening_curve():
    steps, mesh = billet(0.0, METAL, steps=5)
    for step in steps:
        # uniaxial: ln(1 - squeeze) = -(sigma/E + alpha), sigma = 700 + 300 alpha MPa (Kirchhoff)
        strain = -np.log(1.0 - 0.35 * step.time)
        alpha = (strain - 700e6 / 200e9) / (1.0 + 300e6 / 200e9)
        stress = 700e6 + 300e6 * alpha
        np.testing.assert_allclose(step.state["billet"][6], alpha, rtol=1e-4)
        # force = Kirchhoff stress * undeformed volume / current height
        force = stress * volume(mesh, 0.0 * mesh.p) / (15e-3 * (1.0 - 0.35 * step.time))
        assert step.contact["plate"].force[2] == pytest.approx(force, rel=1e-4)


@pytest.mark.slow
def test_upsetting_with_friction_keeps_the_volume_and_bulges():
    steps, mesh = billet(0.2, METAL)
    rest = volume(mesh, 0.0 * mesh.p)
    smooth = billet(0.0, METAL, steps=5)[0][-1].contact["plate"].force[2]
    middle = (mesh.p[2] == 0.0) & (mesh.p[1] == 0.0)
    top = (mesh.p[2] == mesh.p[2].max()) & (mesh.p[1] == 0.0)
    before = np.zeros_like(steps[0].state["billet"][6])
    for step in steps:
        plastic = step.state["billet"][6]
        assert np.all(plastic >= before)
        before = plastic
        u = step.displacement["billet"]
        # only elastic compression, below sigma / K
        assert volume(mesh, u) == pytest.approx(rest, rel=0.01)
        surface = step.contact["plate"]
        assert np.all(np.sum(surface.traction[1:] * surface.slip, axis=0) > -1e-6)
    assert step.contact["plate"].force[2] > 1.01 * smooth
    x = mesh.p + u
    assert x[0, middle].max() > 1.05 * x[0, top].max()


def test_a_rubber_billet_is_squeezed_by_a_third():
    steps, _ = billet(0.3, NeoHookean(2e6, 0.49), steps=4)
    force = [step.contact["plate"].force[2] for step in steps]
    assert np.all(np.diff(force, 2) > 0.0)  # it stiffens
    # rubber gives the work back: without friction the force follows the elastic energy
    elastic, _ = billet(0.0, NeoHookean(2e6, 0.49), steps=4)
    stretch = 1.0 - 0.35
    computed = elastic[-1].contact["plate"].force[2] / (np.pi * 1e-4 / 4.0)
    incompressible = 2e6 / (2.0 * 1.49) * (1.0 / stretch**2 - stretch)
    assert computed == pytest.approx(incompressible, rel=0.05)


def ironing(friction, *, swapped=False):
    """A rubber die pressed into a softer block by a quarter of its height, then drawn along."""
    base = scenes.block(MeshQuad, (30, 6), (0.0, 0.0), (6.0, 1.5))
    die = scenes.block(MeshQuad, (8, 4), (0.7, 1.5), (1.9, 2.3))
    x, y = die.p
    die = scenes.moved(die, [x, y + (2.3 - y) / 0.8 * 0.25 * ((x - 1.3) / 0.6) ** 2])
    drive = (lambda x, t: 2.0 * max(0.0, t - 1.0), lambda x, t: -0.3 * min(t, 1.0))
    bodies = {
        "base": Body(base, NeoHookean(1e6, 0.3), {"bottom": (0.0, 0.0)}),
        "die": Body(die, NeoHookean(4e6, 0.3), {"top": drive}),
    }
    sides = (("die", "bottom"), ("base", "top"))
    contact = Contact(*(sides[::-1] if swapped else sides), friction, finite_sliding=True)
    times = np.r_[np.linspace(0.0, 1.0, 6)[1:], np.linspace(1.0, 2.0, 11)[1:]]
    steps = solve_contact(FiniteAssembly(bodies, {"joint": contact}), times, tolerance=1e-8)
    side = -1.0 if swapped else 1.0
    return np.array([side * step.unwrap().contact["joint"].force for step in steps])


@pytest.mark.slow
@pytest.mark.parametrize("swapped", [False, True], ids=["die first", "base first"])
def test_ironing_has_smooth_resultants(swapped):
    force = ironing(0.2, swapped=swapped)[8:]  # drawn along, away from the start
    tangent, normal = force[:, 0], -force[:, 1]
    # over three times the width of the die nothing but the mesh changes
    assert np.ptp(normal) < 0.02 * normal.mean()
    assert np.ptp(tangent) < 0.05 * tangent.mean()
    assert tangent.mean() == pytest.approx(0.2 * normal.mean(), rel=0.1)


def test_the_slip_of_a_step_that_was_cut_is_whole():
    base = scenes.block(MeshQuad, (12, 4), (0.0, 0.0), (2.0, 1.0))
    drive = (lambda x, t: 3e-4 * max(0.0, t - 1.0), lambda x, t: -1e-3 * min(t, 1.0))
    body = Body(base, Elastic(1e9, 0.3), {"top": drive})
    floor = Contact(("base", "bottom"), RigidPlane((0.0, 0.0), (0.0, 1.0)), 0.3)
    problem = FiniteAssembly({"base": body}, {"floor": floor})
    once, cut = (solve_contact(problem, (1.0, 2.0), max_iterations=n)[-1] for n in (60, 3))
    assert len(once.unwrap().solution.trail) == 1 < len(cut.unwrap().solution.trail)
    whole = once.contact["floor"].slip
    np.testing.assert_allclose(cut.contact["floor"].slip, whole, atol=1e-6 * np.abs(whole).max())


AMPLITUDES = (0.25, 0.5, -0.5, 0.5, 0.75, 0.9, -0.9, 0.9)
"""Tangential forces over the limit of friction; a closed cycle leaves no memory."""


@pytest.fixture(scope="module")
def sheared_balls():
    """Two steel balls on the path of the amplitudes, displacements prescribed by Mindlin."""
    path = []
    for k, ratio in enumerate(AMPLITUDES):
        motion = mindlin.tangential_displacement(
            abs(ratio), LIMIT, CONTACT_RADIUS, scenes.TANGENTIAL_MODULUS
        )
        path.append((2.0 + k, ratio * LIMIT, np.sign(ratio) * float(motion)))
    rings = np.r_[0.32, 0.4, 0.48, 0.56, 0.64, 0.7, np.arange(0.74, 1.07, 0.04)]
    steps = scenes.two_steel_balls(path, 3, rings, 0.04)[1:]
    return [step.contact["joint"] for step in steps]


@pytest.mark.long
@pytest.mark.parametrize("ratio", [0.25, 0.5, 0.75, 0.9])
def test_partial_slip_between_steel_balls_is_mindlins(sheared_balls, ratio):
    surface = sheared_balls[AMPLITUDES.index(ratio)]
    # at the displacement of theory, the force of theory
    tangent, normal = (2.0 * abs(surface.force[k]) for k in (0, 2))
    assert tangent == pytest.approx(ratio * LIMIT, rel=0.01)
    assert normal == pytest.approx(FORCE, rel=0.01)
    # .90856 and .62996 at .25 and .75: mu p - q is the ellipsoid of the stick zone
    r = np.hypot(*surface.position[:2])
    spare = FRICTION * surface.pressure - np.linalg.norm(surface.traction[1:], axis=0)
    stick = scenes.moment_radius(r, np.maximum(spare, 0.0), surface.area)
    contact = scenes.moment_radius(r, surface.pressure, surface.area)
    assert contact == pytest.approx(CONTACT_RADIUS, rel=0.02)
    assert stick / contact == pytest.approx(float(mindlin.stick_radius(ratio)), rel=0.03)


@pytest.mark.long
@pytest.mark.parametrize(("ratio", "expected"), [(0.5, 1.07238e-6), (0.9, 1.22179e-5)])
def test_a_cycle_of_partial_slip_dissipates_the_energy_of_mindlin_and_deresiewicz(
    sheared_balls, ratio, expected
):
    # friction does not change while a point slips one way, so one step a branch is exact
    branches = sheared_balls[AMPLITUDES.index(-ratio) :][:2]
    lost = [
        2.0 * np.sum(surface.area * np.sum(surface.traction[1:] * surface.slip, axis=0))
        for surface in branches
    ]
    assert lost[0] == pytest.approx(lost[1], rel=1e-3)
    assert sum(lost) == pytest.approx(expected, rel=0.03)


SPENCE_RINGS = np.r_[
    np.arange(0.1, 0.3, 0.01), np.arange(0.3, 0.82, 0.04), np.arange(0.82, 1.07, 0.02)
]


@pytest.mark.long
@pytest.mark.parametrize(("friction", "growth"), [(0.1, 1.2), (0.3, 1.05), (0.5, 1.05)])
def test_a_ball_pressed_with_friction_sticks_where_theory_predicts(friction, growth):
    r, surface = scenes.ball_on_rough_half_space(friction, SPENCE_RINGS, growth)
    shear = np.linalg.norm(surface.traction[1:], axis=0)
    closed = surface.pressure > 0.0
    slips = closed & (shear > (1.0 - 1e-6) * friction * surface.pressure)
    edge = 0.5 * (r[closed & ~slips].max() + r[slips].min())
    computed = edge / scenes.moment_radius(r, surface.pressure, surface.area)
    expected = spence.punch_with_friction(friction, 0.3, rings=400)[0]
    assert computed == pytest.approx(expected, rel=0.05)
    # .9186 and .9917 in the validation plan: its formula leaves out the effect of shear on
    # pressure; at .1 only this takes 11 % off its .2240
    if friction > 0.1:
        assert computed == pytest.approx(mindlin.spence_stick_radius(friction, 0.3), rel=0.05)


def press_fit(facets, **how):
    """Pressures of a ring pressed on another, over Lamé's for an interference of 2.5 µm."""
    a, b, c, interference, E, nu = 5e-3, 10e-3, 20e-3, 2.5e-6, 210e9, 0.3
    built = 0.0 if how else interference  # else the meshes overlap
    bodies = {
        "shaft": scenes.quarter_ring(MeshQuad, 8, facets[0] // 4, a, b + built),
        "hub": scenes.quarter_ring(MeshQuad, 12, facets[1] // 4, b, c),
    }
    fixed = {"x": (None, 0.0), "y": (0.0, None)}
    rings = {name: Body(mesh, Elastic(E, nu), fixed) for name, mesh in bodies.items()}
    contact = Contact(("shaft", "outside"), ("hub", "inside"), **how)
    step = solve_contact(FiniteAssembly(rings, {"fit": contact}))[-1].unwrap()
    shape = (c**2 + b**2) / (c**2 - b**2) + (b**2 + a**2) / (b**2 - a**2)
    exact = interference / b * E / (1.0 - nu**2) / shape  # plane strain
    return step.contact["fit"].pressure / exact


@pytest.mark.parametrize(("facets", "error"), [((64, 48), 0.01), ((128, 96), 0.005)])
def test_a_press_fit_has_the_pressure_of_lame_whatever_its_facets(facets, error):
    ratio = press_fit(facets, fitted=True, interference=2.5e-6)
    np.testing.assert_allclose(ratio, 1.0, atol=error)


def test_facets_that_match_need_no_stated_interference():
    np.testing.assert_allclose(press_fit((64, 64)), 1.0, atol=0.01)
