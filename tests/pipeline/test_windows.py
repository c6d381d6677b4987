"""From a measured map to cells: contained waves, filled points, and reports."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.pipeline import measured_sides
from multiscale.pipeline.measured_sides import cut_windows
from multiscale.pipeline.tables.case_tables import CellSettings
from multiscale.pipeline.tables.rough_bodies import InstrumentSurface
from multiscale.surfaces import Surface, rms_height, rms_slope
from tests.support import rough_square

PIXEL = 1e-6


@pytest.fixture
def cut():
    """Cut windows from a map made by hand: surfaces and their share of it."""

    def of(
        heights,
        size,
        points,
        *,
        filled=None,
        count=4,
        needed=None,
        seed=0,
        other_map=False,
        **settings,
    ):
        edges = tuple(n * PIXEL for n in heights.shape)
        whole = Surface(heights - heights.mean(), edges, filled)
        given = InstrumentSurface.model_validate({"file": "map.txt", **settings})
        cell = CellSettings.model_validate({"size": [size, size], "points": [points, points]})
        which = range(count)
        return cut_windows(whole, given, cell, which, needed or count, seed, other_map=other_map)

    return of


def noise(shape, seed=1):
    return 1e-9 * np.random.default_rng(seed).standard_normal(shape)


def rough(n, shortest, seed=1):
    """A periodic map of n x n pixels with a shortest wave of a number of pixels."""
    return rough_square(
        n, 0.1 * n * PIXEL, shortest * PIXEL, 0.05, seed=seed, size=n * PIXEL
    ).heights


def test_roughness_is_measured_at_the_map_the_windows_and_the_cells(cut):
    heights = rough(256, 8)
    surfaces, windows = cut(heights, "128 um", 128)
    of_map, of_windows, of_cells = windows.stages
    assert of_map.rms_height == pytest.approx(heights.std(), rel=1e-9)
    for name, statistic in (("rms_height", rms_height), ("rms_slope", rms_slope)):
        cells = np.sqrt(np.mean([statistic(surface) ** 2 for surface in surfaces]))
        assert getattr(of_cells, name) == pytest.approx(cells, rel=1e-9)
    # a grid that carries every pixel of a mirrored window omits only the waves below the cut-off
    assert of_windows.rms_height == pytest.approx(of_cells.rms_height, rel=1e-2)
    assert of_cells.shortest_wave == pytest.approx(8 * PIXEL, rel=0.1)


def test_windows_keep_every_pixel_as_it_was_measured(cut):
    # white noise lives on the shortest waves: interpolation between pixels would damp it
    _, windows = cut(noise((301, 303)), "100.7 um", 128, short_cutoff="1.6 um", count=9)
    assert windows.stages[1].rms_height == pytest.approx(windows.stages[0].rms_height, rel=0.03)
    assert windows.stages[1].rms_slope == pytest.approx(windows.stages[0].rms_slope, rel=0.03)


def test_missing_roughness_is_a_caution_with_advice_that_holds(cut):
    heights = rough(256, 4)
    _, windows = cut(heights, "128 um", 32)
    assert windows.cutoff == "32 µm, 8 points of the grid, as the case has no short_cutoff"
    (text,) = [caution for caution in windows.cautions if "rms slope" in caution]
    share = windows.stages[2].rms_slope / windows.stages[0].rms_slope
    assert share < 0.5
    assert f"the cells have {share:.2g} of the rms slope of the map" in text
    assert "the cut-off (8 points of the grid, as the case has no short_cutoff) leaves" in text
    cutoff = text.split('short_cutoff = "')[1].split('"')[0]
    points = int(text.split("grid of ")[1].split(" x ")[0])
    _, better = cut(heights, "128 um", points, short_cutoff=cutoff)
    assert better.stages[2].rms_slope >= 0.9 * better.stages[1].rms_slope
    assert not [caution for caution in better.cautions if "leaves" in caution]
    _, worse = cut(heights, "128 um", points, short_cutoff=f"{1.1 * float(cutoff[:-3])} µm")
    assert worse.stages[2].rms_slope < 0.9 * worse.stages[1].rms_slope


def test_a_loss_counts_against_the_map_of_the_other_body(cut):
    heights = rough(256, 4)
    fixed = [cut(scale * heights, "128 um", 64, short_cutoff="32 um")[1] for scale in (1.0, 0.01)]
    large, small = fixed
    (text,) = [caution for caution in large.cautions if "rms slope" in caution]
    assert "on a grid of" in text
    assert large.cautions_beside(small) == large.cautions_beside(large) == list(large.cautions)
    assert not small.cautions_beside(large)
    # where the grid carries the shorter waves, the advice is the cut-off only
    _, fine = cut(heights, "128 um", 256, short_cutoff="32 um")
    (text,) = [caution for caution in fine.cautions if "rms height" in caution]
    assert "short_cutoff = " in text
    assert "grid" not in text


def test_windows_that_are_too_small_for_the_long_waves_report_which_cells_are_not(cut):
    x = np.arange(512)
    heights = 1e-6 * np.cos(2.0 * np.pi * x / 128.0)[:, None] + noise((512, 512))
    _, windows = cut(heights, "64 um", 32)
    (text,) = [caution for caution in windows.cautions if "rms height" in caution]
    needed = float(text.split("and cells of ")[1].split(" µm")[0])
    assert needed == pytest.approx(256.0, rel=0.02)  # windows of one wave, mirrored
    _, windows = cut(heights, f"{needed} um", 128)
    assert not [caution for caution in windows.cautions if "rms height" in caution]


def test_fading_is_reported_with_its_share(cut):
    _, windows = cut(rough(256, 8), "100 um", 100, periodic="window")
    (text,) = [caution for caution in windows.cautions if "rms height" in caution]
    # Tukey's window of a tenth at either end: (1 - 5/4 * .1)^2 of the mean square
    share = float(text.split("fading along the edges leaves ")[1].split(",")[0])
    assert share == pytest.approx(1.0 - 1.25 * 0.1, abs=0.04)
    assert 'where periodic = "mirror" leaves all' in text


def hole(shape, *corners, edge):
    filled = np.zeros(shape, dtype=bool)
    for i, j in corners:
        filled[i : i + edge, j : j + edge] = True
    return filled


def test_windows_avoid_holes_wherever_they_lie(cut):
    # the tiling from the corner would meet a hole in all of its nine windows
    shape, edge = (380, 380), 60
    corners = [(90 + 100 * i, 90 + 100 * j) for i in range(3) for j in range(3)]
    filled = hole(shape, (0, 170), edge=edge) | hole(shape, *corners, edge=6)
    _, windows = cut(noise(shape), "160 um", 64, filled=filled, count=6, short_cutoff="20 um")
    assert windows.map_filled == pytest.approx(filled.mean())
    assert windows.filled == (0.0,) * 6


def test_separate_windows_share_no_pixel_and_follow_in_order_of_their_filled_share(cut):
    shape = (300, 300)
    mark = np.arange(90000.0).reshape(shape)  # every height is of one pixel
    filled = hole(shape, (0, 0), (100, 100), (220, 30), edge=28)
    whole = Surface(mark, (3e-4, 3e-4), filled)
    corners = measured_sides._corners(whole, (60, 60), 0.1, seed=3)
    seen = np.concatenate([mark[i : i + 60, j : j + 60].ravel() for i, j in corners])
    assert seen.size == np.unique(seen).size
    share = [filled[i : i + 60, j : j + 60].mean() for i, j in corners]
    assert share == sorted(share)
    assert max(share) <= 0.1
    assert corners == measured_sides._corners(whole, (60, 60), 0.1, seed=3)


def test_mostly_filled_windows_are_refused_with_the_size_that_is_not(cut):
    shape = (240, 240)
    filled = np.zeros(shape, dtype=bool)
    filled[::4, ::3] = filled[1::4, ::3] = True  # a sixth of the points, everywhere
    filled[:100, :100] = False
    given = {"filled": filled, "short_cutoff": "12 um"}
    with pytest.raises(CaseError, match=r"at most 10 % of their points filled, but 4 are") as error:
        cut(noise(shape), "200 um", 64, **given)
    text = str(error.value)
    assert "or allow more by filled in the surface table" in text
    size = text.split("make the cell ")[1].split(" x ")[0]
    surfaces, windows = cut(noise(shape), size, 64, **given)
    assert len(surfaces) == 4
    assert max(windows.filled) <= 0.1


def test_a_case_may_allow_more_filled_points(cut):
    shape = (200, 200)
    filled = np.zeros(shape, dtype=bool)
    filled[::5] = True
    with pytest.raises(CaseError, match="has 0 separate windows"):
        cut(noise(shape), "200 um", 64, filled=filled, short_cutoff="12 um")
    whole = Surface(noise(shape), (2e-4, 2e-4), filled)
    given = {"file": "map.txt", "filled": "30 %", "short_cutoff": "12 um"}
    cell = CellSettings.model_validate({"size": ["200 um"] * 2, "points": [64, 64]})
    _, windows = cut_windows(whole, InstrumentSurface.model_validate(given), cell, range(4), 4, 0)
    assert windows.filled == pytest.approx((0.2,) * 4)


@pytest.mark.parametrize(
    ("degrees", "periodic", "cautioned"),
    [(30, "mirror", True), (0, "mirror", False), (90, "mirror", False), (30, "window", False)],
)
def test_an_oblique_lay_that_is_mirrored_is_a_caution(cut, degrees, periodic, cautioned):
    random = np.random.default_rng(seed=2)
    angle = np.deg2rad(degrees)
    x, y = np.meshgrid(np.arange(256.0), np.arange(256.0), indexing="ij")
    across = -np.sin(angle) * x + np.cos(angle) * y
    heights = sum(
        1e-6 * np.cos(2.0 * np.pi * k * across / 256.0 + random.uniform(0.0, 6.0))
        for k in np.arange(8.0, 20.0, 0.37)
    )
    _, windows = cut(heights, "100 um", 100, periodic=periodic)
    lines = [caution for caution in windows.cautions if "herringbone" in caution]
    assert bool(lines) == cautioned
    if cautioned:
        assert "the lay is at 30 degrees to the x axis" in lines[0]
        assert "herringbone of 30 and 150 degrees" in lines[0]


def fine(pixels=200, seed=1):
    """A periodic map with a longest wave of 16 pixels."""
    return rough_square(pixels, 16 * PIXEL, 8 * PIXEL, 0.05, seed=seed, size=pixels * PIXEL).heights


def test_windows_of_a_small_map_repeat_in_a_cell_that_holds_the_waves_of_the_other(cut):
    given = {"points": 400, "count": 4, "short_cutoff": "6.4 um"}
    with pytest.raises(CaseError, match="or measure 800 µm x 800 µm"):
        cut(fine(), "800 um", **given)
    surfaces, windows = cut(fine(), "800 um", **given, other_map=True)
    assert "windows of 100 µm x 100 µm" in windows.cautions[0]
    assert "repeat 4 x 4 times in a cell" in windows.cautions[0]
    parts, alone = cut(fine(), "200 um", 100, count=4, short_cutoff="6.4 um")
    for surface, part in zip(surfaces, parts, strict=True):
        assert surface.size == pytest.approx((800e-6, 800e-6))
        np.testing.assert_array_equal(surface.heights, np.tile(part.heights, (4, 4)))
    for stage, other in zip(windows.stages, alone.stages, strict=True):
        assert stage.rms_slope == pytest.approx(other.rms_slope, rel=1e-9)
    assert windows.stages[2].rms_height > 0.9 * windows.stages[0].rms_height


def test_windows_that_lack_the_long_waves_of_their_map_do_not_repeat(cut):
    x = np.arange(200)
    long = 1e-6 * np.cos(2.0 * np.pi * x / 200.0)[:, None] + fine()
    with pytest.raises(CaseError, match="or measure 800 µm x 800 µm"):
        cut(long, "800 um", 400, count=4, short_cutoff="6.4 um", other_map=True)
