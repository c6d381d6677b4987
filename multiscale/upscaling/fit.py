"""From observations of many cells, or of specimens, to laws with their uncertainty."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from multiscale.errors import CaseError, require
from multiscale.laws import AreaLaw
from multiscale.schema import (
    INTERFACE_LAW,
    LAW_COMPARISON,
    Dataset,
    Schema,
    Variable,
    with_cautions,
)
from multiscale.upscaling.family import FAMILIES, Family, families_of
from multiscale.upscaling.free_form import (
    N_TERMS,
    FitResult,
    Values,
    fit_area,
    fit_convex_decreasing,
    fit_each,
    representable,
    unseen_errors,
)
from multiscale.upscaling.law_checks import admissibility
from multiscale.upscaling.observations import QUANTITIES, Observations
from multiscale.upscaling.reading import (
    BY_REALISATION,
    area_from_dataset,
    fitted_law,
)
from multiscale.upscaling.regression import NONE, fit_family, regression_of
from multiscale.upscaling.response_observations import area_observations, normal_observations
from multiscale.upscaling.sampling import draw_counts

BRANCHES = {
    "loading": "measured",
    "unloading": "assumed, along the same curve",
    "shear": "not in the law",
}

LARGEST_GAP = 0.1  # m; the coarsest texture of roads has 0.02 m
FEWEST_PER_DECADE = 2

FREE_FORM = {
    "gap": "convex_decreasing",
    "normal_stiffness": "convex_decreasing",
    "contact_fraction": "monotone",
}


def fit_law(
    data: Dataset | Observations,
    *,
    control: Dataset | None = None,
    family: str | Family | None = None,
    fixed: Mapping[str, float] | None = None,
    weights: np.ndarray | None = None,
    n_terms: int = N_TERMS,
    n_samples: int = 200,
    seed: int = 0,
) -> Dataset:
    r"""Fit a law to the response of an ensemble of cells, or to other observations.

    Parameters
    ----------
    data : Dataset or Observations
        A dataset that follows ``MICRO_RESPONSE``, with realisations loaded to the same pressures,
        gives a normal law and an area law. Failed steps (``converged`` 0 or NaN) are left out,
        as is a pressure that no realisation reached. Observations give the law of their
        quantity; see :func:`observe` and :func:`read_observations`.
    control : Dataset, optional
        Follows ``MICRO_RESPONSE``: many cheap cells next to the few of a response, at the same
        pressures, such as flat cells for conforming cells. Cheap cells with the numbers of the
        response have its surfaces. Means and samples use both, see :class:`~.sampling.Control`, or
        only the response if the control does not narrow the interval of a quantity.
    family : str or Family, optional
        ``"convex_decreasing"`` (gap and normal stiffness) and ``"monotone"`` (contact fraction)
        have free form and are the default; the others are in ``FAMILIES``, or defined by a user.
    fixed : mapping of str to float, optional, parameters of the family that keep a value, SI
    weights : ndarray, shape (points,), optional
        Weight of each step of the response, or of each point, not negative; 1 if not given.
    n_terms : int, number of knots of the normal law of free form, at least 6
    n_samples : int
        Number of bootstrap samples. With fewer than three realisations the scatter is unknown,
        and the dimension ``sample`` has size 0; for a single realisation of independent
        measurements, the residuals of a family with parameters are resampled instead.

    Returns
    -------
    Dataset
        Follows ``INTERFACE_LAW``; a family with parameters has a variable for each, and its
        ``..._sample`` along ``sample``. Attributes: ``family``, ``quantity``,
        ``n_realisations``, ``n_samples``, ``pressure_min``, ``pressure_max`` (Pa),
        ``pressures_per_decade``, ``branches`` (measured or assumed) and for normal laws
        ``gap_min``, ``gap_max`` (m) of the data, ``pressure_limit`` (Pa) if the law ends below the
        largest pressure, ``cautions`` (lines with the cautions of the response and the pressures
        that are left out, or missed), the errors of the fit below (1), ``admissible`` (1 or 0) and
        ``admissibility`` (a sentence for each check), ``seed``, ``uncertainty`` (a sentence), and
        the attributes of the surface.

        - ``maximum_fit_error``: largest relative error (of the pressure, for a normal law) at the
          data;
        - ``cross_validated_error`` and ``cross_validated_rms_error``: the largest and the root
          mean square at a point left out of the fit. The first and the last pressure of a normal
          law are never left out, since that would be extrapolation;
        - ``cross_validated_stiffness_error``: the same for the stiffness, against the full fit.

    Raises
    ------
    CaseError
        If there are too few points, the mean gap does not fall as the pressure rises, no convex
        law follows three gaps of cells, or the data contradict themselves.
    ConvergenceError
        If the parameters do not converge.
    SchemaError
        If the response does not follow its schema.

    Notes
    -----
    The law of free form is :class:`~multiscale.laws.ConvexDecreasing`. Its knots are even in the
    logarithm of the pressure and common to all samples. Its accuracy depends on the pressures per
    decade. For noise-free exponential, power, Greenwood-Williamson and Westergaard laws (up to half
    the pressure of complete contact) over 1 to 3 decades, its largest errors are

    ================== ===== ===== ===== =====
    pressures a decade 2     3     4     8
    ================== ===== ===== ===== =====
    pressure           4 %   .4 %  .25 % .08 %
    stiffness          20 %  5 %   3 %   1 %
    ================== ===== ===== ===== =====

    mostly for Westergaard's law at the highest pressures. Outside its range the law extrapolates.
    If the stiffness tends to infinity, as at complete contact, its error grows.

    Cells that flow nearly everywhere at the surface become softer as the pressure rises, unlike a
    convex law: the law ends at the pressure where this begins. Every other law has a caution at
    observations that it misses.

    The bootstrap resamples whole realisations with replacement, since the steps of each are
    correlated; :func:`widening` spreads the samples, so that 95 % intervals are valid for few
    realisations too. The bands contain the sampling error, but no model error.

    References
    ----------
    .. [1] B. Efron and R. J. Tibshirani, An Introduction to the Bootstrap, Chapman & Hall, 1993.
    """
    for name, count, least in (
        ("n_terms", n_terms, 6),
        ("n_samples", n_samples, 0),
        ("seed", seed, 0),
    ):
        require(name, count, f"[{least}, inf)", integer=True)
    observations, area, share = _observe(data, control, weights)
    chosen = _choose(family, observations.quantity)
    attributes: dict[str, Any] = {}
    cautions: list[str] = []
    # a normal law ends at the pressure that a convex function no longer follows
    if chosen == "convex_decreasing":
        n_used, cautions = representable(observations, share, n_terms=n_terms)
        observations, share = observations.at(slice(n_used)), share[:n_used]
        area = None if area is None else area.at(slice(n_used))
        if cautions:
            attributes["pressure_limit"] = float(observations.pressure[-1])
    # the mean law and its bootstrap samples
    further = max(data.n_further for data in (observations, area) if data is not None)
    counts = draw_counts(observations.n_realisations, n_samples, seed, n_further=further)
    attributes["uncertainty"] = BY_REALISATION if len(counts) else NONE
    if isinstance(chosen, Family):
        result = fit_family(
            observations, chosen, counts, share, fixed or {}, n_samples=n_samples, seed=seed
        )
    elif fixed:
        raise CaseError(f"the family {chosen!r} has free form and no parameter to be fixed")
    elif chosen == "monotone":
        fitted = fit_area(observations, counts)
        result = FitResult(fitted, unseen_errors(fitted["area_fit_error"]))
    else:
        result = fit_convex_decreasing(observations, counts, share, n_terms=n_terms)
    values = result.values
    # the area law of the same cells
    if area is not None:
        fitted = fit_area(area, counts)
        values = fitted | values
        area_law = AreaLaw(fitted["area_pressure"], fitted["area_fraction"])
        cautions += area.misses(area_law, "the area law misses the observed fraction").judge(
            "use more realisations, or a finer grid"
        )
        if control is not None:
            controls = {"mean gap": observations, "contact fraction": area}
            attributes["control"] = "; ".join(
                describe_control(name, data) for name, data in controls.items()
            )
            attributes["n_control"] = control.sizes["realisation"]
        attributes["branches"] = _join_branches(BRANCHES)
    attributes |= result.attributes | {"seed": seed}
    return _build(observations, chosen, values, attributes, cautions, share > 0.0)


def _observe(
    data: Dataset | Observations, control: Dataset | None, weights: np.ndarray | None
) -> tuple[Observations, Observations | None, np.ndarray]:
    """Return observations, observations of the contact fraction, and weights of the points."""
    if isinstance(data, Observations):
        observations, area, given = data, None, data.order.size
    else:
        observations, area = normal_observations(data, control), area_observations(data, control)
        given = data.sizes["step"]
    if weights is None:
        return observations, area, np.ones(observations.pressure.size)
    share = np.asarray(weights, dtype=float)
    if share.shape != (given,) or not np.all((share >= 0.0) & np.isfinite(share)):
        raise CaseError(
            f"weights must be {given} finite numbers that are not negative, one for each point "
            f"given, got shape {share.shape}"
        )
    return observations, area, share[observations.order]


def describe_control(name: str, observed: Observations) -> str:
    """Describe the effect of a control on a quantity, which may be none."""
    return f"{name}: {observed.control or 'none, since they follow each other by chance only'}"


def with_branch(law: Dataset, branch: str, origin: str, values: Mapping[str, Any]) -> Dataset:
    """Add a branch to a law: its values, and whether it is measured."""
    branches = _join_branches({**branch_origins(law), branch: origin})
    return INTERFACE_LAW.assign(law, values).assign_attrs(branches=branches)


def branch_origins(law: Dataset) -> dict[str, str]:
    """Return the origin of each branch of a law, such as ``"measured"``."""
    text = str(law.attrs.get("branches", ""))
    return dict(branch.split(": ", 1) for branch in text.split("; ") if branch)


def _join_branches(origins: Mapping[str, str]) -> str:
    return "; ".join(map(": ".join, origins.items()))


def laws_of_each(observations: Observations, law: Dataset | None = None) -> list[Any]:
    """Fit a normal law to each realisation."""
    mean, counted = observations.mean, observations.counted
    gap, equal_weights = np.where(counted, observations.values, mean), np.ones(mean.size)
    family = FREE_FORM["gap"] if law is None else str(law.attrs["family"])
    if law is None or family == FREE_FORM["gap"]:
        return list(fit_each(observations, gap))
    fixed = {name: float(law[name]) for name in str(law.attrs["fixed"]).split()}
    regression = regression_of(FAMILIES[family], observations, fixed, equal_weights)
    start = regression.solve(mean, equal_weights)
    fits = regression.solve_many(gap, 1.0 * counted, start)
    return [None if fit is None else regression.law(fit) for fit in fits]


def stiffness_of_each(observations: Observations, law: Dataset | None = None) -> np.ndarray:
    """Evaluate the stiffness of the laws of all realisations, Pa/m, NaN where it is missing."""
    counted = observations.counted
    gap = np.where(counted, observations.values, observations.mean)
    stiffness = np.full(gap.shape, np.nan)
    smooth = law is not None and law.attrs["family"] != FREE_FORM["gap"]
    for k, law_k in enumerate(laws_of_each(observations, law)):
        if law_k is not None:
            # laws of free form pass through the observed gaps
            at = law_k.gap_at(observations.pressure) if smooth else gap[k]
            stiffness[k] = law_k.stiffness(at)
    return np.where(counted, stiffness, np.nan)


def _choose(family: str | Family | None, quantity: str) -> str | Family:
    if isinstance(family, Family):
        return family
    fitting = [family.name for family in FAMILIES.values() if quantity in family.quantities]
    free_form = FREE_FORM.get(quantity)
    if family is None and free_form is None and len(fitting) != 1:
        hint = " or ".join(repr(name) for name in fitting) or "unloading_family(loading law)"
        raise CaseError(f"{quantity} can be described in several ways; choose family = {hint}")
    name = family or free_form or fitting[0]
    if name == free_form:
        return name
    if name not in FAMILIES or quantity not in FAMILIES[name].quantities:
        names = ", ".join([*([free_form] if free_form else []), *fitting])
        raise CaseError(f"there is no family {name!r} for {quantity}; choose from {names}")
    return FAMILIES[name]


def _build(
    observations: Observations,
    family: str | Family,
    values: Values,
    attributes: dict[str, Any],
    cautions: list[str],
    counted: np.ndarray,
) -> Dataset:
    """Assemble the dataset, with cautions where data are unlikely or coarse, and judge the law."""
    quantity, p = QUANTITIES[observations.quantity], observations.pressure
    cautions = [*cautions, *_doubts(observations)]
    decades = np.log10(p.max() / p.min())
    coverage = {"pressures_per_decade": float(_steps(p) / decades)} if decades else {}
    conditions = zip(quantity.conditions, observations.conditions, strict=True)
    sizes = [len(value) for name, value in values.items() if name.endswith("_sample")]
    custom = None if isinstance(family, str) else family
    dataset = _schema_of(custom, observations).build(
        {
            **values,
            **{f"fit_{name}": condition for name, condition in conditions},
            quantity.variable: observations.mean,
        },
        **{**observations.attributes, **attributes, **coverage},
        family=family if isinstance(family, str) else family.name,
        quantity=observations.quantity,
        n_realisations=observations.n_realisations,
        n_samples=max(sizes, default=0),
        pressure_min=float(p.min()),
        pressure_max=float(p.max()),
    )
    # distance from the data, and admissibility
    name, free_form = dataset.attrs["family"], FREE_FORM.get(observations.quantity)
    law: Any = (
        area_from_dataset(dataset) if family == "monotone" else fitted_law(dataset, family=custom)
    )
    missed = f"the law of the family {name!r} misses the observed {observations.quantity}"
    other = f"such as {free_form!r}" if free_form not in (None, name) else "or fewer pressures"
    misfit = observations.at(counted).misses(law, missed.replace("_", " "))
    cautions += misfit.judge(f"choose another family, {other}")
    report = admissibility(law, (float(p.min()), float(p.max())))
    dataset = dataset.assign_attrs(admissible=int(report.passed), admissibility=str(report))
    return with_cautions(dataset, *cautions)


def _steps(pressure: np.ndarray) -> int:
    """Count the steps between the pressures."""
    return int(np.unique(pressure).size - 1)


def _doubts(observations: Observations) -> Iterator[str]:
    """Caution on gaps in another unit, and on few pressures."""
    p, mean = observations.pressure, observations.mean
    if observations.quantity != "gap":
        return
    if mean.max() > LARGEST_GAP:
        yield (
            f"the largest mean gap of {mean.max():.3g} m is too large for roughness; give gaps in m"
        )
    if _steps(p):
        per_decade = _steps(p) / np.log10(p.max() / p.min())
        if per_decade < FEWEST_PER_DECADE * (1.0 - 1e-9):
            yield (
                f"the law has {per_decade:.2g} pressures per decade; its accuracy is known for "
                f"{FEWEST_PER_DECADE} or more"
            )


def _schema_of(family: Family | None, observations: Observations) -> Schema:
    """Return the schema of a law, with the parameters of a family as variables."""
    if family is None:
        return INTERFACE_LAW
    text = f"parameter of the {family.name} law"
    added = {
        name: Variable((), parameter.unit, text) for name, parameter in family.parameters.items()
    }
    for name, (_, unit) in family.held(observations).items():
        added[name] = Variable((), unit, f"given by the data to the {family.name} law")
    schema = replace(INTERFACE_LAW, optional={**INTERFACE_LAW.optional, **added})
    return schema.with_samples(sample=family.parameters)


def compare_laws(
    data: Dataset | Observations, families: Sequence[str | Family] | None = None
) -> Dataset:
    r"""Fit several families to the same data and compare them.

    Parameters
    ----------
    data
        As of :func:`fit_law`.
    families : sequence of str or Family, optional
        All built-in families for the quantity if not given, except for sheared grains.

    Returns
    -------
    Dataset
        Follows ``LAW_COMPARISON``, in the order of the cross-validated error, the smallest first.
        The criterion is NaN for a law of free form, which has no defined number of parameters; the
        weights belong to the other families.

    Notes
    -----
    The criterion is Akaike's with the correction for few points [1]_, for independent errors of
    equal relative size; the weights are :math:`w_i \propto e^{-\Delta_i / 2}` with the differences
    from the smallest. The steps of a cell are not independent, which favours families with many
    parameters; the error at unseen points does not assume independence.

    References
    ----------
    .. [1] C. M. Hurvich and C.-L. Tsai, Biometrika 76 (1989) 297-307,
       doi:10.1093/biomet/76.2.297.
    """
    if families is None:
        quantity = data.quantity if isinstance(data, Observations) else "gap"
        families = [family.name for family in families_of(quantity)]
        families = [*([FREE_FORM[quantity]] if quantity in FREE_FORM else []), *families]
    fits = [fit_law(data, family=family, n_samples=0).attrs for family in families]
    error = np.array([fit["cross_validated_rms_error"] for fit in fits])
    criterion = np.array([fit.get("akaike_criterion", np.nan) for fit in fits])
    weight = np.full(len(fits), np.nan)
    finite = np.isfinite(criterion)
    if np.any(finite):
        likelihood = np.exp(-0.5 * (criterion[finite] - criterion[finite].min()))
        weight[finite] = likelihood / likelihood.sum()
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
    names = [family.name for family in families_of(quantity) if len(family.parameters) < n]
    families = compare_laws(observations, [FREE_FORM[quantity], *names])
    admissible = families["family"].values[families["admissible"].values == 1]
    if not admissible.size:
        raise CaseError(
            f"no family of laws of {observations.quantity} is admissible for these data; check "
            f"that they belong to one loading branch"
        )
    return str(admissible[0]), families
