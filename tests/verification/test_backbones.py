"""Frequency and damping of small models against references that know nothing of modes at rest."""

import numpy as np
from scipy.linalg import eigh, solveh_banded

from multiscale.fe.boxes import box_mesh
from multiscale.laws import Exponential, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import Assembly, Body, Interface
from multiscale.macro.vibration import Amplitudes, follow_backbone
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
    """Frequency and damping of a line on springs with sliders, by a fine mesh of its own."""
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
    found = np.interp(amplitudes, q, alpha)
    frequency = np.sqrt(found / amplitudes) / (2.0 * np.pi)
    return frequency, np.interp(amplitudes, q, loss) / (2.0 * np.pi * found * amplitudes)


def test_a_bar_on_friction_slips_from_its_end_as_a_line_on_sliders():
    """The slip goes from the free end over 56 and 71 % of the length."""
    rest, modes, load = first_mode(bar_on_friction())
    slips = FRICTION * DECAY / RATIO / np.abs(modes.shape[:, 0]).max()  # as the end slips
    for full, sizes in ((False, [1.6, 2.4]), (True, [2.4])):
        amplitudes = slips * np.array(sizes)
        frequency, damping = exact_bar(amplitudes)
        asked = Amplitudes(tuple(amplitudes), full_cycle=full, ratio=1.1, steps=12)
        found = follow_backbone(rest, modes, load, 0, asked)
        np.testing.assert_allclose(found.frequency, frequency, rtol=1e-3)
        np.testing.assert_allclose(found.damping, damping, rtol=0.01)


def test_a_free_decay_has_the_frequency_and_damping_of_the_backbone():
    """The block of the Iwan bed swings freely, in steps of time that know its law alone.

    The loss of a cycle is over an energy that one stiffness tells, which is so to first order in
    the fall of the stiffness.
    """
    assembly = block_between_friction(256)
    rest, modes, load = first_mode(assembly)
    asked = Amplitudes(tuple(UNIT * np.geomspace(0.2, 1.2, 8)))
    found = follow_backbone(rest, modes, load, 0, asked)
    laws = [interface.law for interface in assembly.interfaces]
    gap = rest.jump[0].mean()
    jump = np.array([[gap], [0.0], [0.0]])
    states = [law.at_rest(jump) for law in laws]
    area, mass = 1e-4, 1e-4 * 4e-5 * DENSITY
    step = 1.0 / (80.0 * found.frequency[0])
    u, v, path = UNIT / np.sqrt(mass), 0.0, []
    force = 0.0
    for _ in range(30 * 80):
        v -= step * force / mass
        path.append(u)
        u += step * v
        jump = np.array([[gap], [u], [0.0]])
        force = 0.0
        for k, law in enumerate(laws):
            response = law.respond(jump, states[k])
            force, states[k] = force + area * float(response.traction[1, 0]), response.state
    path = np.array(path)
    peaks = np.flatnonzero((path[1:-1] > path[:-2]) & (path[1:-1] >= path[2:])) + 1
    top = np.sqrt(mass) * path[peaks]
    q = np.sqrt(top[1:] * top[:-1])
    decrement = np.log(top[:-1] / top[1:]) / (2.0 * np.pi)
    inside = (q > asked.values[0]) & (q < asked.values[-1])
    assert inside.sum() > 8
    expected, drop = (
        np.interp(np.log(q), np.log(asked.values), one) for one in (found.damping, found.drop[0])
    )
    apart = np.abs(decrement / expected - 1.0)[inside]
    assert np.all(apart < 1.7 * drop[inside] + 0.01)
    assert apart[-1] < 0.6 * apart[0]
