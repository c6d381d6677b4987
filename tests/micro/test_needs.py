"""A cell allocates and computes only the required quantities."""

import tracemalloc

import numpy as np
import pytest

from multiscale.laws.bulk import J2, Elastic, NeoHookean
from multiscale.micro import Cell, Path, SecondBody, Surface, solve_cell
from multiscale.micro.elastic import stiffness
from multiscale.micro.elastic.lateral_fft import LateralInverse
from tests.support import rough_square

N, LAYERS = 48, 10


def plain_cell(n=N, **changes):
    surface = rough_square(n, 0.5, 0.25, 0.2)
    given = {"youngs_modulus": 1.0, "poissons_ratio": 0.3} | changes
    return Cell(surface, 1.0, LAYERS, **given)


PLAIN = {"stiffness", "layer factors"}
LARGE = {"layer factors", "tangent"}


@pytest.mark.parametrize(
    ("changes", "built", "state"),
    [
        ({}, PLAIN, 0),
        ({"geometry": "flat"}, set(), 0),
        ({"geometry": "flat", "hardness": 1.0}, {"hardness cap"}, 0),
        ({"geometry": "flat", "slope_order": 2}, {"slope expansion"}, 0),
        ({"poissons_ratio": 0.45}, {*PLAIN, "mean dilatation", "tilt"}, 0),
        ({"obstacle": Surface(np.zeros((N, N)), (1.0, 1.0))}, {*PLAIN, "obstacle normals"}, 0),
        ({"youngs_modulus": np.ones((N, LAYERS, N))}, {*PLAIN, "element moduli"}, 0),
        ({"friction_coefficient": 0.3}, {*PLAIN, "friction"}, 0),
        (
            {"opposite": SecondBody(0.5, 4, Elastic(1.0, 0.3))},
            {*PLAIN, "obstacle normals", "opposite body"},
            0,
        ),
        ({"bulk": NeoHookean(1.0, 0.3)}, LARGE, 0),
        (
            {"bulk": J2(1.0, 0.3, 0.01), "friction_coefficient": 0.3},
            {*LARGE, "friction", "mean dilatation"},
            2,
        ),
    ],
    ids=lambda given: " ".join(given) if isinstance(given, dict) else None,
)
def test_each_feature_is_built_only_where_it_is_used(changes, built, state):
    needs = plain_cell(**changes).needs()
    assert set(needs.built) == built
    assert not built & set(needs.omitted)
    assert all(f"builds {name}" in needs.explain() for name in built)
    assert len(needs.state_variables) == state
    assert needs.unknowns_per_contact == (3 if "friction" in built else 1)


@pytest.mark.parametrize(
    ("geometry", "order"), [("conforming", 1), ("flat", 1), ("flat", 2)], ids=str
)
def test_the_stated_memory_is_the_memory_taken(geometry, order):
    cell = plain_cell(96, geometry=geometry, slope_order=order)
    path = Path(pressure=(0.01,))
    solve_cell(cell, path)  # compiles
    tracemalloc.start()
    solve_cell(cell, path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert cell.needs().memory == pytest.approx(peak, rel=0.1)


def test_the_cost_of_a_plain_run(monkeypatch):
    # the counts of the first version of this test: a later feature must not raise them
    counts = {"apply": 0, "solve": 0}
    make, solve = stiffness.stiffness_operator, LateralInverse.solve

    def counted_operator(*arguments, **options):
        apply = make(*arguments, **options)

        def counted(*fields):
            counts["apply"] += 1
            return apply(*fields)

        return counted

    def counted_solve(self, *arguments):
        counts["solve"] += 1
        return solve(self, *arguments)

    monkeypatch.setattr(stiffness, "stiffness_operator", counted_operator)
    monkeypatch.setattr(LateralInverse, "solve", counted_solve)
    response = solve_cell(plain_cell(), Path(pressure=(0.002, 0.02)))
    assert response["converged"].values.all()
    steps = response["linear_iterations"].values.sum()
    sets = response["active_set_iterations"].values.sum()
    # each iteration: one product, one solve; each active set: one of both to move onto it
    assert counts["solve"] <= steps + sets + 2
    assert counts["apply"] <= steps + 2 * sets + 2
