"""The error budget of braking forces: what is not known is said in the keys of the case."""

from collections.abc import Mapping

import numpy as np

from multiscale.schema import Dataset
from multiscale.upscaling import estimate_grid_error, with_budget
from multiscale.upscaling.budget import NO_PART, NO_STATED, assemble_budget
from multiscale.upscaling.budget_terms import FEW_CELLS, NORMAL, STATED, Term
from multiscale.upscaling.shear_budget import NORMAL_ALONE

__all__ = ["with_braking_budget"]

OTHERS = "not known: {} were solved; run the case with {} in [cell], and compare"


def with_braking_budget(
    result: Dataset, law: Dataset, coarser: Mapping[float, np.ndarray]
) -> Dataset:
    """Return the result of a tread block with the error budget of its braking force.

    Parameters
    ----------
    result : Dataset, follows ``MACRO_RESULT``, with samples of the force if the law has any
    law : Dataset, the bell of friction, with its misfit
    coarser : mapping of float to ndarray, shape (steps,)
        From the ratio of the elements' sizes to the force, N, on larger ones; may be empty.

    Notes
    -----
    - *sampling*: from the standard deviation over samples of the law;
    - *fit*: from the root mean square by which the bell misses the cells;
    - *macro discretisation*: :func:`multiscale.upscaling.estimate_grid_error`.
    """
    force = np.abs(result["braking_force"].to_numpy())
    nothing = np.zeros((1, force.size))
    missed = float(law.attrs["rms_error_over_peak"]) * float(law["peak_coefficient"])
    fit = NORMAL * missed / np.abs(result["braking_coefficient"].to_numpy())
    terms = {
        "sampling": Term(
            "not known: the law has no samples; give them in [law], and 3 or more realisations in "
            "[sliding]"
        ),
        "fit": Term("root mean square by which the bell misses the cells", fit),
        "cell size": Term(OTHERS.format("cells of one size", "another size")),
        "micro discretisation": Term(OTHERS.format("cells on one grid", "other points")),
        "increments": Term("nothing: rubber does not flow", nothing),
        "small slopes": Term("not known: the half-space of the rubber takes slopes as small"),
        "surface": Term(
            "nothing: the roads are made from a spectrum, which the cells hold whole", nothing
        ),
        "friction bed": NORMAL_ALONE,
        "scale separation": Term(
            "not known: the pressure of the footprint is taken as even over the waves of the road"
        ),
        FEW_CELLS: NO_PART,
        STATED: NO_STATED,
        "macro discretisation": Term(
            "not known: elements of twice the size do not fit; give smaller ones in [tread]"
        ),
    }
    if result.sizes.get("sample", 0) > 1:
        samples = result["braking_force_sample"].to_numpy()
        scatter = NORMAL * np.std(samples, axis=0, ddof=1) / force
        terms["sampling"] = Term(f"{len(samples)} bootstrap samples of the law", scatter)
    if coarser:
        estimate = estimate_grid_error(force, coarser)
        terms["macro discretisation"] = Term(estimate.how, estimate.half_width / force)
    budget = assemble_budget(terms, ("braking_force",), None, steps=force.size)
    return with_budget(result, budget)
