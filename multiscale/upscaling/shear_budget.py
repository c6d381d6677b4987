"""How wrong the tangential traction of a law is, relative to full slip."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from multiscale.schema import INTERFACE_LAW, Dataset
from multiscale.upscaling.budget import FEW_CELLS, NORMAL, Term, estimate_grid_error
from multiscale.upscaling.reading import fitted_laws, law_from_dataset, pick, require_law
from multiscale.upscaling.sampling import half_range

__all__ = [
    "NORMAL_ALONE",
    "STEEPEST",
    "loss_term",
    "shear_errors",
    "tangential_terms",
    "with_loss_grid",
]

STEEPEST = np.exp(-1.0)
"""Largest change of t / (mu p) with the logarithm of the stiffness: of x exp(-x)."""

RATIO = "shear_stiffness_ratio"

NORMAL_ALONE = Term("not in a law without shear")

SLIPS = np.geomspace(0.1, 8.0, 16)  # over mu p / (kappa K), up to full slip


def tangential_terms(
    terms: Mapping[str, Term],
    law: Dataset,
    p: np.ndarray,
    coarser: Mapping[float, Dataset],
) -> dict[str, Term]:
    r"""Add the tangential traction to the terms of gap, contact fraction and stiffness.

    Notes
    -----
    - *sampling*: from the bootstrap samples of normal law, :math:`\kappa` and :math:`\mu`;
    - *friction bed*: the largest distance of the mean cell from the mean bed along its path, at the
      sheared pressures, and in between over the logarithm of the pressure;
    - *micro discretisation*: :func:`~.budget.estimate_grid_error` of :math:`\kappa`, with that
      of the stiffness; not known without coarser grids;
    - the others enter by what they are of the stiffness: as :math:`t \approx \mu p\,
      (1 - e^{-x})` with :math:`x = \kappa K u / (\mu p)`, they change :math:`t / (\mu p)` by
      :math:`x e^{-x} \le 1/e` of it.
    """
    by_grid = terms["micro discretisation"].half_width
    grid = np.full(p.size, np.nan)
    if coarser and by_grid is not None:
        grid = STEEPEST * np.hypot(by_grid[2], _grid_error({1.0: law, **coarser}, RATIO))
    own = {
        "sampling": _sampling(law, p),
        "micro discretisation": grid,
        "friction bed": _distance(law, p),
    }
    told = "largest distance of the sheared cells from the bed over mu p"
    normal = {**terms, "friction bed": Term(told, np.zeros((3, p.size)))}
    found = {}
    for name, term in normal.items():
        if term.half_width is None:
            found[name] = term
            continue
        bias = np.zeros((4, p.size))
        bias[:3] = term.bias
        row = own.get(name, STEEPEST * np.hypot(term.half_width[2], bias[2]))
        found[name] = replace(term, half_width=np.vstack([term.half_width, row]), bias=bias)
    return found


def shear_errors(law: Dataset, p: np.ndarray) -> dict[str, dict[str, np.ndarray]]:
    r"""Errors of friction and stiffness ratio of a law that was measured; none of assumed ones.

    Parameters
    ----------
    law : Dataset
        Follows ``INTERFACE_LAW``; carries a budget with the scales of a structure, if any.
    p : ndarray, shape (steps,), pressures, Pa

    Returns
    -------
    dict
        For ``friction`` and ``stiffness_ratio`` the half-width of the 95 % interval over the value
        by term, shape (steps,): *sampling* by the bootstrap, *few cells* by the scatter that it
        tells of single cells, and for the ratio all that a term of the tangential traction, as
        :func:`tangential_terms` tells it, does not have from the stiffness. A friction without
        samples that was measured has the error that the law states, which may be NaN.
    """
    from scipy.special import stdtrit

    n_samples = int(law.sizes.get("shear_sample", 0))
    if not n_samples:
        stated = law.get("shear_friction_error")
        return {} if stated is None else {"friction": {"sampling": np.full(p.size, float(stated))}}
    n, found = int(law.attrs["n_sheared"]), {}
    for parameter, name in (("friction", "shear_friction"), ("stiffness_ratio", RATIO)):
        values = pick(law, name, [None, *range(n_samples)], of="shear")
        mean, *drawn = (float(np.nanmean(one)) for one in values)
        half = float(half_range(np.array(drawn))) / mean
        scatter = half * np.sqrt(n) / stdtrit(max(n - 1, 1), 0.975)
        few = NORMAL * scatter * float(law.attrs.get("cell_ratio", np.nan))
        found[parameter] = {"sampling": np.full(p.size, half), FEW_CELLS: np.full(p.size, few)}
    if "tangential_traction" in law["quantity"].values:
        half_width, data = law["error_half_width"], np.log(law["fit_pressure"].to_numpy())
        for term in map(str, law["error_term"].values[:-1]):  # the last one is not of a law
            if term not in found["stiffness_ratio"]:
                one = half_width.sel(error_term=term)
                row = one.sel(quantity="tangential_traction").to_numpy() / STEEPEST
                rest = row**2 - one.sel(quantity="stiffness").to_numpy() ** 2
                left = np.sqrt(np.maximum(rest, 0.0))
                found["stiffness_ratio"][term] = np.interp(np.log(p), data, left)
    return found


def loss_term(law: Dataset) -> Term:
    """How wrong the loss of the bed is in a closed cycle, as the cells tell it.

    The term is of one answer at one step. Its bias is :math:`1 - r` with the mean :math:`r` of the
    ratios of the losses at equal slip and at equal traction, since a joint lies between the two.
    Its half-width has the samples, half the distance of the two ratios, and half the range over
    the pressures. NaN where no cells went through closed cycles.
    """
    if "shear_loss_ratio" not in law.variables:
        told = "of the loss not known: no cells went through closed cycles; shear them so"
        return Term(told, np.full((1, 1), np.nan))
    require_law(law, "shear_cycle_pressure", "shear_cycle_amplitude", "shear_cycle_loss_ratio")
    ratio = law["shear_loss_ratio"].to_numpy()
    n_samples = int(law.sizes.get("shear_sample", 0))
    drawn = [one.mean() for one in pick(law, "shear_loss_ratio", range(n_samples), of="shear")]
    sampling = half_range(np.array(drawn)) if n_samples else np.nan
    each = law["shear_cycle_loss_ratio"].mean("control").groupby(law["shear_cycle_pressure"])
    parts = [sampling, 0.5 * np.ptp(ratio), 0.5 * float(np.ptp(each.mean().to_numpy()))]
    amplitude = float(law["shear_cycle_amplitude"].mean())
    told = (
        f"in cycles to {100.0 * amplitude:.2g} % of full slip the cells lose {ratio[0]:.3g} times "
        f"as much as the bed that slips as far, {ratio[1]:.3g} times as the bed that carries as "
        f"much"
    )
    half_width = np.full((1, 1), np.linalg.norm(parts))
    return Term(told, half_width, np.full((1, 1), 1.0 - ratio.mean()))


def _sampling(law: Dataset, p: np.ndarray) -> np.ndarray:
    """Half-width by the samples, over mu p; NaN without any."""
    n = min(int(law.sizes.get("sample", 0)), int(law.sizes.get("shear_sample", 0)))
    if not n:
        return np.full(p.size, np.nan)
    ratio = np.nanmean(pick(law, RATIO, [None, *range(n)], of="shear"), axis=1)
    mu = np.array(pick(law, "shear_friction", [None, *range(n)], of="shear"))
    mean = law_from_dataset(law)
    slip = mu[0] * p / (ratio[0] * mean.stiffness(mean.gap_at(p))) * SLIPS[:, None]
    traction = [
        m * (p - one.pressure(one.gap_at(p) + k * slip / m))
        for one, k, m in zip(fitted_laws(law, range(n)), ratio[1:], mu[1:], strict=True)
    ]
    return np.asarray(np.max(half_range(np.array(traction)), axis=0) / (mu[0] * p))


def _grid_error(laws: Mapping[float, Dataset], name: str) -> float:
    """Half-width by the grid of the mean of a value of laws on several grids, over the value."""
    finest, *others = sorted(laws)
    values = {ratio: laws[ratio][name].mean().to_numpy()[None] for ratio in (finest, *others)}
    fine = values.pop(finest)
    found = estimate_grid_error(fine, {ratio / finest: one for ratio, one in values.items()})
    return float(found.half_width[0] / fine[0])


def with_loss_grid(law: Dataset, laws: Mapping[float, Dataset]) -> Dataset:
    """Return a law with the error by the grid of what its cells lose in closed cycles.

    ``laws``, by the ratio of the spacings, are of the same realisations, as of
    :func:`tangential_terms`; nothing is known if one was not cycled.
    """
    name = "shear_loss_ratio"
    if len(laws) < 2 or not all(name in one.variables for one in laws.values()):
        return law
    return INTERFACE_LAW.assign(law, {"shear_loss_grid_error": _grid_error(laws, name)})


def _distance(law: Dataset, p: np.ndarray) -> np.ndarray:
    """Largest distance of the mean cell from the mean bed at each pressure, over mu p."""
    require_law(law, "shear_pressure", "shear_traction", "shear_bed_traction")
    sheared = law["shear_pressure"].to_numpy()
    apart = law["shear_traction"].to_numpy() - law["shear_bed_traction"].to_numpy()
    share = np.linalg.norm(apart, axis=1) / (float(law["shear_friction"]) * sheared)
    at = np.unique(sheared)
    largest = [share[sheared == one].max() for one in at]
    return np.asarray(np.interp(np.log(p), np.log(at), largest))
