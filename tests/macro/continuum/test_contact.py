"""Bodies in contact: patch test, balance, agreement of the two solvers, refusals."""

import numpy as np
import pytest
from skfem import MeshHex, MeshQuad, MeshTet, MeshTri

from multiscale.convergence import Status
from multiscale.errors import ConvergenceError
from multiscale.laws.bulk import J2, Elastic, NeoHookean, Prony
from multiscale.macro import (
    Body,
    Contact,
    FiniteAssembly,
    RigidPlane,
    solve_contact,
)
from tests.contact_scenes import RigidBall, block, inclined_slider, moved

PRESSURE = 1e6
LAW = Elastic(1e9, 0.3)
SOFT = NeoHookean(2e7, 0.3)
DIE = Elastic(3e9, 0.2)


def stack(kinds, *, law=LAW, width=1.0, **contact):
    """One block on another, pressed from above; the upper block is supported only by contact."""
    d = kinds[0]().dim()
    lower = block(kinds[0], (3, 4, 2)[:d], (0.0,) * d, (1.0,) * d)
    low, high = (0.0,) * (d - 1) + (1.0,), (width,) * (d - 1) + (2.0,)
    upper = block(kinds[1], (4, 3, 2)[:d], low, high)
    fixed = {"left": (0.0, *[None] * (d - 1))}
    if d == 3:
        fixed["front"] = (None, 0.0, None)
    push = {"top": (0.0,) * (d - 1) + (-PRESSURE,)}
    bodies = {
        "lower": Body(lower, law, fixed | {"bottom": (*[None] * (d - 1), 0.0)}),
        "upper": Body(upper, law, fixed, push),
    }
    return FiniteAssembly(bodies, {"joint": Contact(**contact)})


UPPER_FIRST = {"side1": ("upper", "bottom"), "side2": ("lower", "top")}
LOWER_FIRST = {"side1": ("lower", "top"), "side2": ("upper", "bottom")}
SIDES = [
    pytest.param(UPPER_FIRST, id="upper is side 1"),
    pytest.param(LOWER_FIRST, id="lower is side 1"),
]
KINDS = [
    pytest.param((MeshQuad, MeshQuad), id="quad-quad"),
    pytest.param((MeshTri, MeshQuad), id="tri-quad"),
    pytest.param((MeshHex, MeshHex), id="hex-hex"),
    pytest.param((MeshTet, MeshHex), id="tet-hex"),
    pytest.param((MeshTet, MeshTet), id="tet-tet"),
]


@pytest.mark.parametrize("kinds", KINDS)
@pytest.mark.parametrize("sides", SIDES)
@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_a_uniform_pressure_passes_through_meshes_that_do_not_match(kinds, sides, friction):
    problem = stack(kinds, **sides, friction_coefficient=friction)
    step = solve_contact(problem, tolerance=1e-12)[-1].unwrap()
    surface = step.contact["joint"]
    np.testing.assert_allclose(surface.pressure, PRESSURE, rtol=1e-10)
    np.testing.assert_allclose(surface.traction[1:], 0.0, atol=1e-10 * PRESSURE)
    d = len(surface.traction)
    strain = -PRESSURE * (1.0 / 1e9 if d == 3 else (1.0 - 0.3**2) / 1e9)
    for name, body in problem.bodies.items():
        u = step.displacement[name]
        np.testing.assert_allclose(u[-1], strain * body.mesh.p[-1], atol=2e-10 * abs(strain))


@pytest.mark.parametrize("sides", SIDES)
def test_a_smaller_block_also_passes_its_force_whichever_side_carries_it(sides):
    problem = stack((MeshHex, MeshTet), width=0.7, **sides)
    surface = solve_contact(problem)[-1].unwrap().contact["joint"]
    assert np.sum(surface.area) == pytest.approx(0.49)
    sign = -1.0 if sides is UPPER_FIRST else 1.0
    np.testing.assert_allclose(-sign * surface.force, [0, 0, -0.49 * PRESSURE], atol=1e-4)


def test_large_deformation_keeps_the_patch_uniform():
    # each body as wide as the other; the lower surface is the reference of the pressure
    problem = stack((MeshQuad, MeshQuad), law=SOFT, **UPPER_FIRST, finite_sliding=True)
    step = solve_contact(problem, tolerance=1e-11)[-1].unwrap()
    surface = step.contact["joint"]
    np.testing.assert_allclose(surface.pressure, surface.pressure[0], rtol=1e-8)
    assert np.sum(surface.area * surface.pressure) == pytest.approx(PRESSURE, rel=1e-10)


def punch(friction=0.3, *, size=1.0, law=DIE, **options):
    """A small block pressed and pushed sideways on a larger block; both are fixed."""
    base = block(MeshHex, (5, 4, 3), (-1, -1, -1), (1, 1, 0))
    die = block(MeshTet, (3, 3, 2), (-0.45, -0.4, 0.0), (0.5, 0.45, 0.5))
    push = (
        lambda x, t: 1e-3 * size * max(0.0, t - 1.0),
        0.0,
        lambda x, t: -2e-3 * size * min(t, 1.0),
    )
    bodies = {
        "base": Body(moved(base, size * base.p), LAW, {"bottom": (0, 0, 0)}),
        "die": Body(moved(die, size * die.p), law, {"top": push}),
    }
    contact = Contact(("die", "bottom"), ("base", "top"), friction)
    return solve_contact(FiniteAssembly(bodies, {"joint": contact}), (1.0, 1.3, 1.6), **options)


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_the_condensed_problem_has_the_solution_of_the_whole_problem(friction):
    # two independent solvers: dense in the reactions, sparse in all unknowns
    for small, large in zip(
        punch(friction, condensed=True), punch(friction, condensed=False), strict=True
    ):
        a, b = small.unwrap(), large.unwrap()
        for name in a.displacement:
            np.testing.assert_allclose(a.displacement[name], b.displacement[name], atol=1e-11)
        first, two = a.contact["joint"], b.contact["joint"]
        np.testing.assert_allclose(first.traction, two.traction, atol=1e-7 * first.pressure.max())
        np.testing.assert_allclose(first.gap, two.gap, atol=1e-11)


@pytest.mark.parametrize("condensed", [True, False])
@pytest.mark.parametrize(
    "extreme",
    [
        pytest.param({"friction": 2.0}, id="much friction"),
        pytest.param({"law": Elastic(3e9, 0.4999)}, id="incompressible die"),
        pytest.param({"law": Elastic(1e17, 0.3)}, id="stiff die"),
    ],
)
def test_extreme_problems_converge(condensed, extreme):
    for step in punch(**extreme, condensed=condensed):
        assert step.solution.status is Status.CONVERGED


@pytest.mark.parametrize("size", [1e-9, 1e3])
def test_the_unit_of_length_does_not_matter(size):
    first, other = punch(0.3)[-1].unwrap(), punch(0.3, size=size)[-1].unwrap()
    a, b = first.contact["joint"], other.contact["joint"]
    np.testing.assert_allclose(a.traction, b.traction, atol=1e-6 * a.pressure.max())


@pytest.mark.parametrize("condensed", [True, False])
def test_contact_obeys_signorini_and_coulomb(condensed):
    for step in punch(0.3, condensed=condensed):
        surface = step.unwrap().contact["joint"]
        top = surface.pressure.max()
        assert surface.pressure.min() >= 0.0
        assert surface.gap.min() > -1e-11
        assert np.all(surface.gap[surface.pressure > 0.0] < 1e-11)
        size = np.linalg.norm(surface.traction[1:], axis=0)
        assert np.all(size <= 0.3 * surface.pressure + 1e-8 * top)
        stuck = size < 0.3 * surface.pressure * (1.0 - 1e-6) - 1e-8 * top
        assert np.all(np.linalg.norm(surface.slip[:, stuck], axis=0) < 1e-11)
        work = np.sum(surface.traction[1:] * surface.slip, axis=0)
        assert np.all(work >= -1e-8 * top * 1e-3)  # friction never gives energy
    assert np.any(stuck | (surface.pressure > 0.0))


def test_supports_carry_the_forces_of_the_contact():
    step = punch(0.3)[-1].unwrap()
    force = step.contact["joint"].force
    np.testing.assert_allclose(step.support_force["base"].sum(axis=1), -force, rtol=1e-8)
    np.testing.assert_allclose(step.support_force["die"].sum(axis=1), force, rtol=1e-8)
    assert force[2] < 0.0 < force[0]


@pytest.mark.parametrize(
    "law", [Prony(1e9, 0.3, (0.6,), (1.0,), time_step=0.5), J2(1e9, 0.3, 5e6, 1e7)], ids=type
)
def test_supports_of_bodies_with_memory_carry_the_contact_at_the_end_of_the_step(law):
    mesh = block(MeshHex, (2, 2, 2), (0.0,) * 3, (1.0,) * 3)
    body = Body(mesh, law, {"top": (0.0, 0.0, -0.1)})
    contact = Contact(("block", "bottom"), RigidPlane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    for step in solve_contact(FiniteAssembly({"block": body}, {"floor": contact}), (0.5, 1.0)):
        carried = step.unwrap().support_force["block"].sum(axis=1)
        np.testing.assert_allclose(carried[2], step.contact["floor"].force[2], rtol=1e-7)


@pytest.mark.parametrize(
    ("friction", "deformable", "finite_sliding"),
    [
        *((friction, True, False) for friction in (0.0, 0.1, 0.2, 0.3)),
        *((0.3, *kind) for kind in ((False, False), (False, True), (True, True))),
    ],
)
def test_a_slider_on_a_slope_needs_its_friction_and_its_climb(friction, deformable, finite_sliding):
    # NAFEMS CGS-4: (tan a + mu) / (1 - mu tan a); on a ramp that bends the slope itself turns
    expected = (0.1 + friction) / (1.0 - 0.1 * friction)
    result = inclined_slider(friction, deformable=deformable, finite_sliding=finite_sliding)
    exact = not (deformable and finite_sliding)
    assert result == pytest.approx(expected, rel=1e-8 if exact else 1e-3)


OBSTACLES = [
    pytest.param(RigidPlane((0.0, 0.0, 1.0), (0.0, 0.0, -2.0)), id="plane"),
    pytest.param(RigidBall((0.5, 0.5, 6.0), 5.0), id="sphere"),
]


@pytest.mark.parametrize("finite_sliding", [False, True])
@pytest.mark.parametrize("obstacle", OBSTACLES)
def test_no_node_enters_an_obstacle(obstacle, finite_sliding):
    body = Body(
        block(MeshHex, (4, 4, 3), (0, 0, 0), (1, 1, 1)),
        SOFT if finite_sliding else LAW,
        {"bottom": (0.0, 0.0, 0.02)},
    )
    contact = Contact(("block", "top"), obstacle, 0.2, finite_sliding)
    step = solve_contact(FiniteAssembly({"block": body}, {"wall": contact}))[-1].unwrap()
    surface = step.contact["wall"]
    top = np.flatnonzero(body.mesh.p[2] == 1.0)
    x = (body.mesh.p + step.displacement["block"])[:, top].T
    # small sliding keeps the normals of the start: exact to the square of the motion
    depth = 1e-9 if finite_sliding else 2e-4
    assert obstacle.distance(x)[0].min() > -depth
    assert surface.gap.min() > -1e-9
    assert surface.force[2] > 0.0
    assert np.count_nonzero(surface.pressure) > 0


def test_a_moving_obstacle_drags_the_body_along():
    body = Body(block(MeshQuad, (4, 4), (0, 0), (1, 1)), LAW, {"bottom": (0.0, 0.0)})
    path = (lambda x, t: 1e-3 * max(0.0, t - 1.0), lambda x, t: -1e-3 * min(t, 1.0))
    contact = Contact(("block", "top"), RigidPlane((0, 1), (0, -1), path), friction_coefficient=0.5)
    pressed, dragged = solve_contact(FiniteAssembly({"block": body}, {"p": contact}), (1.0, 1.1))
    assert pressed.unwrap().contact["p"].force[0] == pytest.approx(0.0, abs=1e-3)
    assert dragged.unwrap().contact["p"].force[0] < 0.0  # on the obstacle: friction acts backwards
    top = body.mesh.p[1] == 1.0
    assert np.all(dragged.displacement["block"][0, top] > pressed.displacement["block"][0, top])


def test_without_friction_a_contact_node_has_one_unknown():
    from multiscale.macro.continuum.contact_newton import rest

    stacked = stack((MeshHex, MeshHex), **UPPER_FIRST)
    three = stack((MeshHex, MeshHex), **UPPER_FIRST, friction_coefficient=0.1)
    assert rest(stacked).reaction.shape[1] == 1
    assert rest(three).reaction.shape[1] == 3


def test_a_step_that_fails_is_reported_as_data_and_ends_the_path():
    problem = stack((MeshQuad, MeshQuad), law=SOFT, **UPPER_FIRST, finite_sliding=True)
    steps = solve_contact(problem, (0.5, 1.0), max_iterations=1)
    assert len(steps) == 1
    assert steps[0].solution.status is Status.MAX_ITERATIONS
    assert len(steps[0].solution.trail) > 1  # the halves that were tried
    assert np.all(np.isnan(steps[0].displacement["upper"]))
    assert np.all(np.isnan(steps[0].contact["joint"].pressure))
    with pytest.raises(ConvergenceError, match="iteration limit"):
        steps[0].unwrap()


def test_a_problem_without_load_stays_at_rest():
    body = Body(block(MeshQuad, (2, 2), (0, 0), (1, 1)), LAW, {"bottom": (0.0, 0.0)})
    contact = Contact(("block", "top"), RigidPlane((0, 1), (0, -1)), 0.3)
    step = solve_contact(FiniteAssembly({"block": body}, {"p": contact}))[-1].unwrap()
    assert not step.displacement["block"].any()


def test_iterations_are_reported_to_the_callback():
    seen = []
    steps = punch(0.3, callback=lambda time, iteration, residual: seen.append((time, residual)))
    counted = [(step.time, residual) for step in steps for residual in step.solution.residuals]
    assert seen == counted


SQUARE = block(MeshQuad, (2, 2), (0, 0), (1, 1))
HELD, TOP = {"bottom": (0.0, 0.0)}, {"top": (0.0, 0.0)}
FLOOR = RigidPlane((0.0, 0.0), (0.0, 1.0))


def square(**options):
    return Body(SQUARE, LAW, **options)


def on_floor(body, **options):
    return FiniteAssembly({"a": body}, {"c": Contact(("a", "bottom"), FLOOR, **options)})


def bodies(contact, **others):
    return FiniteAssembly({"a": square(supports=HELD)} | others, {"c": contact})


@pytest.mark.parametrize("finite_sliding", [False, True])
def test_a_block_pushed_beyond_its_friction_ends_the_path_with_capacity_and_load(finite_sliding):
    """1 MN/m press a block on its base, friction carries 0.2 MN/m of a push along it."""

    def push(force):
        low = moved(SQUARE, SQUARE.p - np.array([[0.0], [1.0 - 1e-5]]))  # closed from the start
        tractions = {
            "top": (
                lambda x, t: np.full(x.shape[1], force * max(t - 1.0, 0.0)),
                lambda x, t: np.full(x.shape[1], -1e6 * min(t, 1.0)),
            )
        }
        bodies = {
            "base": Body(low, Elastic(1e9, 0.3), supports={"bottom": (0.0, 0.0)}),
            "block": Body(SQUARE, Elastic(1e9, 0.3), tractions=tractions),
        }
        sides = ("block", "bottom"), ("base", "top")
        contact = Contact(*sides, friction_coefficient=0.2, finite_sliding=finite_sliding)
        return solve_contact(FiniteAssembly(bodies, {"joint": contact}), (1.0, 2.0))

    assert all(step.solution.converged for step in push(0.19e6))
    pressed, slid = push(0.21e6)
    assert pressed.solution.converged
    assert not slid.solution.converged
    assert np.isnan(slid.displacement["block"]).all()
    message = r"'block' slides away at time 2: its load .* is 2.1e\+05 N/m, .* about 2e\+05 N/m"
    with pytest.raises(ConvergenceError, match=message):
        slid.unwrap()
