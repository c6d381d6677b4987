"""The neighbour list holds exactly the pairs within reach."""

import numpy as np
import pytest

from multiscale.macro.granulate.contacts import find_pairs


@pytest.mark.parametrize("ratio", [1.0, 3.0, 20.0])
@pytest.mark.parametrize(
    "period",
    [
        pytest.param((np.inf, np.inf, np.inf), id="open"),
        pytest.param((1.0, np.inf, 1.0), id="periodic"),
        pytest.param((0.45, 0.9, 0.7), id="few cells"),
    ],
)
def test_pairs_are_those_of_all_distances(ratio, period):
    rng = np.random.default_rng(seed=4)
    radius = 0.1 * ratio ** -rng.uniform(size=300)
    position = rng.uniform(-0.7, 0.9, (300, 3))
    pairs = find_pairs(position, radius, 0.01, np.array(period))
    d = position[:, None] - position
    for a in np.flatnonzero(np.isfinite(period)):
        d[..., a] -= period[a] * np.round(d[..., a] / period[a])
    gap = np.linalg.norm(d, axis=-1) - radius[:, None] - radius
    expected = {tuple(pair) for pair in np.argwhere(np.triu(gap <= 0.01, 1))}
    found = {tuple(sorted(pair)) for pair in pairs.tolist()}
    assert found == expected
    assert len(pairs) == len(found), "a pair is listed twice"
