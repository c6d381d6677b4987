"""Error budgets as stacked bars."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from multiscale.plotting.figure import Axes, axes_or_current
from multiscale.schema import Dataset
from multiscale.units import length_unit
from multiscale.upscaling.budget import ALWAYS, known_error, total_error, unknown_terms

COLOURS = (*(f"C{k}" for k in range(10)), "0.2", "0.5", "0.8")  # colours of the terms

UNKNOWN = 0.15
"""Height of the bar of unknown terms, over the largest total; it has no meaning."""

SMALLEST_SHARE = 0.02
"""Ratio to the largest total below which a bar has no caption."""

PRESSURES = ("nominal_pressure", "fit_pressure", "preload")
"""Variables with the pressure of a step; missing for named loads."""


def plot_error_budget(
    budget: Dataset, *, quantity: str | None = None, ax: Axes | None = None
) -> Axes:
    """Draw the half-width of the 95 % interval of each step as a bar, stacked by its terms.

    The height of a filled bar is the total of the known terms. As squares of terms add up, the
    height of a term is its share of the sum of squares. Unknown terms are hatched on top of every
    bar, with a question mark, at an arbitrary height. A step without any known term has the word
    unknown instead of a bar.

    Parameters
    ----------
    budget : Dataset
        Follows ``ERROR_BUDGET``, or a law or macro result with a budget; steps without any term are
        left out.
    quantity : str, optional, quantity to plot; the first of the budget if not given
    """
    ax = axes_or_current(ax)
    chosen = str(budget["quantity"].values[0]) if quantity is None else quantity
    shown = budget.sel(quantity=chosen).isel(step=estimated_steps(budget, chosen))
    half = 100.0 * total_error(shown["error_bias"].values, shown["error_half_width"].values)
    error = known_error(shown.expand_dims("quantity"))[0]
    known = np.isfinite(error)
    total = np.where(known, 100.0 * error, 0.0)
    share = np.nan_to_num(half**2) / np.maximum(np.nansum(half**2, axis=0), 1e-300)
    at, bottom = np.arange(total.size), np.zeros(total.size)
    for k, term in enumerate(shown["error_term"].values):
        if not np.any(half[k] > 0.0):  # unknown or zero
            continue
        ax.bar(at, share[k] * total, 0.7, bottom=bottom, color=COLOURS[k], label=str(term))
        bottom = bottom + share[k] * total
    top, unknown = total.max(initial=0.0), ", ".join(unknown_terms(budget, chosen))
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
    ax.set_xticks(at, step_labels(shown))
    ax.set_ylim(0.0, 1.2 * (top or 1.0) + above)
    ax.grid(visible=False, axis="x")
    if any(name in shown.variables for name in PRESSURES):
        ax.set(xlabel="mean pressure (MPa)")
    ax.set_ylabel(f"95 % half-width of {chosen.replace('_', ' ')} (%)")
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, fontsize="small")
    return ax


def estimated_steps(budget: Dataset, quantity: str) -> np.ndarray:
    """Return the steps at which any term of the budget of a quantity was estimated."""
    half = budget["error_half_width"].sel(quantity=quantity).values
    always = np.isin(budget["error_term"], ALWAYS)[:, None]
    return np.flatnonzero(((half > 0.0) | (np.isfinite(half) & always)).any(axis=0))


def step_labels(budget: Dataset, *, unit: str = "") -> list[str]:
    """Return the pressure of each step, MPa, its amplitude, or its number on a path."""
    for name in PRESSURES:
        if name in budget.variables:
            return [f"{1e-6 * value:.3g}{unit}" for value in budget[name].values]
    if "step_mode" in budget:  # result of vibration
        along = length_unit(budget["largest_displacement"].values[-1:])
        modes, sizes = budget["step_mode"].values, along.scale * budget["largest_displacement"]
        which = [f"mode {mode}, " for mode in modes] if len(set(modes)) > 1 else [""] * len(modes)
        return [
            f"{mode}{size:.3g} {along.name}" for mode, size in zip(which, sizes.values, strict=True)
        ]
    on_path = budget["path_step"].values if "path_step" in budget else budget["step"].values
    return ["last cycle" if step < 0 else f"step {step}" for step in on_path]


def plot_costs(
    seconds: Mapping[str, float],
    sources: Sequence[tuple[str, float, float]],
    *,
    ax: Axes | None = None,
) -> Axes:
    """Draw a bar of seconds for each stage, and a bar of per cent for each source of error."""
    ax = axes_or_current(ax)
    names = [*(name.replace("_", " ") for name in seconds), *(name for name, *_ in sources)]
    at, count = np.arange(len(names))[::-1], len(seconds)
    ax.barh(at[:count], list(seconds.values()), 0.7, color=COLOURS[0])
    percent = ax.twiny()
    errors = [100.0 * error for _, error, _ in sources]
    percent.barh(at[count:], errors, 0.7, color=COLOURS[1])
    for y, error, (_, _, halving) in zip(at[count:], errors, sources, strict=True):
        caption = f" halved in {halving:.2g} s" if halving > 0.0 else ""
        if np.isnan(halving):
            caption = " no setting reduces it"
        percent.text(error, float(y), caption, va="center", fontsize="small")
    ax.set_yticks(at, names)
    ax.set_xlim(0.0, 1.05 * max(seconds.values(), default=1.0))
    percent.set_xlim(0.0, 1.35 * max(errors, default=1.0))
    ax.set_xlabel("time (s)", color=COLOURS[0])
    percent.set_xlabel("95 % half-width of the answer (%)", color=COLOURS[1])
    ax.grid(visible=False, axis="y")
    percent.grid(visible=False)
    return ax
