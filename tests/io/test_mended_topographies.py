"""Sound topography files that their reader refuses are read, and others with its reason."""

from io import BytesIO
from zipfile import ZipFile

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.io.surface_file import open_topography

pytest.importorskip("SurfaceTopography")
SIZE = (12e-6, 5e-6)


@pytest.fixture
def heights():
    """Heights of 6 x 5 points, m, one of which is undefined."""
    heights = 1e-9 * np.random.default_rng(seed=3).normal(size=(6, 5))
    heights[2, 3] = np.nan
    return heights


@pytest.fixture
def x3p(heights):
    """Members of an X3P file by their names."""
    from SurfaceTopography import Topography

    file = BytesIO()
    Topography(np.ma.masked_invalid(heights), SIZE, unit="m").to_x3p(file)
    with ZipFile(file) as members:
        return {name: members.read(name) for name in members.namelist()}


def zipped(path, members, folder=""):
    with ZipFile(path, "w") as file:
        for name, content in members.items():
            file.writestr(folder + name, content)
    return path


def same(path, heights, **given):
    topography = open_topography(path, **given)
    np.testing.assert_allclose(topography.heights, heights, rtol=1e-6, atol=1e-15)
    assert topography.size == pytest.approx(SIZE, rel=1e-6)


def listed(members, heights):
    """An X3P file with its data in the index, a missing entry as an empty tag."""
    data = "".join(
        "<Datum/>" if np.isnan(value) else f"<Datum>{value!r}</Datum>"
        for value in heights.T.ravel().tolist()
    )
    text = members["main.xml"].decode()
    begin, end = text.index("<DataLink>"), text.index("</DataLink>") + len("</DataLink>")
    return {"main.xml": f"{text[:begin]}<DataList>{data}</DataList>{text[end:]}"}


def test_an_x3p_is_read_in_a_folder_with_a_dash_and_with_its_data_in_the_index(
    tmp_path, x3p, heights
):
    same(zipped(tmp_path / "plain.x3p", x3p), heights)
    same(zipped(tmp_path / "folder.x3p", x3p, "scan/"), heights)
    dash = x3p["main.xml"].replace(b"ISO5436 - 2000", "ISO5436 \N{EN DASH} 2000".encode())
    assert dash != x3p["main.xml"]
    same(zipped(tmp_path / "dash.x3p", x3p | {"main.xml": dash}), heights)
    same(zipped(tmp_path / "listed.x3p", listed(x3p, heights)), heights)


@pytest.mark.parametrize("comment", ["", "GelSight", "Created by TrueMap v6\r\n", 40 * "long "])
def test_a_truemap_file_is_read_with_a_comment_of_any_length(tmp_path, heights, comment):
    heights = np.nan_to_num(heights)
    content = b"Binary TrueMap Data File v2.0\r\n\0" + comment.encode() + b"\0"
    content += np.array(heights.shape, "<u4").tobytes()
    content += np.array([*(1e3 * edge for edge in SIZE), 0.0, 0.0], "<f4").tobytes()
    (tmp_path / "map.tmd").write_bytes(content + (1e3 * heights.T).astype("<f4").tobytes())
    same(tmp_path / "map.tmd", heights)


def text_of(heights, missing, step=(1.0, 1.0)):
    """Lines of column, row and height in nm, without those that are undefined if missing is ''."""
    return "".join(
        f"{step[0] * i:g} {step[1] * j:g} {missing if np.isnan(z) else repr(1e9 * float(z))}\n"
        for (j, i), z in np.ndenumerate(heights.T)
        if missing or np.isfinite(z)
    )


def test_text_of_zygo_is_a_map_with_undefined_points(tmp_path, heights):
    head = 'Zygo XYZ Data File - Format 1\n0 0 0 0 ""\n0 0 6 5\n#\n'
    path = tmp_path / "map.xyz"
    path.write_text(head + text_of(heights, "No Data") + "#\n")
    same(path, heights, size=SIZE, unit=1e-9)
    with pytest.raises(CaseError, match="no lateral size and no unit of length; give size and"):
        open_topography(path)


def test_points_on_a_grid_may_be_missing_and_in_any_order(tmp_path, heights):
    lines = text_of(heights, "", step=(2000.0, 1000.0)).splitlines()
    np.random.default_rng(1).shuffle(lines)
    (tmp_path / "map.xyz").write_text("\n".join(lines))
    same(tmp_path / "map.xyz", heights, unit=1e-9)


def test_a_damaged_file_has_the_reason_of_its_reader(tmp_path, x3p):
    for sentence, old, new in (
        ("CX AxisType is not 'I'", b"<AxisType>I<", b"<AxisType>R<"),
        ("'Record3' not found", b"Record3", b"Record5"),
    ):
        damaged = x3p | {"main.xml": x3p["main.xml"].replace(old, new)}
        with pytest.raises(CaseError, match=f"reader of XML 3D surface profile .*{sentence}"):
            open_topography(zipped(tmp_path / "damaged.x3p", damaged))


@pytest.mark.parametrize(
    ("ending", "write"),
    [
        pytest.param("nc", lambda item, path: item.to_netcdf(path), id="NetCDF"),
        pytest.param("gwy", lambda item, path: item.to_gwy(path), id="Gwyddion"),
        pytest.param("txt", lambda item, path: item.to_matrix(path), id="text"),
        pytest.param("x3p", lambda item, path: item.to_x3p(path, dtype="L"), id="X3P of integers"),
        pytest.param("x3p", lambda item, path: item.to_x3p(path, dtype="F"), id="X3P of floats"),
    ],
)
def test_what_surface_topography_writes_is_read(tmp_path, heights, ending, write):
    from SurfaceTopography import Topography

    heights = np.nan_to_num(heights)
    path = str(tmp_path / f"map.{ending}")
    write(Topography(heights, SIZE, unit="m"), path)
    same(path, heights)


FIELD = {
    "csafe-logo.x3p": ((741, 419), {}),
    "ISO5436-sample1.x3p": ((4, 4), {}),
    "pyramid.x3p": ((5, 5), {}),
    "gelsight.tmd": ((30, 20), {}),
    "h_zygo.xyz": ((64, 48), {"size": (32e-6, 24e-6), "unit": 1e-6}),
    "f_missing.xyz": ((64, 48), {"unit": 1e-6}),
}


@pytest.mark.parametrize("name", FIELD)
def test_files_of_the_field_are_read(reference_data, name):
    points, given = FIELD[name]
    topography = open_topography(reference_data / "field" / name, **given)
    assert topography.heights.shape == points
    assert np.isfinite(topography.heights).mean() > 0.5
