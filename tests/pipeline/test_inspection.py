"""Content of a measured surface, and cases from measured files of every kind."""

import os
import subprocess
import sys
import tomllib
import warnings
from pathlib import Path

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.pipeline.case import load_case, validate_case
from multiscale.pipeline.case_cells import rough_sides, two_surfaces
from multiscale.pipeline.inspection import inspect_surface
from multiscale.pipeline.measured_sides import measured_map
from multiscale.surfaces import Anisotropy, find_spikes, self_affine
from tests.support import COMMAND

PIXEL = 1e-6
BODY = {"youngs_modulus": "210 GPa", "poissons_ratio": 0.3}


@pytest.fixture
def store(tmp_path):
    """Write heights, m, into an npy file."""

    def write(heights, name="map.npy"):
        np.save(tmp_path / name, heights)
        return tmp_path / name

    return write


@pytest.fixture(scope="module")
def rough():
    """An anisotropic map of 384 x 320 pixels, part of a larger periodic surface."""
    whole = self_affine(
        (512, 512),
        (512 * PIXEL, 512 * PIXEL),
        3,
        hurst_exponent=0.7,
        long_cutoff=80 * PIXEL,
        short_cutoff=5 * PIXEL,
        roll_off=40 * PIXEL,
        rms_height=1e-6,
        anisotropy=Anisotropy(3.0, np.deg2rad(30.0)),
    )
    return whole.heights[:384, :320]


def case_of(surfaces, *, size="60 um", points=48, count=2):
    """A case of bodies with these surface tables."""
    bodies = {
        f"body_{k}": BODY | ({"surface": surface} if surface else {})
        for k, surface in enumerate(surfaces, 1)
    }
    cell = {"size": [size, size], "points": [points, points], "geometry": "flat"}
    micro = {"realisations": count, "pressures": ["10 MPa", "20 MPa", "40 MPa"]}
    return validate_case({"title": "map", "cell": cell, "micro": micro} | bodies, Path("case.toml"))


def test_statistics_of_a_synthetic_map_are_those_it_was_made_of(store, rough):
    inspection = inspect_surface(store(rough), size=(384e-6, 320e-6), unit=1.0, detrend_order=1)
    assert float(inspection["rms_height"]) == pytest.approx(1e-6, rel=0.1)
    assert float(inspection["hurst_exponent"]) == pytest.approx(0.7, abs=0.15)
    assert float(inspection["lay_ratio"]) == pytest.approx(3.0, rel=0.1)
    assert np.rad2deg(float(inspection["lay_angle"])) == pytest.approx(30.0, abs=2.0)
    heights = np.sort(rough.ravel())[::-1]
    share = inspection["bearing_share"].values
    middle = inspection["bearing_height"].values[np.isclose(share, 0.5)]
    assert middle == pytest.approx(np.median(heights) - heights.mean(), abs=2e-8)
    assert float(inspection["shortest_reliable"]) == pytest.approx(4 * PIXEL)


def test_spectrum_of_a_map_adds_up_to_its_mean_square_height(store):
    whole, size = (512, 512), (512 * PIXEL, 512 * PIXEL)
    band = {"long_cutoff": 30 * PIXEL, "short_cutoff": 5 * PIXEL, "rms_height": 1e-6}  # many waves
    heights = self_affine(whole, size, 3, hurst_exponent=0.7, **band).heights[:384, :320]
    inspection = inspect_surface(store(heights), size=(384e-6, 320e-6), unit=1.0, detrend_order=1)
    q, density = inspection["wavenumber"].values, inspection["power_spectral_density"].values
    total = np.trapezoid(q * density, q) / (2.0 * np.pi)
    assert total / float(inspection["rms_height"]) ** 2 == pytest.approx(1.0, abs=0.08)


def test_waves_below_instrument_noise_are_not_reliable(store):
    size = (512 * PIXEL, 512 * PIXEL)
    band = {"long_cutoff": 256 * PIXEL, "short_cutoff": 5 * PIXEL, "rms_height": 1e-6}
    smooth = self_affine((512, 512), size, 1, hurst_exponent=0.8, **band).heights
    noise = 5e-7 * np.random.default_rng(2).standard_normal(smooth.shape)
    inspection = inspect_surface(store(smooth + noise), size=size, unit=1.0)
    # noise of variance s^2 has the density s^2 dx^2, which the surface meets at about 16 pixels
    assert 8 * PIXEL < float(inspection["shortest_reliable"]) < 30 * PIXEL
    clean = inspect_surface(store(smooth, "clean.npy"), size=size, unit=1.0)
    assert float(clean["shortest_reliable"]) == pytest.approx(4 * PIXEL)


@pytest.mark.slow
@pytest.mark.usefixtures("without_pages")
def test_the_proposed_case_runs(store, rough, command, tmp_path):
    file = store(rough)
    status, output, _ = command(
        "inspect",
        file,
        "--size",
        "384 um x 320 um",
        "--unit",
        "m",
        "--case",
        "proposed.toml",
        "-o",
        "page",
    )
    assert status == 0
    assert "The cells have" in output
    case = tomllib.loads((tmp_path / "proposed.toml").read_text())
    height = float(output.split("The cells have ")[1].split()[0])
    assert 0.8 < height < 1.2
    page = (tmp_path / "page" / "report.html").read_text()
    for name in ("measured heights", "spectral density", "bearing curve"):
        assert f'alt="{name}"' in page
    case["cell"] |= {"points": [16, 16]}
    case["body_1"]["surface"]["short_cutoff"] = "60 um"
    case["micro"] |= {"realisations": 1, "pressures": case["micro"]["pressures"][:3]}
    import tomli_w

    (tmp_path / "small.toml").write_text(tomli_w.dumps(case))
    status, output, _ = command("run", "small.toml", "-o", "out", "--jobs", "1")
    assert (status, "MPa" in output) == (0, True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("structure", "preload", "pressed"),
    [
        pytest.param("lap_joint", "20 kN", 104.8, id="bolt"),  # over 190.9 mm^2 of the washer
        pytest.param("blocks", "2 kN", 20.0, id="blocks-by-force"),  # over 100 mm^2
        pytest.param("blocks", "20 MPa", 20.0, id="blocks-by-pressure"),
    ],
)
def test_a_case_for_two_faces_is_pressed_by_its_preload(
    structure, preload, pressed, store, rough, command, tmp_path
):
    files = [store(rough, "a.npy"), store(rough[::-1], "b.npy")]
    known = ("--size", "384 um x 320 um", "--unit", "m", "--case", "joint.toml")
    text = ("inspect", *files, "--structure", structure, "--preload", preload, *known)
    assert command(*text)[0] == 0
    case = load_case(tmp_path / "joint.toml")
    assert case.statics.preloads[-1] == pytest.approx(1e6 * pressed, rel=1e-2)
    assert [body.surface.file for body in case.bodies] == files
    (interface,) = case.structure.pressed(case)
    low, high = interface.steps[0][0], interface.steps[-1][1]
    assert case.micro.pressures[0] < 0.5 * low < high < 0.6 * case.micro.pressures[-1]
    assert max(case.statics.preloads) < 0.6 * case.micro.pressures[-1]
    assert command("run", "joint.toml", "--explain")[0] == 0


@pytest.fixture(scope="module")
def spiked(rough):
    """The map with 40 spikes of 30 times its rms height, up to two points wide, and their mask."""
    spikes = np.zeros(rough.shape, bool)
    places = np.random.default_rng(5).permutation(rough.size // 64)[:40]
    x, y = np.unravel_index(places, (rough.shape[0] // 8, rough.shape[1] // 8))
    spikes[8 * x + 3, 8 * y + 3] = True
    spikes[8 * x[::2] + 4, 8 * y[::2] + 3] = True
    return np.where(spikes, rough + 30.0 * rough.std(), rough), spikes


def test_spikes_are_the_points_that_stand_out(rough, spiked):
    heights, spikes = spiked
    assert not find_spikes(rough).any()
    np.testing.assert_array_equal(find_spikes(heights), spikes)
    lost = np.where(np.roll(spikes, 2, axis=1), np.nan, heights)
    np.testing.assert_array_equal(find_spikes(lost), spikes & np.isfinite(lost))
    line = np.where(np.arange(300) == 100, 9.0, np.sin(0.1 * np.arange(300)))[:, None]
    assert np.argwhere(find_spikes(line)).tolist() == [[100, 0]]
    assert not find_spikes(np.full((9, 9), np.nan)).any()
    assert not find_spikes(np.ones((9, 9))).any()


def test_inspect_counts_spikes_and_removes_them(store, rough, spiked):
    known = {"size": (384e-6, 320e-6), "unit": 1.0}
    heights, spikes = spiked
    inspection = inspect_surface(store(heights), **known)
    number = int(spikes.sum())
    assert (
        f'remove {number} spikes by --remove-spikes, or spikes = "remove"'
        in (inspection.attrs["cautions"])
    )
    clean, text = (
        inspect_surface(store(item), **known, spikes=spikes)
        for item, spikes in ((rough, "keep"), (heights, "remove"))
    )
    assert f"{number} of {heights.size} points (0.049 %) were spikes" in text.attrs["cautions"]
    assert "few points cause" not in text.attrs["cautions"]
    assert float(inspection["kurtosis"]) > 10 * float(text["kurtosis"])
    for name in ("rms_height", "rms_slope"):
        assert float(text[name]) == pytest.approx(float(clean[name]), rel=1e-2)
    table = tomllib.loads(text.attrs["proposal"])["body_1"]["surface"]
    assert table["spikes"] == "remove"
    assert "fill_undefined" not in table


def test_cells_leave_out_spikes_and_report_how_many(store, rough, spiked):
    heights, spikes = spiked
    table = {"size": ["384 um", "320 um"], "unit": "1 m"}
    sides = [
        rough_sides(case_of([table | {"file": str(store(item, name))} | more, None]))[0]
        for item, name, more in (
            (rough, "clean.npy", {}),
            (heights, "spiked.npy", {"spikes": "remove"}),
        )
    ]
    clean, filled = (side.measured.stages[0].rms_height for side in sides)  # of the maps
    assert filled == pytest.approx(clean, rel=1e-3)
    assert sides[1].measured.cautions[0].startswith(f"{spikes.sum()} of {heights.size} points")
    assert not any("spikes" in caution for caution in sides[0].measured.cautions)


def test_too_many_spikes_are_no_spikes(store):
    noise = np.random.default_rng(1).standard_cauchy((64, 64))
    case = case_of([{"file": str(store(noise)), "size": ["1 mm"] * 2, "unit": "um"}, None])
    surface = case.body_1.surface.model_copy(update={"spikes": "remove"})
    with pytest.raises(CaseError, match="far from their neighbours, too many for spikes"):
        measured_map(surface)


@pytest.mark.slow
def test_a_closed_pipe_leaves_the_case_file(store, tmp_path, rough):
    """As of a command that is followed by head."""
    end, closed = os.pipe()
    os.close(end)
    command = ["inspect", store(rough), "--size", "384 um x 320 um", "--unit", "m"]
    command += ["-o", tmp_path / "out", "--case", tmp_path / "case.toml"]
    done = subprocess.run(
        [sys.executable, "-c", COMMAND, *map(str, command)],
        stdout=closed,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    os.close(closed)
    assert "Traceback" not in done.stderr
    assert load_case(tmp_path / "case.toml").has_cells


def test_the_share_that_proposed_cells_hold_is_the_share_of_their_surfaces(store, rough):
    inspection = inspect_surface(store(rough), size=(384e-6, 320e-6), unit=1.0)
    case = validate_case(tomllib.loads(inspection.attrs["proposal"]), Path("case.toml"))
    side = rough_sides(case)[0]
    share = np.sqrt(np.mean([surface.heights.var() for surface in side.surfaces])) / float(
        inspection["rms_height"]
    )
    assert f"have {share:.2f} of the rms height" in inspection.attrs["held"]


# Surface keys


def test_two_maps_are_turned_against_each_other(store, rough):
    table = {"file": str(store(rough)), "size": ["384 um", "320 um"], "unit": "m"}
    other = table | {"file": str(store(rough, "other.npy")), "rotate": "90 deg"}
    stored = {"short_cutoff": "8 um"}
    (lower, upper), *_ = two_surfaces(case_of([table | stored, other | stored]))
    slopes = [
        [np.abs(np.diff(item.heights, axis=k)).mean() for k in range(2)] for item in (lower, upper)
    ]
    assert slopes[0][0] < slopes[0][1]  # ridges at 30 degrees to x
    assert slopes[1][0] > slopes[1][1]


def test_an_isotropic_surface_of_a_profile_has_the_spectrum_of_the_surface_it_crosses(store):
    n = 1024
    whole = self_affine(
        (n, n),
        (n * PIXEL, n * PIXEL),
        5,
        hurst_exponent=0.8,
        long_cutoff=100 * PIXEL,
        short_cutoff=10 * PIXEL,
        roll_off=60 * PIXEL,
        rms_height=1e-6,
    )
    scan = whole.heights[:, 7]
    table = {"file": str(store(scan)), "size": [f"{n} um"], "unit": "m", "profile": "isotropic"}
    case = case_of([table | {"short_cutoff": "10 um"}, None], size="400 um", points=320)
    side = rough_sides(case)[0]
    assert side.surfaces[0].heights.std() == pytest.approx(1e-6, rel=0.3)
    of_scan, _, of_cells = side.measured.stages
    assert of_cells.rms_slope == pytest.approx(of_scan.rms_slope, rel=0.35)
    assert "isotropic self-affine surfaces replace a line scan" in side.measured.cautions[0]


@pytest.mark.parametrize(("rotate", "axis"), [("0 deg", 1), ("90 deg", 0)])
def test_one_directional_grooves_run_across_the_scan(store, rough, rotate, axis):
    table = {"file": str(store(rough[:, 3])), "size": ["384 um"], "unit": "m", "rotate": rotate}
    table |= {"profile": "one_directional", "short_cutoff": "8 um"}
    (surface, _) = rough_sides(case_of([table, None], count=2))[0].surfaces
    assert np.ptp(surface.heights, axis=axis).max() < 1e-9 * np.ptp(surface.heights)
    assert np.ptp(surface.heights) > 0.0


def test_a_synthetic_surface_with_a_lay_comes_from_its_table():
    table = {
        "rms_height": "1 um",
        "hurst_exponent": 0.8,
        "long_cutoff": "20 um",
        "short_cutoff": "5 um",
    }
    lay = {"anisotropy": {"ratio": 2, "direction": "90 deg"}}
    (surface, _) = rough_sides(case_of([table | lay, None]))[0].surfaces
    slopes = [np.abs(np.diff(surface.heights, axis=k)).std() for k in range(2)]
    assert slopes[0] / slopes[1] == pytest.approx(2.0, rel=0.15)


# Bad input: key, table or options, and the sentence


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        pytest.param({"unit": None}, "gives no unit of length; give unit", id="no-unit"),
        pytest.param({"size": None}, "gives no lateral size; give size", id="no-size"),
        pytest.param({"size": ["1 um"]}, "size of a map is two lengths", id="one-length"),
        pytest.param({"channel": "Phase"}, "no channel 'Phase' .* 0 \\('Default'\\)", id="channel"),
        pytest.param({"unit": "furlongz"}, "unit.*unknown unit", id="unknown-unit"),
        pytest.param({"profile": "isotropic"}, "holds a map, not a line scan", id="map-as-profile"),
        pytest.param({"rotate": "1 m"}, "cannot be converted to rad", id="no-angle"),
    ],
)
def test_surface_tables_are_refused_in_a_sentence(store, rough, changed, sentence):
    table = {"file": str(store(rough)), "size": ["384 um", "320 um"], "unit": "m"} | changed
    table = {key: value for key, value in table.items() if value is not None}
    with pytest.raises(CaseError, match=sentence) as caught:
        rough_sides(case_of([table, None]))
    assert "=True" not in str(caught.value)
    assert "Surface(" not in str(caught.value)


def test_a_profile_where_cells_need_an_area_is_refused_with_the_key(store, rough):
    table = {"file": str(store(rough[:, 3])), "size": ["384 um"], "unit": "um"}
    with pytest.raises(CaseError, match=r'line scan of 384 points.*set profile = "isotropic"'):
        rough_sides(case_of([table, None]))


@pytest.mark.parametrize(
    ("heights", "sentence"),
    [
        pytest.param(np.zeros((3, 4, 5)), "an array of shape \\(3, 4, 5\\)", id="three-dimensions"),
        pytest.param(np.ones((20, 20)), "all heights are equal", id="constant"),
        pytest.param(np.full((20, 20), np.nan), "no point has a defined height", id="nan"),
        pytest.param(np.ones((9, 9)) + 1j, "complex128", id="complex"),
    ],
)
def test_arrays_that_are_no_rough_map_are_refused(store, command, heights, sentence):
    file = store(heights)
    status, _, output = command("inspect", file, "--size", "1 um x 1 um", "--unit", "um")
    assert status == 1
    assert len(output.strip().splitlines()) == 1
    with pytest.raises(CaseError, match=sentence):
        inspect_surface(file, size=(1e-6, 1e-6), unit=1e-6)


# Every file of the reference data: the content next to SurfaceTopography's, or the refusal

FILES = {
    "al3d-1.al3d": {},
    "csv-1.csv": {"unit": 1e-6},
    "dektak-1.csv": {},
    "di-3.di": {},
    "example-2d.npy": {"unit": 1e-6, "size": (2e-6, 2e-6)},
    "frt-1.frt": {},
    "gwyddion-export-english.txt": {},
    "hfm-1.hfm": {},
    "matrix-3.txt": {},
    "mi-1.mi": {},
    "mnt-1.mnt": {},
    "nc-1.nc": {},
    "nms-1.nms": {},
    "opdx-3.opdx": {},
    "sdf-1.sdf": {},
    "stp-1.stp": {},
    "sur-3.sur": {},
    "tmd-1.tmd": {},
    "top-1.top": {},
    "xyz-1.txt": {"unit": 1e-6},
}
REFUSED = {
    "nc-1.nc": "all heights are equal without the plane",
}


def library_rms_height(file, given):
    """Root mean square height without plane by SurfaceTopography, m."""
    from SurfaceTopography import UniformLineScan, open_topography

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with open_topography(str(file)) as reader:
            entry = reader.default_channel
            missing = {}
            if entry.unit is None:
                missing["unit"] = "µm"
            if entry.physical_sizes is None:
                missing["physical_sizes"] = tuple(1e6 * edge for edge in given["size"])
            topography = entry.topography(**missing).to_unit("m")
            if topography.dim == 1 and not topography.is_uniform:  # as even points
                x, heights = topography.positions_and_heights()
                heights = np.interp(np.linspace(x[0], x[-1], x.size), x, heights)
                topography = UniformLineScan(heights, x[-1] - x[0])
            level = topography.detrend("height")
            if level.dim == 2:
                return level.rms_height_from_area()
            return level.rms_height_from_profile()


SLOW = {"sur-3.sur": pytest.mark.slow}  # nine tenths of its points are filled


@pytest.mark.parametrize(
    "name", [pytest.param(entry, marks=SLOW.get(entry, ())) for entry in FILES]
)
def test_every_file_has_the_rms_height_of_the_library_or_a_sentence(reference_data, name):
    file = reference_data / "topography" / name
    if name in REFUSED:
        with pytest.raises(CaseError, match=REFUSED[name]):
            inspect_surface(file, **FILES[name], detrend_order=1)
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        inspection = inspect_surface(file, **FILES[name], detrend_order=1)
    expected = library_rms_height(file, FILES[name])
    assert float(inspection["rms_height"]) == pytest.approx(expected, rel=1e-6, abs=0.0)
    if inspection.attrs["proposal"]:
        case = validate_case(tomllib.loads(inspection.attrs["proposal"]), Path("case.toml"))
        surface = rough_sides(case)[0].surfaces[0]
        assert surface.heights.shape == case.cell.points
        assert surface.heights.std() > 0.0
    else:
        assert "no case is proposed" in inspection.attrs["cautions"]


def test_cells_of_a_line_scan_have_the_spectrum_that_is_shown(reference_data):
    # the reliable waves begin where the uneven points of the file are far apart
    inspection = inspect_surface(reference_data / "topography" / "dektak-1.csv")
    shown = f"fitted with a Hurst exponent of {float(inspection['hurst_exponent']):.2g} and"
    assert shown in inspection.attrs["cautions"]


def test_a_map_of_few_points_has_no_reliable_wave_and_no_case(store, command):
    heights = 1e-6 * np.random.default_rng(4).standard_normal((7, 4))
    status, output, cautions = command(
        "inspect", store(heights), "--size", "7 um x 4 um", "--unit", "m"
    )
    assert status == 0
    rows = {line[: line.find("  ")]: line.split("  ")[-1] for line in output.splitlines()}
    assert rows["reliable wavelengths"] == "none"
    assert "not known decades" not in output
    assert "no case is proposed: the map has too few points for any reliable wave" in cautions
    assert "short_cutoff" not in cautions  # which nobody has given


def test_spikes_that_make_the_rms_height_are_a_caution(store, rough):
    spiked = rough.copy()
    spiked[::90, ::90] += 4e-5
    clean, dusty = (
        inspect_surface(store(heights), size=(384e-6, 320e-6), unit=1.0)
        for heights in (rough, spiked)
    )
    assert "kurtosis" not in clean.attrs["cautions"]
    assert "remove 20 spikes by --remove-spikes" in dusty.attrs["cautions"]
