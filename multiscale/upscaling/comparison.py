"""Laws of measured specimens: the family that fits best, and predictions with their intervals."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError
from multiscale.schema import LAW_COMPARISON, Dataset
from multiscale.upscaling.family import FAMILIES, Family
from multiscale.upscaling.fit import FREE_FORM, fit_law
from multiscale.upscaling.observations import QUANTITIES, Observations
from multiscale.upscaling.reading import fitted_law, law_band, refuse_band

__all__ = [
    "Prediction",
    "best_family",
    "compare_laws",
    "predict",
]


def compare_laws(
    data: Dataset | Observations, families: Sequence[str | Family] | None = None
) -> Dataset:
    r"""Fit several families to the same data and compare them.

    Parameters
    ----------
    data
        As of :func:`fit_law`.
    families : sequence of str or Family, optional
        All that are built in for the quantity if not given.

    Returns
    -------
    Dataset
        Follows ``LAW_COMPARISON``, best first by the cross-validated error. The criterion
        is NaN for a law of free form, whose number of parameters is not defined, and its weight
        is that among the others.

    Notes
    -----
    The criterion is Akaike's with the correction for few points [1]_, for independent errors of
    one relative size; with the weights :math:`w_i \propto e^{-\Delta_i / 2}` from the differences
    to the smallest. The steps of one cell are not independent, which favours families with many
    parameters; the error at unseen points does not rest on that.

    References
    ----------
    .. [1] C. M. Hurvich and C.-L. Tsai, Biometrika 76 (1989) 297-307,
       doi:10.1093/biomet/76.2.297.
    """
    if families is None:
        quantity = data.quantity if isinstance(data, Observations) else "gap"
        families = [one.name for one in FAMILIES.values() if quantity in one.quantities]
        families = [*([FREE_FORM[quantity]] if quantity in FREE_FORM else []), *families]
    fits = [fit_law(data, family=family, n_samples=0).attrs for family in families]
    error = np.array([fit["cross_validated_rms_error"] for fit in fits])
    criterion = np.array([fit.get("akaike_criterion", np.nan) for fit in fits])
    weight = np.full(len(fits), np.nan)
    known = np.isfinite(criterion)
    if np.any(known):
        likelihood = np.exp(-0.5 * (criterion[known] - criterion[known].min()))
        weight[known] = likelihood / likelihood.sum()
    order = np.argsort(error)
    names = [family if isinstance(family, str) else family.name for family in families]
    return LAW_COMPARISON.build(
        {
            "cross_validated_error": error[order],
            "n_parameters": np.array([fit.get("n_parameters", 0) for fit in fits])[order],
            "akaike_criterion": criterion[order],
            "akaike_weight": weight[order],
            "admissible": np.array([fit["admissible"] for fit in fits])[order],
        }
    ).assign_coords(family=[names[k] for k in order])


@dataclass(frozen=True, eq=False)
class Prediction:
    """Values of a law at pressures, with 95 % intervals, NaN where they are not known.

    Attributes
    ----------
    value : ndarray, shape (points,), SI unit of the quantity
    mean_law, next_specimen : ndarray, shape (2, points), ends of both intervals
    unknown : tuple of str, why an interval is not known, a sentence each
    """

    value: np.ndarray
    mean_law: np.ndarray
    next_specimen: np.ndarray
    unknown: tuple[str, ...]


def best_family(observations: Observations) -> tuple[str, Dataset]:
    """Return the admissible family with the least error at unseen pressures, and the comparison.

    Families with as many parameters as there are pressures are left out.

    Raises
    ------
    CaseError
        If no family is admissible.
    MultiscaleError
        If the data are refused.
    """
    n, quantity = observations.pressure.size, observations.quantity
    fitting = [one for one in FAMILIES.values() if quantity in one.quantities]
    names = [one.name for one in fitting if len(one.parameters) < n]
    families = compare_laws(observations, [FREE_FORM[quantity], *names])
    admissible = families["family"].values[families["admissible"].values == 1]
    if not admissible.size:
        raise CaseError(
            f"no family of laws of {observations.quantity} is admissible for these data; check "
            f"that they are of one loading branch"
        )
    return str(admissible[0]), families


def predict(law: Dataset, seen: Observations, pressure: np.ndarray) -> Prediction:
    r"""Predict the quantity of a law at pressures.

    Parameters
    ----------
    law : Dataset, follows ``INTERFACE_LAW``; fitted to ``seen``, values over pressures alone
    seen : Observations
    pressure : ndarray, shape (points,), Pa

    Returns
    -------
    Prediction
        A specimen differs from the mean law by one factor at all pressures (a gap by one
        distance): with the standard deviation s of the logarithm of that factor over n specimens,
        the next specimen lies within :math:`t_{0.975, n-1}\, s\, \sqrt{1 + 1/n}`.
    """
    from scipy.stats import t

    predicted = QUANTITIES[seen.quantity].predict
    mean, n = fitted_law(law), seen.n_realisations
    value, none = predicted(mean, pressure), np.full((2, pressure.size), np.nan)
    unknown = []
    band = none
    if refusal := refuse_band(law):
        unknown.append(f"the interval of the mean law is not known: {refusal}")
    else:
        band = np.array(law_band(law, lambda one: predicted(one, pressure)))
    additive = seen.quantity == "gap"
    read = (lambda x: x) if additive else np.log
    offset = np.nanmean(read(seen.masked) - read(predicted(mean, seen.pressure)), axis=1)
    if n < 2:
        unknown.append("the interval of the next specimen is not known: there is one specimen")
        return Prediction(value, band, none, tuple(unknown))
    half = t.ppf(0.975, n - 1) * offset.std(ddof=1) * np.sqrt(1.0 + 1.0 / n)
    ends = read(value) + half * np.array([[-1.0], [1.0]])
    return Prediction(value, band, ends if additive else np.exp(ends), tuple(unknown))
