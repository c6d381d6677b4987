"""Which family describes the data best: unseen points and an information criterion."""

from collections.abc import Sequence

import numpy as np

from multiscale.schema import LAW_COMPARISON, Dataset
from multiscale.upscaling.family import FAMILIES, Family
from multiscale.upscaling.fit import FREE_FORM, fit_law
from multiscale.upscaling.observations import Observations

__all__ = ["compare_laws"]


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
