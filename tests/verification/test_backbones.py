"""Frequency and damping of small models against references without modes at rest."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.linalg import eigh, solveh_banded
from scipy.sparse import csr_array

from multiscale.fe.mesh_file import box_mesh
from multiscale.laws import Exponential, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import Assembly, Body, Interface
from multiscale.macro.substructures.whole import assemble
from multiscale.macro.vibration import Amplitudes, follow_backbone, structure_mass
from multiscale.macro.vibration.backbone import TOLERANCE, TractionChange
from tests.macro.test_vibration import DENSITY, UNIT, E, block_between_friction, first_mode

LENGTH, WIDTH, HEIGHT = 1.0, 0.01, 0.002
PRESSURE, FRICTION, RATIO, DECAY = 1e6, 0.3, 0.01, 1e-5


def bar_on_friction():
    """A bar that one end holds, pressed on a ground of single sliders."""
    body = Body(
        box_mesh((LENGTH, WIDTH, HEIGHT), (30, 1, 1)),
        Elastic(E, 0.0),
        {"left": (0.0, None, None), "front": (None, 0.0, None)},
        {"top": (0.0, 0.0, -PRESSURE)},
    )
    law = Sliders(Exponential(1e9, DECAY), FRICTION, RATIO, pressures=(1e5, 1e7), slabs=1)
    return Assembly((body,), (Interface((None, 0), (None, "bottom"), law),))


def exact_bar(amplitudes, elements=200):
    """Frequency and damping of a line on springs with sliders, by a separate fine mesh."""
    h = LENGTH / elements
    axial, spring = E * WIDTH * HEIGHT, RATIO * PRESSURE / DECAY * WIDTH * h
    cap, mass = FRICTION * PRESSURE * WIDTH * h, DENSITY * WIDTH * HEIGHT * h
    share = np.ones(elements)
    share[-1] = 0.5  # of the free end
    diagonal, beside = 2.0 * share * axial / h, np.full(elements - 1, -axial / h)
    K = np.diag(diagonal) + np.diag(beside, 1) + np.diag(beside, -1)
    M = mass * share
    square, shape = eigh(K + spring * np.diag(share), np.diag(M), subset_by_index=[0, 0])
    phi, square = np.abs(shape[:, 0]), float(square[0])
    force = square * np.linspace(0.0, 1.0, 401)[1:] * amplitudes[-1]
    q, u = [0.0], np.zeros(elements)
    for alpha in force:
        for _ in range(50):  # Newton
            slips = spring * u > cap
            rest = K @ u + share * np.where(slips, cap, spring * u) - alpha * M * phi
            banded = np.array([np.append(0.0, beside), diagonal + share * spring * ~slips])
            u = u - solveh_banded(banded, rest)
            if np.array_equal(spring * u > cap, slips):
                break
        q.append(float(phi @ (M * u)))
    q, alpha = np.array(q), np.append(0.0, force)
    area = np.append(0.0, np.cumsum(0.5 * (alpha[1:] + alpha[:-1]) * np.diff(q)))
    loss = 8.0 * area - 4.0 * alpha * q
    secant = np.interp(amplitudes, q, alpha)
    frequency = np.sqrt(secant / amplitudes) / (2.0 * np.pi)
    return frequency, np.interp(amplitudes, q, loss) / (2.0 * np.pi * secant * amplitudes)


@pytest.mark.slow
def test_a_bar_on_friction_slips_from_its_end_as_a_line_on_sliders():
    """The slip goes from the free end over 56 and 71 % of the length."""
    rest, modes, load = first_mode(bar_on_friction())
    slips = FRICTION * DECAY / RATIO / np.abs(modes.shape[:, 0]).max()  # as the end slips
    for full, sizes in ((False, [1.6, 2.4]), (True, [2.4])):
        amplitudes = slips * np.array(sizes)
        frequency, damping = exact_bar(amplitudes)
        asked = Amplitudes(tuple(amplitudes), full_cycle=full, ratio=1.1, steps=12)
        backbone = follow_backbone(rest, modes, load, 0, asked)
        np.testing.assert_allclose(backbone.frequency, frequency, rtol=1e-3)
        np.testing.assert_allclose(backbone.damping, damping, rtol=0.01)


def free_decay(rest, mass, velocity, step, count):
    r"""Change of the displacement since rest, m, after a blow that gives a velocity, m/s.

    With the change v, the middle m of a step h solves

    .. math::
        \frac{4}{h^2} M \left( v_m - v - \frac{h}{2} \dot v \right) + K v_m
        + B^T w\, \Delta t(B v_m) = 0, \qquad
        v^+ = 2 v_m - v, \qquad \dot v^+ = \frac{4}{h} (v_m - v) - \dot v;    \tag{1}

    the tractions of joints follow the law from middle to middle.
    """
    whole, inertia = assemble(rest.free.with_locked_bolts()), csr_array(4.0 / step**2 * mass)
    moving = replace(whole, stiffness=csr_array(whole.stiffness + inertia), load=inertia)
    state, middle = rest.state, np.zeros(velocity.size)
    law = TractionChange(rest.law, rest.law.respond(state.jump, state.history).traction)
    change = np.zeros((count + 1, velocity.size))
    for k in range(count):
        ahead = change[k] + 0.5 * step * velocity
        jump = state.jump + (whole.jump @ (ahead - middle)).reshape(state.jump.shape)
        solution = moving.solve(
            law, ahead, start=ahead, jump=jump, state=state.history, tolerance=TOLERANCE
        )  # (1)
        assert solution.converged
        state, _ = state.advance(rest.law, solution.value, solution.jump, state.traction)
        middle = solution.value
        change[k + 1] = 2.0 * middle - change[k]
        velocity = 4.0 / step * (middle - change[k]) - velocity
    return change


def test_a_free_decay_has_the_frequency_and_damping_of_the_backbone():
    """A block on an Iwan bed swings freely after a blow, in steps without modes.

    By Masing's rule half a swing of span 2 s, from a peak with the force f to one with 2 alpha(s)
    - f, does no work if 2 s (f - alpha(s)) = D(s) / 2. Errors of f change their sign in each half.
    """
    assembly = block_between_friction(64)
    rest, modes, load = first_mode(assembly)
    asked = Amplitudes(tuple(UNIT * np.geomspace(0.4, 1.8, 6)))
    backbone = follow_backbone(rest, modes, load, 0, asked)
    mass = structure_mass(rest.free, assembly.bodies, [DENSITY] * 2)
    blow = 1.5 * UNIT * np.sqrt(modes.square[0]) * modes.shape[:, 0]
    step = 1.0 / (40.0 * modes.frequency[0])
    q = np.abs(load[:, 0] @ free_decay(rest, mass, blow, step, 160).T)
    k = np.flatnonzero((q[1:-1] > q[:-2]) & (q[1:-1] >= q[2:])) + 1
    before, peak, after = q[k - 1], q[k], q[k + 1]  # on a parabola
    top = peak + (before - after) ** 2 / (8.0 * (2.0 * peak - before - after))
    at = k + 0.5 * (after - before) / (2.0 * peak - before - after)
    s = 0.5 * (top[1:] + top[:-1])

    square = CubicSpline(asked.values, backbone.frequency**2)
    force, falls = [top[0] * square(top[0])], []
    for carried in s * square(s):
        falls.append(force[-1] / carried - 1.0)
        force.append(2.0 * carried - force[-1])
    damping, expected = (
        curve[:6].reshape(3, 2).mean(axis=1)
        for curve in (2.0 / np.pi * np.array(falls), CubicSpline(asked.values, backbone.damping)(s))
    )
    assert asked.values[0] < s[5] < top[0] < asked.values[-1]
    np.testing.assert_allclose(damping, expected, rtol=0.05)
    frequency = 0.5 / (step * np.diff(at))
    np.testing.assert_allclose(frequency[:6], np.sqrt(square(s[:6])), rtol=0.006)
