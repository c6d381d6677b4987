r"""The law of cells, corrected by measured joints, with its remaining uncertainty.

The prior of the stiffness is the law of the cells, with the leading modes :math:`\varphi_k` of the
covariance of the logarithm, by its samples and a discrepancy between cells and joints, and the
logarithm :math:`\sigma` of the factor of all heights:

.. math:: \ln K(x) = m(x - \sigma) + \sum_k \theta_k \varphi_k(x), \qquad x = \ln p.    \tag{1}
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from multiscale.errors import CaseError, ConvergenceError, require
from multiscale.executors import run_jobs
from multiscale.schema import Dataset
from multiscale.units import readable
from multiscale.upscaling.branches import tangential_values
from multiscale.upscaling.budget import NORMAL
from multiscale.upscaling.law_budget import DISCREPANCY, EXPONENT
from multiscale.upscaling.measured.joints import Answer, BedCurve, Curve, MeasuredJoint
from multiscale.upscaling.observations import list_pressures
from multiscale.upscaling.posterior import Draws, Mode, Residual, draw, find_mode
from multiscale.upscaling.posterior_law import DATA_POINTS, law_of_interfaces
from multiscale.upscaling.reading import fitted_laws, pick, refuse_band, require_law
from multiscale.upscaling.sampling import widening

HEIGHTS = "factor of the heights"
UNITS = {"frame": "m/Pa", "offset": "Pa", "zero": "m"}  # of nuisances

UNIT_TEXTS = {"Pa m-1": "Pa/m", "s-1": "Hz"}

FRICTION, RATIO = 0.5, 0.12
"""Half-widths of the 95 % intervals of the prior, of the logarithms of friction and stiffness
ratio: the friction of points of contact is an input of the cells."""

ROUGHNESS = 0.2  # default half-width of the factor of all heights

GRID, BELOW, ABOVE = 400, 7.0, 0.8  # points of the grid over x; beyond the data on both sides

VARIANCE = 0.995  # of the logarithm of the stiffness, that the modes contain

CANDIDATES, SAMPLES = 400, 200  # draws of the posterior, and samples of a law without any

OUTSIDE = 2.0  # factor of the pressures of a law up to which a preload is within its data

FAR, FEW = 3.0, 0.25  # standard deviations of a residual, and share of rows that may lie beyond

DISAGREES, LEARNS = 3.0, 0.05  # standard deviations of a pull; share of a variance

RELIABLE = 0.7  # shape of the tail of the weights


class Parameter(NamedTuple):
    """A parameter of the law, or a nuisance, before and after calibration."""

    name: str
    unit: str  # of value and half-widths, SI
    prior: float
    prior_half_width: float  # of the 95 % interval
    value: float
    half_width: float
    learned: float  # share of the prior variance that the data remove
    pull: float  # standard deviations by which the data move it


class MeasuredRow(NamedTuple):
    """A measured value with its prediction by the calibrated law."""

    table: str
    row: str  # such as "row 1", or "damping of row 1"
    pressure: float  # Pa
    unit: str
    measured: float
    predicted: float
    half_width: float  # of the 95 % interval of the prediction
    residual: float  # prediction less measured value, in standard deviations of the data
    weight: float  # 1 for a value near the law, small for an outlier


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated law, and how it follows from prior and data."""

    law: Dataset  # follows INTERFACE_LAW, with samples and budget of the posterior
    parameters: tuple[Parameter, ...]
    rows: tuple[MeasuredRow, ...]
    sentences: tuple[str, ...]  # parameters that disagree or are not learned, outliers
    effective: float  # number of independent draws
    solves: int  # of every table, for the mode


def calibrate(
    law: Dataset,
    measured: Sequence[MeasuredJoint],
    solve: Answer | None = None,
    *,
    roughness: float = ROUGHNESS,
    discrepancy: float = DISCREPANCY,
    exponent: float = EXPONENT,
    cells: float | None = None,
    extrapolate: bool = False,
    seed: int = 0,
) -> Calibration:
    r"""Calibrate a law of cells by measured joints.

    Parameters
    ----------
    law : Dataset
        Follows ``INTERFACE_LAW``; with friction and stiffness ratio, see :func:`assume_shear`, if a
        table depends on them.
    measured : sequence of MeasuredJoint, see :func:`read_measured`
    solve : callable, optional
        Values and gradient of a table by a law and by its nuisances, with the arguments and the
        result of :meth:`MeasuredJoint.answer`, which is taken if not given; see
        :func:`by_differences` for a structure without gradient.
    roughness, discrepancy, exponent : float
        Half-widths of the 95 % intervals of the logarithms of all heights and of the stiffness of
        joints about the law of their cells, and of its exponent over the pressure.
    cells : float, optional
        Number of cells in the nominal area of the joint; their scatter is then part of the prior.
    extrapolate : bool, whether preloads outside the pressures of the law are used

    Returns
    -------
    Calibration
        Samples of normal law, stiffness ratio and friction are drawn together, so that samples of
        the same number belong together. Other branches stay unchanged, also the shear branch if no
        table depends on it.

    Raises
    ------
    ConvergenceError
        If the parameters do not converge.

    Notes
    -----
    Gauss-Newton steps compute the mode, for data with Student's distribution; samples are drawn
    about it, and weighted. With ``solve``, or with tables of structures, they have the normal
    distribution of the linearised answers, so structures are solved for the mode only.
    """
    if cells is not None:
        require("cells", cells, "(0, inf)")
    _refuse_tables(measured, law, extrapolate)
    prior = _Prior.of(law, measured, roughness, (discrepancy, exponent), cells)
    answer = solve or (lambda table, *given: table.answer(*given))

    def residual(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return prior.residual(theta, measured, answer)

    mode = find_mode(residual, prior.scale.size)
    _refuse_contradiction(mode, measured)
    if not mode.settled:
        raise ConvergenceError(
            f"the parameters of the law do not converge in {mode.solves} solves; find rows that "
            f"contradict each other, or for an area far below the size of a cell, or state larger "
            f"errors"
        )
    # samples of the law, as many as the cells have
    count = int(law.sizes.get("sample", 0)) or SAMPLES
    linear = solve is not None or any(table.linear for table in measured)
    draws = _draws(mode, None if linear else residual, count, np.random.default_rng(seed))
    rows = tuple(_rows(mode, measured))
    sentences = tuple(_sentences(mode, prior, rows, draws))
    theta = np.vstack([mode.theta, draws.theta])
    calibrated = law_of_interfaces(
        law,
        [prior.interface(row) for row in theta],
        prior.factors_of_heights(theta),
        sentences,
        sheared=prior.sheared and (solve is not None or any(table.sheared for table in measured)),
    )
    calibrated.attrs["effective_draws"] = draws.effective
    parameters = tuple(prior.parameters(mode))
    return Calibration(calibrated, parameters, rows, sentences, draws.effective, mode.solves)


def _draws(mode: Mode, residual: Residual | None, count: int, random: np.random.Generator) -> Draws:
    """Draw weighted samples, or normal samples about the mode without a residual."""
    if residual is not None:
        return draw(residual, mode, max(CANDIDATES, 2 * count), count, random)
    normal = random.normal(size=(count, mode.theta.size))
    spread = normal @ np.linalg.cholesky(mode.covariance).T
    return Draws(mode.theta + spread, float(count), 0.0)


def predict_measured(law: Dataset, table: MeasuredJoint) -> tuple[np.ndarray, np.ndarray]:
    """Predict the values of a table by a law with samples, such as a calibrated law.

    Parameters
    ----------
    law : Dataset, follows ``INTERFACE_LAW``
    table : MeasuredJoint, of which the measured values are not used

    Returns
    -------
    value : ndarray, shape (rows,), by the mean law, in the unit of the table
    band : ndarray, shape (2, rows), ends of the 95 % intervals, by the samples
    """
    count = int(law.sizes.get("sample", 0))
    if refusal := refuse_band(law):
        raise CaseError(refusal)
    if table.sheared:
        require_law(law, "shear_stiffness_ratio", "shear_friction")
    low, high = (float(law.attrs[f"pressure_{end}"]) for end in ("min", "max"))
    x = np.linspace(np.log(low) - BELOW, np.log(high) + ABOVE, GRID)
    laws = fitted_laws(law, [None, *range(count)])
    shears = [(1.0, 1.0)] * len(laws)
    if table.sheared:
        drawn = [None, *range(min(count, int(law.sizes.get("shear_sample", 0))))]
        ratios, frictions = (
            [float(np.nanmean(value)) for value in pick(law, f"shear_{name}", drawn, of="shear")]
            for name in ("stiffness_ratio", "friction")
        )
        shears = list(
            zip(np.resize(ratios, len(laws)), np.resize(frictions, len(laws)), strict=True)
        )
    values = []
    for normal, (ratio, friction) in zip(laws, shears, strict=True):
        stiffness = normal.stiffness(normal.gap_at(np.exp(x)))
        curve = Curve(x, np.log(stiffness), np.empty((0, x.size)))
        values.append(table.answer(BedCurve(curve, ratio, friction), {})[0])
    return values[0], np.percentile(values[1:], [2.5, 97.5], axis=0)


def by_differences(
    values: Callable[[MeasuredJoint, BedCurve, Mapping[str, float]], np.ndarray],
    step: float = 1e-3,
    executor: Executor | None = None,
) -> Answer:
    """Return an answer with its gradient by central differences, two solves for each parameter.

    Parameters
    ----------
    values : callable
        Values of a table by a law and by its nuisances; workers must be able to import it.
    step : float
        Change of the curve along its rates, of the logarithms of stiffness ratio and friction, and
        of nuisances over their standard deviations.
    executor : Executor, optional, see :func:`multiscale.executors.run_jobs`
    """

    def answer(
        table: MeasuredJoint, interface: BedCurve, nuisances: Mapping[str, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        curve, ratio, friction = interface

        def moved(h: float) -> Iterator[tuple[BedCurve, Mapping[str, float]]]:
            for rate in curve.rates:
                stiffer = replace(curve, log_stiffness=curve.log_stiffness + h * rate)
                yield BedCurve(stiffer, ratio, friction), nuisances
            yield BedCurve(curve, ratio * np.exp(h), friction), nuisances
            yield BedCurve(curve, ratio, friction * np.exp(h)), nuisances
            for name, width in table.nuisances.items():
                yield interface, {**nuisances, name: nuisances[name] + h * width}

        inputs = [(interface, nuisances), *moved(step), *moved(-step)]
        solved: dict[int, np.ndarray] = {}
        jobs = ((k, (table, *given)) for k, given in enumerate(inputs))
        run_jobs(values, jobs, executor, solved.__setitem__)
        value, *changed = (solved[k] for k in range(len(inputs)))
        up, down = np.reshape(changed, (2, -1, value.size))
        widths = [1.0] * (len(curve.rates) + 2) + list(table.nuisances.values())
        return value, ((up - down) / (2.0 * step * np.array(widths)[:, None])).T

    return answer


@dataclass(frozen=True, eq=False)
class _Prior:
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
    ) -> "_Prior":
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
        x, centred = np.linspace(ends[0] - BELOW, ends[1] + ABOVE, GRID), data - data.mean()
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

    def parameters(self, mode: Mode) -> Iterator[Parameter]:
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
            yield Parameter(name, unit, *map(float, row))


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


def _refuse_tables(measured: Sequence[MeasuredJoint], law: Dataset, extrapolate: bool) -> None:
    """Refuse no tables, tables of branches without a law, and preloads outside its pressures."""
    if not measured:
        raise CaseError("there are no measured values; give at least one table [[measured]]")
    if any(table.sheared for table in measured):
        require_shear(tangential_values(law))
    low, high = (float(law.attrs[f"pressure_{end}"]) for end in ("min", "max"))
    for table in measured:
        p = table.pressure
        outside = (p < low / OUTSIDE) | (p > high * OUTSIDE)
        if outside.any() and not extrapolate:
            raise CaseError(
                f"{table.name}: the law has pressures from {list_pressures(np.array([low]))} to "
                f"{list_pressures(np.array([high]))}, and was not computed at the measured "
                f"{list_pressures(p[outside])}; press the cells there, or leave these rows out"
            )


def require_shear(known: Collection[str]) -> None:
    """Refuse a law without friction or stiffness ratio, by the names that it has."""
    if not {"friction", "stiffness_ratio"} <= set(known):
        raise CaseError(
            "the tables need friction and stiffness ratio, which the law of the cells does not "
            "have; shear the cells, or state both in [law]"
        )


def _refuse_contradiction(mode: Mode, measured: Sequence[MeasuredJoint]) -> None:
    far = np.abs(mode.residual) > FAR
    if far.sum() <= FEW * far.size:
        return
    names = [f"{table.name}, {name}" for table in measured for name, _ in table.rows]
    worst = int(np.argmax(np.abs(mode.residual)))
    raise CaseError(
        f"{far.sum()} of {far.size} measured values are more than {FAR:g} standard deviations of "
        f"their errors from the nearest law ({names[worst]}: {abs(mode.residual[worst]):.3g}): "
        f"they contradict each other or the cells; correct the table, or state larger errors, a "
        f"frame or a roughness"
    )


def _rows(mode: Mode, measured: Sequence[MeasuredJoint]) -> Iterator[MeasuredRow]:
    residual, J = mode.residual, mode.derivative
    spread = NORMAL * np.sqrt(np.einsum("ij,jk,ik->i", J, mode.covariance, J))
    at = 0
    for table in measured:
        columns = (table.rows, table.pressure, table.value, table.deviation)
        for (name, unit), p, value, deviation in zip(*columns, strict=True):
            yield MeasuredRow(
                table.name,
                name,
                float(p),
                UNIT_TEXTS.get(unit, unit),
                float(value),
                float(value + residual[at] * deviation),
                float(spread[at] * deviation),
                float(residual[at]),
                float(mode.weight[at]),
            )
            at += 1


def _sentences(
    mode: Mode, prior: _Prior, rows: Sequence[MeasuredRow], draws: Draws
) -> Iterator[str]:
    """Report disagreement, outliers, parameters without information, and unreliable weights."""
    yield from mode.cautions
    pull = np.where(mode.learned > LEARNS, np.abs(mode.pull), 0.0)
    worst = int(np.argmax(pull))
    if pull[worst] > DISAGREES:
        yield (
            f"the measured values move the {prior.names[worst]} {pull[worst]:.2g} standard "
            f"deviations away from its value before calibration, by cells, case or default: check "
            f"this value first, and state it or a larger half-width if the data are right"
        )
    for row in rows:
        if abs(row.residual) > FAR:
            value = readable(f"{row.measured:.4g} {row.unit}").removesuffix(" 1")
            yield (
                f"{row.table}, {row.row}: {value} at "
                f"{list_pressures(np.array([row.pressure]))} is {abs(row.residual):.2g} standard "
                f"deviations from the law, and has {row.weight:.2g} of the weight of another value"
            )
    form = range(len(prior.modes))
    if not any(mode.learned[k] > LEARNS for k in form) or len(rows) < 2:
        text = "1 measured value gives" if len(rows) == 1 else f"{len(rows)} measured values give"
        yield (
            f"{text} no information on the form of the law, and cannot separate it from the zero "
            f"of the load and the frame"
        )
    columns = zip(prior.names, mode.learned, prior.middle, strict=True)
    unlearned = [name for name, learned, value in columns if learned < LEARNS and value > 0.0]
    if unlearned:
        yield f"the measured values give no information on the {' and the '.join(unlearned)}"
    # few candidates have uneven weights by chance, and may give enough independent draws
    if draws.tail > RELIABLE and draws.effective < len(draws.theta):
        yield (
            f"the weights of the draws are uneven (Pareto shape {draws.tail:.2g}); the samples "
            f"represent {draws.effective:.3g} independent draws, and intervals are rough"
        )
