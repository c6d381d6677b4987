"""Observations from CSV files of tests or of other codes, whose heads carry the units."""

import re
from os import PathLike
from pathlib import Path

import numpy as np

from multiscale.errors import CaseError
from multiscale.io import read_table, read_text
from multiscale.units import to_si
from multiscale.upscaling.observations import QUANTITIES, Observations, observe

__all__ = ["read_observations"]

_COLUMN = {
    "gap": "gap",
    "normal_stiffness": "stiffness",
    "contact_fraction": "contact fraction",
    "tangential_stiffness": "stiffness",
    "friction_coefficient": "friction coefficient",
    "recovery": "recovery",
}
_PINT = {"m": "m", "Pa": "Pa", "Pa m-1": "Pa/m", "m s-1": "m/s", "1": "1"}
_EXAMPLE = {"m": "um", "Pa": "MPa", "Pa m-1": "MPa/um", "m s-1": "mm/s", "1": "1"}
_HEAD = re.compile(r"\s*(?P<name>[^(\[]*?)\s*(?:[(\[]\s*(?P<unit>[^)\]]*?)\s*[)\]])?\s*")


def read_observations(path: str | PathLike[str], quantity: str) -> Observations:
    """Read observations of one quantity from a CSV file.

    Parameters
    ----------
    path : path
        Comma separated. The first line names the columns with their units, such as
        ``pressure (MPa), stiffness (MPa/um), specimen``: the columns of the quantity, in any order,
        and optionally ``specimen`` (any text); further columns are ignored. Without specimens the
        k-th value at a pressure belongs to the k-th of them. Each is a realisation.
    quantity : str, see :func:`observe`; for instance ``"normal_stiffness"``

    Raises
    ------
    CaseError
        If a column or its unit is missing or of another dimension, a number is none, or a
        specimen has two values at one point.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder) / "stiffness.csv"
    ...     _ = file.write_text("pressure (MPa), stiffness (MPa/um)" + chr(10) + "10, 20" + chr(10))
    ...     seen = read_observations(file, "normal_stiffness")
    >>> seen.pressure, seen.values  # Pa and Pa/m
    (array([10000000.]), array([[2.e+13]]))
    """
    path = Path(path)
    if quantity not in QUANTITIES:
        raise CaseError(f"there is no quantity {quantity!r}; choose from {', '.join(QUANTITIES)}")
    wanted = {
        name.replace("_", " "): unit for name, unit in QUANTITIES[quantity].conditions.items()
    }
    wanted[_COLUMN[quantity]] = QUANTITIES[quantity].unit
    columns, specimen = _columns(path, wanted)
    *conditions, values = columns.values()
    rows = specimen if specimen is not None else _occurrence(conditions)
    points, column = np.unique(np.column_stack(conditions), axis=0, return_inverse=True)
    names, row = np.unique(rows, return_inverse=True)
    table = np.full((len(names), len(points)), np.nan)
    for r, c, value in zip(row, column.ravel(), values, strict=True):
        if np.isfinite(table[r, c]):
            raise CaseError(
                f"{path}: specimen {names[r]} has two values at {points[c, 0]:.3g} Pa, "
                f"{table[r, c]:.3g} and {value:.3g} {QUANTITIES[quantity].unit}; keep one, or give "
                f"the second another specimen"
            )
        table[r, c] = value
    try:
        return observe(quantity, tuple(points.T), table, title=path.name)
    except CaseError as error:
        raise CaseError(f"{path}: {error}") from error


def _columns(path: Path, wanted: dict[str, str]) -> tuple[dict[str, np.ndarray], np.ndarray | None]:
    """Return the wanted columns in SI, and the column of specimens if there is one."""
    example = ", ".join(f"{name} ({_EXAMPLE[unit]})" for name, unit in wanted.items())
    lines = read_text(path).splitlines()
    found = {}
    for head in (part.strip() for part in (lines[0] if lines else "").split(",")):
        match = _HEAD.fullmatch(head)
        name = (match["name"] if match else head).strip().lower().replace("_", " ")
        found[name] = (head, match["unit"] if match else None)
    missing = [name for name in wanted if name not in found]
    if missing and lines and ";" in lines[0]:
        raise CaseError(
            f"{path}: the first line separates columns by semicolons; separate them by commas, and "
            f"write numbers with decimal points"
        )
    if missing:
        raise CaseError(
            f"{path}: no column {' and no column '.join(missing)}; the first line should name "
            f"{example}, found {', '.join(head for head, _ in found.values())}"
        )
    other = {head: str for name, (head, _) in found.items() if name not in wanted}
    table = read_table(path, other)
    columns = {}
    for name, unit in wanted.items():
        head, given = found[name]
        if not given and unit != "1":
            raise CaseError(
                f"{path}: the column {head!r} has no unit; write it in the first line, such as "
                f"{name} ({_EXAMPLE[unit]})"
            )
        try:
            factor = to_si(f"1 {given}", _PINT[unit]) if given and given != "1" else 1.0
        except CaseError as error:
            raise CaseError(f"{path}: the column {head!r}: {error}") from error
        columns[name] = factor * np.array(table[head], dtype=float)
    specimen = np.array(table[found["specimen"][0]]) if "specimen" in found else None
    return columns, specimen


def _occurrence(conditions: list[np.ndarray]) -> np.ndarray:
    """How often the conditions of each row have come before."""
    seen: dict[tuple[float, ...], int] = {}
    counts = []
    for row in zip(*conditions, strict=True):
        counts.append(seen.get(row, 0))
        seen[row] = counts[-1] + 1
    return np.array(counts)
