"""How wrong a law, or an answer of the structure, is: every term estimated and none assumed."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws import NormalLaw, StretchedLaw
from multiscale.schema import ERROR_BUDGET, INTERFACE_LAW
from multiscale.upscaling.budget_terms import (
    NORMAL,
    fit_term,
    grid_term,
    pooled_sampling_term,
    sampling_term,
    separation_term,
    size_term,
)
from multiscale.upscaling.fit import fit_law
from multiscale.upscaling.observations import normal_observations, observe
from multiscale.upscaling.reading import law_from_dataset
from multiscale.upscaling.resolution import estimate_grid_error
from multiscale.upscaling.scales import ScaleSeparation

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["ERROR_TERMS", "error_budget", "structure_budget", "total_error", "with_budget"]

ERROR_TERMS = (
    "sampling",
    "fit",
    "cell size",
    "micro discretisation",
    "scale separation",
    "macro discretisation",
)
"""Labels of the dimension ``error_term``."""

STRETCH = 0.02  # of the gaps, to see how an answer depends on them
FEWEST_SAMPLES = 40  # for a percentile interval
ONE_SIDED = 6.0  # standard deviations from which a bias leaves one tail alone
TAIL = 1.6448536269514722  # standard deviations to 95 % of one side

QUANTITIES = ("mean_gap", "contact_fraction", "stiffness")
Terms = dict[str, np.ndarray]  # from term to half-widths or biases (quantity, step)


def error_budget(
    response: "xr.Dataset",
    law: "xr.Dataset",
    *,
    resolutions: Mapping[float, "xr.Dataset"] | None = None,
    sizes: Mapping[float, "xr.Dataset"] | None = None,
    scales: ScaleSeparation | None = None,
    apart: bool = False,
) -> "xr.Dataset":
    r"""Estimate how wrong the gap, the contact fraction and the stiffness of a law are.

    Parameters
    ----------
    response : Dataset
        Follows ``MICRO_RESPONSE``.
    law : Dataset
        Follows ``INTERFACE_LAW``; fitted to the response by :func:`fit_law`.
    resolutions : mapping of float to Dataset, optional
        From the ratio of its spacing to that of the response (2, or 2 and 4) to the response of
        the same realisations on a coarser grid.
    sizes : mapping of float to Dataset, optional
        From the ratio of its cell to that of the response (for instance 0.5) to a response of
        cells with the same spectrum.
    scales : ScaleSeparation, optional
        From :func:`compare_scales`.
    apart : bool, default False
        Whether resolutions and sizes, two at least of each, are ensembles of their own that are
        compared among themselves: the same small cells on several grids, and many cells of
        several sizes on a coarse grid. Their scatter then counts for that of the response too.

    Returns
    -------
    Dataset
        Follows ``ERROR_BUDGET``: half-widths of 95 % intervals relative to the value, for each
        quantity, term and step of the law; NaN for a term that nothing was given for. A bias,
        answer minus truth, is zero where no sign is known, and never taken out. The total
        is that of the known terms; the attribute ``unknown`` lists the others, and ``how_...``
        says of each term how it was estimated, or what would tell it.

    Raises
    ------
    CaseError
        If the law does not belong to the response, or a response has other steps.

    Notes
    -----
    - *sampling*: Student's interval of the mean for gap and contact fraction, the bootstrap band
      for the stiffness;
    - *fit*: 1.96 times the root mean square, over the steps, of the error at a step that the fit
      has not seen;
    - *cell size*: with the mean :math:`m(L) = m_\infty + b L^{-q}` through the sizes, weighted
      by their uncertainty, the bias :math:`b L^{-q}` and the interval about it;
      :math:`q` between 1 and 2 fits best to three sizes and is 1 for two;
    - *micro discretisation*: :func:`estimate_grid_error` of the means of the same realisations;
    - *scale separation*: with :math:`\varepsilon = \lambda_l/\ell` two independent parts: the
      pressure is not even over a wave, :math:`\tfrac12 f''(p)\, (\varepsilon p)^2 / 12` of a
      quantity :math:`f`; and the length :math:`\ell` of one structure holds only
      :math:`(\ell/L)^2` cells, :math:`1.96\, \mathrm{CoV}\, L / \ell`.

    Terms are independent of each other. With the sum :math:`b` of the biases and the standard
    deviation :math:`s` from the root of the sum of the squares of the half-widths about them, the
    total :math:`w` is such that :math:`|b + s\, \mathcal{N}(0, 1)| \le w` with a probability of
    95 %; without a bias it is that root itself.
    """
    INTERFACE_LAW.check(law)
    gap = normal_observations(response)
    p = gap.pressure
    if law.sizes["step"] != p.size or not np.allclose(law["fit_pressure"], p, rtol=1e-6):
        raise CaseError(
            f"the law was fitted at {law.sizes['step']} pressures that are not the {p.size} of the "
            f"response; fit it to this response"
        )
    terms: Terms = {}
    biases: Terms = {}
    how = {
        "sampling": f"Student's interval of {gap.n_realisations} realisations, and the bootstrap "
        f"band of the stiffness",
        "fit": "error at pressures that the fit has not seen",
        "cell size": "not known: pass sizes, responses of cells of another size",
        "micro discretisation": "not known: pass resolutions, the same realisations on coarser "
        "grids",
        "scale separation": "not known: pass scales from compare_scales",
        "macro discretisation": "not in a law: see structure_budget",
    }
    terms["sampling"] = sampling_term(response, law, p)
    if apart and sizes:
        pooled = pooled_sampling_term(response, sizes)
        how["sampling"] = "Student's interval, with the scatter of the sizes, which falls as 1/L"
    if gap.n_realisations < 2:
        how["sampling"] = "not known: one realisation tells nothing of the scatter, solve 3"
    terms["fit"] = fit_term(law, p.size)
    if sizes:
        biases["cell size"], terms["cell size"], how["cell size"] = size_term(
            response, sizes, apart=apart
        )
    if resolutions:
        terms["micro discretisation"], how["micro discretisation"] = grid_term(
            response, resolutions, apart=apart
        )
    if scales is not None:
        terms["scale separation"] = separation_term(law, terms["sampling"], p, scales)
        how["scale separation"] = str(scales)
    if apart and sizes:
        terms["sampling"] = pooled
    return _assemble(terms, biases, how, QUANTITIES, p)


def structure_budget(
    name: str,
    law: "xr.Dataset",
    solve: Callable[[NormalLaw], np.ndarray],
    *,
    pressure: np.ndarray | None = None,
    through: tuple[str, ...] = ("mean_gap", "stiffness"),
    coarser: Mapping[float, np.ndarray] | None = None,
    samples: np.ndarray | int = 100,
) -> "xr.Dataset":
    """Carry the error budget of a law to an answer of the structure.

    Parameters
    ----------
    name : str
        Of the answer, for instance ``"joint_stiffness"``.
    law : Dataset
        Follows ``INTERFACE_LAW`` and carries its budget; see :func:`with_budget`.
    solve : callable
        From a normal law to the answer, shape (steps,), any unit: a macro solver.
    pressure : ndarray, shape (steps,), optional
        Pressure of the interface at each step, Pa, at which the errors of the law count; their
        root mean square over its data if not given.
    through : tuple of str
        Quantities of the law whose errors pass into the answer; the largest counts.
    coarser : mapping of float to ndarray, shape (steps,), optional
        Answers with the mean law on coarser meshes, by the ratio of the spacings; see
        :func:`estimate_grid_error`.
    samples : int or ndarray, shape (samples, steps)
        How many bootstrap samples of the law are solved, from the first on, or their answers.
        With fewer than 40, sampling enters as the other terms do.

    Returns
    -------
    Dataset
        Follows ``ERROR_BUDGET``, with one quantity. *Sampling* comes from the samples of the law.
        The other terms of the law enter by the change of the answer when its gaps are stretched;
        a bias by solving with a law of free form through the gaps without it.

    Raises
    ------
    CaseError
        If the law carries no budget.
    """
    if "error_half_width" not in law:
        raise CaseError(
            "the law carries no error budget; add it by with_budget(law, error_budget(...))"
        )
    mean_law = law_from_dataset(law)
    answer = np.atleast_1d(np.asarray(solve(mean_law), dtype=float))
    size = np.abs(answer)
    how = {term: str(law.attrs[_how(term)]) for term in ERROR_TERMS}
    stretched = np.atleast_1d(solve(StretchedLaw(mean_law, 1.0 + STRETCH)))
    sensitivity = np.abs(stretched - answer) / size / STRETCH
    terms = {
        term: (sensitivity * half)[None]
        for term in ERROR_TERMS[:-1]
        if (half := _at_pressure(law, term, through, pressure)) is not None
    }
    biases: Terms = {}
    for term in terms:
        bias = law["error_bias"].sel(quantity="mean_gap", error_term=term).to_numpy()
        if np.any(bias):
            unbiased = np.atleast_1d(solve(_unbiased(law, bias)))
            biases[term] = ((answer - unbiased) / size)[None]
    if not isinstance(samples, np.ndarray):
        n = min(samples, int(law.sizes.get("sample", 0)))
        n = n if n >= FEWEST_SAMPLES else 0
        samples = np.array([np.atleast_1d(solve(law_from_dataset(law, k))) for k in range(n)])
    if len(samples):
        low, high = np.nanpercentile(samples, [2.5, 97.5], axis=0)
        terms["sampling"] = (0.5 * (high - low) / size)[None]
        how["sampling"] = f"{len(samples)} bootstrap samples of the law"
    how["macro discretisation"] = "not known: pass coarser, the answers on coarser meshes"
    if coarser:
        estimate = estimate_grid_error(answer, coarser)
        terms["macro discretisation"] = (estimate.half_width / size)[None]
        how["macro discretisation"] = estimate.how
    return _assemble(terms, biases, how, (name,), None, steps=answer.size)


def _at_pressure(
    law: "xr.Dataset", term: str, through: tuple[str, ...], pressure: np.ndarray | None
) -> np.ndarray | None:
    """Half-width of a term of the law that counts for an answer; nothing if it is not known."""
    found = []
    for half in law["error_half_width"].sel(error_term=term, quantity=list(through)).to_numpy():
        known = np.isfinite(half)
        if not np.any(known):
            continue
        if pressure is None:
            found.append(np.sqrt(np.mean(half[known] ** 2)))
        else:
            x = np.log(law["fit_pressure"].to_numpy()[known])
            found.append(np.interp(np.log(pressure), x, half[known]))
    return np.max(found, axis=0) if found else None


def _unbiased(law: "xr.Dataset", bias: np.ndarray) -> NormalLaw:
    """Return the law through the gaps of the data less their bias, which is relative."""
    gap = law["fit_mean_gap"].to_numpy() * (1.0 - bias)
    data = observe("gap", law["fit_pressure"].to_numpy(), gap)
    return law_from_dataset(fit_law(data, n_samples=0))


def total_error(bias: np.ndarray, half_width: np.ndarray) -> np.ndarray:
    r"""Bound that an error with a bias keeps with a probability of 95 %.

    Parameters
    ----------
    bias, half_width : ndarray
        Mean of the error and half-width of its 95 % interval about it, one shape and unit.

    Returns
    -------
    ndarray
        :math:`w` with :math:`P(|b + s\, \mathcal{N}(0, 1)| \le w) = 0.95` for the half-width
        :math:`1.96\, s`.
    """
    from scipy.special import chndtrix

    b, s = np.abs(bias), np.asarray(half_width) / NORMAL
    ratio = np.where(s > 0.0, b / np.where(s > 0.0, s, 1.0), np.inf)
    near = s * np.sqrt(chndtrix(0.95, 1.0, np.minimum(ratio, ONE_SIDED) ** 2))
    return np.asarray(np.where(ratio < ONE_SIDED, near, b + TAIL * s))


def with_budget(dataset: "xr.Dataset", budget: "xr.Dataset") -> "xr.Dataset":
    """Return a law or a macro result that carries its error budget.

    Parameters
    ----------
    dataset : Dataset
        Follows ``INTERFACE_LAW`` or ``MACRO_RESULT``, with the steps of the budget.
    budget : Dataset
        Follows ``ERROR_BUDGET``.

    Raises
    ------
    CaseError
        If the steps differ in number.
    """
    ERROR_BUDGET.check(budget)
    if dataset.sizes.get("step") != budget.sizes["step"]:
        raise CaseError(
            f"the budget has {budget.sizes['step']} steps, the dataset "
            f"{dataset.sizes.get('step')}; estimate the budget of this dataset"
        )
    variables = budget.drop_vars("nominal_pressure", errors="ignore")
    return dataset.merge(variables, join="exact").assign_attrs(
        {name: value for name, value in budget.attrs.items() if name not in dataset.attrs}
    )


def _how(term: str) -> str:
    """Return the attribute that says how a term was estimated."""
    return "how_" + term.replace(" ", "_")


def _assemble(
    terms: Terms,
    biases: Terms,
    how: Mapping[str, str],
    quantities: tuple[str, ...],
    pressure: np.ndarray | None,
    steps: int | None = None,
) -> "xr.Dataset":
    """Arrange the terms, add them up and say which are not known."""
    n = steps if pressure is None else pressure.size
    half = np.full((len(quantities), len(ERROR_TERMS), n or 0), np.nan)
    bias = np.zeros(half.shape)
    for k, term in enumerate(ERROR_TERMS):
        if term in terms:
            half[:, k] = terms[term]
        if term in biases:
            bias[:, k] = biases[term]
    half[~np.isfinite(half)] = np.nan
    bias[~np.isfinite(bias)] = 0.0
    unknown = [
        term
        for k, term in enumerate(ERROR_TERMS)
        if np.all(np.isnan(half[:, k])) and not how[term].startswith("not in a law")
    ]
    total = total_error(bias.sum(axis=1), np.sqrt(np.nansum(half**2, axis=1)))
    values = {"error_half_width": half, "error_bias": bias, "error_total": total}
    if pressure is not None:
        values["nominal_pressure"] = pressure
    return ERROR_BUDGET.build(
        values,
        **{_how(term): how[term] for term in ERROR_TERMS},
        unknown=", ".join(unknown),
        confidence=0.95,
    ).assign_coords(quantity=list(quantities), error_term=list(ERROR_TERMS))
