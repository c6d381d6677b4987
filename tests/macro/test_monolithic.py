"""Semismooth Newton on elastic bodies that are joined by a law."""

import numpy as np
import pytest
from scipy.optimize import brentq, minimize
from scipy.sparse import csr_array

from multiscale.convergence import Status
from multiscale.laws import ConvexDecreasing, Exponential
from multiscale.macro import Block, solve_interface
from multiscale.macro.substructures import assemble, cut_assembly
from tests.pressed_joint import ElementJoint, pressed_blocks

PRESSURE = 2.0e6
EXPONENTIAL = Exponential(pressure_scale=4.0e9, decay_length=0.2e-6)
CUBIC = ConvexDecreasing(knot=np.array([1e-6, 2e-6]), coefficient=np.array([8e24, 2e24]))
LAWS = [pytest.param(EXPONENTIAL, id="exponential"), pytest.param(CUBIC, id="compact-support")]

# one spring between the ground and an interface with the ground: k u - p(u) = f
SPRING = csr_array([[1.0e12]])
JUMP = csr_array([[1.0], [0.0], [0.0]])
AREA = np.array([1.0])


def spring_solution(law, load):
    def residual(u):
        jump = np.array([[u], [0.0], [0.0]])
        return 1.0e12 * u + law.respond(jump, np.zeros((0, 1))).traction[0, 0] - load

    return brentq(residual, -1e-4, 1e-4, xtol=1e-22, rtol=1e-15)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("form", [csr_array.copy, csr_array.toarray], ids=["sparse", "dense"])
@pytest.mark.parametrize("start", [0.0, -2e-5, -4e-6, 3e-6, 1e-3, 1.0])
def test_any_start_leads_to_the_solution_of_one_spring(law, form, start):
    load = np.array([-PRESSURE])
    solution = solve_interface(form(SPRING), load, JUMP, AREA, law, start=np.array([start]))
    assert solution.unwrap()[0] == pytest.approx(spring_solution(law, load[0]), rel=1e-8)
    assert solution.residuals[-1] <= 1e-10


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("distance", [-1e-5, 0.0, 1e-5, 1e-2], ids="{:g} m".format)
def test_a_floating_body_lands_on_the_interface_from_any_distance(law, distance):
    K = csr_array([[1e12, -1e12], [-1e12, 1e12]])  # supported only by the interface
    B = csr_array(([1.0], ([0], [1])), shape=(3, 2))
    load = np.array([-PRESSURE, 0.0])
    start = np.full(2, distance)
    u = solve_interface(K, load, B, AREA, law, start=start).unwrap()
    response = law.respond((B @ u).reshape(3, 1), np.zeros((0, 1)))
    assert -response.traction[0, 0] == pytest.approx(PRESSURE, rel=1e-9)
    assert u[1] - u[0] == pytest.approx(PRESSURE / 1e12, rel=1e-6)


@pytest.fixture(scope="module")
def small_joint():
    block = Block(height=0.02, youngs_modulus=210e9, poissons_ratio=0.3)
    soft = Block(height=0.01, youngs_modulus=70e9, poissons_ratio=0.2)
    mesh = {"elements": (2, 1), "layers": (1, 1)}
    joint = ElementJoint((0.02, 0.01), block, soft, **mesh, eccentricity=(0.004, 0.001))
    whole = assemble(cut_assembly(pressed_blocks(joint, EXPONENTIAL)))
    return whole.stiffness, whole.load[:, 0], whole.jump, whole.weight


@pytest.mark.parametrize("law", LAWS)
def test_the_solution_minimises_the_energy(law, small_joint):
    K, load, B, w = small_joint
    u = solve_interface(K, PRESSURE * load, B, w, law, tolerance=1e-12).unwrap()
    unit = 1e-7  # m, so that the general minimiser sees numbers of unit order

    def potential(gap):
        if law is EXPONENTIAL:
            return law.pressure_scale * law.decay_length * np.exp(-gap / law.decay_length)
        closed = np.maximum(0.0, law.knot[:, None] - gap)
        return law.coefficient @ closed**4 / 4.0

    def energy(x):
        v = unit * x
        return (0.5 * v @ (K @ v) + w @ potential((B @ v)[: w.size]) - PRESSURE * load @ v) / unit

    def gradient(x):
        jump = (unit * (B @ x)).reshape(3, -1)
        traction = law.respond(jump, np.zeros((0, w.size))).traction
        return unit * (K @ x) + B.T @ (w * traction).ravel() - PRESSURE * load

    optimum = minimize(energy, u / unit + 0.3, jac=gradient, method="BFGS", options={"gtol": 1e-7})
    # differences of the energy are exact to its round-off, and independent of every derivative
    for direction in np.random.default_rng(seed=5).normal(size=(20, u.size)):
        for step in (0.3, -0.3):
            assert energy(u / unit + step * direction) > energy(u / unit)
    np.testing.assert_allclose(unit * optimum.x, u, atol=1e-5 * np.abs(u).max())


def test_the_residual_that_is_returned_belongs_to_the_solution(small_joint):
    K, load, B, w = small_joint
    solution = solve_interface(K, PRESSURE * load, B, w, EXPONENTIAL)
    u = solution.unwrap()
    traction = EXPONENTIAL.respond((B @ u).reshape(3, -1), np.zeros((0, w.size))).traction
    residual = K @ u + B.T @ (w * traction).ravel() - PRESSURE * load
    relative = np.linalg.norm(residual) / np.linalg.norm(PRESSURE * load)
    assert solution.residuals[-1] == pytest.approx(relative, rel=1e-3, abs=1e-14)
    assert relative <= 1e-10


def test_newton_converges_quadratically_near_the_solution(small_joint):
    K, load, B, w = small_joint
    u = solve_interface(K, PRESSURE * load, B, w, EXPONENTIAL).unwrap()
    again = solve_interface(K, 1.02 * PRESSURE * load, B, w, EXPONENTIAL, start=u)
    assert len(again.residuals) <= 5
    assert again.residuals[2] < 10.0 * again.residuals[1] ** 2


def test_the_arguments_are_not_changed(small_joint):
    K, load, B, w = small_joint
    start = np.zeros(load.size)
    before = K.copy()
    solve_interface(K, PRESSURE * load, B, w, EXPONENTIAL, start=start).unwrap()
    assert not start.any()
    assert (before != K).nnz == 0


def test_too_few_iterations_are_reported():
    solution = solve_interface(
        SPRING, np.array([-PRESSURE]), JUMP, AREA, EXPONENTIAL, max_iterations=1
    )
    assert solution.status is Status.MAX_ITERATIONS
    assert len(solution.residuals) == 2


def test_a_start_that_overflows_is_reported():
    start = np.array([-1.0])
    solution = solve_interface(SPRING, -AREA, JUMP, AREA, EXPONENTIAL, start=start)
    assert solution.status is Status.NOT_FINITE


def test_a_load_that_nothing_carries_is_reported():
    pull = np.array([PRESSURE])  # opens the joint of a body that nothing else holds
    solution = solve_interface(csr_array([[0.0]]), pull, JUMP, AREA, CUBIC)
    assert not solution.converged


def test_iterations_are_reported_to_the_callback():
    seen = []
    solution = solve_interface(
        SPRING,
        np.array([-PRESSURE]),
        JUMP,
        AREA,
        EXPONENTIAL,
        callback=lambda iteration, residual: seen.append((iteration, residual)),
    )
    assert seen == list(enumerate(solution.residuals))
