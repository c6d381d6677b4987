"""Sound topography files that their reader refuses, rewritten in memory for the reader."""

import re
from collections.abc import Callable
from io import BytesIO
from xml.etree import ElementTree
from zipfile import ZipFile

import numpy as np

TRUEMAP, ZYGO, ZIP = b"Binary TrueMap Data File v2.0\r\n\0", b"Zygo XYZ Data File", b"PK\x03\x04"

COMMENT = 24  # bytes of the comment of a TrueMap file that its reader expects
ROUND = 1e-3  # distance of points from a regular grid, over its spacing, that is round-off
MOST_MISSING = 0.9  # largest share of the points of a grid that a file may leave out


def mend(content: bytes) -> BytesIO | None:
    """Rewrite the content of a file of a kind that can be mended; None for other kinds."""
    menders: dict[bytes, Callable[[bytes], BytesIO | None]] = {
        ZIP: _mend_x3p,
        TRUEMAP: _mend_truemap,
        ZYGO: _mend_zygo,
    }
    for begin, mender in menders.items():
        if content.startswith(begin):
            return mender(content)
    return None


def _mend_x3p(content: bytes) -> BytesIO | None:
    """Move an X3P out of its folder, write its revision with a hyphen, and its data as binary."""
    old, mended = ZipFile(BytesIO(content)), BytesIO()
    index = next((name for name in old.namelist() if name.rpartition("/")[2] == "main.xml"), "")
    if not index:
        return None
    folder = index.removesuffix("main.xml")
    root = ElementTree.fromstring(old.read(index))
    revision, record = root.find("Record1/Revision"), root.find("Record3")
    if revision is not None and revision.text:
        revision.text = revision.text.replace("\N{EN DASH}", "-")
    with ZipFile(mended, "w") as new:
        if record is not None and (listed := record.find("DataList")) is not None:
            heights = np.array(
                [float(datum.text or "nan") for datum in listed.iter("Datum")], "<f8"
            )
            new.writestr("bindata/data.bin", heights.tobytes())
            record.remove(listed)
            link = ElementTree.SubElement(
                ElementTree.SubElement(record, "DataLink"), "PointDataLink"
            )
            link.text = "bindata/data.bin"
            for kind in root.iterfind("Record1/Axes/CZ/DataType"):
                kind.text = "D"
        new.writestr("main.xml", ElementTree.tostring(root))
        for name in old.namelist():
            if name != index and not name.endswith("/") and name.startswith(folder):
                new.writestr(name.removeprefix(folder), old.read(name))
    mended.seek(0)
    return mended


def _mend_truemap(content: bytes) -> BytesIO:
    """Bring the comment of a TrueMap file, which ends with a zero, to the length of most files."""
    end = content.index(b"\0", len(TRUEMAP))
    comment = content[len(TRUEMAP) : end][: COMMENT - 1].ljust(COMMENT, b"\0")
    return BytesIO(TRUEMAP + comment + content[end + 1 :])


def _mend_zygo(content: bytes) -> BytesIO:
    """Write the heights of a Zygo file, at columns and rows of pixels, as a matrix."""
    pattern = rb"^(\d+)[ \t]+(\d+)[ \t]+(No Data|[-+.\deE]+)[ \t]*\r?$"
    columns, rows, entries = zip(*re.findall(pattern, content, re.MULTILINE), strict=True)
    row, column = np.array(rows, dtype=int), np.array(columns, dtype=int)
    heights = np.full((row.max() + 1, column.max() + 1), np.nan)
    heights[row, column] = [np.nan if entry == b"No Data" else float(entry) for entry in entries]
    return _text(heights)


def _text(matrix: np.ndarray, **options: str) -> BytesIO:
    """Write a matrix as text into memory."""
    text = BytesIO()
    np.savetxt(text, matrix, **options)
    text.seek(0)
    return text


def place_on_grid(points: np.ndarray) -> BytesIO | None:
    """Write points (n, 3) of a regular grid at all places, NaN where missing, or None."""
    places, steps = [], []
    for values in points[:, :2].T:
        edges = np.unique(values)
        gaps = np.diff(edges)
        step = float(gaps[gaps > ROUND * gaps.max(initial=0.0)].min(initial=np.inf))
        place = (values - edges[0]) / step
        if not (np.isfinite(step) and np.all(np.abs(place - np.rint(place)) < ROUND)):
            return None
        places.append(np.rint(place).astype(int))
        steps.append(step)
    x, y = places
    shape = (int(y.max()) + 1, int(x.max()) + 1)
    if len(points) < (1.0 - MOST_MISSING) * shape[0] * shape[1]:
        return None
    heights = np.full(shape, np.nan)
    heights[y, x] = points[:, 2]
    rows, columns = np.indices(shape)
    whole = np.column_stack([columns.ravel() * steps[0], rows.ravel() * steps[1], heights.ravel()])
    return _text(whole, fmt="%.17g")
