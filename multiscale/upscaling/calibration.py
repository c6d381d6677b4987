"""The law of cells, corrected by measured joints, with its remaining uncertainty."""

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
from multiscale.upscaling.posterior import Draws, Mode, draw, find_mode
from multiscale.upscaling.posterior_law import law_of_interfaces
from multiscale.upscaling.prior import CalibratedParameter, Prior, pressure_grid
from multiscale.upscaling.reading import fitted_laws, pick, refuse_band, require_law

UNIT_TEXTS = {"Pa m-1": "Pa/m", "s-1": "Hz"}

ROUGHNESS = 0.2  # default half-width of the factor of all heights

CANDIDATES, SAMPLES = 400, 200  # draws of the posterior, and samples of a law without any

OUTSIDE = 2.0  # factor of the pressures of a law up to which a preload is within its data

FAR, FEW = 3.0, 0.25  # standard deviations of a residual, and share of rows that may lie beyond

DISAGREES, LEARNS = 3.0, 0.05  # standard deviations of a pull; share of a variance

RELIABLE, USABLE = 0.7, 1.0
"""Shapes of the tail of the weights: above the second their effective number is no measure."""


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
    parameters: tuple[CalibratedParameter, ...]
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
    CaseError
        If there are no data, nothing is uncertain, a preload lies outside the law, a table needs a
        friction that the law lacks, or more than a quarter of the values lies more than 3 standard
        deviations away from any law: they contradict each other.
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
    prior = Prior.of(law, measured, roughness, (discrepancy, exponent), cells)
    answer = solve or (lambda table, *given: table.answer(*given))

    def residual(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return prior.residual(theta, measured, answer)

    linear = solve is not None or any(table.linear for table in measured)
    mode = find_mode(residual, prior.scale.size, noisy=linear)
    _refuse_contradiction(mode, measured)
    if not mode.settled:
        raise ConvergenceError(
            f"the parameters of the law do not converge in {mode.solves} solves; find rows that "
            f"contradict each other, or for an area far below the size of a cell, or state larger "
            f"errors"
        )
    # samples of the law, as many as the cells have
    count = int(law.sizes.get("sample", 0)) or SAMPLES
    random = np.random.default_rng(seed)
    if linear:
        spread = (
            random.normal(size=(count, mode.theta.size)) @ np.linalg.cholesky(mode.covariance).T
        )
        draws = Draws(mode.theta + spread, float(count), 0.0)
    else:
        draws = draw(residual, mode, max(CANDIDATES, 2 * count), count, random)
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

    Raises
    ------
    CaseError
        If the law has no samples, or not the stiffness ratio and friction of the table.
    """
    count = int(law.sizes.get("sample", 0))
    if refusal := refuse_band(law):
        raise CaseError(refusal)
    if table.sheared:
        require_law(law, "shear_stiffness_ratio", "shear_friction")
    x = pressure_grid(law)
    laws = fitted_laws(law, [None, *range(count)])
    drawn = [None, *range(min(count, int(law.sizes.get("shear_sample", 0))))]
    ratios, frictions = (
        np.resize([np.nanmean(value) for value in pick(law, name, drawn, of="shear")], len(laws))
        if table.sheared
        else np.ones(len(laws))
        for name in ("shear_stiffness_ratio", "shear_friction")
    )
    values = []
    for normal, ratio, friction in zip(laws, ratios, frictions, strict=True):
        stiffness = normal.stiffness(normal.gap_at(np.exp(x)))
        curve = Curve(x, np.log(stiffness), np.empty((0, x.size)))
        values.append(table.answer(BedCurve(curve, float(ratio), float(friction)), {})[0])
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
    J, residual = mode.derivative, mode.residual
    listed = [
        (table.name, name, UNIT_TEXTS.get(unit, unit))
        for table in measured
        for name, unit in table.rows
    ]
    pressure, value, deviation = (
        np.concatenate([getattr(table, name) for table in measured])
        for name in ("pressure", "value", "deviation")
    )
    spread = NORMAL * np.sqrt(np.einsum("ij,jk,ik->i", J, mode.covariance, J)) * deviation
    columns = (value, value + residual * deviation, spread, residual, mode.weight)
    for (table, row, unit), p, *numbers in zip(listed, pressure, *columns, strict=True):
        yield MeasuredRow(table, row, float(p), unit, *map(float, numbers))


def _sentences(
    mode: Mode, prior: Prior, rows: Sequence[MeasuredRow], draws: Draws
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
    if draws.tail > (USABLE if draws.effective >= len(draws.theta) else RELIABLE):
        yield (
            f"the weights of the draws are uneven (Pareto shape {draws.tail:.2g}); the samples "
            f"represent {draws.effective:.3g} independent draws, and intervals are rough"
        )
