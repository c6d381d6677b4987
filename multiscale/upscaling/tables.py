"""CSV tables with units in their heads: observations of tests, and interface laws of the user."""

import re
from collections.abc import Callable, Collection, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.io import open_law
from multiscale.io.csv_tables import finite, positive, read_table
from multiscale.schema import INTERFACE_LAW, Dataset
from multiscale.units import to_si
from multiscale.upscaling.budget import (
    ALWAYS,
    ERROR_TERMS,
    STATED,
    Term,
    assemble_budget,
    with_budget,
)
from multiscale.upscaling.law_budget import LAW_QUANTITIES
from multiscale.upscaling.observations import QUANTITIES, Observations, observe
from multiscale.upscaling.reading import TABLE

_COLUMN = {
    name: "stiffness" if name.endswith("stiffness") else name.replace("_", " ")
    for name in QUANTITIES
}
_PINT = {"m": "m", "Pa": "Pa", "Pa m-1": "Pa/m", "m s-1": "m/s", "s-1": "Hz", "1": "1"}
_EXAMPLE = {"m": "um", "Pa": "MPa", "Pa m-1": "MPa/um", "m s-1": "mm/s", "s-1": "Hz", "1": "1"}
_HEAD = re.compile(r"(?P<name>[^(\[]*?)\s*(?:[(\[]\s*(?P<unit>[^)\]]*?)\s*[)\]])?")

LOWEST = 1e-3
"""Lowest pressure of the data over the first positive one of a table: the first chord is data."""

ROUNDED = 0.01
"""Distance of a row from the convex law of the others, over its pressure, allowed as rounding."""

LOADS = ("pressure", "preload")  # names of the load over the nominal area, in every table

COLUMNS = {"pressure": "Pa", "overclosure": "m"}  # columns of a table and their units


def read_observations(path: str | PathLike[str], quantity: str) -> Observations:
    """Read observations of a quantity from a CSV file.

    Parameters
    ----------
    path : path
        A table separated by commas, semicolons or tabs, with units of its columns, such as
        ``pressure (MPa), stiffness (MPa/um), specimen``: the columns of the quantity, in any order,
        and optionally ``specimen`` (any text); further columns are ignored. Without specimens the
        k-th value at a pressure belongs to the k-th specimen. Each specimen is a realisation.
    quantity : str, see :func:`observe`; for instance ``"normal_stiffness"``

    Raises
    ------
    CaseError
        If a column or its unit is missing or of another dimension, an entry is not a number,
        infinite or, except for gaps and speeds, not positive, or a specimen has two values at a
        point.

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
    expected = {
        name.replace("_", " "): unit for name, unit in QUANTITIES[quantity].conditions.items()
    }
    expected[_COLUMN[quantity]] = QUANTITIES[quantity].unit
    columns, specimen, _ = read_columns(path, expected, signed=("gap", "speed"))
    *conditions, values = columns.values()
    rows = specimen if specimen is not None else _occurrence(conditions)
    points, column = np.unique(np.column_stack(conditions), axis=0, return_inverse=True)
    names, row = np.unique(rows, return_inverse=True)
    table = np.full((len(names), len(points)), np.nan)
    for r, c, value in zip(row, column.ravel(), values, strict=True):
        if np.isfinite(table[r, c]):
            raise CaseError(
                f"{path}: specimen {names[r]} has two values at {points[c, 0]:.3g} Pa, "
                f"{table[r, c]:.3g} and {value:.3g} {QUANTITIES[quantity].unit}; remove one of "
                f"them, or give the second another specimen"
            )
        table[r, c] = value
    try:
        return observe(quantity, tuple(points.T), table, title=path.name)
    except CaseError as error:
        raise CaseError(f"{path}: {error}") from error


def quantity_of(path: str | PathLike[str]) -> str:
    """Return the quantity of a table over pressures: stiffness or gap."""
    names = list(units_of_columns(Path(path)))
    columns = {_COLUMN[quantity]: quantity for quantity in ("normal_stiffness", "gap")}
    present = [quantity for column, quantity in columns.items() if column in names]
    if len(present) != 1:
        raise CaseError(
            f"{path}: the first line should name pressure and {' or '.join(columns)}, with "
            f"units, got {', '.join(names)}"
        )
    return present[0]


def units_of_columns(path: Path) -> dict[str, str | None]:
    """Return the names of the columns of a table, and their written units."""
    return dict(map(_name_and_unit, read_table(path, lambda head: str)))


def read_columns(
    path: Path, expected: Mapping[str, str], *, signed: Collection[str], bare: bool = False
) -> tuple[dict[str, np.ndarray], np.ndarray | None, list[str]]:
    """Read columns of a table, in SI, the column of specimens, and the columns without units."""
    heads = units_of_columns(path)
    # a load named as another table names it
    renamed = {
        other: name
        for name, other in (LOADS, LOADS[::-1])
        if name in expected and name not in heads and other not in expected
    }

    def parse(head: str) -> tuple[str, str | None]:
        name, unit = _name_and_unit(head)
        return renamed.get(name, name), unit

    table = read_table(path, lambda head: _kind(parse(head)[0], expected, signed))
    present = {name: (head, unit) for head in table for name, unit in [parse(head)]}
    if missing := [name for name in expected if name not in present]:
        example = ", ".join(f"{name} ({_EXAMPLE[unit]})" for name, unit in expected.items())
        raise CaseError(
            f"{path}: no column {' and no column '.join(missing)}; the first line should name "
            f"{example}, got {', '.join(table)}"
        )
    for head in table:
        name, _ = parse(head)
        if name in expected and present[name][0] != head:
            raise CaseError(
                f"{path}: the columns {head!r} and {present[name][0]!r} have the same name; leave "
                f"one of them out"
            )
    columns, without = {}, []
    for name, unit in expected.items():
        head, given = present[name]
        if not given and bare:
            without.append(name)
            given = unit
        if not given and unit != "1":
            raise CaseError(
                f"{path}: the column {head!r} has no unit; write it in the first line, such as "
                f"{name} ({_EXAMPLE[unit]})"
            )
        try:
            factor = 1.0 if (given or "1") == unit else to_si(f"1 {given}", _PINT[unit])
        except CaseError as error:
            raise CaseError(f"{path}: the column {head!r}: {error}") from error
        columns[name] = factor * np.array(table[head])
    specimen = np.array(table[present["specimen"][0]]) if "specimen" in present else None
    return columns, specimen, without


def _kind(name: str, expected: Collection[str], signed: Collection[str]) -> Callable[[str], Any]:
    if name not in expected:
        return str
    return finite if name in signed else positive


def _name_and_unit(head: str) -> tuple[str, str | None]:
    """Split the head of a column into name and unit."""
    match = _HEAD.fullmatch(head)
    name, unit = (match["name"], match["unit"]) if match else (head, None)
    return name.lower().replace("_", " "), unit


def _occurrence(conditions: list[np.ndarray]) -> np.ndarray:
    """Count the earlier rows with the conditions of each row."""
    seen: dict[tuple[float, ...], int] = {}
    counts = []
    for row in zip(*conditions, strict=True):
        counts.append(seen.get(row, 0))
        seen[row] = counts[-1] + 1
    return np.array(counts)


def read_law(path: str | PathLike[str]) -> Dataset:
    """Read an interface law: a dataset, or a ``.csv`` table of pressures and overclosures."""
    path = Path(path)
    if path.suffix.lower() != ".csv":
        return open_law(path)
    columns, _, bare = read_columns(path, COLUMNS, signed=COLUMNS, bare=True)
    p, closed = columns.values()
    _refuse_rows(path, p, closed)
    # linear between rows; rows where it would soften, as in rounded tables, are left out within 1 %
    p, closed = _convex(path, p, closed)
    caution = f"{path.name} has no unit of its {' and '.join(bare)} and is read in SI" * bool(bare)
    data = np.append(LOWEST * p[1], p[1:])
    return INTERFACE_LAW.build(
        {
            "table_pressure": p,
            "table_gap": -closed,
            "fit_pressure": data,
            "fit_mean_gap": -np.interp(data, p, closed),
        },
        title=path.name,
        family=TABLE,
        quantity="gap",
        n_realisations=1,
        n_samples=0,
        uncertainty="none: a table has no scatter",
        branches="loading: a table",
        pressure_min=float(data[0]),
        pressure_max=float(p[-1]),
        cautions=caution,
    )


def _refuse_rows(path: Path, pressure: np.ndarray, overclosure: np.ndarray) -> None:
    """Refuse rows that do not begin at zero, or do not rise; rows count from 1."""
    if pressure.size < 2:
        raise CaseError(f"{path}: a law needs two rows or more, got {pressure.size}")
    if pressure[0] != 0.0:
        raise CaseError(
            f"{path}, row 1: the pressure is {pressure[0]:g} Pa, and a law begins at zero, at "
            f"first contact; add this row"
        )
    rise, closing = np.diff(pressure), np.diff(overclosure)
    for k in np.flatnonzero((rise <= 0.0) | (closing <= 0.0)):
        column, values, unit = "pressure", pressure, "Pa"
        if rise[k] > 0.0:
            column, values, unit = "overclosure", overclosure, "m"
        raise CaseError(
            f"{path}, row {k + 2}: the {column} of {values[k + 1]:g} {unit} does not rise above "
            f"the {values[k]:g} {unit} of the row before; both columns must rise"
        )


def _convex(path: Path, p: np.ndarray, closed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows with chords that are not softer than the chord before."""
    convex_p, convex = p, closed
    while (falls := np.diff(np.diff(convex_p) / np.diff(convex)) < 0.0).any():
        rest = np.arange(convex.size) != 1 + int(np.argmax(falls))
        convex_p, convex = convex_p[rest], convex[rest]
    for k in np.flatnonzero(np.abs(np.interp(closed, convex, convex_p) - p) > ROUNDED * p):
        below, above = (np.diff(p) / np.diff(closed))[k - 1 : k + 1]
        raise CaseError(
            f"{path}, row {k + 2}: the stiffness falls from {below:.4g} to {above:.4g} Pa/m, and "
            f"a rough interface stiffens under pressure; smooth the table, or fit a law to its "
            f"points by multiscale fit"
        )
    return convex_p, convex


def with_stated_error(law: Dataset, error: float) -> Dataset:
    """Return the law of a table with a stated error budget."""
    if law.attrs.get("family") != TABLE:
        raise CaseError(
            f"law_error belongs to a table of pressure and overclosure, but the law is of family "
            f"{law.attrs.get('family')!r}; leave out law_error"
        )
    p = law["fit_pressure"].to_numpy()
    half = np.array([[error], [np.nan], [error]]) * np.ones(p.size)  # a table has no contact area
    zero = Term("nothing: the error of the table is stated", np.zeros((3, p.size)))
    terms = {term: Term("not in a law with a stated error") for term in ERROR_TERMS}
    terms |= dict.fromkeys(ALWAYS, zero)
    terms[STATED] = Term(f"law_error = {100.0 * error:.3g} %", half)
    return with_budget(law, assemble_budget(terms, LAW_QUANTITIES, p))
