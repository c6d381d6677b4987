"""Unilateral contact with Coulomb friction between substructures, against a separate solver."""

import numpy as np
import pytest
from scipy.sparse.linalg import splu

from multiscale.fe.mesh_file import box_mesh
from multiscale.laws import RigidContact
from multiscale.laws.bulk import Elastic
from multiscale.macro import Assembly, Body, Interface
from multiscale.macro.substructures import (
    assemble,
    cut_assembly,
    solve_latin,
)
from multiscale.macro.substructures.directions import law_stiffness
from multiscale.nonsmooth import solve_friction

E = 210e9


def console(law, parts, pushes=(1.5e6,), pressure=8e6):
    """A block fixed at its end rests on another; pressed at one end and pushed along."""
    lower = Body(
        box_mesh((0.04, 0.02, 0.01), (4, 2, 1), origin=(0.0, 0.0, -0.01)),
        Elastic(E, 0.3),
        supports={"bottom": (0.0, 0.0, 0.0)},
    )
    upper = Body(
        box_mesh((0.04, 0.02, 0.01), (4, 2, 1)),
        Elastic(E, 0.3),
        supports={"right": (0.0, 0.0, 0.0)},
        tractions={
            "top": (
                lambda x, push: np.full(x.shape[1], push),
                0.0,
                lambda x, push: pressure * (x[0] / 0.02 - 1.0),
            )
        },
    )
    joint = Interface((0, 1), ("top", "bottom"), law)
    return cut_assembly(Assembly((lower, upper), (joint,), pushes), (parts, 1))


def condensed_steps(problem, law, factors):
    """Displacement of all unknowns and forces at the points, step by step, by solve_friction."""
    whole = assemble(problem)
    points = whole.weight.size
    # the force at a point is its traction times its weight: u = W r + q, normal first
    order = np.arange(3 * points).reshape(3, points).T.ravel()
    J = whole.jump.toarray()[order]
    solve = splu(whole.stiffness.tocsc()).solve
    compliance, slipped, computed = solve(J.T), np.zeros(3 * points), []
    for factor in factors:
        free = solve(whole.load @ factor)
        q = J @ free - slipped
        q[::3] += law.gap
        scale = 1.0 / (np.abs(q).max() or 1.0)
        friction = np.full(points, law.friction)
        force = solve_friction(J @ compliance * 1e8, q * scale, friction, tolerance=1e-9).unwrap()
        force *= 1e8 / scale
        u = free + compliance @ force
        slipped = J @ u
        slipped[::3] = 0.0
        computed.append((u, force.reshape(-1, 3)))
    return computed


@pytest.mark.parametrize(
    ("friction", "push"),
    [
        pytest.param(0.0, 1.5e6, id="frictionless"),
        pytest.param(0.3, 1.5e6, id="slides"),
        pytest.param(0.3, 0.6e6, id="sticks-in-part"),
    ],
)
@pytest.mark.parametrize("gap", [0.0, 2e-8])
def test_blocks_that_press_slide_and_gape_follow_the_condensed_problem(gap, friction, push):
    law = RigidContact(friction, gap)
    problem = console(law, 2, (push,))
    ((expected, force),) = condensed_steps(problem, law, np.eye(1))
    touching = force[:, 0] > 1e-6 * force.max()
    assert 0 < np.count_nonzero(touching) < len(force), "some points must be open"
    sliding = (np.hypot(*force.T[1:]) > 0.999 * friction * force[:, 0])[touching]
    assert np.all(sliding) == (friction > 0.0 and push > 1e6)
    assert np.any(sliding) == (friction > 0.0)

    result = solve_latin(problem, tolerance=1e-8)
    assert result.converged == 1
    computed = result.displacement.values[0]
    size = np.abs(expected).max()
    np.testing.assert_allclose(computed, problem.displacement(expected), atol=1e-6 * size)
    traction = result.traction.values[0]
    round_off = 1e-9 * np.abs(traction).max()
    assert np.all(traction[:, 0] <= round_off)
    shear = np.hypot(traction[:, 1], traction[:, 2])
    assert np.all(shear <= -friction * traction[:, 0] + round_off)
    assert np.all(result.jump.values[0, :, 0] >= -gap * (1.0 + 1e-12))


@pytest.mark.parametrize("friction", [0.1, 0.6])
def test_shear_to_and_fro_and_loads_taken_away_leave_the_state_of_the_condensed_problem(friction):
    law = RigidContact(friction)
    problem = console(law, 2, (0.0, 1e6))  # the load of a push has the pressure in it
    press, push = np.array([1.0, 0.0]), np.array([-1.0, 1.0])
    shear = (0.0, 0.6, 1.5, -0.6, -1.5, 0.6)
    factors = np.array([press + s * push for s in shear] + [0.0 * press, press + push])
    result = solve_latin(problem, factors)
    assert np.all(result.converged == 1)
    assert np.all(result.iterations <= 80)
    size = float(np.abs(result.displacement).max())
    order = np.lexsort(result.point_position.values.T)
    turned = []
    for step, (u, force) in enumerate(condensed_steps(problem, law, factors)):
        expected = problem.displacement(u)
        np.testing.assert_allclose(result.displacement[step], expected, atol=1e-6 * size)
        turned.append(force[order, 1].sum())
    assert turned[2] * turned[4] < 0.0, "friction must have turned"
    assert np.all(np.abs(result.traction[6]) < 1e-6 * np.abs(result.traction[0]).max())


def test_search_directions_of_rigid_contact_are_equal_at_open_and_closed_points():
    stiffness = law_stiffness(RigidContact(0.3), np.array([[0.0, 1e-6]] * 3), np.zeros((2, 2)))
    assert np.all(np.isinf(stiffness))
