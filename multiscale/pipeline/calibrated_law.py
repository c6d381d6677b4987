"""The law of a case, calibrated by its measured joints, and its tables."""

from concurrent.futures import Executor
from functools import partial

from multiscale.errors import CaseError
from multiscale.pipeline.tables.case_tables import MeasuredTable
from multiscale.pipeline.tables.settings import Case
from multiscale.schema import Dataset
from multiscale.units import readable
from multiscale.upscaling import (
    Calibration,
    MeasuredJoint,
    assume_shear,
    calibrate,
    read_vibration,
    require_law,
    tangential_values,
)
from multiscale.upscaling.calibration import ROUGHNESS
from multiscale.upscaling.law_budget import DISCREPANCY, EXPONENT

PARAMETERS = ("parameter", "cells", "±", "calibrated", "±", "learned", "pull")
ROWS = ("table", "row", "pressure", "measured", "calibrated law", "±", "deviations", "weight")
"""Heads of the tables of a calibration."""

SHOWN_UNITS = {"Pa/m": (1e-12, "MPa/µm"), "m/Pa": (1e12, "µm/MPa")}

TEXT = "\t"  # between the columns of a table in an attribute


def calibrate_case(case: Case, law: Dataset, executor: Executor | None = None) -> Calibration:
    """Calibrate a law by the tables [[measured]] of a case."""
    known = tangential_values(law)
    stated = {
        name: value
        for name in ("friction", "stiffness_ratio")
        if (value := getattr(case.law, name)) is not None
    }
    for name in (name for name in stated if name in known):
        raise CaseError(
            f"{name} in [law] is {stated[name]:.3g}, and the sheared cells have measured "
            f"{known[name]:.3g}, from which the calibration begins; leave out {name}"
        )
    cautions = law.attrs["cautions"]
    if stated:
        law = assume_shear(law, **stated)
    tables = [_read(table, law, executor) for table in case.measured]
    if any(table.sheared for table in tables):  # the values are calibrated, not assumed
        law = law.assign_attrs(cautions=cautions)
    areas = [table.area for table in case.measured if table.area is not None]
    discrepancy = DISCREPANCY if case.law.discrepancy is None else case.law.discrepancy
    if areas:
        require_law(law, "cell_size")  # its cells may differ from the cells of the case
    calibration = calibrate(
        law,
        tables,
        cells=min(areas) / float(law.attrs["cell_size"]) ** 2 if areas else None,
        roughness=ROUGHNESS if case.law.roughness is None else case.law.roughness,
        discrepancy=discrepancy,
        exponent=EXPONENT * discrepancy / DISCREPANCY,
        extrapolate=case.law.extrapolate,
    )
    texts = {
        f"calibration_{name}": "\n".join(map(TEXT.join, rows))
        for name, rows in (
            ("parameters", _parameters(calibration)),
            ("rows", _measured(calibration)),
        )
    }
    calibration.law.attrs.update(texts)
    return calibration


def _read(table: MeasuredTable, law: Dataset, executor: Executor | None) -> MeasuredJoint:
    """Read a table of joints, or of a structure that is solved with the law."""
    if table.case is None:
        return table.read()
    from multiscale.pipeline.case import load_case  # which imports this module
    from multiscale.pipeline.stages.vibrating_bodies import modes_of_law

    if len(tangential_values(law)) < 2:
        raise CaseError(
            f"{table.file}: vibrations need friction and stiffness ratio, which the law of the "
            f"cells does not have; shear the cells, or state both in [law]"
        )
    structure = partial(modes_of_law, load_case(table.case), law, executor)
    return read_vibration(table.file, structure=structure, error=table.error)


def calibration_tables(law: Dataset) -> list[tuple[str, tuple[str, ...], list[tuple[str, ...]]]]:
    """Return title, head and rows of both tables of a calibrated law; empty for other laws."""
    tables = (
        ("Parameters of the law before and after calibration", PARAMETERS, "parameters"),
        ("Measured values", ROWS, "rows"),
    )
    return [
        (title, head, [tuple(line.split(TEXT)) for line in text.splitlines()])
        for title, head, name in tables
        if (text := str(law.attrs.get(f"calibration_{name}", "")))
    ]


def _parameters(calibration: Calibration) -> list[tuple[str, ...]]:
    return [
        (
            row.name,
            _text(row.prior, row.unit),
            _text(row.prior_half_width, row.unit, 2),
            _text(row.value, row.unit),
            _text(row.half_width, row.unit, 2),
            f"{100.0 * row.learned:.0f} %",
            f"{row.pull:+.1f}",
        )
        for row in calibration.parameters
    ]


def _measured(calibration: Calibration) -> list[tuple[str, ...]]:
    return [
        (
            row.table,
            row.row,
            _text(row.pressure, "Pa"),
            _text(row.measured, row.unit),
            _text(row.predicted, row.unit),
            _text(row.half_width, row.unit, 2),
            f"{row.residual:+.1f}",
            f"{row.weight:.2g}",
        )
        for row in calibration.rows
    ]


def _text(value: float, unit: str, digits: int = 3) -> str:
    """Write a value in SI with a readable unit."""
    if unit in SHOWN_UNITS:
        factor, unit = SHOWN_UNITS[unit]
        return f"{factor * value:.{digits}g} {unit}"
    rounded = f"{value:.{digits}g}"
    return rounded if unit == "1" else readable(f"{rounded} {unit}")
