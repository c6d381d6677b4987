"""The area of unions in a polygon against closed forms and counting."""

import numpy as np
import pytest

from multiscale.micro.damage.ellipse_union import union_area

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
PENTAGON = np.array([[0.1, 0.0], [0.9, 0.1], [1.0, 0.7], [0.5, 1.0], [0.0, 0.6]])


def discs(*centre_and_radius):
    """Centres and roots of discs."""
    centre = np.array([c for c, _ in centre_and_radius], dtype=float).reshape(-1, 2)
    radius = np.array([r for _, r in centre_and_radius], dtype=float)
    return centre, radius[:, None, None] * np.eye(2)


@pytest.mark.parametrize(
    ("sets", "area"),
    [
        pytest.param([], 0.0, id="nothing"),
        pytest.param([((0.5, 0.5), 0.3)], np.pi * 0.09, id="inside"),
        pytest.param([((0.0, 0.0), 0.3)], np.pi * 0.09 / 4.0, id="corner"),
        pytest.param([((0.5, 0.0), 0.5)], np.pi * 0.125, id="touching-corners"),
        pytest.param([((0.5, 0.5), 0.5)], np.pi * 0.25, id="inscribed"),
        pytest.param([((0.5, 0.5), 3.0)], 1.0, id="everything"),
        pytest.param([((5.0, 0.5), 1.0)], 0.0, id="outside"),
        pytest.param([((0.5, 0.5), 0.3)] * 3, np.pi * 0.09, id="equal"),
        pytest.param([((0.5, 0.5), 0.3), ((0.6, 0.5), 0.1)], np.pi * 0.09, id="nested"),
        pytest.param([((0.3, 0.5), 0.2), ((0.7, 0.5), 0.2)], np.pi * 0.08, id="touching"),
    ],
)
@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e3])
def test_closed_forms_in_any_unit(sets, area, unit):
    centre, root = discs(*sets)
    entry = union_area(unit * SQUARE, unit * centre, unit * root)
    assert entry == pytest.approx(unit**2 * area, abs=1e-12 * unit**2)


@pytest.mark.parametrize("seed", range(3))
def test_random_unions_cover_the_counted_area(seed):
    rng, n, k = np.random.default_rng(seed), 1500, 12
    centre, root = rng.uniform(size=(k, 2)), 0.12 * rng.normal(size=(k, 2, 2))
    turned = np.linalg.det(root) < 0.0
    root[turned] = root[turned][:, :, ::-1]
    x, y = np.meshgrid(*(2 * [(np.arange(n) + 0.5) / n]), indexing="ij")
    covered, inside = np.zeros((n, n), dtype=bool), np.ones((n, n), dtype=bool)
    for p, q in zip(PENTAGON, np.roll(PENTAGON, -1, axis=0), strict=True):
        inside &= (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) > 0.0
    for c, M in zip(centre, root, strict=True):
        W = np.linalg.inv(M)
        u = W[0, 0] * (x - c[0]) + W[0, 1] * (y - c[1])
        v = W[1, 0] * (x - c[0]) + W[1, 1] * (y - c[1])
        covered |= u * u + v * v <= 1.0
    area = union_area(PENTAGON, centre, root)
    assert area == pytest.approx((covered & inside).mean(), abs=5e-5)
