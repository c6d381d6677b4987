r"""Rough contact: this package and boundary-element codes on the same heights and pressures.

The surface is self-affine with waves 4 to 16 of a square cell, so that 32 points along an edge do
not carry it and 64 are the coarsest grid. All grids sample the same band-limited surface.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from multiscale.bench.limits import common_reference, extrapolate
from multiscale.bench.measure import Measured, measure
from multiscale.bench.peers import CODES, TOLERANCE, Answer, Code
from multiscale.bench.record import load_average, record
from multiscale.surfaces.surface import Surface

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["CONTACT_MODULUS", "RMS_SLOPE", "bench_micro", "scene_surface"]

LENGTH = 1e-3  # m
CONTACT_MODULUS = 1e9
"""Pa."""
RMS_SLOPE = 0.1
RELATIVE_PRESSURES = (0.02, 0.1, 0.3)  # p / (E* h')
POINTS = (64, 128, 256, 512)
QUICK_RELATIVE_PRESSURES, QUICK_POINTS = (0.1,), (64, 128, 256)

Runs = Mapping[tuple[float, str], list[Measured[Answer]]]
"""One measurement for each grid, by relative pressure and code."""


def scene_surface(points: int) -> Surface:
    """Sample the surface of the scene on a square grid.

    Parameters
    ----------
    points : int
        Along an edge, at least 33.
    """
    from multiscale.micro import self_affine

    return self_affine(
        (points, points),
        (LENGTH, LENGTH),
        seed=1,
        hurst_exponent=0.8,
        long_cutoff=LENGTH / 4.0,
        short_cutoff=LENGTH / 16.0,
        rms_slope=RMS_SLOPE,
    )


def bench_micro(
    *, quick: bool = False, report: Callable[[str], None] = lambda line: None
) -> "xr.Dataset":
    r"""Measure every installed code on every grid and pressure.

    Parameters
    ----------
    quick : bool
        One pressure, three grids and one run of each instead of three, four and the median of
        three.
    report : callable
        Gets a line after each measurement.

    Returns
    -------
    Dataset
        Follows ``WORK_PRECISION``. The attribute ``cautions`` has a sentence for each code that is
        not installed.

    Notes
    -----
    *Errors.* Of the mean gap, relative to the root mean square height; of the contact fraction,
    relative to it. ``error`` and ``contact_error`` are against a common reference, the half-space
    problem for small slopes: of the limits that the codes which approximate it tend to, the one
    that was extrapolated least; its uncertainty is the distance to the others. ``own_error`` and
    ``own_contact_error`` are against the limit of the code itself. The mesh of the conforming cell
    follows the surface: against the common reference it ends at the difference of the two models,
    of the first order in the slope, because contact is on the summits, softer than a half-space.

    *Limits.* Richardson's, with the observed order for the mean gap and order 1 for the contact
    fraction, whose error sits at the edges of the spots and is too irregular for more.

    *Times* are from heights to averages in a process of its own, with all that depends on the
    heights, after a solve on the coarsest grid that takes the imports and the compilation.
    """
    points = QUICK_POINTS if quick else POINTS
    pressures = QUICK_RELATIVE_PRESSURES if quick else RELATIVE_PRESSURES
    repeats = 1 if quick else 3
    codes = {name: code for name, code in CODES.items() if code.installed}
    load = load_average()
    runs: dict[tuple[float, str], list[Measured[Answer]]] = {}
    for pressure in pressures:
        for n in points:
            for name, code in codes.items():
                measured = _measure(code, n, pressure, repeats)
                runs.setdefault((pressure, name), []).append(measured)
                report(f"{_scene(pressure)}, n = {n}, {name}: {measured.wall_time:.3g} s")
    found = record(
        _rows(codes, runs, points),
        title="rough contact: mean gap and contact fraction",
        surface=f"waves 4 to 16, H = 0.8, rms slope {RMS_SLOPE:g}, E* = {CONTACT_MODULUS:g} Pa",
        versions=", ".join(
            dict.fromkeys(f"{code.distribution} {code.version}" for code in codes.values())
        ),
        tolerance=TOLERANCE,
        load_before=load,
        repeats=repeats,
        wall_time_counts="median; without start of the process, imports and compilation",
        cautions=(
            f"{name} is left out because it is not installed; pip install 'multiscale[bench]'"
            for name, code in CODES.items()
            if name not in codes
        ),
    )
    found["error"].attrs["long_name"] = "error of the mean gap over rms height"
    return found


def _scene(pressure: float) -> str:
    return f"micro, p = {pressure:g} E* h'"


def _measure(code: Code, points: int, pressure: float, repeats: int) -> Measured[Answer]:
    """Measure one code on one grid at one relative pressure."""

    def task(n: int) -> Callable[[], Answer]:
        mean_pressure = pressure * CONTACT_MODULUS * RMS_SLOPE
        return partial(code.solve, scene_surface(n), mean_pressure, CONTACT_MODULUS)

    return measure(task(points), warm_up=task(POINTS[0]), repeats=repeats)


def _rows(
    codes: Mapping[str, Code], runs: Runs, points: tuple[int, ...]
) -> list[dict[str, float | str]]:
    """Join the runs with their errors."""
    rms_height = float(scene_surface(POINTS[0]).heights.std())
    small_slope = [code.small_slope for code in codes.values()]
    rows: list[dict[str, float | str]] = []
    for pressure in dict.fromkeys(key[0] for key in runs):
        gaps, areas = np.array([_values(runs[pressure, name]) for name in codes]).swapaxes(0, 1)
        gap_limits = np.array([extrapolate(gap) for gap in gaps])
        area_limits = np.array([extrapolate(area, order=1.0) for area in areas])
        gap, gap_uncertainty = common_reference(gap_limits[small_slope], gaps[small_slope, -1])
        area, area_uncertainty = common_reference(area_limits[small_slope], areas[small_slope, -1])
        for i, name in enumerate(codes):
            for k, measured in enumerate(runs[pressure, name]):
                rows.append(
                    _cost(measured)
                    | {
                        "scene": _scene(pressure),
                        "method": name,
                        "points": points[k],
                        "relative_pressure": pressure,
                        "mean_gap": gaps[i, k],
                        "contact_fraction": areas[i, k],
                        "error": abs(gaps[i, k] - gap) / rms_height,
                        "own_error": abs(gaps[i, k] - gap_limits[i]) / rms_height,
                        "error_uncertainty": gap_uncertainty / rms_height,
                        "contact_error": abs(areas[i, k] / area - 1.0),
                        "own_contact_error": abs(areas[i, k] / area_limits[i] - 1.0),
                        "contact_error_uncertainty": area_uncertainty / area,
                    }
                )
    return rows


def _values(measured: list[Measured[Answer]]) -> np.ndarray:
    """Mean gap and contact fraction on each grid, shape (2, grids); NaN if not converged."""
    return np.array(
        [
            (run.value.mean_gap, run.value.contact_fraction)
            if run.value is not None and run.value.converged
            else (np.nan, np.nan)
            for run in measured
        ]
    ).T


def _cost(measured: Measured[Answer]) -> dict[str, float | str]:
    """Cost of a run; counts are 0 if its process died."""
    answer = measured.value
    return {
        "wall_time": measured.wall_time,
        "peak_memory": measured.peak_memory,
        "converged": int(answer is not None and answer.converged),
        "iterations": 0 if answer is None else answer.iterations,
        "unknowns": 0 if answer is None else answer.unknowns,
    }
