"""Error budgets as stacked bars."""

from typing import Any

import numpy as np

from multiscale.plotting.figure import Axes, axes_or_current
from multiscale.schema import Dataset
from multiscale.upscaling.budget import total_error

__all__ = ["estimated_steps", "plot_error_budget", "step_labels"]

COLOURS = (*(f"C{k}" for k in range(10)), "0.3", "0.7")  # of the terms

UNKNOWN = 0.15
"""Height of what is not known, over the largest total; it has no number."""

SMALLEST_SHARE = 0.02
"""Ratio to the largest total below which a bar has no caption."""

PRESSURES = ("nominal_pressure", "fit_pressure", "preload")
"""Variables that tell the pressure of a step; steps of named loads have none."""


def plot_error_budget(
    budget: Dataset, *, quantity: str | None = None, ax: Axes | None = None
) -> Axes:
    """Draw the half-width of the 95 % interval of each step as a bar, stacked by its terms.

    The height of a filled bar is the total. As terms add as squares, each term has its share of
    the sum of the squares. Terms that are not known stand hatched on top of every bar, with a
    question mark: their height means nothing. A total with an unknown term has no bar but the word
    unknown.

    Parameters
    ----------
    budget : Dataset
        Follows ``ERROR_BUDGET``, or a law or macro result that carries one; steps without any
        term are left out.
    quantity : str, optional, quantity to plot; the first of the budget if not given
    """
    ax = axes_or_current(ax)
    chosen = str(budget["quantity"].values[0]) if quantity is None else quantity
    one = estimated_steps(budget, chosen)
    half = 100.0 * total_error(one["error_bias"].values, one["error_half_width"].values)
    known = np.isfinite(one["error_total"].values)
    total = np.where(known, 100.0 * one["error_total"].values, 0.0)
    share = np.nan_to_num(half**2) / np.maximum(np.nansum(half**2, axis=0), 1e-300)
    at, bottom = np.arange(total.size), np.zeros(total.size)
    for k, term in enumerate(one["error_term"].values):
        if not np.any(half[k] > 0.0):  # unknown or zero
            continue
        ax.bar(at, share[k] * total, 0.7, bottom=bottom, color=COLOURS[k], label=str(term))
        bottom = bottom + share[k] * total
    top, unknown = total.max(initial=0.0), str(budget.attrs.get("unknown", ""))
    above = UNKNOWN * (top or 1.0) if unknown else 0.0
    if unknown:
        style: dict[str, Any] = {
            "color": "none",
            "edgecolor": "0.5",
            "hatch": "///",
            "linestyle": ":",
        }
        ax.bar(at, above, 0.7, bottom=total, label=f"not known: {unknown}", **style)
    for x, height, is_known in zip(at, total, known, strict=True):
        if height > SMALLEST_SHARE * top or not is_known:
            caption = f"{height:.2g}{' + ?' if unknown else ''}" if is_known else "unknown"
            ax.text(
                float(x), float(height + above), caption, ha="center", va="bottom", fontsize="small"
            )
    ax.set_xticks(at, step_labels(one))
    ax.set_ylim(0.0, 1.2 * (top or 1.0) + above)
    ax.grid(visible=False, axis="x")
    if any(name in one.variables for name in PRESSURES):
        ax.set(xlabel="mean pressure (MPa)")
    ax.set_ylabel(f"95 % half-width of {chosen.replace('_', ' ')} (%)")
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, fontsize="small")
    return ax


def estimated_steps(budget: Dataset, quantity: str) -> Dataset:
    """Return the budget of a quantity at the steps where any term was estimated."""
    one = budget.sel(quantity=quantity)
    return one.isel(step=np.flatnonzero(one["error_half_width"].notnull().any("error_term")))


def step_labels(budget: Dataset, *, unit: str = "") -> list[str]:
    """Pressures of the steps, MPa, from the first of three variables; else numbers of the steps."""
    for name in PRESSURES:
        if name in budget.variables:
            return [f"{1e-6 * value:.3g}{unit}" for value in budget[name].values]
    return [f"step {step}" for step in budget["step"].values]
