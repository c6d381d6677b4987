"""Three ways to one answer: sequential, concurrent and direct, their errors and times."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError
from multiscale.schema import WORK_PRECISION, Dataset
from multiscale.studies.rough_structure import (
    RoughStructure,
    solve_concurrent,
    solve_direct,
    solve_sequential,
)
from multiscale.studies.rough_wave import RoughWave
from multiscale.studies.tilted_joint import TiltedJoint
from multiscale.upscaling import estimate_grid_error

__all__ = ["EFFORTS", "QUICK_EFFORTS", "Effort", "three_ways"]

SCENES: dict[str, Callable[[float], RoughStructure]] = {
    "rough wave": RoughWave,
    "joint of two blocks": TiltedJoint,
}
COARSEST = 4  # points per shortest wave of a structure resolved


@dataclass(frozen=True)
class Effort:
    r"""How much to compute at one ratio of scales.

    Parameters
    ----------
    ratio : float, :math:`\varepsilon`, longest wave over the length of the structure
    realisations : int, structures, and so errors, at least 2
    finest : int, points per shortest wave of the reference: 4 times a power of 2, at least 8

    Raises
    ------
    CaseError
        If a number is too small, or the finest grid is not of this kind.
    """

    ratio: float
    realisations: int
    finest: int = 8

    def __post_init__(self) -> None:
        if self.realisations < 2:
            raise CaseError(f"realisations must be at least 2, got {self.realisations}")
        doublings = np.log2(self.finest / COARSEST) if self.finest > 0 else 0.0
        if doublings < 1.0 or doublings % 1.0:
            raise CaseError(
                f"finest must be {COARSEST} points per wave times a power of two, at least "
                f"{2 * COARSEST}, got {self.finest}"
            )


EFFORTS = (Effort(1 / 4, 8, 16), Effort(1 / 8, 6, 16), Effort(1 / 16, 4), Effort(1 / 32, 3))
QUICK_EFFORTS = (Effort(1 / 4, 2),)


def three_ways(
    efforts: Sequence[Effort] = EFFORTS,
    *,
    scenes: Sequence[str] = tuple(SCENES),
    cells: int = 8,
    points_per_wave: int = 8,
    report: Callable[[str], None] = lambda line: None,
) -> Dataset:
    r"""Solve rough structures with a law, with cells and resolved, and measure error and time.

    Parameters
    ----------
    efforts : sequence of Effort
        A quarter of an hour for both scenes, if not given; ``QUICK_EFFORTS`` are the other choice.
    scenes : sequence of str
        Of ``"rough wave"`` and ``"joint of two blocks"``; see :class:`RoughWave` and
        :class:`TiltedJoint`.
    cells : int, cells, of four longest waves, that a law is fitted to
    points_per_wave : int, grid points of cells per shortest wave
    report : callable, gets a line after each way

    Returns
    -------
    Dataset, follows ``WORK_PRECISION``

    Raises
    ------
    CaseError
        If a scene is unknown or a number too small.
    ConvergenceError
        If a way does not converge.

    Notes
    -----
    The answer is the mean gap. Its truth is that of each structure with its own surface: resolved
    on the finest grid, and extrapolated from there by
    :func:`~multiscale.upscaling.estimate_grid_error`, whose bound is the uncertainty of the
    reference. ``error`` is the root mean square, over the
    structures, of the relative error: a law, or a cell, does not know the surface at hand, and that
    counts. ``mean_error`` is the error of the mean over the structures, where it averages out,
    with its standard error.

    *Times* are those of one answer in this process, after a small answer that takes imports and
    compilation: of all cells with their fit and one solve, *sequential*; of this solve alone, *law
    at hand*, as for the next structure with the same roughness; of one solve with one cell pressed
    where it is asked for, *concurrent*; of one structure, *direct*.
    """
    unknown = sorted(set(scenes) - set(SCENES))
    if unknown or not efforts:
        raise CaseError(
            f"three_ways needs at least one effort and scenes of {list(SCENES)}, got {unknown}"
        )
    load = os.getloadavg()
    rows: list[dict[str, float | str]] = []
    for name in scenes:
        for way in (solve_sequential, solve_concurrent, solve_direct):  # imports and compilation
            way(SCENES[name](0.25), [0], points_per_wave=3)
        for effort in efforts:
            structure = SCENES[name](effort.ratio)
            for row in _measure(structure, effort, cells, points_per_wave):
                rows.append({"scene": name, **row})
                report(
                    f"{name}, 1/{structure.waves}, {row['method']}: error "
                    f"{100.0 * float(row['error']):.2f} %, {float(row['wall_time']):.3g} s, "
                    f"{float(row['cells_solved']):.0f} cells solved, "
                    f"{float(row['cells_reused']):.0f} times one reused"
                )
    return WORK_PRECISION.build(
        {name: np.array([row[name] for row in rows]) for name in rows[0]},
        title="three ways to one answer: mean gap of rough structures",
        cells=cells,
        load_before=load[0],
        load_after=os.getloadavg()[0],
        wall_time_counts="one answer in one process; without imports and compilation",
    )


def _measure(
    structure: RoughStructure, effort: Effort, cells: int, points_per_wave: int
) -> list[dict[str, float | str]]:
    seeds = range(effort.realisations)
    direct, px = {}, COARSEST
    while px <= effort.finest:
        direct[px] = solve_direct(structure, seeds, points_per_wave=px)
        px *= 2
    coarser = {effort.finest / n: way.gaps for n, way in direct.items() if n < effort.finest}
    estimate = estimate_grid_error(direct[effort.finest].gaps, coarser)
    truth = direct[effort.finest].gaps - estimate.error
    uncertainty = float(np.sqrt(np.mean((estimate.half_width / truth) ** 2)))
    law = solve_sequential(structure, range(cells), points_per_wave=points_per_wave)
    concurrent = solve_concurrent(structure, seeds, points_per_wave=points_per_wave)
    ways = [
        ("sequential", law, law.seconds),
        ("sequential, law at hand", law, law.solve_seconds),
        ("concurrent", concurrent, concurrent.seconds / len(seeds)),
        *(
            (f"direct, {px} points per wave", way, way.seconds / len(seeds))
            for px, way in direct.items()
            if px < effort.finest
        ),
    ]
    rows: list[dict[str, float | str]] = []
    for method, way, seconds in ways:
        difference = way.gaps - truth
        error = float(np.sqrt(np.mean((difference / truth) ** 2)))
        rows.append(
            {
                "method": method,
                "scale_ratio": effort.ratio,
                "realisations": len(seeds),
                "wall_time": seconds,
                "error": error,
                "error_uncertainty": uncertainty,
                "mean_error": abs(float(np.mean(difference) / np.mean(truth))),
                "mean_error_uncertainty": float(
                    np.std(difference, ddof=1) / np.sqrt(len(seeds)) / np.mean(truth)
                ),
                "cells_solved": way.solved / len(way.answers),
                "cells_reused": way.reused / len(way.answers),
                "converged": 1,
            }
        )
    return rows
