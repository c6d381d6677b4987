r"""Prior of a calibration: the law of the cells, with the parameters that measured joints correct.

The stiffness has the leading modes :math:`\varphi_k` of the covariance of the logarithm, by the
samples of the law and a discrepancy between cells and joints, and the logarithm :math:`\sigma` of
the factor of all heights:

.. math:: \ln K(x) = m(x - \sigma) + \sum_k \theta_k \varphi_k(x), \qquad x = \ln p.    \tag{1}
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from multiscale.errors import CaseError
from multiscale.schema import Dataset
from multiscale.upscaling.branches import tangential_values
from multiscale.upscaling.budget import NORMAL
from multiscale.upscaling.measured.joints import Answer, BedCurve, Curve, MeasuredJoint
from multiscale.upscaling.posterior import Mode
from multiscale.upscaling.posterior_law import DATA_POINTS
from multiscale.upscaling.reading import fitted_laws, pick, require_law
from multiscale.upscaling.sampling import widening

HEIGHTS = "factor of the heights"
UNITS = {"frame": "m/Pa", "offset": "Pa", "zero": "m"}  # of nuisances

FRICTION, RATIO = 0.5, 0.12
"""Half-widths of the 95 % intervals of the prior, of the logarithms of friction and stiffness
ratio: the friction of points of contact is an input of the cells."""

GRID, BELOW, ABOVE = 400, 7.0, 0.8  # points of the grid over x; beyond the data on both sides

VARIANCE = 0.995  # of the logarithm of the stiffness, that the modes contain


class CalibratedParameter(NamedTuple):
    """A parameter of the law, or a nuisance, before and after calibration."""

    name: str
    unit: str  # of value and half-widths, SI
    prior: float
    prior_half_width: float  # of the 95 % interval
    value: float
    half_width: float
    learned: float  # share of the prior variance that the data remove
    pull: float  # standard deviations by which the data move it


@dataclass(frozen=True, eq=False)
class Prior:
    """Whitened parameters: modes, heights, stiffness ratio, friction, nuisances of the tables."""

    x: np.ndarray  # grid, logarithm of the pressure
    mean: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # m(x) and its slope
    modes: np.ndarray  # (modes, points), of ln K, scaled by their deviations
    names: tuple[str, ...]
    units: tuple[str, ...]
    scale: np.ndarray  # deviation of every parameter, in its unit or of its logarithm
    middle: np.ndarray  # value before calibration of parameters with a logarithm, 0 of others
    heights: slice  # places of the parameters, empty where they are certain
    shear: slice

    @classmethod
    def of(
        cls,
        law: Dataset,
        measured: Sequence[MeasuredJoint],
        roughness: float,
        discrepancy: tuple[float, float],
        cells: float | None,
    ) -> "Prior":
        """Collect the parameters from the law and the tables."""
        from scipy.interpolate import CubicSpline

        require_law(law, "pressure_min", "pressure_max", "n_realisations")
        ends = [float(np.log(law.attrs[f"pressure_{end}"])) for end in ("min", "max")]
        data = np.linspace(ends[0], ends[1], DATA_POINTS)
        p = np.exp(data)
        laws = fitted_laws(law, [None, *range(int(law.sizes.get("sample", 0)))])
        middle, *drawn = (np.log(normal.stiffness(normal.gap_at(p))) for normal in laws)
        # (1), linear beyond the data
        spline = CubicSpline(data, middle)

        def mean(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            inside = np.clip(x, ends[0], ends[1])
            slope = spline(inside, 1)
            return spline(inside) + slope * (x - inside), slope

        # covariance of the samples, of few cells, and of the discrepancy; its leading modes
        x, centred = pressure_grid(law), data - data.mean()
        level, bend = np.array(discrepancy) / NORMAL
        covariance = level**2 + bend**2 * np.outer(centred, centred)
        if len(drawn) > 1:
            covariance += _covariance_of_cells(law, np.cov(np.array(drawn).T), cells)
        modes = np.array([np.interp(x, data, mode) for mode in _leading(covariance)])
        # name, unit, deviation and value of every parameter
        n = len(modes)
        listed = [(f"form of the law, mode {k + 1}", "1", 1.0, 0.0) for k in range(n)]
        if roughness > 0.0:
            listed.append((HEIGHTS, "1", roughness / NORMAL, 1.0))
        heights = slice(n, len(listed))
        if len(shears := tangential_values(law)) == 2:
            listed += _shear_parameters(law, shears)
        shear = slice(heights.stop, len(listed))
        for k, table in enumerate(measured, 1):
            listed += [
                (f"{name} of {k}, {table.name}", UNITS[name], width, 0.0)
                for name, width in table.nuisances.items()
            ]
        if not listed:
            raise CaseError(
                "no parameter of the law is uncertain, so measured values have no effect; give a "
                "roughness or a discrepancy above 0"
            )
        names, units, scale, before = zip(*listed, strict=True)
        modes = modes.reshape(n, x.size)
        return cls(x, mean, modes, names, units, np.array(scale), np.array(before), heights, shear)

    @property
    def sheared(self) -> bool:
        """Whether the law has friction and stiffness ratio."""
        return bool(self.shear.stop > self.shear.start)

    def interface(self, theta: np.ndarray) -> BedCurve:
        """Return the law by parameters, with its rates by modes and by heights, if uncertain."""
        width = self.scale[self.heights]
        middle, slope = self.mean(self.x - width @ theta[self.heights])
        log_stiffness = middle + theta[: len(self.modes)] @ self.modes
        rates = np.vstack([self.modes, -width[:, None] * slope])
        ratio, friction = 1.0, 1.0  # without influence
        if self.sheared:
            ratio, friction = self.middle[self.shear] * np.exp(
                self.scale[self.shear] * theta[self.shear]
            )
        return BedCurve(Curve(self.x, log_stiffness, rates).rising(), float(ratio), float(friction))

    def factors_of_heights(self, theta: np.ndarray) -> np.ndarray:
        """Return the factors of the heights of rows of parameters."""
        return np.asarray(np.exp(theta[:, self.heights] @ self.scale[self.heights]))

    def residual(
        self, theta: np.ndarray, measured: Sequence[MeasuredJoint], answer: Answer
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return all residuals over their deviations, and their derivatives."""
        interface = self.interface(theta)
        m, at, residuals, rows = self.heights.stop, self.shear.stop, [], []
        for table in measured:
            place = slice(at, at + len(table.nuisances))
            given = dict(zip(table.nuisances, self.scale[place] * theta[place], strict=True))
            value, gradient = answer(table, interface, given)
            row = np.zeros((value.size, theta.size))
            row[:, :m] = gradient[:, :m]
            if self.sheared:
                row[:, self.shear] = gradient[:, m : m + 2] * self.scale[self.shear]
            row[:, place] = gradient[:, m + 2 :] * self.scale[place]
            residuals.append((value - table.value) / table.deviation)
            rows.append(row / table.deviation[:, None])
            at = place.stop
        return np.concatenate(residuals), np.concatenate(rows)

    def parameters(self, mode: Mode) -> Iterator[CalibratedParameter]:
        """Yield the parameters in their units before and after calibration."""
        data = (self.x >= self.x[0] + BELOW) & (self.x <= self.x[-1] - ABOVE)
        scale = self.scale.copy()  # of modes as the root mean square of ln K over the data
        scale[: len(self.modes)] = np.sqrt(np.mean(self.modes[:, data] ** 2, axis=1))
        logarithmic, step = self.middle > 0.0, scale * mode.theta
        value = np.where(logarithmic, self.middle * np.exp(np.where(logarithmic, step, 0.0)), step)
        before, after = (
            NORMAL * scale * np.where(logarithmic, size, 1.0) for size in (self.middle, value)
        )
        after *= np.sqrt(np.diag(mode.covariance))
        columns = (self.middle, before, value, after, mode.learned, mode.pull)
        for name, unit, *row in zip(self.names, self.units, *columns, strict=True):
            yield CalibratedParameter(name, unit, *map(float, row))


def pressure_grid(law: Dataset) -> np.ndarray:
    """Return the logarithms of pressures of curves of stiffness, about the data of a law."""
    low, high = (np.log(law.attrs[f"pressure_{end}"]) for end in ("min", "max"))
    return np.linspace(low - BELOW, high + ABOVE, GRID)


def _covariance_of_cells(law: Dataset, sampled: np.ndarray, cells: float | None) -> np.ndarray:
    """Return the covariance of the mean law, and of a joint with a number of cells about it."""
    if cells is None:
        return sampled
    n = int(law.attrs["n_realisations"])
    if "n_control" not in law.attrs:
        return (1.0 + n / cells) * sampled
    require_law(law, "cell_scatter")
    scatter = law["cell_scatter"].sel(quantity="stiffness").to_numpy()
    variance = widening(n - 1) ** 2 * np.nanmean(scatter**2) / cells
    mean = float(np.diag(sampled).mean())
    # the scatter is of the level only where the samples are all alike
    return np.asarray(sampled * (1.0 + variance / mean) if mean > 0.0 else sampled + variance)


def _leading(covariance: np.ndarray) -> np.ndarray:
    """Return the leading eigenvectors of a covariance, scaled by their deviations, as rows."""
    value, vector = np.linalg.eigh(covariance)
    value, vector = value[::-1], vector[:, ::-1]
    share = np.cumsum(value) / max(value.sum(), 1e-300)
    n = int(np.searchsorted(share, VARIANCE)) + 1 if value[0] > 1e-12 else 0
    return np.asarray((np.sqrt(value[:n]) * vector[:, :n]).T)


def _shear_parameters(
    law: Dataset, shears: Mapping[str, float]
) -> Iterator[tuple[str, str, float, float]]:
    """Yield name, unit, deviation of the logarithm and value of stiffness ratio and friction."""
    for short, name, width in (
        ("stiffness_ratio", "stiffness ratio", RATIO),
        ("friction", "friction coefficient", FRICTION),
    ):
        samples = range(int(law.sizes.get("shear_sample", 0)))
        drawn = [np.nanmean(value) for value in pick(law, f"shear_{short}", samples, of="shear")]
        scatter = float(np.std(drawn)) / shears[short] if drawn else 0.0
        yield name, "1", float(np.hypot(scatter, width / NORMAL)), shears[short]
