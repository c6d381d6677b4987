"""Errors of the tangential traction of a law, relative to full slip."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from multiscale.schema import INTERFACE_LAW, Dataset
from multiscale.upscaling.budget import FEW_CELLS, NORMAL, Term, estimate_grid_error
from multiscale.upscaling.reading import fitted_laws, law_from_dataset, pick, require_law
from multiscale.upscaling.sampling import half_range, student

STEEPEST = np.exp(-1.0)
"""Largest change of t / (mu p) with the logarithm of the stiffness: of x exp(-x)."""

RATIO = "shear_stiffness_ratio"

BED = "friction bed"  # a term

NORMAL_ALONE = Term("not in a law without shear")

SLIPS = np.geomspace(0.1, 8.0, 16)  # over mu p / (kappa K), up to full slip


def tangential_terms(
    terms: Mapping[str, Term],
    law: Dataset,
    p: np.ndarray,
    coarser: Mapping[float, Dataset],
) -> dict[str, Term]:
    """Add the tangential traction to the terms of gap, contact fraction and stiffness."""
    # other terms enter by their stiffness: t = mu p (1 - exp(-x)), x = kappa K u / (mu p), changes
    # by at most 1/e of their error
    by_grid = terms["micro discretisation"].half_width
    grid = np.full(p.size, np.nan)
    if coarser and by_grid is not None:
        grid = STEEPEST * np.hypot(by_grid[2], _grid_error({1.0: law, **coarser}, RATIO))
    tangential = {
        "sampling": _sampling(law, p),
        "micro discretisation": grid,
        BED: _distance(law, p),
    }
    bed = "largest distance of the sheared cells from the bed over mu p"
    normal = {**terms, BED: Term(bed, np.zeros((3, p.size)))}
    extended = {}
    for name, term in normal.items():
        if term.half_width is None:
            extended[name] = term
            continue
        bias = np.zeros((4, p.size))
        bias[:3] = term.bias
        row = tangential.get(name, STEEPEST * np.hypot(term.half_width[2], bias[2]))
        extended[name] = replace(term, half_width=np.vstack([term.half_width, row]), bias=bias)
    return extended


def shear_errors(law: Dataset, p: np.ndarray) -> dict[str, dict[str, np.ndarray]]:
    """Return half-widths of measured friction and stiffness ratio over them, by term."""
    n_samples = int(law.sizes.get("shear_sample", 0))
    if not n_samples:
        stated = law.get("shear_friction_error")
        return {} if stated is None else {"friction": {"sampling": np.full(p.size, float(stated))}}
    n, errors = int(law.attrs["n_sheared"]), {}
    for parameter, name in (("friction", "shear_friction"), ("stiffness_ratio", RATIO)):
        values = pick(law, name, [None, *range(n_samples)], of="shear")
        mean, *drawn = (float(np.nanmean(value)) for value in values)
        half = float(half_range(np.array(drawn))) / mean
        scatter = half * np.sqrt(n) / float(student(n - 1))
        few = NORMAL * scatter * float(law.attrs.get("cell_ratio", np.nan))
        errors[parameter] = {"sampling": np.full(p.size, half), FEW_CELLS: np.full(p.size, few)}
    if "tangential_traction" in law["quantity"].values:
        half_width, data = law["error_half_width"], np.log(law["fit_pressure"].to_numpy())
        for term in map(str, law["error_term"].values[:-1]):  # the last term is not of a law
            if term not in errors["stiffness_ratio"]:
                of_term = half_width.sel(error_term=term)
                total = of_term.sel(quantity="tangential_traction").to_numpy() / STEEPEST
                square = total**2 - of_term.sel(quantity="stiffness").to_numpy() ** 2
                half = np.sqrt(np.maximum(square, 0.0))
                errors["stiffness_ratio"][term] = np.interp(np.log(p), data, half)
    return errors


def loss_terms(law: Dataset) -> dict[str, Term]:
    """Estimate the errors of the loss of the bed in a closed cycle from the cells."""
    if "shear_loss_ratio" not in law.variables:
        how = "of the loss not known: no cells have closed cycles; shear cells in closed cycles"
        return {BED: Term(how, np.full((1, 1), np.nan))}
    require_law(law, "shear_cycle_pressure", "shear_cycle_amplitude", "shear_cycle_loss_ratio")
    ratio = law["shear_loss_ratio"].to_numpy()
    n_samples = int(law.sizes.get("shear_sample", 0))
    samples = pick(law, "shear_loss_ratio", range(n_samples), of="shear")
    drawn = [sample.mean() for sample in samples]
    sampling = half_range(np.array(drawn)) if n_samples else np.nan
    each = law["shear_cycle_loss_ratio"].mean("control").groupby(law["shear_cycle_pressure"])
    between = law.get("shear_loss_pressure_error", 0.5 * float(np.ptp(each.mean().to_numpy())))
    # bias 1 - r of the mean r of the ratios at equal slip and at equal traction, between which a
    # joint lies; half-width: half their distance, and the change over the pressures
    widths = [0.5 * np.ptp(ratio), float(between)]
    amplitude = float(law["shear_cycle_amplitude"].mean())
    how = (
        f"in cycles to {100.0 * amplitude:.2g} % of full slip the loss of the cells is "
        f"{ratio[0]:.3g} times the loss of the bed at equal slip, {ratio[1]:.3g} times at equal "
        f"traction"
    )
    bed = Term(how, np.full((1, 1), np.linalg.norm(widths)), np.full((1, 1), 1.0 - ratio.mean()))
    count = f"of the loss by {law.attrs.get('n_sheared', 'some')} sheared cells"
    return {BED: bed, "sampling": Term(count, np.full((1, 1), sampling))}


def _sampling(law: Dataset, p: np.ndarray) -> np.ndarray:
    """Return the half-width by the samples, over mu p; NaN without samples."""
    n = min(int(law.sizes.get("sample", 0)), int(law.sizes.get("shear_sample", 0)))
    if not n:
        return np.full(p.size, np.nan)
    ratio = np.nanmean(pick(law, RATIO, [None, *range(n)], of="shear"), axis=1)
    mu = np.array(pick(law, "shear_friction", [None, *range(n)], of="shear"))
    mean = law_from_dataset(law)
    slip = mu[0] * p / (ratio[0] * mean.stiffness(mean.gap_at(p))) * SLIPS[:, None]
    traction = [
        m * (p - sample.pressure(sample.gap_at(p) + k * slip / m))
        for sample, k, m in zip(fitted_laws(law, range(n)), ratio[1:], mu[1:], strict=True)
    ]
    return np.asarray(np.max(half_range(np.array(traction)), axis=0) / (mu[0] * p))


def _grid_error(laws: Mapping[float, Dataset], name: str) -> float:
    """Estimate the relative half-width by the grid of the mean of a value of laws."""
    finest, *others = sorted(laws)
    values = {ratio: laws[ratio][name].mean().to_numpy()[None] for ratio in (finest, *others)}
    fine = values.pop(finest)
    coarser = {ratio / finest: value for ratio, value in values.items()}
    return float(estimate_grid_error(fine, coarser).half_width[0] / fine[0])


def with_loss_grid(law: Dataset, laws: Mapping[float, Dataset]) -> Dataset:
    """Return a law with the error by the grid of its loss, from laws by ratios of spacings."""
    name = "shear_loss_ratio"
    if len(laws) < 2 or not all(name in grid.variables for grid in laws.values()):
        return law
    return INTERFACE_LAW.assign(law, {"shear_loss_grid_error": _grid_error(laws, name)})


def _distance(law: Dataset, p: np.ndarray) -> np.ndarray:
    """Return the largest distance of the mean cell from the mean bed at pressures, over mu p."""
    require_law(law, "shear_pressure", "shear_traction", "shear_bed_traction")
    sheared = law["shear_pressure"].to_numpy()
    apart = law["shear_traction"].to_numpy() - law["shear_bed_traction"].to_numpy()
    share = np.linalg.norm(apart, axis=1) / (float(law["shear_friction"]) * sheared)
    at = np.unique(sheared)
    largest = [share[sheared == pressure].max() for pressure in at]
    return np.asarray(np.interp(np.log(p), np.log(at), largest))
