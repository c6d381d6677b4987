"""Cost and error of a choice of cells, forecast from the cells that have been computed."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from multiscale.errors import CaseError
from multiscale.upscaling.budget import ERROR_TERMS, add_terms, total_error

SIZES = range(-1, 5)
GRIDS = range(3)
COARSE = -1
"""Grid of flat cells; some cells on finer grids lead to the finest grid of a setting."""

REALISATIONS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 40, 48, 64, 96, 128)
CONTROLS = (16, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768, 1024)
GROWTH = 1.25
"""Power of the unknowns in the time of a cell: iterations grow with the grid, and caches fill."""


@dataclass(frozen=True, order=True)
class Setting:
    """Size, grid and number of cells that a planner chooses."""

    size: float
    """The edges are 2^size times the edges of the case, and so is a depth that is not given."""
    grid: float  # the finest spacing is 2^-grid times the spacing of the case
    realisations: int
    control: int = 0  # flat control cells, the first of which have the same surfaces

    def __str__(self) -> str:
        """Return the setting in words."""
        controls = f", {self.control} control cells" if self.control else ""
        return (
            f"cells {2.0**self.size:g} times as large, spacing down to {2.0**-self.grid:g} times, "
            f"{self.realisations} realisations{controls}"
        )


@dataclass(frozen=True, eq=False)
class Estimate:
    """The error budget of one quantity at one setting."""

    setting: Setting
    half_width: np.ndarray  # shape (terms, steps), relative, NaN where not known
    bias: np.ndarray  # likewise
    cheap: float = 0.0  # share of the cheap cells in the square of the sampling error

    @property
    def total(self) -> float:
        """Largest total over the steps, relative; NaN where a term of a step is not known."""
        given = np.isfinite(self.half_width).any(axis=1).tolist()
        return float(np.max(add_terms(self.half_width[None], self.bias[None], given)))

    def at(self, setting: Setting) -> "Estimate":
        r"""Return the estimate that is expected at another setting.

        Notes
        -----
        From the setting :math:`(s_0, g_0, R_0, M_0)` of the estimate, half-widths change by

        .. math::
            \text{sampling}\ \sqrt{(1 - c)\, R_0/R + 4^{s_0 - s} c\, M_0/M}, \quad
            \text{cell size}\ 2^{s_0 - s}, \quad \text{micro discretisation}\ 2^{g_0 - g},

        with the share c of the cheap cells; without any, sampling by
        :math:`2^{s_0 - s} \sqrt{R_0/R}`, and
        the bias of the cell size by :math:`2^{s_0 - s}`; the other terms stay.
        """
        now = self.setting
        larger = 2.0 ** (now.size - setting.size)
        factor = np.ones((len(ERROR_TERMS), 1))
        variance = (1.0 - self.cheap) * now.realisations / setting.realisations
        if self.cheap > 0.0:  # and the pairs do not grow
            variance += larger**2 * self.cheap * now.control / setting.control
        else:
            variance *= larger**2
        factor[ERROR_TERMS.index("sampling")] = np.sqrt(variance)
        factor[ERROR_TERMS.index("cell size")] = larger
        factor[ERROR_TERMS.index("micro discretisation")] = 2.0 ** (now.grid - setting.grid)
        return replace(
            self, setting=setting, half_width=factor * self.half_width, bias=larger * self.bias
        )


@dataclass(frozen=True)
class CostModel:
    """Time of a cell: a constant, and a share that grows with the number of unknowns."""

    fixed: float  # constant, s
    time: float  # growing share of a cell of the case, s
    layered: bool  # whether the unknowns fill the depth, so that they grow with its layers

    @classmethod
    def fit(cls, times: Mapping[tuple[float, float], float], *, layered: bool) -> "CostModel":
        """Fit the times of cells, s, by (size, grid), with least relative errors."""
        from scipy.optimize import nnls

        unit, time = cls(0.0, 1.0, layered), np.array(list(times.values()))
        growing = np.array([unit.of_cell(*kind) for kind in times])
        columns = [np.ones(time.size), growing] if time.size > 1 else [growing]
        *fixed, slope = nnls(np.transpose(columns) / time[:, None], np.ones(time.size))[0]
        return cls(float(sum(fixed)), float(slope), layered)

    def seen(self, size: float, grid: float, time: float) -> "CostModel":
        """Scale all times by the time of a cell, s."""
        ratio = time / self.of_cell(size, grid)
        return CostModel(ratio * self.fixed, ratio * self.time, self.layered)

    def of_cell(self, size: float, grid: float) -> float:
        """Time of a cell, s."""
        unknowns = 4.0 ** (size + grid) * (2.0**grid if self.layered else 1.0)
        return float(self.fixed + self.time * unknowns**GROWTH)


def cheapest(
    estimate: Estimate,
    settings: Iterable[Setting],
    time_of: Callable[[Setting], float],
    target: float,
) -> Setting:
    """Choose the setting of least time among those that are expected to reach a target."""
    totals = {setting: estimate.at(setting).total for setting in settings}
    if reaching := [
        (time_of(setting), setting) for setting, total in totals.items() if total <= target
    ]:
        return min(reaching)[1]
    best = min(totals, key=lambda setting: (totals[setting], setting))
    near = estimate.at(best)
    sizes = np.nan_to_num(total_error(near.bias, near.half_width)).max(axis=1)
    largest = ERROR_TERMS[int(np.argmax(sizes))]
    raise CaseError(
        f"an error of {100.0 * target:.3g} % is out of reach: {best} are expected to leave "
        f"{100.0 * totals[best]:.3g} %, most of it by the {largest}; ask for "
        f"a larger target, or change what that comes from"
    )
