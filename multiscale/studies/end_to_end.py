"""From cells to a structure and back: the law's answer against the roughness resolved."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.schema import END_TO_END, Dataset
from multiscale.studies.rough_structure import (
    CELL_WAVES,
    RoughStructure,
    StructureOutcome,
    answer_of,
    solve_concurrent,
    solve_direct,
    solve_sequential,
)
from multiscale.studies.rough_wave import RoughWave
from multiscale.upscaling import estimate_grid_error

__all__ = ["CASES", "PARTS", "EndToEndCase", "end_to_end"]

PARTS = (
    "sampling",
    "cell size",
    "fit",
    "remainder",
    "discretisation of the law",
    "discretisation resolved",
)
"""Labels of the dimension ``error_term``; the parts add up to the gap error."""

FEWEST_PER_GRID = 3  # realisations that tell the error of a grid, on the same surfaces
FITTED = 8  # cells that tell the error of the fit
GROUPS = 10  # of seeds, left out in turn

Part = tuple[float, float]
"""A part of the relative error of the gap, and its standard error."""


@dataclass(frozen=True)
class EndToEndCase:
    r"""How much to compute at one ratio of scales.

    Parameters
    ----------
    ratio : float, :math:`\varepsilon`, longest wave over the length of the structure
    cells : int, cells of four longest waves that the law is fitted to
    realisations : int
        Structures resolved, and cells as large as the structure with the same surfaces.
    points_per_wave : int, grid points per shortest wave, of cells and structures alike

    Raises
    ------
    CaseError
        If there are fewer than three cells or realisations.
    """

    ratio: float
    cells: int
    realisations: int
    points_per_wave: int = 8

    def __post_init__(self) -> None:
        for name in ("cells", "realisations"):
            if getattr(self, name) < FEWEST_PER_GRID:
                raise CaseError(
                    f"{name} must be at least {FEWEST_PER_GRID}, so that there is a scatter, got "
                    f"{getattr(self, name)}"
                )


CASES = (
    EndToEndCase(1 / 4, cells=40, realisations=40),
    EndToEndCase(1 / 8, cells=40, realisations=16),
    EndToEndCase(1 / 16, cells=40, realisations=8),
    EndToEndCase(1 / 32, cells=40, realisations=6, points_per_wave=4),
)
"""With these the standard error of the gap error of a rough wave is below 0.7 %."""


def end_to_end(
    cases: Sequence[EndToEndCase] = CASES, *, report: Callable[[str], None] = lambda line: None
) -> Dataset:
    r"""Compare the sequential way with the direct one, and part the difference.

    Parameters
    ----------
    cases : sequence of EndToEndCase, ten minutes in all, if not given
    report : callable, gets a line after each case

    Returns
    -------
    Dataset, follows ``END_TO_END``

    Notes
    -----
    With the mean gap S of the structure with the law and D, the mean over the realisations,
    resolved, the error is :math:`e = S/D - 1`. Cell k and structure k have one seed. The parts,
    whose sum is e:

    - *sampling*: of unknown sign, 0 with the standard error of S, about the coefficient of
      variation of the cells over the root of their number;
    - *cell size*: S with the law of cells of four longest waves, less S' with that of cells as
      large as the structure;
    - *fit*: S with the law of one cell, less the answer of the concurrent way with the same cell,
      the mean over eight: more than that of a law fitted to all, whose data are smoother;
    - *remainder*: what the other parts leave of :math:`S'/D - 1`, the *paired error*, in which law
      and structure have the very same surfaces: scale separation, which is not computed by itself,
      and the errors of the other parts;
    - *discretisation* of the law (grid of the cells and points of the structure) and of what is
      resolved, by :func:`~multiscale.upscaling.estimate_grid_error` from the same surfaces with
      twice the points.

    Standard errors are those of a jackknife that leaves ten groups of seeds out in turn, cells and
    structures of a seed together where both have the same surface.
    """
    rows = []
    for case in cases:
        begin = perf_counter()
        rows.append(_compare(RoughWave(case.ratio), case))
        rows[-1]["wall_time"] = perf_counter() - begin
        report(
            f"scale ratio 1/{round(1.0 / case.ratio)}: gap error "
            f"{100.0 * rows[-1]['gap_error']:+.2f} % with a standard error of "
            f"{100.0 * rows[-1]['gap_error_uncertainty']:.2f} %"
        )
    return END_TO_END.build(
        {name: np.array([row[name] for row in rows]) for name in rows[0]},
        title="sequential against direct",
        structure=RoughWave.__name__,
    ).assign_coords(error_term=list(PARTS))


def _compare(structure: RoughStructure, case: EndToEndCase) -> dict[str, Any]:
    px, seeds = case.points_per_wave, range(case.realisations)
    cells = solve_sequential(structure, range(case.cells), points_per_wave=px)
    direct = solve_direct(structure, seeds, points_per_wave=px)
    D = direct.mean_gap
    scatter = float(np.std(direct.gaps, ddof=1)) / D
    by_group = _gaps_by_group(structure, cells)
    sampling = _jackknife(by_group) / D
    if structure.waves == CELL_WAVES and case.cells == case.realisations:
        large, large_by_group, size = cells, by_group, (0.0, 0.0)
    else:
        large = solve_sequential(structure, seeds, points_per_wave=px, waves=structure.waves)
        large_by_group = _gaps_by_group(structure, large)
        spread = np.hypot(sampling, _jackknife(large_by_group) / D)
        size = (cells.mean_gap - large.mean_gap) / D, float(spread)
    direct_by_group = np.array([np.mean(direct.gaps[kept]) for kept in _groups(len(seeds))])
    paired = large.mean_gap / D - 1.0, _jackknife(large_by_group / direct_by_group)
    error = cells.mean_gap / D - 1.0, float(np.hypot(sampling, scatter / np.sqrt(len(seeds))))
    if large is cells:
        error = paired
    few = range(min(FITTED, case.cells))
    solved = solve_concurrent(structure, few, points_per_wave=px)
    fit = _mean_part(_single_gaps(structure, cells, len(few)) - solved.gaps, D)
    grid = _law_grid_part(structure, cells, px, D)
    fine = solve_direct(structure, range(FEWEST_PER_GRID), points_per_wave=2 * px)
    resolved = _doubled(direct.gaps[:FEWEST_PER_GRID], fine.gaps, D)
    known = (fit, grid, (-resolved[0], resolved[1]))
    remainder = (
        paired[0] - sum(part[0] for part in known),
        float(np.linalg.norm([paired[1], *(part[1] for part in known)])),
    )
    parts = [(0.0, sampling), size, fit, remainder, *known[1:]]
    answer, x = cells.answers[0], direct.answers[0].position
    resolved_pressure = np.mean([one.pressure for one in direct.answers], axis=0)
    period = x[-1] + x[1] - 2.0 * x[0]
    expected = np.interp(x, answer.position, answer.pressure, period=period)
    apart = np.linalg.norm(expected - resolved_pressure)
    return {
        "scale_ratio": case.ratio,
        "points_per_wave": px,
        "cells": case.cells,
        "realisations": case.realisations,
        "gap_law": cells.mean_gap / structure.rms_height,
        "gap_direct": D / structure.rms_height,
        "gap_scatter": scatter,
        "gap_error": error[0],
        "gap_error_uncertainty": error[1],
        "paired_error": paired[0],
        "paired_error_uncertainty": paired[1],
        "area_law": answer.contact_fraction,
        "area_direct": float(np.mean([one.contact_fraction for one in direct.answers])),
        "pressure_error": float(apart / np.linalg.norm(resolved_pressure)),
        "error_part": [part[0] for part in parts],
        "error_part_uncertainty": [part[1] for part in parts],
    }


def _groups(n: int) -> list[np.ndarray]:
    """Return the indices that are left when one group of seeds is taken out, for each group."""
    left_out = np.array_split(np.arange(n), min(n, GROUPS))
    return [np.setdiff1d(np.arange(n), group) for group in left_out]


def _gaps_by_group(structure: RoughStructure, way: StructureOutcome) -> np.ndarray:
    """Mean gap with the law of the cells that are left without a group, m."""
    kept = _groups(way.response.sizes["realisation"])
    laws = [way.response.isel(realisation=k) for k in kept]
    return np.array([answer_of(structure, one).mean_gap for one in laws])


def _jackknife(by_group: np.ndarray) -> float:
    """Return the standard error of an estimate from those that leave one group of seeds out."""
    return float(np.sqrt((by_group.size - 1) * np.var(by_group)))


def _law_grid_part(structure: RoughStructure, cells: StructureOutcome, px: int, D: float) -> Part:
    """Grid of the cells and points of the structure."""
    fine = solve_sequential(structure, range(FEWEST_PER_GRID), points_per_wave=2 * px)
    micro = _doubled(
        _single_gaps(structure, cells, FEWEST_PER_GRID),
        _single_gaps(structure, fine, FEWEST_PER_GRID),
        D,
    )
    gaps = [answer_of(structure, cells.response, refined).mean_gap for refined in (1, 2)]
    macro = _doubled(np.array(gaps[:1]), np.array(gaps[1:]), D)
    return micro[0] + macro[0], micro[1]


def _single_gaps(structure: RoughStructure, way: StructureOutcome, n: int) -> np.ndarray:
    """Mean gap with the laws of the first n cells, one by one, m."""
    single = [answer_of(structure, way.response.isel(realisation=[k])) for k in range(n)]
    return np.array([answer.mean_gap for answer in single])


def _doubled(coarse: np.ndarray, fine: np.ndarray, D: float) -> Part:
    """Error of a grid from the same answers with twice the points."""
    error = estimate_grid_error(fine, {2.0: coarse}).error + (coarse - fine)
    return _mean_part(error, D)


def _mean_part(difference: np.ndarray, D: float) -> Part:
    """Mean of paired differences and its standard error, relative to D."""
    n = difference.size
    uncertain = float(np.std(difference, ddof=1)) / np.sqrt(n) / D if n > 1 else 0.0
    return float(np.mean(difference)) / D, uncertain
