"""Paths in increments: the limit load of a body without hardening, and where a path ends."""

from dataclasses import replace

import numpy as np
import pytest

from multiscale.convergence import Status
from multiscale.laws.bulk import J2
from multiscale.micro import Cell, Surface
from multiscale.micro.finite import cell_newton
from multiscale.micro.finite.cell_newton import PRESSED, walk_step
from multiscale.micro.finite.finite_cell import make_scene
from multiscale.micro.path import Target

YIELD = 1e-4  # of Young's modulus


def peaks(height=0.02, second=0.0, hardening=0.0):
    """Two sharp asperities, one lower than the other, of metal that flows at once."""
    heights = np.zeros((8, 8))
    heights[2, 2] = height
    heights[6, 6] = height - second
    bulk = J2(1.0, 0.3, YIELD, hardening)
    return Cell(Surface(heights, (1.0, 1.0)), 0.5, 4, 1.0, 0.3, bulk=bulk)


def press(cell, load):
    scene = make_scene(cell)
    return walk_step(
        scene,
        scene.rest(),
        Target(load, None, np.zeros(2)),
        increments=1,
        tolerance=1e-8,
        largest_approach=cell.largest_approach(),
    )


def load_of_the_first(cell, approach):
    """Load at an approach, in increments as short as plastic bodies are given."""
    scene = make_scene(cell)
    count = int(np.ceil(approach / cell.largest_approach()))
    target = Target(None, approach, np.zeros(2))
    return walk_step(scene, scene.rest(), target, increments=count, tolerance=1e-8).state.load


def test_a_load_that_one_asperity_cannot_carry_is_carried_when_the_next_one_touches():
    cell = peaks(second=0.01)
    before = load_of_the_first(cell, 0.0095)  # the lower peak does not touch yet
    walk = press(cell, 1.5 * before)
    assert walk.reached == 1.0
    assert walk.state.status is Status.CONVERGED
    assert walk.state.approach > 0.01
    assert walk.state.active[6, 6]
    assert walk.state.load == pytest.approx(1.5 * before, rel=1e-8)
    assert walk.newton_iterations < 160  # 360 by ever shorter increments of the load


@pytest.mark.slow
def test_a_load_takes_the_increments_of_its_approach_and_two_more_to_end_at_the_load():
    waves = np.cos(2.0 * np.pi * np.arange(8) / 8)
    heights = 0.04 * waves[:, None] * waves
    cell = Cell(Surface(heights, (1.0, 1.0)), 0.5, 4, 1.0, 0.3, bulk=J2(1.0, 0.3, YIELD, 0.01))
    walk = press(cell, 0.006)
    assert walk.state.load == pytest.approx(0.006, rel=1e-7)
    fewest = walk.state.approach / (PRESSED * cell.largest_approach())
    assert fewest <= walk.increments <= fewest + 2.0


def test_a_load_that_is_not_reached_leaves_the_part_that_was(monkeypatch):
    cell = peaks(second=0.01)
    load = 1.5 * load_of_the_first(cell, 0.0095)
    monkeypatch.setattr(cell_newton, "MOST", 8)
    walk = press(cell, load)
    assert walk.state.status is Status.MAX_ITERATIONS
    assert 0.0 < walk.reached < 1.0
    assert walk.state.load == pytest.approx(walk.reached * load)


def test_where_an_increment_starts_does_not_change_where_it_ends():
    cell = peaks(hardening=0.01)
    scene = make_scene(cell)
    target = Target(None, 0.004, np.zeros(2))
    whole = walk_step(scene, scene.rest(), target, increments=4, tolerance=1e-10)
    spent = []
    for past in (1.0, 0.0):
        state, iterations = scene.rest(), 0
        for approach in (0.001, 0.002, 0.003, 0.004):
            target = Target(None, approach, np.zeros(2))
            given = replace(state, change=past * state.change)  # without a past, no prediction
            walk = walk_step(scene, given, target, increments=1, tolerance=1e-10)
            state, iterations = walk.state, iterations + walk.newton_iterations
        np.testing.assert_allclose(whole.state.force, state.force, atol=1e-9 * state.load)
        spent.append(iterations)
    assert whole.newton_iterations < 0.75 * spent[1]  # it goes on as in the increment before
    assert spent[0] == whole.newton_iterations  # also from one step of a path to the next
