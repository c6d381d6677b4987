"""A topography file becomes a surface in metres, or one sentence."""

import sys
from pathlib import Path

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.io import read_surface, surface_file
from multiscale.io.surface_file import LARGEST_FILE, open_topography
from multiscale.surfaces import Surface, crop, detrend
from multiscale.surfaces.surface import remove_trend
from tests.support import run_python

HEADER = "# Width: 12 um\n# Height: 5 um\n# Value units: nm\n"


@pytest.fixture
def heights():
    """Heights of 6 x 5 points, nm."""
    return np.random.default_rng(seed=3).normal(size=(6, 5))


def write_text(path, heights, header=HEADER):
    """Write the text format of SurfaceTopography: one line per y."""
    rows = "\n".join(" ".join(f"{h:.17g}" for h in row) for row in heights.T)
    path.write_text(header + rows + "\n", encoding="utf-8")
    return path


# Surface


def test_surface_stores_a_copy_of_the_heights():
    heights = np.zeros((3, 3))
    surface = Surface(heights, (1.0, 1.0))
    heights[:] = 1.0
    assert not surface.heights.any()


# Trend


@pytest.mark.parametrize("order", [0, 1, 2])
def test_detrending_removes_the_polynomial_of_its_order_and_no_higher_order(order):
    x, y = np.meshgrid(np.linspace(0.0, 3.0, 17), np.linspace(0.0, 1.0, 12), indexing="ij")
    trends = [1.0 + 0.0 * x, 1.0 + 2.0 * x - 3.0 * y, 1.0 - y + x * y - 4.0 * x**2 + y**2]
    for degree, trend in enumerate(trends):
        left = np.abs(remove_trend(trend, order)).max()
        assert left < 1e-13 if degree <= order else left > 1e-2


def test_detrending_ignores_undefined_points():
    x, y = np.meshgrid(np.arange(9.0), np.arange(7.0), indexing="ij")
    heights = 2.0 * x - y
    heights[3:5, 2] = np.nan
    detrended = remove_trend(heights, 1)
    assert np.count_nonzero(np.isnan(detrended)) == 2
    assert np.nanmax(np.abs(detrended)) < 1e-13


# Reading


def test_text_file_is_read_in_metres_with_x_along_the_rows(tmp_path, heights):
    surface = read_surface(write_text(tmp_path / "map.txt", heights), detrend_order=0)
    assert surface.size == pytest.approx((12e-6, 5e-6), rel=1e-12)
    np.testing.assert_allclose(surface.heights, 1e-9 * (heights - heights.mean()), atol=1e-22)


def test_plane_is_removed_by_default(tmp_path, heights):
    x, y = np.meshgrid(np.arange(6.0), np.arange(5.0), indexing="ij")
    tilted = read_surface(write_text(tmp_path / "tilted.txt", heights + 3.0 * x - 2.0 * y))
    level = read_surface(write_text(tmp_path / "level.txt", heights))
    np.testing.assert_allclose(tilted.heights, level.heights, atol=1e-22)


def test_undefined_points_are_refused_with_their_number_and_share(tmp_path, heights):
    heights[2, 1:4] = np.nan
    sentence = r"3 of 30 points \(10.00%\) are undefined; set fill_undefined"
    with pytest.raises(CaseError, match=sentence):
        read_surface(write_text(tmp_path / "map.txt", heights))


def test_undefined_points_are_filled_harmonically(tmp_path):
    x, y = np.meshgrid(np.arange(8.0), np.arange(7.0), indexing="ij")
    harmonic = x**2 - y**2  # satisfies the discrete Laplace equation too
    holed = harmonic.copy()
    holed[2:5, 2:4] = np.nan
    path = write_text(tmp_path / "map.txt", holed)
    surface = read_surface(path, detrend_order=0, fill_undefined=True)
    expected = 1e-9 * (harmonic - np.nanmean(holed))
    np.testing.assert_allclose(surface.heights, expected, atol=1e-20)
    np.testing.assert_array_equal(surface.filled, np.isnan(holed))
    assert surface.filled_share == pytest.approx(6 / 56)


def test_detrended_and_cropped_maps_mark_their_filled_points(heights):
    filled = heights > 1.0
    piece = crop(detrend(Surface(heights, (6.0, 5.0), filled)), (1, 2), (4, 3))
    np.testing.assert_array_equal(piece.filled, filled[1:5, 2:5])
    with pytest.raises(CaseError, match=r"each of 6 x 5 heights, got an array of shape \(5, 6\)"):
        Surface(heights, (6.0, 5.0), filled.T)


def test_channel_is_selected_by_name_and_by_number(tmp_path, heights):
    first = write_text(tmp_path / "first.txt", heights, "# Channel: Up\n" + HEADER)
    second = write_text(tmp_path / "second.txt", 2.0 * heights, "# Channel: Down\n" + HEADER)
    both = tmp_path / "both.txt"
    both.write_text(first.read_text() + second.read_text())
    down = read_surface(both, channel="Down").heights
    np.testing.assert_allclose(down, 2.0 * read_surface(both).heights, rtol=1e-12)
    np.testing.assert_array_equal(down, read_surface(both, channel=1).heights)
    with pytest.raises(CaseError, match=r"no channel 'Left' .* 0 \('Up'\), 1 \('Down'\)"):
        read_surface(both, channel="Left")


def test_missing_file_is_refused_with_the_nearest_name(tmp_path, heights):
    write_text(tmp_path / "ground.txt", heights)
    with pytest.raises(CaseError, match=r"no such file; did you mean 'ground.txt'\?"):
        read_surface(tmp_path / "grund.txt")


def test_a_map_that_does_not_fit_into_memory_is_refused_before_it_is_read(tmp_path, monkeypatch):
    large, many = tmp_path / "large.npy", tmp_path / "many.npy"
    with large.open("wb") as file:
        file.truncate(LARGEST_FILE + 1)  # with no bytes on disk
    with pytest.raises(CaseError, match=r"4.29 GB are more than 4.29 GB; export fewer points"):
        read_surface(large, size=(1e-3, 1e-3), unit=1e-6)
    np.save(many, np.ones((4, 5)))
    monkeypatch.setattr(surface_file, "MOST_POINTS", 19)
    with pytest.raises(CaseError, match="4 x 5 points are more than 19 in all"):
        read_surface(many, size=(1e-3, 1e-3), unit=1e-6)


def test_unreadable_file_is_refused(tmp_path, heights, monkeypatch):
    path = write_text(tmp_path / "map.txt", heights)

    def refuse(*_args, **_options):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(CaseError, match=r"map\.txt: cannot be opened \(Permission denied\)"):
        read_surface(path)


def test_missing_library_is_named_with_its_installation(tmp_path, heights, monkeypatch):
    monkeypatch.setitem(sys.modules, "SurfaceTopography", None)
    with pytest.raises(CaseError, match=r'pip install "multiscale-contact\[surfaces\]"'):
        read_surface(write_text(tmp_path / "map.txt", heights))


def test_importing_the_reader_loads_no_heavy_library():
    code = (
        "import sys, multiscale.io.surface_file; "
        "print([m for m in ('SurfaceTopography', 'pint', 'numba') if m in sys.modules])"
    )
    run = run_python(code)
    assert run.stdout.strip() == "[]"


# Measured files. Grid, size, rms height and gradient were read once with SurfaceTopography 1.27,
# curvature removed; the gradient is one of differences, given to two or three digits.


@pytest.mark.parametrize(
    ("name", "points", "size", "rms_height", "rms_slope"),
    [
        pytest.param("tmd-1.tmd", (300, 300), (18.96e-3, 18.96e-3), 47.7e-6, 0.158, id="tmd"),
        pytest.param("al3d-1.al3d", (200, 296), (88e-6, 130e-6), 0.259e-6, 0.090, id="al3d"),
    ],
)
def test_measured_files_have_the_known_statistics(
    reference_data, name, points, size, rms_height, rms_slope
):
    surface = read_surface(reference_data / "topography" / name, detrend_order=2)
    slopes = (np.diff(surface.heights, axis=k) / surface.spacing[k] for k in range(2))
    assert surface.heights.shape == points
    assert surface.size == pytest.approx(size, rel=5e-3)
    assert surface.heights.mean() == pytest.approx(0.0, abs=1e-9 * rms_height)
    assert surface.heights.std() == pytest.approx(rms_height, rel=2e-3)
    assert np.sqrt(sum(np.mean(slope**2) for slope in slopes)) == pytest.approx(rms_slope, rel=1e-2)


@pytest.mark.parametrize(
    ("name", "needed"),
    [
        pytest.param("tmd-1.tmd", 80 + 300 * 300 * 4, id="tmd"),
        # a photograph of the sample follows the heights
        pytest.param("al3d-1.al3d", 1261 + 200 * 296 * 4, id="al3d", marks=pytest.mark.slow),
    ],
)
def test_truncated_file_is_refused_whatever_its_length(reference_data, tmp_path, name, needed):
    whole = (reference_data / "topography" / name).read_bytes()
    copy = tmp_path / name
    lengths = {*range(1, 30, 2), *np.geomspace(30, needed - 1, 35).astype(int)}
    for length in sorted(lengths):
        copy.write_bytes(whole[:length])
        with pytest.raises(CaseError, match=name):
            read_surface(copy)
    copy.write_bytes(whole[:needed])
    complete = read_surface(reference_data / "topography" / name)
    np.testing.assert_array_equal(read_surface(copy).heights, complete.heights)


@pytest.mark.parametrize("name", ["tmd-1.tmd", "al3d-1.al3d"])
def test_corrupted_header_gives_a_surface_or_a_sentence(reference_data, tmp_path, name):
    whole = (reference_data / "topography" / name).read_bytes()
    copy = tmp_path / name
    random = np.random.default_rng(seed=11)
    for _ in range(40):
        damaged = bytearray(whole)
        for position in random.integers(0, 600, size=4):
            damaged[position] = random.integers(0, 256)
        copy.write_bytes(damaged)
        try:
            outcome = np.isfinite(read_surface(copy).heights).all()
        except CaseError as error:
            outcome = str(error).startswith(f"{copy}: ")
        assert outcome


# Text of every kind


def written(numbers, separator, comma, mark):
    rows = "\n".join(separator.join(f"{h:.6g}" for h in row) for row in numbers) + "\n"
    return (b"\xef\xbb\xbf" if mark else b"") + rows.replace(".", comma).encode()


@pytest.mark.parametrize("mark", [False, True], ids=["plain", "byte-order-mark"])
@pytest.mark.parametrize(
    ("separator", "comma"),
    [(" ", "."), ("\t", "."), (",", "."), (";", "."), (";", ","), ("\t", ","), (" ", ",")],
)
def test_a_matrix_is_read_whatever_separates_its_numbers(tmp_path, heights, separator, comma, mark):
    path = tmp_path / "matrix.txt"
    path.write_bytes(written(heights.T, separator, comma, mark))
    surface = read_surface(path, size=(12e-6, 5e-6), unit=1e-9, detrend_order=0)
    assert surface.size == (12e-6, 5e-6)
    np.testing.assert_allclose(surface.heights, 1e-9 * (heights - heights.mean()), atol=1e-14)


@pytest.mark.parametrize(("separator", "comma"), [(" ", "."), (",", "."), (";", ","), ("\t", ",")])
def test_points_x_y_z_and_line_scans_are_read_with_their_unit(tmp_path, heights, separator, comma):
    points = [(0.5 * i, 0.25 * j, heights[i, j]) for i in range(6) for j in range(5)]
    path = tmp_path / "points.txt"
    path.write_bytes(written(points, separator, comma, False))
    topography = open_topography(path, unit=1e-6)
    assert topography.size == pytest.approx((3e-6, 1.25e-6))
    np.testing.assert_allclose(topography.heights, 1e-6 * heights, atol=1e-11)
    path.write_bytes(
        written([(0.5 * k, h) for k, h in enumerate(heights.ravel())], separator, comma, True)
    )
    scan = open_topography(path, unit=1e-6)
    assert scan.is_profile
    assert scan.size[0] == pytest.approx(15e-6)
    np.testing.assert_allclose(scan.heights[:, 0], 1e-6 * heights.ravel(), atol=1e-11)
    with pytest.raises(CaseError, match="contains a line scan of 30 points"):
        read_surface(path, unit=1e-6)


def test_a_unit_that_the_file_gives_must_not_be_given_twice(tmp_path, heights):
    with pytest.raises(CaseError, match="the file gives its unit, nm; leave out unit"):
        read_surface(write_text(tmp_path / "map.txt", heights), unit=1e-6)
    larger = read_surface(write_text(tmp_path / "map.txt", heights), size=(24e-6, 10e-6))
    assert larger.size == (24e-6, 10e-6)


def test_channels_that_are_no_heights_are_listed_and_refused(reference_data):
    file = reference_data / "topography" / "di-3.di"
    assert [
        channel.split(":")[1].split(",")[0].strip() for channel in open_topography(file).channels
    ] == [
        "height",
        "other",
        "other",
        "height",
    ]
    with pytest.raises(CaseError, match=r"no channel 'Phase'.*: 0 \('ZSensor'\), 3 \('Height'\)"):
        read_surface(file, channel="Phase")


def test_an_sdf_file_with_the_older_first_line_is_read(tmp_path):
    n = 6
    rows = np.arange(n * n, dtype=float).reshape(n, n) % 7.0
    head = (
        "ManufacID = x\nCreateDate = 010120200000\nModDate = 010120200000\nNumPoints = 6\n"
        "NumProfiles = 6\nXscale = 2.0e-6\nYscale = 1.0e-6\nZscale = 1.0e-9\n"
        "Zresolution = 1.0E-9\nCompression = 0\nDataType = 7\nCheckType = 0\n*\n"
    )
    data = "\n".join(" ".join(f"{value:.3f}" for value in row) for row in rows) + "\n*\n*\n"
    for name, first in (("new.sdf", "aISO-1.0\n"), ("old.sdf", "aBCR-1.0\n")):
        (tmp_path / name).write_text(first + head + data)
    new, old = (read_surface(tmp_path / name, detrend_order=0) for name in ("new.sdf", "old.sdf"))
    assert old.size == pytest.approx((12e-6, 6e-6))
    np.testing.assert_array_equal(old.heights, new.heights)
    np.testing.assert_allclose(old.heights, 1e-9 * (rows.T - rows.mean()), atol=1e-21)
