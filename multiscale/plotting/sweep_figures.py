"""Figures of a sweep; a ``result`` follows ``SWEEP``."""

import numpy as np

from multiscale.plotting.figure import Axes, axes_or_current
from multiscale.plotting.lines import BANDS, LARGEST_LEGEND, draw_band, draw_bands
from multiscale.schema import Dataset

DECADE = 10.0  # largest over smallest value of a key from which its axis is logarithmic


def key_in_words(key: str) -> str:
    """Return a key of a case in words.

    >>> key_in_words("body_1.surface.rms_height")
    'rms height of surface of body 1'
    """
    return " of ".join(reversed(key.split("."))).replace("_", " ")


def sweep_ends(result: Dataset, answer: str) -> Dataset:
    """Return an answer at the end of its steps or cycles at every point.

    Returns
    -------
    Dataset
        Along ``point``, in SI units: ``value``, and ``mean_law`` and ``one_part`` with the
        dimension ``limit``, NaN where missing.
    """
    import xarray as xr

    place = result["answer_place"].sel(answer=answer, drop=True)
    blank = xr.DataArray(np.full((result.sizes["point"], 2), np.nan), dims=("point", "limit"))
    variables = {"value": result[answer]}
    variables |= {kind: result.get(f"{answer}_{kind}", blank) for kind in BANDS}
    ends = {}
    for name, values in variables.items():
        (along,) = set(values.dims) - {"point", "limit"} or {None}
        ends[name] = values if along is None else values.isel({along: place})
    return xr.Dataset({name: values.drop_vars(values.coords) for name, values in ends.items()})


def plot_sweep(result: Dataset, answer: str, *, ax: Axes | None = None) -> Axes:
    """Plot an answer over the swept key with most values, a line for each setting of other keys.

    Bars are the 95 % interval of the mean law; bands are this interval and, lighter, the interval
    of one part.

    Parameters
    ----------
    answer : str, label of the coordinate ``answer``, such as ``"joint_stiffness"``
    ax : Axes, optional, axes to draw on
    """
    import matplotlib
    from matplotlib.ticker import EngFormatter

    ax = axes_or_current(ax)
    settings = result["setting"].values.astype(str)
    along = int(np.argmax([np.unique(column).size for column in settings.T]))
    key = str(result["parameter"].values[along])
    of_text, names = result[key].dtype.kind in "OUT", list(dict.fromkeys(settings[:, along]))
    x = result[key].values
    if of_text:
        x = np.array([names.index(setting) for setting in settings[:, along]])
    others = [", ".join(map(str, row)) for row in np.delete(settings, along, axis=1)]
    lines = list(dict.fromkeys(others))
    ends, scale = sweep_ends(result, answer), float(result["answer_scale"].sel(answer=answer))
    colours = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.85, len(lines)))
    for line, colour in zip(lines, colours, strict=True):
        points = np.array([k for k in np.argsort(x, kind="stable") if others[k] == line])
        value = scale * ends["value"].values[points]
        for kind, alpha in BANDS.items():
            band = scale * ends[kind].values[points].T
            draw_band(ax, x[points], band, colour, alpha=0.4 * alpha, label=None)
        bars = np.abs(scale * ends["mean_law"].values[points].T - value)
        marks = "o:" if of_text else "o-"
        ax.errorbar(x[points], value, bars, fmt=marks, color=colour, capsize=2, label=line)
    if of_text:
        ax.set_xticks(range(len(names)), names)
    elif x.min() > 0.0 and x.max() >= DECADE * x.min():
        ax.set_xscale("log")
    unit = str(result[key].attrs.get("units", "1"))
    if unit != "1":
        ax.xaxis.set_major_formatter(EngFormatter(unit.replace("u", "µ")))
    _label_answer(result, answer, ax)
    ax.set_xlabel(key_in_words(key))
    if lines != [""] and len(lines) <= LARGEST_LEGEND:
        keys = np.delete(result["parameter"].values, along)
        ax.legend(
            title=", ".join(map(key_in_words, keys)), fontsize="small", title_fontsize="small"
        )
    return ax


def plot_sweep_steps(result: Dataset, answer: str, *, ax: Axes | None = None) -> Axes:
    """Plot an answer over the steps of each point, a line with its bands for each."""
    import matplotlib

    ax, count = axes_or_current(ax), result.sizes["point"]
    over = str(result["answer_over"].sel(answer=answer).values)
    scale, wide = (float(result["answer_scale"].sel(answer=name)) for name in (answer, over))
    for k, colour in enumerate(matplotlib.colormaps["viridis"](np.linspace(0.0, 0.85, count))):
        point = result.isel(point=k)
        label = ", ".join(map(str, point["setting"].values)) if count <= LARGEST_LEGEND else None
        along = wide * point[over].to_numpy()
        ax.plot(along, scale * point[answer], "o-", color=colour, label=label)
        draw_bands(point, answer, along, ax, scale, colour, labelled=False)
    _label_answer(result, answer, ax)
    _label_answer(result, over, ax, axis="x")
    ax.set_title(", ".join(map(key_in_words, result["parameter"].values)))
    if count <= LARGEST_LEGEND:
        ax.legend(fontsize="small")
    return ax


def _label_answer(result: Dataset, answer: str, ax: Axes, axis: str = "y") -> None:
    label, unit = (
        str(result[f"answer_{column}"].sel(answer=answer).values) for column in ("label", "unit")
    )
    ax.set(**{f"{axis}label": label if unit == "1" else f"{label} ({unit})"})
