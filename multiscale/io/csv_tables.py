"""Tables of named columns from CSV files."""

import csv
from collections.abc import Callable
from math import isfinite
from pathlib import Path
from typing import Any

from multiscale.errors import CaseError
from multiscale.io.files import read_text

SEPARATORS = (";", "\t", ",")
"""The first mark that the line of names contains separates all entries."""


def finite(cell: str) -> float:
    """Read a number that is neither infinite nor ``nan``."""
    if not isfinite(number := float(cell)):
        raise ValueError(cell)
    return number


def positive(cell: str) -> float:
    """Read a finite number above zero."""
    if not (number := finite(cell)) > 0.0:
        raise ValueError(cell)
    return number


KINDS: dict[Callable[[str], Any], str] = {
    int: "a whole number",
    float: "a number",
    finite: "a finite number",
    positive: "a positive, finite number",
}
"""Names of the kinds of a column in messages."""


def read_table(
    path: Path, kind_of: Callable[[str], Callable[[str], Any]] = lambda name: finite
) -> dict[str, list[Any]]:
    """Read a CSV file with the names of the columns in its first line; a list for each column."""
    text = read_text(path).splitlines()
    names = next((line for line in text if line.strip()), "")
    separator = next((mark for mark in SEPARATORS if mark in names), ",")
    lines = csv.reader(text, delimiter=separator)
    rows = [(lines.line_num, [cell.strip() for cell in row]) for row in lines if row]
    if not rows:
        raise CaseError(f"{path}: empty; the first line must have the names of the columns")
    head = rows[0][1]
    table: dict[str, list[Any]] = {name: [] for name in head}
    if len(table) < len(head):
        raise CaseError(f"{path}: two columns have the same name; columns: {', '.join(head)}")
    for number, row in rows[1:]:
        if len(row) != len(head):
            raise CaseError(f"{path}, line {number}: {len(row)} entries for {len(head)} columns")
        for name, cell in zip(head, row, strict=True):
            kind = kind_of(name)
            decimal = kind not in (int, str) and separator != ","
            plain = cell.replace(",", ".") if decimal else cell
            try:
                table[name].append(kind(plain))
            except ValueError as error:
                raise CaseError(
                    f"{path}, line {number}: {name} should be {KINDS[kind]}, got {cell!r}"
                ) from error
    return table
