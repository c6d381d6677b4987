"""Intervals of laws of measured specimens: at pressures, and in their error budget."""

from dataclasses import dataclass

import numpy as np

from multiscale.schema import INTERFACE_LAW, Dataset
from multiscale.upscaling.budget import (
    ALWAYS,
    ERROR_TERMS,
    FEW_CELLS,
    NORMAL,
    Term,
    assemble_budget,
    with_budget,
)
from multiscale.upscaling.fit import stiffness_of_each
from multiscale.upscaling.law_budget import LAW_QUANTITIES
from multiscale.upscaling.observations import QUANTITIES, Observations
from multiscale.upscaling.reading import fitted_law, law_band, refuse_band
from multiscale.upscaling.sampling import student


@dataclass(frozen=True, eq=False)
class Prediction:
    """Values of a law at pressures, with 95 % intervals, NaN where they are not known."""

    value: np.ndarray  # (points,), SI unit of the quantity
    mean_law: np.ndarray  # (2, points), ends of the interval of the mean
    next_specimen: np.ndarray  # (2, points), ends of the interval of a further specimen
    unknown: tuple[str, ...]  # why an interval is not known, a sentence each


def predict(law: Dataset, seen: Observations, pressure: np.ndarray) -> Prediction:
    r"""Predict the quantity of a law at pressures.

    Parameters
    ----------
    law : Dataset, follows ``INTERFACE_LAW``; fitted to ``seen``, values over pressures only
    pressure : ndarray, shape (points,), Pa

    Returns
    -------
    Prediction
        A specimen differs from the mean law by the same factor at all pressures (a gap by the same
        distance). With the standard deviation s of the logarithm of this factor over n specimens,
        the mean lies within :math:`t_{0.975, n-1}\, s / \sqrt n` if the law has too few samples for
        a band, and the next specimen within :math:`t_{0.975, n-1}\, s\, \sqrt{1 + 1/n}`. If the
        ends of a band are farther away than :math:`t s / \sqrt n`, by the scatter of single values,
        they replace this share.
    """
    predicted = QUANTITIES[seen.quantity].predict
    mean, n = fitted_law(law), seen.n_realisations
    value, too_few = predicted(mean, pressure), bool(refuse_band(law))
    # the factor (of a gap: the distance) of each specimen, and its scatter
    additive = seen.quantity == "gap"
    read, write = ((lambda x: x),) * 2 if additive else (np.log, np.exp)
    offset = np.nanmean(read(seen.values) - read(predicted(mean, seen.pressure)), axis=1)
    half, sign = student(n - 1) * offset.std(ddof=1) if n > 1 else np.nan, [[-1.0], [1.0]]
    of_mean = np.full((2, pressure.size), half / np.sqrt(n))
    band = write(read(value) + sign * of_mean)
    if not too_few:
        band = np.array(law_band(law, lambda sample: predicted(sample, pressure)))
        of_mean = np.fmax(sign * (read(band) - read(value)), of_mean)
    ends = write(read(value) + sign * np.hypot(half, of_mean))
    lacking = ["mean law"] * too_few + ["next specimen"] if n < 2 else []
    unknown = [
        f"the interval of the {name} is unknown: there is a single specimen" for name in lacking
    ]
    return Prediction(value, band, ends, tuple(unknown))


def with_specimen_budget(law: Dataset, seen: Observations) -> Dataset:
    """Return the law of measured specimens with its error budget: their scatter, and the fit."""
    p, normal, n = seen.pressure, fitted_law(law), seen.n_realisations
    gap = normal.gap_at(p)
    law = INTERFACE_LAW.assign(law, {"fit_mean_gap": law.get("fit_mean_gap", gap)})
    law = law.assign_attrs(realisation="specimen")
    # factors of the stiffness, and distances of the gap, of every specimen
    of_gap = seen.quantity == "gap"
    each = stiffness_of_each(seen, law) if of_gap else seen.values
    factor = np.nanmean(np.log(each / normal.stiffness(gap)), axis=1)
    mean, following = np.full((2, 3, p.size), np.nan)
    if n > 1:
        t, widths = student(n - 1), np.sqrt([1.0 / n, 1.0 + 1.0 / n])[:, None]
        # with the deviation s of the logarithm of the factors and Student's t of n - 1
        #     1 + h = exp(t s / sqrt n),  1 + h' = exp(t s sqrt(1 + 1/n))  (1)
        # of the mean and of the next specimen; gaps of a stiffness are in inverse proportion
        mean[2], following[2] = np.expm1(t * factor.std(ddof=1) * widths)  # (1)
        mean[0], following[0] = mean[2], following[2]
        if of_gap:
            shift = np.nanmean(seen.values - gap, axis=1).std(ddof=1)
            mean[0], following[0] = t * shift * widths / np.fmax(np.abs(gap), np.finfo(float).tiny)
    fit = np.full((3, p.size), np.nan)
    for row, of, share_of in (
        (0, "fit_error", "gap_fit_share"),
        (2, "stiffness_fit_error", "stiffness_fit_share"),
    ):
        error, share = law[of].to_numpy(), law[share_of]
        fit[row] = NORMAL * float(share) * np.sqrt(np.nanmean(error**2))
    unknown = "not known: a single specimen has no scatter, measure 2 or more"
    how = f"Student's interval of {n} specimens" if n > 1 else unknown
    zero = Term("nothing: the values are measured", np.zeros((3, p.size)))
    terms = {term: Term("not in a law of measured specimens") for term in ERROR_TERMS}
    terms |= dict.fromkeys(ALWAYS, zero)
    terms["sampling"] = Term(how, mean)
    terms["fit"] = Term("error at pressures that are left out of the fit", fit)
    about_mean = np.sqrt(following**2 - mean**2)
    terms[FEW_CELLS] = Term(how.replace("interval", "interval of the next"), about_mean)
    return with_budget(law, assemble_budget(terms, LAW_QUANTITIES, p))
