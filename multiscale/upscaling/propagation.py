r"""From the sources of error of a computation to the error budget of its answers.

With the relative change :math:`s_{k}` of an answer by a parameter :math:`k`, and the half-width
:math:`w_{kt}` of the parameter by the term :math:`t`,

.. math:: w_t^2 = \sum_k (s_k\, w_{kt})^2.    \tag{1}
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from multiscale.executors import run_jobs
from multiscale.schema import ERROR_BUDGET, Dataset
from multiscale.upscaling.budget import (
    ALWAYS,
    ERROR_TERMS,
    FEW_CELLS,
    MACRO,
    MODEL,
    NO_PART,
    NO_STATED,
    STATED,
    Term,
    assemble_budget,
    estimate_grid_error,
    is_absent,
)
from multiscale.upscaling.sampling import half_range

STRETCH = 0.02
"""Relative change of a parameter with which the answers are solved again."""

FEWEST_SAMPLES = 40  # for a percentile interval

FIRST_ORDER = 0.5
"""Relative half-width by samples above which changes of first order are no estimate: the samples of
a law then differ too much at the pressures of an answer, such as beyond the data."""


NO_SOURCE = dict.fromkeys(ALWAYS, "nothing: no source of this error contributes") | {
    STATED: NO_STATED.how,
    MODEL: "not in a law: no law of cells contributes",
    MACRO: "not known: no structure was solved on a coarser mesh",
}
"""Texts of terms without a source."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Source(ABC):
    """A source of error.

    Attributes
    ----------
    of : str, optional, object that the source belongs to, such as an interface
    changes : sequence, inputs with which the answers are solved again, any type
    answers : sequence of ndarray, shape (answers, steps), optional
        Answers with these changes, if they are known.
    """

    name: str
    of: str = ""
    changes: Sequence[Any] = ()
    answers: Sequence[np.ndarray] | None = None

    @abstractmethod
    def terms(self, value: np.ndarray, changed: Sequence[np.ndarray]) -> Mapping[str, Term]:
        """Return the terms of the budget by this source, from the answers and changed answers."""

    def sensitivity(self, value: np.ndarray, changed: Sequence[np.ndarray]) -> np.ndarray | None:
        """Return the relative change of the answers by the half-width of a parameter."""
        return None

    def averaged(self, cells: np.ndarray) -> "Source":
        """Return the source of answers that average over cells, shape (answers, steps).

        Their number is relative to the number by the scales of the law; see
        :func:`effective_cells`.
        """
        return self


@dataclass(frozen=True, eq=False, kw_only=True)
class Uncertainty(Source):
    """A parameter with half-widths of its 95 % interval, by terms of the budget.

    Attributes
    ----------
    half_width : mapping of str to ndarray or float, in the unit of ``step``
    how : mapping of str to str, how they were estimated, if a text is needed
    step : float, increase of the parameter in the only element of ``changes``
    rate : ndarray, shape (answers, steps), optional
        Relative change of the answers over the change of the parameter, instead of ``changes``.
    """

    half_width: Mapping[str, np.ndarray | float]
    how: Mapping[str, str] = field(default_factory=dict)
    step: float = STRETCH
    rate: np.ndarray | None = None

    def terms(self, value: np.ndarray, changed: Sequence[np.ndarray]) -> Mapping[str, Term]:
        """Return (1); an answer that does not change has no error, even by an unknown width."""
        rate = np.abs(self._rate(value, changed))
        return {
            term: Term(self.how.get(term, ""), np.where(rate == 0.0, 0.0, rate * half))
            for term, half in self.half_width.items()
        }

    def sensitivity(self, value: np.ndarray, changed: Sequence[np.ndarray]) -> np.ndarray:
        """Return the relative change of the answers by the half-width of all known terms."""
        square = sum(np.square(np.nan_to_num(half)) for half in self.half_width.values())
        return np.asarray(self._rate(value, changed) * np.sqrt(square) * np.ones(value.shape))

    def averaged(self, cells: np.ndarray) -> Source:
        """Return the source with a smaller scatter of few cells."""
        if FEW_CELLS not in self.half_width:
            return self
        few = self.half_width[FEW_CELLS] / np.sqrt(cells)
        return replace(self, half_width={**self.half_width, FEW_CELLS: few})

    def _rate(self, value: np.ndarray, changed: Sequence[np.ndarray]) -> np.ndarray:
        return (changed[0] / value - 1.0) / self.step if self.rate is None else self.rate


@dataclass(frozen=True, eq=False, kw_only=True)
class Samples(Source):
    """Inputs drawn from their distribution, such as bootstrap samples of a law.

    Attributes
    ----------
    how : str, how the error was estimated
    weights : ndarray, shape (samples, changes), optional
        Changes of the answers by all samples over those by the solved ones, to first order.
    counts : ndarray, shape (answers, steps), or bool, whether an answer has this error
    """

    how: str
    weights: np.ndarray | None = None
    counts: np.ndarray | bool = True

    def terms(self, value: np.ndarray, changed: Sequence[np.ndarray]) -> Mapping[str, Term]:
        """Return half the distance of the percentiles; NaN where it is unknown or no estimate."""
        drawn, largest = np.array(changed), np.inf
        if self.weights is not None:
            drawn = value + np.tensordot(self.weights, drawn - value, axes=1)
            largest = FIRST_ORDER
        known = np.isfinite(drawn).all(axis=0)
        half = half_range(np.where(known, drawn, 0.0)) / np.abs(value)
        known = known & (half < largest)
        half = np.where(self.counts, np.where(known, half, np.nan), 0.0 * value)
        return {"sampling": Term(self.how, half)}


@dataclass(frozen=True, eq=False, kw_only=True)
class Knob(Source):
    """A setting of accuracy, with an answer at a coarser value for each change.

    Attributes
    ----------
    ratios : sequence of float, spacings of the coarser values over the spacing of the answers
    term : str, term of the budget
    share : ndarray, shape (answers, steps), optional
        Largest error of the answers over the change by the only coarser value; without it the
        error follows from the ratios, see :func:`estimate_grid_error`.
    how : str, how the share was estimated, if a text is needed
    """

    ratios: Sequence[float] = ()
    term: str = MACRO
    share: np.ndarray | None = None
    how: str = ""

    def terms(self, value: np.ndarray, changed: Sequence[np.ndarray]) -> Mapping[str, Term]:
        """Return the half-widths."""
        if self.share is not None:
            change = np.abs(changed[0] / value - 1.0)
            half = np.where(self.share == 0.0, 0.0, self.share * change)
            return {self.term: Term(self.how, half)}
        estimate = estimate_grid_error(value, dict(zip(self.ratios, changed, strict=True)))
        return {self.term: Term(estimate.how, estimate.half_width / np.abs(value))}


@dataclass(frozen=True, eq=False, kw_only=True)
class Correction(Source):
    """A term with a known sign; its only change is the inputs without that error."""

    term: str

    def terms(self, value: np.ndarray, changed: Sequence[np.ndarray]) -> Mapping[str, Term]:
        """Return the bias."""
        bias = (value - changed[0]) / np.abs(value)
        return {self.term: Term("", np.zeros(value.shape), bias)}


@dataclass(frozen=True, eq=False, kw_only=True)
class Bound(Source):
    """Computed errors of the answers; a term without half-width is unknown."""

    bounds: Mapping[str, Term]

    def terms(self, value: np.ndarray, changed: Sequence[np.ndarray]) -> Mapping[str, Term]:
        """Return the bounds."""
        return self.bounds


def propagate(
    names: str | Sequence[str],
    sources: Sequence[Source],
    solve: Callable[[Any], Any] | None = None,
    value: np.ndarray | None = None,
    *,
    base: Any = None,
    read: Callable[[Any], np.ndarray] = np.asarray,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Dataset:
    """Propagate independent errors to answers: solve once for each change of each source.

    Parameters
    ----------
    names : str or sequence of str, names of the answers, such as ``"joint_stiffness"``
    sources : sequence of Source
        See :func:`law_sources` for the sources of an interface law.
    solve : callable, optional, from a change of a source to the argument of ``read``
        Workers of an executor must be able to import it. Not needed where all answers are known.
    value : ndarray, shape (answers, steps) or (steps,) of a single answer, any units, optional
        Answers without a change; solved with ``base`` if not given.
    base : object, optional, inputs without a change
    read : callable, from a result of ``solve`` to the answers, shaped as ``value``
    executor : Executor, optional, see :func:`multiscale.executors.run_jobs`
    progress : callable, optional, called with the numbers of finished and of all solves

    Returns
    -------
    Dataset
        Follows ``ERROR_BUDGET``, with a quantity for each answer. Half-widths add as squares and
        biases with their signs. The total is NaN at a step where a term of a source is unknown, or
        if a term of ``ALWAYS`` of a source is unknown at all steps. The ``sensitivity`` is for the
        parameters among the sources.
    """
    # the computations that are needed
    names = (names,) if isinstance(names, str) else tuple(names)
    jobs: dict[tuple[int, int], Any] = {} if value is not None else {(-1, 0): base}
    for k, source in enumerate(sources):
        if source.answers is None:
            jobs |= {(k, j): change for j, change in enumerate(source.changes)}
    if jobs and solve is None:
        raise TypeError(f"{len(jobs)} answers are unknown, and solve is missing")
    solved: dict[tuple[int, int], np.ndarray] = {}

    def finish(key: tuple[int, int], result: Any) -> None:
        solved[key] = _rows(read(result), names)
        progress(len(solved), len(jobs))

    if solve is not None and jobs:
        progress(0, len(jobs))
        run_jobs(solve, ((key, (change,)) for key, change in jobs.items()), executor, finish)
    value = solved[-1, 0] if value is None else _rows(value, names)

    # the terms and the sensitivity by each source
    contributions: dict[str, list[tuple[str, Term]]] = {term: [] for term in ERROR_TERMS}
    labels, sensitivities = list[str](), list[np.ndarray]()
    for k, source in enumerate(sources):
        if source.answers is None:
            changed = [solved[k, j] for j in range(len(source.changes))]
        else:
            changed = [_rows(answer, names) for answer in source.answers]
        for name, term in source.terms(value, changed).items():
            contributions[name].append((source.of, term))
        sensitivity = source.sensitivity(value, changed)
        if sensitivity is not None:
            labels.append(": ".join(filter(None, (source.of, source.name))))
            sensitivities.append(sensitivity)
    terms = {name: _add(name, listed, value.shape) for name, listed in contributions.items()}
    budget = assemble_budget(terms, names, None, steps=value.shape[1])
    if not sensitivities:
        return budget
    budget = ERROR_BUDGET.assign(budget, {"sensitivity": np.array(sensitivities)})
    return budget.assign_coords(parameter=labels)


def _rows(answer: Any, names: Sequence[str]) -> np.ndarray:
    """Return answers as rows over the steps, a row for each name."""
    return np.reshape(np.asarray(answer, dtype=float), (len(names), -1))


def _add(name: str, listed: Sequence[tuple[str, Term]], shape: tuple[int, ...]) -> Term:
    """Add the contributions of sources to a term, with the objects that they belong to."""
    how = _join(name, listed)
    if name in ALWAYS and not listed:
        return Term(how, np.zeros(shape))
    bias = sum(np.asarray(term.bias) for _, term in listed)
    widths = [term.half_width for _, term in listed if term.half_width is not None]
    if not widths or (name in ALWAYS and len(widths) < len(listed)):
        return Term(how, None, bias)
    return Term(how, np.sqrt(sum(np.square(half) for half in widths)) * np.ones(shape), bias)


def _join(name: str, contributions: Sequence[tuple[str, Term]]) -> str:
    """Join the texts of a term; objects without the term are named only if all lack it."""
    texts: dict[str, dict[str, None]] = {}
    for of, term in contributions:
        if term.how:
            texts.setdefault(of, {})[term.how] = None
    if not texts:
        return NO_SOURCE.get(name, NO_PART.how)
    present = {of: [how for how in listed if not is_absent(how)] for of, listed in texts.items()}
    joined = {of: "; ".join(listed) for of, listed in present.items() if listed}
    if not joined:
        return next(how for listed in texts.values() for how in listed)
    if len(set(joined.values())) == 1:
        return next(iter(joined.values()))
    several = sum(map(bool, joined)) > 1
    return "; ".join(f"{of}: {how}" if of and several else how for of, how in joined.items())
