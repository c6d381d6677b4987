"""Cost and error of a choice of cells, forecast from the cells that have been computed."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from multiscale.errors import CaseError
from multiscale.upscaling.budget import ERROR_TERMS, add_up, total_error

__all__ = ["CostModel", "Estimate", "Setting", "cheapest"]

SIZES = range(-1, 5)
GRIDS = range(-1, 3)
REALISATIONS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 40, 48, 64, 96, 128)
STUDIES = (1, 2, 4, 8)
GROWTH = 1.25
"""Power of the unknowns in the time of a cell: iterations grow with the grid, and caches fill."""


@dataclass(frozen=True, order=True)
class Setting:
    """What a planner may choose.

    Attributes
    ----------
    size : float
        The cell is :math:`2^s` times as large as that of the case, and so is its depth if the
        case gives none; a whole number, but for stored cells.
    grid : float, the spacing is :math:`2^{-g}` times that of the case; likewise
    realisations : int
    study : int
        How many times the cells of the pilot runs tell the scatter and the bias by the size.
    """

    size: float
    grid: float
    realisations: int
    study: int = 1

    def __str__(self) -> str:
        """Return the setting in words."""
        return (
            f"cells {2.0**self.size:g} times as large, spacing {2.0**-self.grid:g} times, "
            f"{self.realisations} realisations"
        )


@dataclass(frozen=True, eq=False)
class Estimate:
    """The error budget of one quantity at one setting.

    Attributes
    ----------
    setting : Setting
    half_width, bias : ndarray, shape (terms, steps)
        See ``ERROR_BUDGET``; relative, NaN where not known.
    """

    setting: Setting
    half_width: np.ndarray
    bias: np.ndarray

    @property
    def total(self) -> float:
        """Largest total over the steps, relative; NaN where a term of a step is not known."""
        given = np.isfinite(self.half_width).any(axis=1).tolist()
        return float(np.max(add_up(self.half_width[None], self.bias[None], given)))

    def at(self, setting: Setting) -> "Estimate":
        r"""Return what is expected at another setting.

        Notes
        -----
        From the setting :math:`(s_0, g_0, N_0, k_0)` of the estimate, half-widths change by

        .. math::
            \text{sampling}\ 2^{s_0 - s} \sqrt{N_0/N}, \quad
            \text{cell size}\ 2^{s_0 - s} \sqrt{k_0/k}, \quad
            \text{micro discretisation}\ 2^{g_0 - g},

        the bias of the cell size by :math:`2^{s_0 - s}`; the other terms stay.
        """
        own = self.setting
        larger = 2.0 ** (own.size - setting.size)
        factor = np.ones((len(ERROR_TERMS), 1))
        factor[ERROR_TERMS.index("sampling")] = larger * np.sqrt(
            own.realisations / setting.realisations
        )
        factor[ERROR_TERMS.index("cell size")] = larger * np.sqrt(own.study / setting.study)
        factor[ERROR_TERMS.index("micro discretisation")] = 2.0 ** (own.grid - setting.grid)
        return Estimate(setting, factor * self.half_width, larger * self.bias)


@dataclass(frozen=True)
class CostModel:
    """Time of a cell: a part that every cell takes, and one that grows with its unknowns.

    Attributes
    ----------
    fixed : float, of every cell, s
    time : float, beyond that, of a cell of the case as it is, s
    layered : bool, whether unknowns fill the depth, so that they grow with its layers
    """

    fixed: float
    time: float
    layered: bool

    @classmethod
    def fit(cls, times: Mapping[tuple[float, float], float], *, layered: bool) -> "CostModel":
        """Fit the times of cells, s, by (size, grid), with least relative errors."""
        from scipy.optimize import nnls

        unit, time = cls(0.0, 1.0, layered), np.array(list(times.values()))
        growing = np.array([unit.of_cell(*kind) for kind in times])
        columns = [np.ones(time.size), growing] if time.size > 1 else [growing]
        *fixed, slope = nnls(np.transpose(columns) / time[:, None], np.ones(time.size))[0]
        return cls(float(sum(fixed)), float(slope), layered)

    def seen(self, setting: Setting, time: float) -> "CostModel":
        """Scale all times by the time of a cell of a setting, s."""
        ratio = time / self.of_cell(setting.size, setting.grid)
        return CostModel(ratio * self.fixed, ratio * self.time, self.layered)

    def of_cell(self, size: float, grid: float) -> float:
        """Time of a cell, s."""
        unknowns = 4.0 ** (size + grid) * (2.0**grid if self.layered else 1.0)
        return float(self.fixed + self.time * unknowns**GROWTH)


def cheapest(
    estimate: Estimate,
    costs: CostModel,
    done: Mapping[tuple[float, float], int],
    study: Mapping[tuple[float, float], int],
    target: float,
    limits: tuple[range, range],
    fewest: int = 1,
) -> tuple[Setting, float]:
    """Choose the setting of least time among those that are expected to reach a target.

    Parameters
    ----------
    estimate, costs : Estimate, CostModel
        What is known.
    done : dict
        Realisations that are there by (size, grid); they cost nothing.
    study : dict
        Cells of the pilot runs by (size, grid), of which a study takes a multiple; empty if they
        are stored and cannot become more.
    target : float
        Relative.
    limits : tuple of range
        Sizes and grids that can be had.
    fewest : int
        Realisations at least.

    Returns
    -------
    tuple of Setting and float
        And its expected time, s, of what is not there yet.

    Raises
    ------
    CaseError
        If no setting is expected to reach the target; the message says how near one comes.
    """
    found: list[tuple[float, Setting]] = []
    best = (np.inf, estimate.setting)
    studies = STUDIES if study else (estimate.setting.study,)
    for size, grid, n, many in product(*limits, REALISATIONS, studies):
        if many < estimate.setting.study or n < fewest:
            continue
        setting = Setting(size, grid, n, many)
        total = estimate.at(setting).total
        best = min(best, (total, setting))
        if total <= target:
            more = setting.realisations - done.get((setting.size, setting.grid), 0)
            time = max(0, more) * costs.of_cell(setting.size, setting.grid)
            extra = setting.study / estimate.setting.study - 1.0
            time += extra * sum(one * costs.of_cell(*key) for key, one in study.items())
            found.append((time, setting))
    if not found:
        near = estimate.at(best[1])
        sizes = np.nan_to_num(total_error(near.bias, near.half_width)).max(axis=1)
        largest = ERROR_TERMS[int(np.argmax(sizes))]
        raise CaseError(
            f"an error of {100.0 * target:.3g} % is out of reach: {best[1]} are expected to leave "
            f"{100.0 * best[0]:.3g} %, most of it by the {largest}; ask for "
            f"a larger target, or change what that comes from"
        )
    time, setting = min(found)
    return setting, time
