"""Laws as tables for other finite-element codes."""

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
"""Largest number of points that CalculiX 2.20 reads face to face, and points of the table: it uses
the integer part of the overclosure of the 41st point as the number of points."""

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
    the last point Abaqus continues with its slope and CalculiX with a constant pressure, so a
    further point extends the last chord to ten times the largest pressure. Surfaces of the model
    that touch are at the first contact of the summits: the head of the file has the distance of the
    mean planes there. CalculiX makes no contact elements where surfaces are open, so a body
    supported by the contact only should overlap a little at the start.

    With ``TYPE=SURFACE TO SURFACE`` CalculiX 2.20 ignores usual tables without a message: it takes
    the number of points from the overclosure of a 41st point, which they do not have. A table
    ``face_to_face`` has this point; ``TYPE=NODE TO SURFACE`` reads it as well, ``TYPE=MORTAR`` does
    not. With ``TYPE=MORTAR`` and friction, the shear in CalculiX 2.20 exceeds the friction limit.

    Both codes have a single spring and slider, without micro-slip, with the stiffness of the bed of
    sliders before any slip. CalculiX uses the stiffness :math:`\kappa K(p)` at all pressures;
    Abaqus uses the elastic slip :math:`\mu p / (\kappa K(p))`, so its stiffness is proportional to
    the pressure, nearly as for rough surfaces. Stiffness and capacity of a joint are then right,
    but not its loss: in a lap joint, a constant stiffness at all pressures doubles it.
    """
    if not (name and name.isascii() and name.replace("_", "a").replace("-", "a").isalnum()):
        raise CaseError(f"{name!r} cannot name a surface interaction; use letters and digits")
    require_law(dataset, "pressure_min", "pressure_max", "n_realisations")
    units = _Units(length_unit, pressure_unit)
    low, high = (float(dataset.attrs[key]) for key in ("pressure_min", "pressure_max"))
    chords = pressure_overclosure(law_from_dataset(dataset), (low, high), tolerance=tolerance)
    if chords.pressure.size >= (most := FACE_POINTS if face_to_face else MOST_POINTS):
        raise CaseError(
            f"a table within {100.0 * tolerance:g} % takes {chords.pressure.size + 1} points, and "
            f"CalculiX reads {most}{' face to face' * face_to_face}; allow a larger tolerance"
        )
    table = _prolong(chords, units, face_to_face)
    added, rows = len(table) - chords.pressure.size, table / (units.pressure, units.length)
    lines = [
        f"** pressure ({pressure_unit}), overclosure ({length_unit}) of a rough interface",
        f"** {dataset.attrs.get('title', 'interface law')}, "
        f"{dataset.attrs.get('family', 'convex_decreasing')}, {count_realisations(dataset)}",
        f"** zero overclosure: mean planes {chords.first_contact / units.length:.6g} "
        f"{length_unit} apart",
        f"** from {low / units.pressure:.4g} to {high / units.pressure:.4g} {pressure_unit}, "
        f"chords within {100.0 * tolerance:g} % of the law",
        *_describe_reader(added, face_to_face),
        f"*SURFACE INTERACTION, NAME={name}",
        "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=TABULAR",
        *(f"{pressure:.9e}, {overclosure:.9e}" for pressure, overclosure in rows),
    ]
    if friction_for is not None:
        at = float(np.sqrt(low * high)) if stick_pressure is None else stick_pressure
        lines += _friction(dataset, at, friction_for, units)
    if conductance_for is not None:
        lines += _conductance(dataset, chords.pressure[1:], conductance_for, units)
    write_bytes(Path(path), ("\n".join(lines) + "\n").encode("ascii", "replace"))


@dataclass(frozen=True)
class _Units:
    length_name: str
    pressure_name: str

    @property
    def length(self) -> float:
        """Unit of lengths, m."""
        return to_si(f"1 {self.length_name}", "m")

    @property
    def pressure(self) -> float:
        """Unit of pressures, Pa."""
        return to_si(f"1 {self.pressure_name}", "Pa")


def _prolong(chords: ChordTable, units: _Units, face_to_face: bool) -> np.ndarray:
    """Prolong the last chord: pressures, Pa, and overclosures, m, that CalculiX reads, (points, 2).

    Face to face, further points give CalculiX 2.20 the number of points as 41st overclosure.
    """
    p, overclosure, unit = chords.pressure, chords.overclosure, units.length_name
    slope = (overclosure[-1] - overclosure[-2]) / (p[-1] - p[-2])
    last, count = BEYOND * p[-1], p.size + 1
    overclosure = np.append(overclosure, overclosure[-1] + slope * (last - p[-1]))
    p = np.append(p, last)
    if face_to_face:
        end = (count + 0.5) * units.length
        if overclosure[-1] >= end:
            raise CaseError(
                f"the overclosures reach {overclosure[-1] / units.length:.3g} {unit}, and face to "
                f"face CalculiX reads {count} points only of a table below {count} {unit}; use a "
                f"larger length_unit"
            )
        further = np.linspace(overclosure[-1], end, FACE_TABLE - count + 1)[1:]
        p = np.append(p, last + (further - overclosure[-1]) / slope)
        overclosure = np.append(overclosure, further)
    smallest = float(np.min(np.diff(overclosure))) / units.length
    if smallest < SMALLEST_STEP:
        raise CaseError(
            f"two overclosures of the table differ by only {smallest:.1g} {unit}, less than the "
            f"{SMALLEST_STEP:g} that CalculiX keeps apart; use a smaller length_unit"
        )
    return np.column_stack([p, overclosure])


def _friction(dataset: Dataset, at: float, code: str, units: _Units) -> list[str]:
    low, high = (float(dataset.attrs[key]) for key in ("pressure_min", "pressure_max"))
    if code not in ("abaqus", "calculix"):
        raise CaseError(f"friction is written for abaqus or calculix, got {code!r}")
    if not low <= at <= high:
        raise CaseError(
            f"the law has data from {low:.3g} to {high:.3g} Pa, got a stick_pressure of "
            f"{at:.3g} Pa; give a pressure between them"
        )
    law, bed = law_from_dataset(dataset), sliders_from_dataset(dataset)
    if not bed.friction:
        raise CaseError(
            f"the law has no friction and no stick stiffness for {code}; leave the friction out"
        )
    stiffness = bed.stiffness_ratio * float(law.stiffness(law.gap_at(np.array(at))))
    lines = [
        f"** a slider as stiff as the interface at {at / units.pressure:.4g} "
        f"{units.pressure_name}; its micro-slip is left out"
    ]
    if code == "abaqus":
        slip = bed.friction * at / stiffness / units.length
        return [*lines, f"*FRICTION, ELASTIC SLIP={slip:.9e}", f"{bed.friction:.9e}"]
    stick = stiffness * units.length / units.pressure
    return [*lines, *MORTAR_SHEAR, "*FRICTION", f"{bed.friction:.9e}, {stick:.9e}"]


def _conductance(dataset: Dataset, data: np.ndarray, code: str, units: _Units) -> list[str]:
    if code not in ("abaqus", "calculix"):
        raise CaseError(f"a conductance is for abaqus or calculix, got {code!r}")
    ratio = conductance_ratios(dataset).get("thermal_conductance")
    if ratio is None:
        raise CaseError(
            "the law has no thermal conductance; give thermal_conductivity of both bodies"
        )
    law = law_from_dataset(dataset)
    h = ratio * law.stiffness(law.gap_at(data)) / (units.pressure * units.length)
    return [
        "*GAP CONDUCTANCE" + (", PRESSURE" if code == "abaqus" else ""),
        "0., 0., 0.",
        *(f"{value:.9e}, {p:.9e}, 0." for value, p in zip(h, data / units.pressure, strict=True)),
    ]


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
    units = _Units(length_unit, pressure_unit)
    length, pressure = units.length, units.pressure
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
