"""The area of unions in a polygon against closed forms and counting."""

import numpy as np
import pytest

from multiscale.micro.damage.planar import Ellipses, union_area

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
PENTAGON = np.array([[0.1, 0.0], [0.9, 0.1], [1.0, 0.7], [0.5, 1.0], [0.0, 0.6]])
UNCUT = [0.0, 0.0, -np.inf, np.inf]


def disc(centre, radius, strip=UNCUT):
    return Ellipses(np.array([centre]), np.array([radius * np.eye(2)]), np.array([strip], float))


@pytest.mark.parametrize(
    ("sets", "area"),
    [
        pytest.param(Ellipses.join([]), 0.0, id="nothing"),
        pytest.param(disc((0.5, 0.5), 0.3), np.pi * 0.09, id="inside"),
        pytest.param(disc((0.0, 0.0), 0.3), np.pi * 0.09 / 4.0, id="corner"),
        pytest.param(disc((0.5, 0.0), 0.5), np.pi * 0.125, id="touching-corners"),
        pytest.param(disc((0.5, 0.5), 0.5), np.pi * 0.25, id="inscribed"),
        pytest.param(disc((0.5, 0.5), 3.0), 1.0, id="everything"),
        pytest.param(disc((5.0, 0.5), 1.0), 0.0, id="outside"),
        pytest.param(Ellipses.join([disc((0.5, 0.5), 0.3)] * 3), np.pi * 0.09, id="equal"),
        pytest.param(
            Ellipses.join([disc((0.5, 0.5), 0.3), disc((0.6, 0.5), 0.1)]), np.pi * 0.09, id="nested"
        ),
        pytest.param(
            Ellipses.join([disc((0.3, 0.5), 0.2), disc((0.7, 0.5), 0.2)]),
            np.pi * 0.08,
            id="touching",
        ),
        pytest.param(disc((0.5, 0.5), 9.0, [0, 1, 0.2, 0.6]), 0.4, id="strip"),
        pytest.param(disc((0.5, 0.5), 9.0, [0, 1, 0.0, 0.6]), 0.6, id="strip-at-the-edge"),
        pytest.param(
            Ellipses.join([disc((0, 0), 9.0, [0, 1, 0.2, 0.6]), disc((0, 0), 9.0, [1, 0, 0, 0.5])]),
            0.7,
            id="crossed-strips",
        ),
    ],
)
@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e3])
def test_closed_forms_in_any_unit(sets, area, unit):
    scaled = Ellipses(unit * sets.centre, unit * sets.root, sets.strip * [1.0, 1.0, unit, unit])
    assert union_area(unit * SQUARE, scaled) == pytest.approx(unit**2 * area, abs=1e-12 * unit**2)


@pytest.mark.parametrize("seed", range(3))
def test_random_unions_cover_what_counting_says(seed):
    rng, n, k = np.random.default_rng(seed), 1500, 12
    centre, root = rng.uniform(size=(k, 2)), 0.12 * rng.normal(size=(k, 2, 2))
    turned = np.linalg.det(root) < 0.0
    root[turned] = root[turned][:, :, ::-1]
    strip = np.tile(UNCUT, (k, 1))
    angle = rng.uniform(0.0, 2.0 * np.pi, k)[::2]
    g = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    middle = np.sum(g * centre[::2], axis=1)
    strip[::2] = np.column_stack([g, middle - 0.05, middle + 0.08])

    x, y = np.meshgrid(*(2 * [(np.arange(n) + 0.5) / n]), indexing="ij")
    covered, inside = np.zeros((n, n), dtype=bool), np.ones((n, n), dtype=bool)
    for p, q in zip(PENTAGON, np.roll(PENTAGON, -1, axis=0), strict=True):
        inside &= (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) > 0.0
    for c, M, s in zip(centre, root, strip, strict=True):
        W = np.linalg.inv(M)
        u = W[0, 0] * (x - c[0]) + W[0, 1] * (y - c[1])
        v = W[1, 0] * (x - c[0]) + W[1, 1] * (y - c[1])
        along = s[0] * x + s[1] * y
        covered |= (u * u + v * v <= 1.0) & (s[2] <= along) & (along <= s[3])
    found = union_area(PENTAGON, Ellipses(centre, root, strip))
    assert found == pytest.approx((covered & inside).mean(), abs=5e-5)
