"""The law of a case, calibrated by its measured joints, and its tables."""

from dataclasses import replace
from functools import partial

import numpy as np

from multiscale.errors import CaseError
from multiscale.needs import Choice, Needs
from multiscale.pipeline.stage import Job
from multiscale.pipeline.tables.case_tables import MeasuredTable
from multiscale.pipeline.tables.settings import Case
from multiscale.schema import RVE, Dataset
from multiscale.units import readable
from multiscale.upscaling import (
    Calibration,
    MeasuredJoint,
    assume_shear,
    calibrate,
    require_law,
    tangential_values,
)
from multiscale.upscaling.calibration import ROUGHNESS, require_shear
from multiscale.upscaling.law_budget import DISCREPANCY, EXPONENT
from multiscale.upscaling.measured.joints import Answer

PARAMETERS = ("parameter", "cells", "±", "calibrated", "±", "learned", "pull")
ROWS = ("table", "row", "pressure", "measured", "calibrated law", "±", "deviations", "weight")
"""Heads of the tables of a calibration."""

SHOWN_UNITS = {"Pa/m": (1e-12, "MPa/µm"), "m/Pa": (1e12, "µm/MPa")}

SOLVES = 120  # of a structure with measured modes: about 13 in each of 4 to 12 steps

TEXT = "\t"  # between the columns of a table in an attribute


def measured_structure(table: MeasuredTable) -> Case | None:
    """Return the case of the structure of a table, if it has any; refuse other structures."""
    if table.case is None:
        return None
    from multiscale.pipeline.case import load_case  # which imports this module
    from multiscale.pipeline.stages.vibrating_bodies import require_modes

    case = load_case(table.case)
    require_modes(case)
    return case


def prepare_calibration(case: Case) -> None:
    """Refuse wrong tables, structures without modes, and a law without friction."""
    from multiscale.pipeline.stages.vibrating_bodies import VIBRATING_BODIES

    for table in case.measured or ():
        structure = measured_structure(table)
        if structure is not None:
            VIBRATING_BODIES.prepare(structure)
        if table.read(_unsolved if structure else None).sheared:
            require_shear(case.known_shear)


def _unsolved(amplitudes: np.ndarray) -> tuple[float, np.ndarray, Answer]:
    """Return no pressure, half-widths and answer of a structure, with which a table is checked."""
    return np.nan, np.zeros(2 * amplitudes.size), MeasuredJoint.answer


def calibration_needs(case: Case) -> list[Needs]:
    """Return the needs of structures solved for the calibration."""
    from multiscale.pipeline.stages.vibrating_bodies import VIBRATING_BODIES

    listed = []
    for table in case.measured or ():
        if structure := measured_structure(table):
            needs = VIBRATING_BODIES.needs(structure)
            choice = Choice("measured modes", f"about {SOLVES} solves of {structure.title}")
            listed.append(replace(needs, seconds=SOLVES * needs.seconds, choices=(choice,)))
    return listed


def calibrate_case(case: Case, law: Dataset, job: Job) -> Calibration:
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
            f"{known[name]:.3g}, the start of the calibration; leave out {name}"
        )
    cautions = law.attrs["cautions"]
    if stated:
        law = assume_shear(law, **stated)
    tables = [_read(table, law, job) for table in case.measured]
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


def _read(table: MeasuredTable, law: Dataset, job: Job) -> MeasuredJoint:
    """Read a table of joints, or of a structure that is solved with the law."""
    structure = measured_structure(table)
    if structure is None or table.case is None:
        return table.read()
    from multiscale.pipeline.stages.vibrating_bodies import modes_of_law  # imports this module

    require_shear(tangential_values(law))
    volumes = {} if structure.rve is None else {RVE.name: job.read_rve(table.case, False)}
    solve = partial(modes_of_law, structure, law, volumes, job)
    return table.read(solve)


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
    if unit in SHOWN_UNITS:
        factor, unit = SHOWN_UNITS[unit]
        return f"{factor * value:.{digits}g} {unit}"
    rounded = f"{value:.{digits}g}"
    return rounded if unit == "1" else readable(f"{rounded} {unit}")
