"""Laws as tables that other finite-element codes read."""

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from multiscale.convergence import check_limits
from multiscale.errors import CaseError
from multiscale.io import write_bytes
from multiscale.schema import Dataset
from multiscale.units import to_si
from multiscale.upscaling.branches import sliders_from_dataset
from multiscale.upscaling.reading import (
    area_from_dataset,
    count_realisations,
    law_band,
    law_from_dataset,
    refuse_band,
    require_law,
)
from multiscale.upscaling.transport import conductance_ratios

if TYPE_CHECKING:
    from multiscale.laws import NormalLaw

SMALLEST_STEP = 1e-10
"""Overclosures that differ by less are moved apart by CalculiX, in the unit of the table."""

MOST_POINTS = 40  # of tables in older versions of CalculiX
FACE_POINTS, FACE_TABLE = 20, 41
"""Points that CalculiX 2.20 reads of a table, at most, and points that the table has, face to face:
it takes the integer part of the overclosure of the 41st point as the number of points."""

MORTAR_SHEAR = ("** with TYPE=MORTAR CalculiX 2.20 carries more shear than friction allows",)

TABLE_POINTS = 41  # pressures of a CSV table, even in the logarithm over the data
BEYOND = 10.0  # the table goes on with its last slope to this multiple of the largest pressure


@dataclass(frozen=True, eq=False)
class ChordTable:
    """A normal law as a chain of chords."""

    pressure: np.ndarray  # (points,), Pa; zero first, rising
    overclosure: np.ndarray  # (points,), m; zero first, rising
    first_contact: float  # gap of the mean planes at zero overclosure, m


def pressure_overclosure(
    law: "NormalLaw", pressure_range: tuple[float, float], *, tolerance: float = 5e-3
) -> ChordTable:
    """Approximate a normal law by a chain of chords."""
    check_limits(tolerance)
    low, high = pressure_range
    if not 0.0 < low < high < np.inf:
        raise CaseError(
            f"a table runs from a positive to a larger pressure (Pa), got {low:g} and {high:g}"
        )
    n = 4
    while True:
        p = np.geomspace(low, high, n)
        gap = law.gap_at(p)
        middle = 0.5 * (gap[1:] + gap[:-1])
        # a chord of a convex law lies above it, about furthest in the middle
        error = 0.5 * (p[1:] + p[:-1]) / law.pressure(middle) - 1.0
        if float(np.max(error)) <= tolerance or n >= 2000:
            break
        n += max(1, n // 4)
    first = float(gap[0] + p[0] / law.stiffness(gap[:1])[0])
    return ChordTable(np.append(0.0, p), np.append(0.0, first - gap), first)


def write_pressure_overclosure(
    dataset: Dataset,
    path: str | PathLike[str],
    *,
    name: str = "ROUGH",
    length_unit: str = "mm",
    pressure_unit: str = "MPa",
    tolerance: float = 5e-3,
    friction_for: Literal["abaqus", "calculix"] | None = None,
    stick_pressure: float | None = None,
    conductance_for: Literal["abaqus", "calculix"] | None = None,
    face_to_face: bool = False,
) -> None:
    r"""Write a normal law as a tabular pressure-overclosure for CalculiX and Abaqus.

    Parameters
    ----------
    dataset : Dataset, follows ``INTERFACE_LAW``
    path : path, an input file, to be included before the steps with ``*INCLUDE, INPUT=...``
    name, length_unit, pressure_unit : str
        Name of the surface interaction, and the units of the model.
    tolerance : float, see :func:`pressure_overclosure`
    friction_for : {"abaqus", "calculix"}, optional
        Write friction and stick stiffness too, in the keywords of either code. The law needs a
        tangential branch.
    stick_pressure : float, optional
        Pressure p of the stick stiffness, Pa; the geometric mean of the data if not given.
    conductance_for : {"abaqus", "calculix"}, optional
        Write the thermal conductance too, as gap conductance against pressure; energies of the
        model are in its unit of pressure times length cubed, and times in s.
    face_to_face : bool, default False
        Write the table so that CalculiX 2.20 carries load with ``TYPE=SURFACE TO SURFACE`` too.

    Raises
    ------
    CaseError
        If two points would be closer than CalculiX keeps apart, the tolerance needs more than 40
        points, or 20 face to face, the name is invalid, or friction is asked of a law without.

    Notes
    -----
    Both codes read the same lines: ``*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=TABULAR`` under a
    ``*SURFACE INTERACTION``, then pressure and overclosure, rising, the first pressure zero. Beyond
    the last point Abaqus continues with its slope and CalculiX keeps the pressure, so that a
    further point prolongs the last chord to ten times the largest pressure. Surfaces of the model
    that touch have the first contact of the summits: the head of the file gives the distance of the
    mean planes there. CalculiX makes no contact elements where surfaces are open, so that a body
    supported by the contact only should overlap a little at the start.

    CalculiX 2.20 carries no load with a table and ``TYPE=SURFACE TO SURFACE``, in silence: it takes
    the number of points from the overclosure of a 41st point, which no usual table has. A table
    ``face_to_face`` has this point; ``TYPE=NODE TO SURFACE`` reads it as well, ``TYPE=MORTAR`` does
    not. With ``TYPE=MORTAR`` and friction, CalculiX 2.20 carries more shear than friction allows.

    Either code sticks with a single spring and slider, without micro-slip. It is as stiff as
    the bed of sliders before any slip: CalculiX takes the stiffness :math:`\kappa K(p)`, the same
    at all pressures; Abaqus the elastic slip :math:`\mu p / (\kappa K(p))`, from which it makes a
    stiffness in proportion to the pressure, as rough surfaces nearly have. Stiffness and capacity
    of a joint carry over so; its loss does not: in a lap joint, one stiffness at all pressures
    doubles it.
    """
    if not (name and name.isascii() and name.replace("_", "a").replace("-", "a").isalnum()):
        raise CaseError(f"{name!r} cannot name a surface interaction; use letters and digits")
    require_law(dataset, "pressure_min", "pressure_max", "n_realisations")
    family = dataset.attrs.get("family", "convex_decreasing")
    low, high = (float(dataset.attrs[key]) for key in ("pressure_min", "pressure_max"))
    law = law_from_dataset(dataset)
    table = pressure_overclosure(law, (low, high), tolerance=tolerance)
    p, overclosure, points = table.pressure, table.overclosure, table.pressure.size
    most, reader = (FACE_POINTS, " face to face") if face_to_face else (MOST_POINTS, "")
    if p.size >= most:
        raise CaseError(
            f"a table within {100.0 * tolerance:g} % takes {p.size + 1} points, and CalculiX holds "
            f"{most}{reader}; allow a larger tolerance"
        )
    slope = (overclosure[-1] - overclosure[-2]) / (p[-1] - p[-2])
    p = np.append(p, BEYOND * p[-1])
    overclosure = np.append(overclosure, overclosure[-1] + slope * (p[-1] - p[-2]))
    length, pressure = to_si(f"1 {length_unit}", "m"), to_si(f"1 {pressure_unit}", "Pa")
    if face_to_face:
        end = (p.size + 0.5) * length
        if overclosure[-1] >= end:
            raise CaseError(
                f"the overclosures reach {overclosure[-1] / length:.3g} {length_unit}, and face to "
                f"face CalculiX reads {p.size} points only of a table below {p.size} "
                f"{length_unit}; use a larger length_unit"
            )
        further = np.linspace(overclosure[-1], end, FACE_TABLE - p.size + 1)[1:]
        p = np.append(p, p[-1] + (further - overclosure[-1]) / slope)
        overclosure = np.append(overclosure, further)
    smallest = float(np.min(np.diff(overclosure))) / length
    if smallest < SMALLEST_STEP:
        raise CaseError(
            f"two overclosures of the table differ by only {smallest:.1g} {length_unit}, less than "
            f"the {SMALLEST_STEP:g} that CalculiX keeps apart; use a smaller length_unit"
        )
    lines = [
        f"** pressure ({pressure_unit}), overclosure ({length_unit}) of a rough interface",
        f"** {dataset.attrs.get('title', 'interface law')}, {family}, "
        f"{count_realisations(dataset)}",
        f"** zero overclosure: mean planes {table.first_contact / length:.6g} {length_unit} apart",
        f"** from {low / pressure:.4g} to {high / pressure:.4g} {pressure_unit}, chords within "
        f"{100.0 * tolerance:g} % of the law",
        *_describe_reader(p.size - points, face_to_face),
        f"*SURFACE INTERACTION, NAME={name}",
        "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=TABULAR",
        *(f"{a / pressure:.9e}, {b / length:.9e}" for a, b in zip(p, overclosure, strict=True)),
    ]
    if friction_for is not None:
        at = np.sqrt(low * high) if stick_pressure is None else stick_pressure
        if friction_for not in ("abaqus", "calculix"):
            raise CaseError(f"friction is written for abaqus or calculix, got {friction_for!r}")
        if not low <= at <= high:
            raise CaseError(
                f"the law rests on data from {low:.3g} to {high:.3g} Pa, got a stick_pressure of "
                f"{at:.3g} Pa; give a pressure between them"
            )
        bed = sliders_from_dataset(dataset)
        if not bed.friction:
            raise CaseError(
                f"the law has no friction, and no stick stiffness, to be written for "
                f"{friction_for}; leave the friction out"
            )
        stiffness = bed.stiffness_ratio * float(law.stiffness(law.gap_at(np.array(at))))
        slip = bed.friction * at / stiffness
        lines += [
            f"** a slider as stiff as the interface at {at / pressure:.4g} {pressure_unit}; "
            f"its micro-slip is left out",
            *MORTAR_SHEAR * (friction_for == "calculix"),
            *(
                [f"*FRICTION, ELASTIC SLIP={slip / length:.9e}", f"{bed.friction:.9e}"]
                if friction_for == "abaqus"
                else ["*FRICTION", f"{bed.friction:.9e}, {stiffness * length / pressure:.9e}"]
            ),
        ]
    if conductance_for is not None:
        if conductance_for not in ("abaqus", "calculix"):
            raise CaseError(f"a conductance is for abaqus or calculix, got {conductance_for!r}")
        ratio = conductance_ratios(dataset).get("thermal_conductance")
        if ratio is None:
            raise CaseError(
                "the law has no thermal conductance; give thermal_conductivity of both bodies"
            )
        data = table.pressure[1:]
        h = ratio * law.stiffness(law.gap_at(data)) / (pressure * length)
        lines += [
            "*GAP CONDUCTANCE" + (", PRESSURE" if conductance_for == "abaqus" else ""),
            "0., 0., 0.",
            *(f"{value:.9e}, {p / pressure:.9e}, 0." for value, p in zip(h, data, strict=True)),
        ]
    write_bytes(Path(path), ("\n".join(lines) + "\n").encode("ascii", "replace"))


def _describe_reader(added: int, face_to_face: bool) -> list[str]:
    """Describe the lines of a table beyond the data, and its contact type in CalculiX 2.20."""
    if face_to_face:
        return [
            f"** the last {added} lines are not data: they prolong the chord before them, and the "
            f"last",
            "** overclosure gives CalculiX 2.20 the number of lines with TYPE=SURFACE TO SURFACE",
        ]
    return [
        "** the last line is not data: it prolongs the chord before it",
        "** CalculiX 2.20 reads it with TYPE=NODE TO SURFACE and MORTAR; with SURFACE TO SURFACE",
        "** it carries no load: there write the table by multiscale export --face-to-face",
    ]


def write_law_table(
    dataset: Dataset,
    path: str | PathLike[str],
    *,
    length_unit: str = "um",
    pressure_unit: str = "MPa",
    leakage: bool = False,
) -> None:
    """Write a normal law, with its band and its area law if it has them, as CSV.

    Too few realisations or samples for a band of 95 % leave its columns out.

    Parameters
    ----------
    dataset, path, length_unit, pressure_unit
        See :func:`write_pressure_overclosure`; the head of each column has its unit.
    leakage : bool
        Write the hydraulic apertures too, along x, y and both, with the ends of their 95 %
        intervals, and all columns at the pressures of the data only; zero is tight.

    Raises
    ------
    CaseError
        If apertures are asked of a law without them.
    """
    require_law(dataset, "pressure_min", "pressure_max")
    p = np.geomspace(dataset.attrs["pressure_min"], dataset.attrs["pressure_max"], TABLE_POINTS)
    if leakage:
        if "hydraulic_aperture" not in dataset:
            raise CaseError("the law has no hydraulic aperture; set leakage = true in [micro]")
        p = dataset["fit_pressure"].to_numpy()
    law = law_from_dataset(dataset)
    gap = law.gap_at(p)
    length, pressure = to_si(f"1 {length_unit}", "m"), to_si(f"1 {pressure_unit}", "Pa")
    columns = {
        f"pressure ({pressure_unit})": p / pressure,
        f"gap ({length_unit})": gap / length,
        f"stiffness ({pressure_unit}/{length_unit})": law.stiffness(gap) * length / pressure,
    }
    if "area_pressure" in dataset:
        columns["contact fraction (1)"] = area_from_dataset(dataset).contact_fraction(p)
    if not refuse_band(dataset):
        low, high = law_band(dataset, lambda sample: sample.gap_at(p), confidence=0.95)
        columns[f"gap low 95 % ({length_unit})"] = low / length
        columns[f"gap high 95 % ({length_unit})"] = high / length
    for name in map(str, dataset["direction"].to_numpy() if leakage else ()):
        flow = dataset.sel(direction=name)
        apertures = [
            flow["hydraulic_aperture"].to_numpy(),
            *flow["hydraulic_aperture_mean_law"].to_numpy(),
        ]
        for suffix, aperture in zip(("", " low 95 %", " high 95 %"), apertures, strict=True):
            columns[f"aperture {name}{suffix} ({length_unit})"] = aperture / length
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(f"{value:.9g}" for value in row) for row in rows)]
    write_bytes(Path(path), ("\n".join(lines) + "\n").encode())
