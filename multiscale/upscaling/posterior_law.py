"""The dataset of a calibrated law: mode and samples of its posterior, and its budget."""

from collections.abc import Sequence

import numpy as np

from multiscale.laws import NormalLaw
from multiscale.schema import INTERFACE_LAW, Dataset, with_cautions
from multiscale.upscaling.budget import (
    ALWAYS,
    ERROR_TERMS,
    FEW_CELLS,
    MODEL,
    OF_ONE_PART,
    Term,
    assemble_budget,
    has_budget,
    how_attribute,
    with_budget,
)
from multiscale.upscaling.family import integrate_stiffness
from multiscale.upscaling.fit import with_branch
from multiscale.upscaling.free_form import N_TERMS, fit_each, fit_spline, place_knots
from multiscale.upscaling.law_budget import LAW_QUANTITIES
from multiscale.upscaling.measured.joints import BedCurve, Curve
from multiscale.upscaling.observations import observe
from multiscale.upscaling.reading import law_from_dataset
from multiscale.upscaling.sampling import half_range

DATA_POINTS, BEYOND = 64, 2.0  # of the law, up to this factor outside its data

REPLACED = ("knot", "coefficient", "fit_error", "stiffness_fit_error", "gap_fit", "stiffness_fit")
"""Begins of the names of variables of the normal law of the cells."""


def normal_law(law: Dataset, curve: Curve) -> NormalLaw:
    """Return a normal law of a curve of stiffness over and about the data of a law of cells."""
    low, high = (float(law.attrs[f"pressure_{end}"]) for end in ("min", "max"))
    p = np.geomspace(low / BEYOND, high * BEYOND, DATA_POINTS)
    gap = integrate_stiffness(p, np.exp(curve.at(p)[0]))
    gap += float(law_from_dataset(law).gap_at(np.array(high)))
    return fit_each(observe("gap", p, gap), gap[None])[0]


def law_of_interfaces(
    law: Dataset,
    interfaces: Sequence[BedCurve],
    heights: np.ndarray,
    sentences: Sequence[str],
    *,
    sheared: bool,
) -> Dataset:
    """Return a law of cells with a mode and its samples, which have factors of the heights."""
    low, high = (float(law.attrs[f"pressure_{end}"]) for end in ("min", "max"))
    p = np.geomspace(low / BEYOND, high * BEYOND, DATA_POINTS)
    stiffness = np.array([np.exp(interface.curve.at(p)[0]) for interface in interfaces])
    # gaps up to a constant, by the gap of the cells at the largest pressure and the heights
    gap = integrate_stiffness(p, stiffness)
    top = heights * law_from_dataset(law).gap_at(high / heights)
    at_top = np.array([np.interp(np.log(high), np.log(p), row) for row in gap])
    gap += (top - at_top)[:, None]
    knot, level = place_knots(p, gap[0], N_TERMS, float(gap.max()))
    coefficient = fit_spline(p, gap, np.ones_like(gap), knot, level)
    values = {"knot": knot, "coefficient": coefficient[0], "coefficient_sample": coefficient[1:]}
    data = law["fit_pressure"].to_numpy()
    at_data = np.array([np.interp(np.log(data), np.log(p), row) for row in gap])
    values["fit_mean_gap"] = at_data[0]
    count = len(interfaces) - 1
    if not law.sizes.get("sample", 0):
        law = law.drop_dims("sample", errors="ignore")
    if "area_fraction" in law and "area_fraction_sample" not in law:
        values["area_fraction_sample"] = np.tile(law["area_fraction"].to_numpy(), (count, 1))
    gone = [name for name in law.variables if str(name).startswith(REPLACED)]
    after = law.drop_dims(("quantity", "error_term", "parameter", "term"), errors="ignore")
    after = INTERFACE_LAW.assign(after.drop_vars(gone, errors="ignore"), values)
    after.attrs = {
        name: text
        for name, text in after.attrs.items()
        if not name.startswith(("how_", "unknown", "cell_ratio"))
    } | {
        "family": "convex_decreasing",
        "uncertainty": "posterior of measured joints",
        "n_samples": count,
        "calibration": "\n".join(sentences),
    }
    after = with_branch(after, "loading", "calibrated by measured joints", {})
    if sheared:
        after = _with_shear(after, interfaces)
    at_law = np.exp([interface.curve.at(data)[0] for interface in interfaces])
    budget = _budget(law, after, at_data, at_law)
    return with_cautions(with_budget(after, budget), *sentences)


def _with_shear(law: Dataset, interfaces: Sequence[BedCurve]) -> Dataset:
    """Add stiffness ratio and friction; ratios along x and y keep their quotient."""
    along = law["shear_stiffness_ratio"].to_numpy()
    ratio = np.outer([interface.ratio for interface in interfaces], along / np.nanmean(along))
    friction = np.array([interface.friction for interface in interfaces])
    values = {
        "shear_stiffness_ratio": ratio[0],
        "shear_stiffness_ratio_sample": ratio[1:],
        "shear_friction": friction[0],
        "shear_friction_sample": friction[1:],
    }
    if "shear_loss_ratio_sample" in law:
        lost = law["shear_loss_ratio_sample"].to_numpy()
        values["shear_loss_ratio_sample"] = np.resize(lost, (len(interfaces) - 1, 2))
    law = with_branch(law.drop_dims("shear_sample", errors="ignore"), "shear", "measured", values)
    return law.assign_attrs(n_sheared=int(law.attrs.get("n_sheared", 1)))


def _budget(before: Dataset, after: Dataset, gap: np.ndarray, stiffness: np.ndarray) -> Dataset:
    """Return the budget: the posterior of gap and stiffness, and the terms of the cells."""
    p, spline = after["fit_pressure"].to_numpy(), law_from_dataset(after)
    misfit = np.abs(spline.stiffness(spline.gap_at(p)) / stiffness[0] - 1.0)
    terms = {}
    for term in ERROR_TERMS:
        half, bias = np.zeros((2, 3, p.size))
        how = "nothing but the posterior"
        if has_budget(before) and term not in OF_ONE_PART:
            of_term = before.sel(error_term=term, quantity=list(LAW_QUANTITIES[:2]))
            if term in ALWAYS or of_term["error_half_width"].notnull().any():
                half[:2], bias[:2] = (of_term[f"error_{kind}"] for kind in ("half_width", "bias"))
            how = f"of gap and contact area: {before.attrs[how_attribute(term)]}"
        elif term in ALWAYS:
            half[:2] = np.nan
        if term == "fit":
            half[2] = misfit
            how += f"; the stiffness is within {100.0 * misfit.max():.2g} % of the posterior"
        if term == "sampling":
            half[[0, 2]] = [half_range(rows[1:]) / np.abs(rows[0]) for rows in (gap, stiffness)]
            how = f"{len(gap) - 1} samples of the posterior of measured joints"
        terms[term] = Term(how, half, bias)
    terms[FEW_CELLS] = Term("not in a law of a measured joint: it has no scatter of further parts")
    terms[MODEL] = Term("not in a law of a measured joint: its samples contain the discrepancy")
    return assemble_budget(terms, LAW_QUANTITIES, p)
