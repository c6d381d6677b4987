"""Interface laws of a user: tables of pressure and overclosure, with an error that is stated."""

from os import PathLike
from pathlib import Path

import numpy as np

from multiscale.errors import CaseError
from multiscale.io import open_law
from multiscale.schema import INTERFACE_LAW, Dataset
from multiscale.upscaling.budget import (
    ALWAYS,
    ERROR_TERMS,
    STATED,
    Term,
    assemble_budget,
    with_budget,
)
from multiscale.upscaling.law_budget import QUANTITIES
from multiscale.upscaling.reading import TABLE

__all__ = ["read_law", "with_stated_error"]

LOWEST = 1e-3
"""Lowest pressure of the data of a table over its first one above zero: its first chord is data."""

ROUNDED = 0.01
"""Distance of a row from the convex law of the others, over its pressure, that is rounding."""

COLUMNS = {"pressure": "Pa", "overclosure": "m"}
"""Columns of a table and their units."""


def read_law(path: str | PathLike[str]) -> Dataset:
    """Read an interface law: a dataset, or a table whose name ends in ``.csv``.

    Parameters
    ----------
    path : path
        A dataset as of :func:`multiscale.io.open_law`; or a table with the columns ``pressure``
        and ``overclosure``, such as ``pressure (MPa), overclosure (um)``, in Pa and m where the
        head has no units. Its first row is the pressure zero; both rise from row to row, and the
        law is linear between them. Rows at which it would soften are left out, if they are within
        1 % of the pressure of the others, as in rounded tables.

    Returns
    -------
    Dataset
        Follows ``INTERFACE_LAW``. A table has no error budget; see :func:`with_stated_error`.

    Raises
    ------
    MultiscaleError
        If a file is refused, or a table does not begin at zero, rise and stiffen.
    """
    path = Path(path)
    if path.suffix.lower() != ".csv":
        return open_law(path)
    from multiscale.upscaling.observation_tables import read_columns

    columns, _, bare = read_columns(path, COLUMNS, signed=COLUMNS, bare=True)
    p, closed = columns.values()
    _refuse_rows(path, p, closed)
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
            f"{path}, row 1: the pressure is {pressure[0]:g} Pa, and a law begins at zero, where "
            f"the faces begin to touch; add that row"
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
    """Return the rows between which no chord is softer than the chord before it."""
    some_p, some = p, closed
    while (falls := np.diff(np.diff(some_p) / np.diff(some)) < 0.0).any():
        kept = np.arange(some.size) != 1 + int(np.argmax(falls))
        some_p, some = some_p[kept], some[kept]
    for k in np.flatnonzero(np.abs(np.interp(closed, some, some_p) - p) > ROUNDED * p):
        below, above = (np.diff(p) / np.diff(closed))[k - 1 : k + 1]
        raise CaseError(
            f"{path}, row {k + 2}: the stiffness falls from {below:.4g} to {above:.4g} Pa/m, and "
            f"no rough interface softens under pressure; smooth the table, or fit a law to its "
            f"points by multiscale fit"
        )
    return some_p, some


def with_stated_error(law: Dataset, error: float) -> Dataset:
    """Return the law of a table with an error budget that is stated.

    Parameters
    ----------
    law : Dataset, of :func:`read_law`
    error : float
        Half-width of the 95 % interval of overclosures and stiffness at every pressure, relative
        to them.

    Raises
    ------
    CaseError
        If the law is no table.
    """
    if law.attrs.get("family") != TABLE:
        raise CaseError(
            f"law_error is of a table of pressure and overclosure, and the law is of the family "
            f"{law.attrs.get('family')!r}; leave out law_error"
        )
    p = law["fit_pressure"].to_numpy()
    half = np.array([[error], [np.nan], [error]]) * np.ones(p.size)  # a table has no contact area
    none = Term("nothing: the error of the table is stated", np.zeros((3, p.size)))
    terms = {term: Term("not in a law whose error is stated") for term in ERROR_TERMS}
    terms |= dict.fromkeys(ALWAYS, none)
    terms[STATED] = Term(f"law_error = {100.0 * error:.3g} %", half)
    return with_budget(law, assemble_budget(terms, QUANTITIES, p))
