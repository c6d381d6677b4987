"""Tables of measured joints: columns, errors, and nuisances."""

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np

from multiscale.errors import CaseError
from multiscale.upscaling.budget import NORMAL
from multiscale.upscaling.measured.joints import (
    MeasuredClosure,
    MeasuredJoint,
    MeasuredLoop,
    MeasuredStiffness,
    MeasuredTangential,
    masing_terms,
    split_loops,
)
from multiscale.upscaling.observations import list_pressures
from multiscale.upscaling.tables import read_columns, units_of_columns

FRAME, OFFSET = 0.2, 0.1
"""Default half-widths of the compliance of the frame, over the least measured compliance, and of
the zero of the load, over the least preload."""

STIFFEST = 1 / 3  # share of the measured compliances with the least values, without single values

AWAY = 0.1  # of the range of a loop, by which its middle may differ from zero

Kind = Literal["stiffness", "tangential_stiffness", "closure", "loop"]

COLUMNS: dict[Kind, dict[str, str]] = {
    "stiffness": {"stiffness": "Pa m-1"},
    "tangential_stiffness": {"stiffness": "Pa m-1"},
    "closure": {"closure": "m"},
    "loop": {"displacement": "m", "shear": "Pa"},
}
"""Columns of every kind in addition to the preload, the value last, and their units."""

LOADS: dict[Kind, str] = {"closure": "pressure"}
"""Column of the load of a kind, if it is not the preload."""


def read_measured(
    path: str | PathLike[str],
    kind: Kind,
    *,
    error: float | None = None,
    bodies: float = 0.0,
    frame: float | None = None,
    offset: float | None = None,
) -> MeasuredJoint:
    """Read measured values of a joint from a table with units in its head.

    Parameters
    ----------
    path : path
        A table as of :func:`multiscale.io.read_table`, with the columns ``preload`` and
        ``stiffness`` (kinds ``"stiffness"`` and ``"tangential_stiffness"``); ``pressure`` and
        ``closure``, rising; or ``preload``, ``displacement`` and ``shear`` along loops, in the
        order of the path, which begins at zero or at an end of a symmetric loop. Preload and shear
        are over the nominal area. A column ``error``, in the unit of the value or in %, has the
        half-width of the 95 % interval of every value.
    error : float, optional
        Half-width of the 95 % interval of all values, without the column: over the value, and in
        loops over the largest shear of the loop; between 0 and 1.
    bodies : float, compliance of the bodies between the sensors, m/Pa
    frame, offset : float, optional
        Half-widths of the 95 % intervals of the compliance of the frame in series, m/Pa, and of
        the zero of the load, Pa. A fifth of the least measured compliance and a tenth of the least
        preload if not given; 0 where they are known to be absent.

    Raises
    ------
    CaseError
        If the table is refused, has no error, is not in order, or leaves the range of its kind.
    """
    path = Path(path)
    refuse_settings(path, error, {"bodies": bodies, "frame": frame, "offset": offset})
    columns, unit = _read_columns(path, kind, error)
    pressure, value = columns[LOADS.get(kind, "preload")], columns[list(COLUMNS[kind])[-1]]
    _refuse_rows(path, kind, pressure, columns)
    # the value that an error is relative to, and must lie below
    if kind == "closure":
        value = value - value[0]
    scale = np.abs(value)
    for rows in split_loops(pressure) if kind == "loop" else ():
        scale[rows] = scale[rows].max()
    half = columns.get("error", np.full(value.size, error)) * (scale if unit == "1" else 1.0)
    largest = np.full(value.size, scale.max()) if kind == "closure" else scale
    if (above := np.flatnonzero(~(half < largest))).size:
        k = int(above[0])
        raise CaseError(
            f"{path}, row {k + 1}: the error of {half[k]:.4g} {unit} is not below a value of "
            f"{largest[k]:.4g}, so the row has no information; give error and value in their "
            f"units"
        )
    deviation = half / NORMAL
    nuisances = usual_nuisances(frame, offset, _compliances(kind, columns, value), pressure)
    if kind == "closure":
        deviation = np.where(deviation > 0.0, deviation, deviation[deviation > 0.0].min())
        nuisances = {"zero": float(deviation[0])} | nuisances
    table = (path.name, pressure, value, deviation, nuisances, bodies)
    if kind == "loop":
        return MeasuredLoop(*table, displacement=columns["displacement"])
    return {
        "stiffness": MeasuredStiffness,
        "tangential_stiffness": MeasuredTangential,
        "closure": MeasuredClosure,
    }[kind](*table)


def _read_columns(path: Path, kind: Kind, error: float | None) -> tuple[dict[str, np.ndarray], str]:
    """Read the columns of a kind, SI, and return also the unit of its errors."""
    given = units_of_columns(path)
    expected = {LOADS.get(kind, "preload"): "Pa"} | COLUMNS[kind]
    if "error" in given and error is not None:
        raise CaseError(
            f"{path}: the table has a column error, and error = {error:g} is given too; leave out "
            f"one of them"
        )
    if "error" in given:
        expected["error"] = (
            "1" if given["error"] in ("%", "1", None) else list(expected.values())[-1]
        )
    elif error is None:
        raise CaseError(
            f'{path}: the values have no error; state error, such as "3 %", or give the table a '
            f"column of this name"
        )
    columns, _, _ = read_columns(path, expected, signed=("displacement", "shear", "closure"))
    unit = expected.get("error", "1")
    if unit == "1" and "error" in columns and columns["error"].max() >= 1.0:
        raise CaseError(
            f"{path}: the column error has a share of {columns['error'].max():.4g}, and errors are "
            f"below the values; give its unit, such as error (%)"
        )
    return columns, unit


def _refuse_rows(
    path: Path, kind: Kind, pressure: np.ndarray, columns: Mapping[str, np.ndarray]
) -> None:
    least = 2 if kind in ("closure", "loop") else 1
    if pressure.size < least:
        raise CaseError(f"{path}: {pressure.size} rows, and {kind} needs {least} or more")
    if kind == "closure":
        _refuse_falling(path, pressure, columns["closure"])
    if kind == "loop":
        _refuse_loops(path, columns["displacement"], columns["shear"], pressure)


def usual_nuisances(
    frame: float | None, offset: float | None, compliance: np.ndarray, pressure: np.ndarray
) -> dict[str, float]:
    """Return the deviations of frame and zero of the load, stated or by the measured values."""
    compliance = np.sort(compliance[compliance > 0.0])
    # the frame has a share of the median compliance of the stiffest third, m/Pa
    least = float(np.median(compliance[: int(np.ceil(STIFFEST * compliance.size))]))
    widths = {
        "frame": FRAME * least if frame is None else frame,
        "offset": OFFSET * float(pressure.min()) if offset is None else offset,
    }
    return {name: width / NORMAL for name, width in widths.items() if width}


def _compliances(kind: Kind, columns: Mapping[str, np.ndarray], value: np.ndarray) -> np.ndarray:
    """Return the compliances of the rows of a table, m/Pa."""
    if kind == "closure":
        return np.diff(value) / np.diff(columns["pressure"])
    if kind == "loop":
        between = list[float]()
        for rows in split_loops(columns["preload"]):
            u, t = columns["displacement"][rows], value[rows]
            du, dt = np.diff(u), np.diff(t)
            between += [*np.abs(du / np.where(dt == 0.0, np.inf, dt)), np.ptp(u) / np.ptp(t)]
        return np.array(between)
    return 1.0 / value


def refuse_settings(path: Path, error: float | None, others: Mapping[str, float | None]) -> None:
    """Refuse a load of two names, and errors and compliances without a meaning."""
    if units_of_columns(path).keys() >= {"preload", "pressure"}:
        raise CaseError(
            f"{path}: preload and pressure both name the load over the nominal area; leave one of "
            f"both columns out"
        )
    if error is not None and not 0.0 < error < 1.0:
        raise CaseError(
            f"{path}: error must be a share of the values between 0 and 1, got {error:g}; give the "
            f"half-width of their 95 % interval, such as 0.03"
        )
    for name, value in others.items():
        if value is not None and not 0.0 <= value < np.inf:
            raise CaseError(f"{path}: {name} must be 0 or more, got {value:g}; correct it")


def _refuse_falling(path: Path, pressure: np.ndarray, closure: np.ndarray) -> None:
    """Refuse a closure that is not of one loading; rows count from 1."""
    for name, values, unit in (("pressure", pressure, "Pa"), ("closure", closure, "m")):
        falls = np.flatnonzero(np.diff(values) <= 0.0)
        if falls.size:
            k = int(falls[0])
            raise CaseError(
                f"{path}, row {k + 2}: the {name} of {values[k + 1]:.4g} {unit} does not rise "
                f"above the {values[k]:.4g} {unit} of the row before; give the rows of one "
                f"loading, in rising order"
            )


def _refuse_loops(
    path: Path, displacement: np.ndarray, shear: np.ndarray, pressure: np.ndarray
) -> None:
    """Refuse loops that do not turn about zero, slide away, or begin away from zero."""
    for rows in split_loops(pressure):
        u, t, p = displacement[rows], shear[rows], list_pressures(pressure[rows][:1])
        if not (np.ptp(u) > 0.0 and np.ptp(t) > 0.0):
            raise CaseError(f"{path}, row {rows.start + 1}: the displacement under {p} is constant")
        if np.diff(u) @ np.diff(t) < 0.0:
            raise CaseError(
                f"{path}, row {rows.start + 1}: under {p} the shear falls where the displacement "
                f"rises; change the sign of one of the columns"
            )
        middle = 0.5 * (u.max() + u.min()) / np.ptp(u)
        turned = any(len(terms) > 1 for terms in masing_terms(u))
        if not turned and abs(u[0]) > np.ptp(u):
            raise CaseError(
                f"{path}, row {rows.start + 1}: the first loading under {p} begins at "
                f"{u[0]:.4g} m, farther from zero than its range of {np.ptp(u):.4g} m; give "
                f"displacements from the state without shear"
            )
        if turned and min(abs(middle), abs(u[0]) / np.ptp(u)) > AWAY:
            raise CaseError(
                f"{path}: the middle of the loop under {p} lies "
                f"{abs(middle):.2g} times its range from zero displacement, and the loop does not "
                f"begin at zero: it slides away; give displacements from the middle of the loop"
            )
