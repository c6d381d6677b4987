r"""Rough contact: this package and boundary-element codes on the same heights and pressures.

The surface is self-affine with waves 4 to 16 of a square cell, so that 32 points along an edge do
not carry it and 64 are the coarsest grid. All grids sample the same band-limited surface.
"""

from collections.abc import Callable, Iterable
from functools import partial
from importlib.util import find_spec

import numpy as np

from multiscale.bench.limits import common_reference, extrapolate
from multiscale.bench.peers import CODES, TOLERANCE, Code, ContactAnswer
from multiscale.bench.trials import BenchFamily, Columns, Runs, Trial
from multiscale.surfaces.surface import Surface

__all__ = ["CONTACT_MODULUS", "RMS_SLOPE", "plan_micro", "scene_surface"]

LENGTH = 1e-3  # m
CONTACT_MODULUS = 1e9
"""Pa."""
RMS_SLOPE = 0.1
RELATIVE_PRESSURES = (0.02, 0.1, 0.3)  # p / (E* h')
POINTS = (64, 128, 256, 512)
QUICK_RELATIVE_PRESSURES, QUICK_POINTS = (0.1,), (64, 128, 256)


def scene_surface(points: int) -> Surface:
    """Sample the surface of the scene on a grid of so many points along an edge, at least 33."""
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


def plan_micro(*, quick: bool) -> BenchFamily:
    r"""Plan to measure every installed code on every grid and pressure.

    If quick, one pressure, three grids and one run of each instead of three, four and the median of
    three.

    Notes
    -----
    *Errors* of the mean gap are relative to the root mean square height, errors of the contact
    fraction to the fraction. ``error`` and ``contact_error`` are distances from a common reference,
    the half-space problem for small slopes: the limit that was extrapolated least among the limits
    of the codes that solve this problem. Its uncertainty is the distance to the other limits.
    ``own_error`` and ``own_contact_error`` are distances from the limit of the code itself. The
    mesh of the conforming cell follows the surface, so that its distance from the common reference
    tends to the difference of the two models, which is of first order in the slope: contact is on
    the summits, softer than a half-space.

    *Limits* are Richardson's, with the observed order for the mean gap and order 1 for the contact
    fraction, whose error sits at the edges of the spots and is too irregular for more.

    *Times* count the way from heights to averages in a process of its own, after a solve on the
    coarsest grid that takes the imports and the compilation.
    """

    def task(code: Code, n: int, pressure: float) -> Callable[[], ContactAnswer]:
        mean_pressure = pressure * CONTACT_MODULUS * RMS_SLOPE
        return partial(code.solve, scene_surface(n), mean_pressure, CONTACT_MODULUS)

    return BenchFamily(
        [
            Trial(
                f"micro, p = {pressure:g} E* h'",
                name,
                task(code, n, pressure),
                task(code, POINTS[0], pressure),
                {"points": n, "relative_pressure": pressure},
                1 if quick else 3,
                left_out=""
                if find_spec(code.module)
                else "because it is not installed; pip install 'multiscale[bench]'",
            )
            for pressure in (QUICK_RELATIVE_PRESSURES if quick else RELATIVE_PRESSURES)
            for name, code in CODES.items()
            for n in (QUICK_POINTS if quick else POINTS)
        ],
        _judge,
        title="rough contact: mean gap and contact fraction",
        packages=tuple(code.module for code in CODES.values()),
        error="error of the mean gap over rms height",
        attributes={
            "surface": f"waves 4 to 16, H = 0.8, rms slope {RMS_SLOPE:g}, "
            f"E* = {CONTACT_MODULUS:g} Pa",
            "tolerance": TOLERANCE,
        },
    )


def _judge(scene: str, runs: Runs) -> Iterable[tuple[Trial, Columns]]:
    """Compare the codes with their common limit, and each with its own, NaN without an answer."""
    rms_height = float(scene_surface(POINTS[0]).heights.std())
    codes = list(dict.fromkeys(trial.method for trial in runs))
    values = np.array(
        [
            (run.value.mean_gap, run.value.contact_fraction)
            if run.value is not None and run.value.converged
            else (np.nan, np.nan)
            for run in runs.values()
        ]
    )
    gaps, areas = values.reshape(len(codes), -1, 2).transpose(2, 0, 1)
    small_slope = [CODES[name].small_slope for name in codes]
    gap_limits = np.array([extrapolate(gap) for gap in gaps])
    area_limits = np.array([extrapolate(area, order=1.0) for area in areas])
    gap, gap_uncertainty = common_reference(gap_limits[small_slope], gaps[small_slope, -1])
    area, area_uncertainty = common_reference(area_limits[small_slope], areas[small_slope, -1])
    for (mean_gap, fraction), (trial, run) in zip(values, runs.items(), strict=True):
        own = codes.index(trial.method)
        answer: ContactAnswer | None = run.value
        columns: Columns = {
            "mean_gap": mean_gap,
            "contact_fraction": fraction,
            "error": abs(mean_gap - gap) / rms_height,
            "own_error": abs(mean_gap - gap_limits[own]) / rms_height,
            "error_uncertainty": gap_uncertainty / rms_height,
            "contact_error": abs(fraction / area - 1.0),
            "own_contact_error": abs(fraction / area_limits[own] - 1.0),
            "contact_error_uncertainty": area_uncertainty / area,
        }
        if answer is not None:
            columns |= {
                "converged": int(answer.converged),
                "iterations": answer.iterations,
                "unknowns": answer.unknowns,
            }
        yield trial, columns
