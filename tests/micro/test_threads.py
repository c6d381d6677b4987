"""The number of threads does not change the answer."""

import numpy as np
import pytest

from multiscale.executors import threads
from multiscale.laws.bulk import J2, NeoHookean
from multiscale.micro import Cell, Path, solve_cell
from tests.support import egg_box

PRESS = Path(approach=(0.005, 0.01))
SHEAR = Path(approach=(0.005, 0.01), slide=((0.0, 0.0), (0.005, 0.0)))


@pytest.mark.parametrize(
    ("body", "path"),
    [
        pytest.param({}, PRESS, id="elastic"),
        pytest.param({"friction_coefficient": 0.3}, SHEAR, id="friction"),
        pytest.param({"bulk": NeoHookean(1.0, 0.3)}, PRESS, id="rubber"),
        pytest.param({"bulk": J2(1.0, 0.3, 0.01, 0.01)}, PRESS, id="metal"),
    ],
)
def test_a_cell_has_the_same_answer_on_one_thread_and_on_two(body, path):
    cell = Cell(egg_box(16, 0.02), 0.5, 6, 1.0, 0.3, **body)
    results = []
    for count in (1, 2):
        with threads(count):
            results.append(solve_cell(cell, path, tolerance=1e-10)["traction"].values)
    np.testing.assert_allclose(*results, rtol=1e-8, atol=1e-12)
