"""Coatings: the compliance of a coated half-space, its limits, and the cells that have them."""

import numpy as np
import pytest

from multiscale.laws.bulk import Elastic
from multiscale.micro import Cell, Coating, FlatCell, Path, SecondBody, Surface, solve_cell
from multiscale.micro.elastic.elastic_cells import flat_compliance
from multiscale.micro.layer import elements_of
from tests.support import rough_square, wave

SHAPE = (64, 2)


def symbol(coating=(), modulus=1.0, nu=0.3, depth=20.0, **more):
    """Compliance of waves along x with the wavelengths 1, 1/2, ... m, m/Pa."""
    grid = Surface(np.zeros(SHAPE), (1.0, 1.0 / 32.0))
    law = Elastic(modulus, nu)
    cell = FlatCell(grid, depth, 4, law, coating=tuple(coating), **more)
    return flat_compliance(cell)[1:32, 0] / SHAPE[0] / SHAPE[1] / 32.0


def coated_half_space(q, thickness, coating, below):
    """Compliance of a coated half-space by Nogi and Kato, J. Tribol. 119 (1997) 493, and others."""
    (first, nu), (second, ratio) = coating, below
    shear, share = first / (2.0 * (1.0 + nu)), first * (1.0 + ratio) / (second * (1.0 + nu))
    a = 1.0 - 4.0 * (1.0 - nu) / (1.0 + share * (3.0 - 4.0 * ratio))
    b = (share - 1.0) / (share + 3.0 - 4.0 * nu)
    x, decay = q * thickness, np.exp(-2.0 * q * thickness)
    above = 1.0 + 4.0 * x * b * decay - a * b * decay**2
    return (
        (1.0 - nu)
        / (shear * q)
        * above
        / (1.0 - (a + b + 4.0 * b * x**2) * decay + a * b * decay**2)
    )


WAVES = 2.0 * np.pi * np.arange(1, 32)


@pytest.mark.parametrize("thickness", [1e-3, 0.05, 1.0], ids=["film", "wave", "thick"])
@pytest.mark.parametrize("contrast", [0.01, 0.5, 1.7, 100.0])
def test_the_compliance_is_the_closed_form_of_the_coated_half_space(thickness, contrast):
    kernel = symbol([Coating(thickness, contrast, 0.2)])
    expected = coated_half_space(WAVES, thickness, (contrast, 0.2), (1.0, 0.3))
    np.testing.assert_allclose(kernel, expected, rtol=1e-9)


def test_a_coating_of_the_same_material_changes_nothing_and_thick_or_thin_it_is_a_half_space():
    plain = symbol()
    np.testing.assert_allclose(symbol([Coating(0.02, 1.0, 0.3)] * 3), plain, rtol=1e-10)
    np.testing.assert_allclose(symbol([Coating(1e-9, 10.0, 0.2)]), plain, rtol=1e-6)
    thick = symbol(modulus=10.0, nu=0.2)
    np.testing.assert_allclose(symbol([Coating(15.0, 10.0, 0.2)]), thick, rtol=1e-9)
    assert np.all(np.isfinite(symbol([Coating(15.0, 1e4, 0.2), Coating(1.0, 1e-4, 0.4)])))


def test_the_outermost_coating_comes_first():
    hard, soft = Coating(0.02, 10.0, 0.3), Coating(0.02, 0.1, 0.3)
    short = [symbol(pair)[-1] for pair in ([hard, soft], [soft, hard])]
    assert short[0] < 0.5 * short[1]


def test_the_compliances_of_two_bodies_add_up():
    film = (Coating(0.03, 5.0, 0.2),)
    second = SecondBody(20.0, 4, Elastic(2.0, 0.25), (Coating(0.01, 0.3, 0.4),))
    both = symbol(film, second=second)
    kernel = symbol(second.coating, modulus=2.0, nu=0.25)
    np.testing.assert_allclose(both, symbol(film) + kernel, rtol=1e-12)


@pytest.mark.parametrize("share", [0.5, 1.0, 2.0], ids=["thin", "even", "thick"])
def test_a_flat_punch_on_a_nearly_alike_coating_moves_as_by_gao_chiu_and_lee(share):
    """First order in the difference of the moduli: Int. J. Solids Struct. 29 (1992) 2471, eq 24."""
    n, radius, nu, more = 96, 1.0 / 12.0, 0.3, 1e-2
    x = (np.arange(n) - n // 2) / n
    inside = x[:, None] ** 2 + x**2 < radius**2
    obstacle = Surface(np.where(inside, 0.0, 1e-3), (1.0, 1.0))
    flat, moved, pressure = Surface(np.zeros((n, n)), (1.0, 1.0)), [], 1e-4
    stiff = (1.0 + more, nu)
    film = Coating(share * radius, *stiff)
    for coating in ((), (film,)):
        cell = Cell(flat, 20.0, 4, 1.0, nu, obstacle, geometry="flat", coating=coating)
        response = solve_cell(cell, Path(pressure=(pressure,)), keep_fields=True, tolerance=1e-9)
        # against the mean plane, which the whole depth moves
        gap = response["gap"].values[0, 0].T - obstacle.heights
        moved.append(float(np.mean(gap[inside]) - np.mean(gap)))
    # other punches of the square lattice lift the plane: the constant of its Green's function
    alone = moved[0] + 3.9002649 / np.pi * (1.0 - nu**2) * pressure
    xi = share * radius * 2.0 * alone / ((1.0 - nu**2) * pressure)  # thickness over radius
    expected = 2.0 / np.pi * np.arctan(xi) + (
        (1.0 - 2.0 * nu) * xi * np.log((1.0 + xi**2) / xi**2) - xi / (1.0 + xi**2)
    ) / (2.0 * np.pi * (1.0 - nu))
    long = [2.0 * (1.0 - nu**2) / 1e-2, coated_half_space(1e-2, film.thickness, stiff, (1.0, nu))]
    mean = pressure * (long[0] - long[1])  # of the coating, which the mean plane takes away
    softer = alone / (alone - (moved[0] - moved[1] + mean)) - 1.0
    assert softer / more == pytest.approx(expected, rel=0.01)


def test_planes_of_a_mesh_follow_coatings_which_the_conforming_cell_answers_as_the_flat_cell():
    surface = wave((48, 2), 1e-5)
    film = (Coating(0.1, 4.0, 0.2), Coating(0.15, 0.5, 0.3))
    gaps = []
    for geometry in ("flat", "conforming"):
        cell = Cell(surface, 1.0, 24, 1.0, 0.3, geometry=geometry, coating=film)
        gaps.append(solve_cell(cell, Path(pressure=(2e-5,)))["mean_gap"].item())
    assert gaps[1] == pytest.approx(gaps[0], rel=0.01)
    assert np.min(np.abs(cell.planes - 0.9)) == np.min(np.abs(cell.planes - 0.75)) == 0.0
    assert elements_of(film, cell.planes) == [4, 5]
    coarse = Cell(surface, 1.0, 8, 1.0, 0.3, coating=film)
    assert "gets 2 layer(s) of elements" in coarse.cautions()[0]
    bare = Cell(surface, 1.0, 24, 1.0, 0.3)
    changed = solve_cell(bare, Path(pressure=(2e-5,)))["mean_gap"].item()
    assert abs(changed / gaps[0] - 1.0) > 0.1


def test_a_cell_that_slides_keeps_its_coating():
    cell = Cell(wave((16, 2), 1e-5), 1.0, 8, 1.0, 0.3, coating=(Coating(0.2, 4.0, 0.2),))
    still = solve_cell(cell, Path(pressure=(2e-5,)))
    moving = solve_cell(cell, Path(pressure=(2e-5,), slide=((0.0, 0.0),)))
    assert moving["mean_gap"].item() == pytest.approx(still["mean_gap"].item(), rel=1e-6)


def test_two_deformable_bodies_have_separate_coatings():
    surface, film = rough_square(16, 1.0, 0.5, 0.01), (Coating(0.2, 5.0, 0.3),)
    under = Surface(np.zeros((16, 16)), (1.0, 1.0))
    path = Path(pressure=(1e-3,))
    second = SecondBody(1.0, 12, Elastic(1.0, 0.3), film)
    flat = FlatCell(surface, 1.0, 12, Elastic(1.0, 0.3), second=second)
    pair = Cell(surface, 1.0, 12, 1.0, 0.3, under, opposite=second)
    gaps = [solve_cell(cell, path)["mean_gap"].item() for cell in (flat, pair)]
    assert gaps[1] == pytest.approx(gaps[0], rel=0.03)
