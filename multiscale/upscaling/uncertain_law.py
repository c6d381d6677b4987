"""The sources of error of an interface law: terms of its budget, samples, biases and ends."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws import ModifiedLaw, NormalLaw
from multiscale.schema import Dataset
from multiscale.upscaling.budget import (
    ERROR_TERMS,
    Term,
    has_budget,
    how_attribute,
    known_terms,
    of_this_version,
)
from multiscale.upscaling.free_form import FEWEST_PRESSURES, fit_each
from multiscale.upscaling.observations import observe
from multiscale.upscaling.propagation import (
    FEWEST_SAMPLES,
    STRETCH,
    Bound,
    Correction,
    Knob,
    Samples,
    Source,
    Uncertainty,
)
from multiscale.upscaling.reading import fitted_laws, law_from_dataset, require_law

BEYOND = np.array(2.0)
"""Error of answers by the form of a law beyond its data over their change without the last data.
Every further pressure would change them by about half of the change by the pressure before it."""

SOLVED_SAMPLES = 4
"""Number of samples of a law with which answers are solved that no tangent gives."""

ALIKE = 0.05  # scatter of samples, over the largest, below which they span nothing more


def law_sources(
    law: Dataset,
    pressure: np.ndarray | None = None,
    *,
    of: str = "",
    change: Callable[[NormalLaw], Any] = lambda law: law,
    samples: int = 0,
    drawn: Sequence[np.ndarray] | None = None,
    beyond: tuple[bool, bool] = (False, False),
) -> list[Source]:
    """Return the sources of error of an interface law, from its budget.

    Parameters
    ----------
    law : Dataset, follows ``INTERFACE_LAW`` and has its budget; see :func:`with_budget`
    pressure : ndarray, shape (steps,), optional
        Pressure of the interface at each step, Pa, where the errors of the law are evaluated; their
        root mean square over the data if not given.
    of : str, optional, name of the interface
    change : callable, optional, from a changed normal law to the change of a :class:`Source`
    samples : int
        Number of bootstrap samples of the law to solve; with fewer than 40, sampling is propagated
        like the other terms.
    drawn : sequence of ndarray, shape (answers, steps), optional
        Known answers of all samples of the law; where one is NaN, a few samples are solved.
    beyond : tuple of bool
        Whether load lies below, and above the data: the change of the answers without the last data
        at an end is then the error of the form of the law beyond it, a part of the term "fit",
        which is unknown if the data are too few to leave any out.

    Returns
    -------
    list of Source
        Terms of the gap are propagated by larger gaps, terms of the stiffness by a softer law about
        the mean pressure, biases by a law of free form through the gaps without them.

    Raises
    ------
    CaseError
        If the law has no budget.
    """
    if not has_budget(law):
        raise CaseError(
            "the law has no error budget; add it by with_budget(law, error_budget(...))"
        )
    law = of_this_version(law)
    require_law(law, "fit_mean_gap", "error_bias", *map(how_attribute, ERROR_TERMS))
    uncertain = _UncertainLaw(law, of, change)
    sampled = uncertain.sampled(samples, drawn)
    terms = [term for term in uncertain.known if not (sampled and term == "sampling")]
    bounds = {
        term: Term(str(law.attrs[how_attribute(term)]), np.zeros(()) if term in terms else None)
        for term in ERROR_TERMS[:-1]  # the last term is not of a law
        if not (sampled and term == "sampling")
    }
    return [
        Bound(name="budget of the law", of=of, bounds=bounds),
        *uncertain.parameters(pressure, terms),
        *uncertain.biases(),
        *uncertain.ends(beyond),
        *sampled,
    ]


@dataclass(frozen=True, eq=False)
class _UncertainLaw:
    """A law with its budget, and changes of it as changes of a computation."""

    law: Dataset
    of: str  # name of the interface
    change: Callable[[NormalLaw], Any]

    @cached_property
    def mean(self) -> NormalLaw:
        """The normal law."""
        return law_from_dataset(self.law)

    @property
    def data(self) -> np.ndarray:
        """Pressures of the data, Pa."""
        return np.asarray(self.law["fit_pressure"].to_numpy())

    @property
    def gap(self) -> np.ndarray:
        """Gaps of the data, m."""
        return np.asarray(self.law["fit_mean_gap"].to_numpy())

    @property
    def known(self) -> list[str]:
        """Terms of the budget that are known."""
        return list(known_terms(self.law))

    def sampled(self, samples: int, drawn: Sequence[np.ndarray] | None) -> list[Source]:
        """Return the sampling by bootstrap samples: all of them, or a few where none is drawn."""
        law, of = self.law, self.of
        if drawn is None:
            count = min(samples, int(law.sizes.get("sample", 0)))
            draws = fitted_laws(law, range(count if count >= FEWEST_SAMPLES else 0))
            if not draws:
                return []
            changes = [self.change(sample) for sample in draws]
            how = f"{len(draws)} bootstrap samples of the law"
            return [Samples(name="samples", of=of, changes=changes, how=how)]
        if not len(drawn):
            return []
        listed: list[Source] = []
        how = f"{len(drawn)} bootstrap samples of the law"
        solved = np.asarray(np.isnan(drawn).any(axis=0))
        if not solved.all():
            listed.append(Samples(name="samples", of=of, answers=drawn, how=how, counts=~solved))
        if solved.any():
            few, weights = _spanning(fitted_laws(law, range(len(drawn))), self.mean, self.data)
            changes, how = [self.change(sample) for sample in few], f"{len(few)} of {how}"
            listed.append(
                Samples(
                    name="few samples",
                    of=of,
                    changes=changes,
                    how=f"{how}, to first order",
                    weights=weights,
                    counts=solved,
                )
            )
        return listed

    def parameters(self, pressure: np.ndarray | None, terms: Sequence[str]) -> list[Source]:
        """Return larger gaps, and a softer law about the mean pressure, as sources."""
        shift = STRETCH * float(np.ptp(self.gap))
        p = self.data if pressure is None else np.asarray(pressure)
        middle = float(self.mean.gap_at(np.array(np.exp(np.nanmean(np.log(p))))))
        larger = ModifiedLaw(self.mean, shift=shift)
        softer = ModifiedLaw(self.mean, factor=1.0 + STRETCH, centre=middle)
        gap, softness = (
            {term: self._half_width(quantity, term, unit, pressure) for term in terms}
            for quantity, unit in (("mean_gap", np.abs(self.gap)), ("stiffness", 1.0))
        )
        of = self.of
        return [
            Uncertainty(
                name="gap", of=of, changes=[self.change(larger)], step=shift, half_width=gap
            ),
            Uncertainty(name="softness", of=of, changes=[self.change(softer)], half_width=softness),
        ]

    def _half_width(
        self, quantity: str, term: str, unit: np.ndarray | float, pressure: np.ndarray | None
    ) -> np.ndarray | float:
        """Return the half-width of a quantity by a term at the pressures, or over the data."""
        errors = self.law["error_half_width"].sel(error_term=term, quantity=quantity)
        half = errors.to_numpy() * unit
        if pressure is None:
            return float(np.sqrt(np.mean(half**2)))
        return np.asarray(np.interp(np.log(pressure), np.log(self.data), half))

    def biases(self) -> list[Source]:
        """Return laws of free form through the gaps without the bias of a term, as sources."""
        listed: list[Source] = []
        for term in self.known:
            bias = self.law["error_bias"].sel(quantity="mean_gap", error_term=term).to_numpy()
            if np.any(bias):
                unbiased = observe("gap", self.data, self.gap * (1.0 - bias))
                corrected = self.change(fit_each(unbiased, unbiased.values)[0])
                listed.append(
                    Correction(name=f"bias by {term}", of=self.of, changes=[corrected], term=term)
                )
        return listed

    def ends(self, beyond: tuple[bool, bool]) -> list[Source]:
        """Return the errors of the form of the law below, and above its data, as sources."""
        data, gap, listed = self.data, self.gap, list[Source]()
        for outside, name, left in zip(
            beyond, ("lowest", "highest"), (slice(1, None), slice(-1)), strict=True
        ):
            if not outside or "fit" not in self.known:
                continue
            if data[left].size < FEWEST_PRESSURES:
                how = f"not known beyond {data.size} pressures, of which none can be left out"
                bounds = {"fit": Term(how)}
                listed.append(Bound(name="form of the law", of=self.of, bounds=bounds))
            else:
                without = fit_each(observe("gap", data[left], gap[left]), gap[None, left])[0]
                how, changes = f"the law without its {name} pressure", [self.change(without)]
                listed.append(
                    Knob(name=how, of=self.of, changes=changes, term="fit", share=BEYOND, how=how)
                )
        return listed


def _spanning(
    samples: Sequence[NormalLaw], mean: NormalLaw, pressure: np.ndarray
) -> tuple[list[NormalLaw], np.ndarray]:
    """Return samples of a law that span the scatter of all, and weights (samples, spanning)."""
    from scipy.linalg import qr

    stiffness = [law.stiffness(law.gap_at(pressure)) for law in (mean, *samples)]
    scatter = np.log(stiffness[1:]) - np.log(stiffness[0])
    # the most different samples, one after the other; others are sums of these
    order = qr(scatter.T, mode="r", pivoting=True)[1][:SOLVED_SAMPLES]
    weights = np.linalg.lstsq(scatter[order].T, scatter.T, rcond=ALIKE)[0].T
    return [samples[k] for k in order], weights
