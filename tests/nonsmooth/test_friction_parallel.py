"""Coloured sweeps give the numbers of serial ones, and colours keep neighbours apart."""

import numpy as np

from multiscale.bench.friction_scenes import sphere_pile
from multiscale.nonsmooth.friction import solve_friction
from multiscale.nonsmooth.friction_problem import scale_friction
from multiscale.nonsmooth.gauss_seidel import colour_contacts, sweep, sweep_coloured
from multiscale.numerics.compiled import threads
from tests.nonsmooth.friction_problems import random_stack


def test_contacts_of_one_colour_share_no_block():
    problem = scale_friction(*random_stack(0).condensed())
    order, bounds = colour_contacts(problem.columns, problem.starts)
    colour = np.empty(order.size, dtype=int)
    for c in range(bounds.size - 1):
        colour[order[bounds[c] : bounds[c + 1]]] = c
    rows = np.repeat(np.arange(order.size), np.diff(problem.starts))
    off = rows != problem.columns
    assert np.all(colour[rows[off]] != colour[problem.columns[off]])
    assert sorted(order) == list(range(order.size))


def test_coloured_sweeps_equal_serial_ones_bit_by_bit():
    problem = scale_friction(*sphere_pile(60, np.random.default_rng(seed=1)).condensed())
    order, bounds = colour_contacts(problem.columns, problem.starts)
    data = (
        problem.blocks, problem.columns, problem.starts, problem.diagonal,
        problem.velocity, problem.friction,
    )  # fmt: skip
    serial, coloured = np.zeros_like(problem.velocity), np.zeros_like(problem.velocity)
    sweep(*data, order, serial, 30)
    sweep_coloured(*data, order, bounds, coloured, 30)
    assert np.any(serial)
    np.testing.assert_array_equal(serial, coloured)


def test_the_answer_of_a_large_problem_does_not_depend_on_the_threads(monkeypatch):
    monkeypatch.setattr("multiscale.nonsmooth.gauss_seidel.MANY", 10)
    W, q, mu = sphere_pile(60, np.random.default_rng(seed=2)).condensed()
    values = []
    for count in (1, 2):
        with threads(count):
            values.append(solve_friction(W, q, mu, method="gauss_seidel", max_iterations=40).value)
    np.testing.assert_array_equal(*values)
