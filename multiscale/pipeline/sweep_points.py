"""Report of a sweep: tables, figures and cautions of its points, each a run in a folder."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from multiscale.pipeline import showing
from multiscale.pipeline.stage import Datasets, Section, Shown
from multiscale.plotting.figure import on_axes
from multiscale.plotting.sweep_figures import plot_sweep, plot_sweep_steps, sweep_ends
from multiscale.schema import SWEEP, Dataset

MOST_NAMED = 3  # points that are named for one caution
MOST_SENTENCES = 10  # sentences that are shown of cautions, and of points without a result
NUMBER = re.compile(r"\b\d[\d.e+-]*( \S+)?")  # A number and its unit
MOST_SHOWN = 200  # points of a table or a figure


def name_point(parameters: Iterable[str], setting: Iterable[str]) -> str:
    """Return the name of a point of a sweep: its full keys with their values."""
    return ", ".join(f"{key} = {text}" for key, text in zip(parameters, setting, strict=True))


def _list_cautions(result: Dataset) -> list[str]:
    """Return the failures of points without a result, then the cautions, each with its points."""
    parameters, failures = _parameters(result), [str(text) for text in result["failure"].values]
    names = [name_point(parameters, map(str, setting)) for setting in result["setting"].values]
    cautions = [str(text) for text in result["caution"].values]
    refused = _places(
        (f"no result: {text.rstrip('.')}", k) for k, text in enumerate(failures) if text
    )
    beware = _places((line, k) for k, text in enumerate(cautions) for line in text.splitlines())
    solved = failures.count("")
    return [
        *_first(f"at {_list(names, at)}: {text}" for text, at in refused.items()),
        *_first(
            f"at {'every point with a result' if len(at) == solved else _list(names, at)}: {text}"
            for text, at in sorted(beware.items(), key=lambda item: -len(item[1]))
        ),
    ]


def _first(cautions: Iterable[str]) -> list[str]:
    every = list(cautions)
    more = len(every) - MOST_SENTENCES
    rest = f"{more} more sentences like these are in {POINTS.file}" if more > 0 else ""
    return [*every[:MOST_SENTENCES], *filter(None, [rest])]


def _places(sentences: Iterable[tuple[str, int]]) -> dict[str, list[int]]:
    """Return the points of each sentence; sentences that differ only by numbers are merged."""
    alike: dict[tuple[str, int], dict[str, list[int]]] = {}
    seen: Counter[tuple[str, int]] = Counter()
    for text, point in sentences:
        rest = NUMBER.sub("", text)
        alike.setdefault((rest, seen[rest, point]), {}).setdefault(text, []).append(point)
        seen[rest, point] += 1
    first = " (numbers of the first of these points)"
    return {
        next(iter(same)) + (first if len(same) > 1 else ""): sorted(
            point for at in same.values() for point in at
        )
        for same in alike.values()
    }


def _list(names: list[str], at: list[int]) -> str:
    named = "; ".join(names[k] for k in at[:MOST_NAMED])
    return f"{named}; and {len(at) - MOST_NAMED} more" if len(at) > MOST_NAMED else named


def _drawn(result: Dataset) -> dict[str, str]:
    """Labels of the answers that are drawn, by their names."""
    names = map(str, result["answer"].values[result["answer_drawn"].values == 1])
    return {name: str(result["answer_label"].sel(answer=name).item()) for name in names}


def _answer(result: Dataset) -> Iterator[str]:
    """Report the range of each answer at the ends of points, with digits that its error leaves."""
    ranges = []
    for name, label in _drawn(result).items():
        ends = sweep_ends(result, name)
        scale, unit = (
            result[f"answer_{field}"].sel(answer=name).item() for field in ("scale", "unit")
        )
        values = scale * ends["value"].values
        width = scale * ends["mean_law"].diff("limit").squeeze("limit").values
        half_width = np.nan_to_num(0.5 * width)
        finite = np.flatnonzero(np.isfinite(values))
        if finite.size:
            extremes = finite[[values[finite].argmin(), values[finite].argmax()]]
            limits = dict.fromkeys(showing.round_by(values[k], half_width[k]) for k in extremes)
            ranges.append(f"{label} {' to '.join(limits)}{'' if unit == '1' else f' {unit}'}")
    solved, count = int((result["failure"] == "").sum()), result.sizes["point"]
    points = f"{'all' if solved == count else f'the {solved} with a result of'} {count} points"
    yield f"At the end of {points}: {', '.join(ranges) or 'nothing known'}."


def _and(names: Iterable[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def _parameters(result: Dataset) -> list[str]:
    return list(map(str, result["parameter"].values))


def _shown(result: Dataset) -> tuple[Dataset, list[str]]:
    """Return at most :data:`MOST_SHOWN` points, and a sentence about the rest."""
    count = result.sizes["point"]
    if count <= MOST_SHOWN:
        return result, []
    few = result.isel(point=np.linspace(0, count - 1, MOST_SHOWN).astype(int))
    return few, [f"{MOST_SHOWN} of {count} points are shown; {POINTS.file} has all."]


def _list_missing(result: Dataset) -> list[str]:
    """Return a sentence on the error terms that are unknown at some point."""
    lists = map(str, result["missing_terms"].values) if "missing_terms" in result else ()
    missing = ", ".join(
        dict.fromkeys(name for terms in lists if terms for name in terms.split(", "))
    )
    marked = f"Intervals that end with '{showing.LOWER_BOUND.strip()}' do not contain unknown terms"
    return [f"{marked}: {missing}."] if missing else []


def _sections(datasets: Datasets, out: Path) -> Iterator[Section]:
    result, more = _shown(datasets[POINTS.name])
    drawn = list(_drawn(result))
    over_steps = [name for name in drawn if result["answer_over"].sel(answer=name).item()][:1]

    ends = {name: sweep_ends(result, name)["value"].to_numpy() for name in drawn}
    differ = [name for name, value in ends.items() if np.unique(value[np.isfinite(value)]).size > 1]
    figures = {f"sweep_{name}": on_axes(plot_sweep, result, name) for name in differ or drawn[:1]}
    figures |= {
        f"sweep_{name}_steps": on_axes(plot_sweep_steps, result, name) for name in over_steps
    }
    text = [
        "Each point at its last step or cycle; in brackets the 95 % interval of the mean law, in "
        "figures a bar, and lighter the interval of one part.",
    ]
    head, rows = tabulate_sweep(result)
    numbered = [(str(number), *row) for number, row in enumerate(rows, start=1)]
    pages = [f"{folder}/report.html" for folder in result["folder"].values]
    links = {str(k): page for k, page in enumerate(pages, start=1) if (out / page).exists()}
    remarks = [*more, *_list_missing(result)]
    table = ("point", *head), numbered
    yield Section("Points", text, *table, figures, links, small=True, remarks=remarks)
    head, rows = _tabulate_steps(result)
    if rows:
        text = [
            "After an answer is its error, the larger side of the 95 % interval of one part, "
            "or of the mean law if there is no other; or both sides if they differ much, or "
            "the interval if its half-width is not smaller than the answer."
        ]
        yield Section("All steps", text, head, rows, printed=False)


def tabulate_sweep(result: Dataset) -> showing.Rows:
    """Return head and rows of a sweep: each point at its end, with intervals in brackets."""
    names = list(map(str, result["answer"].values))
    head = tuple(_answer_head(result, name) for name in names)
    columns = [_column(result, name) for name in names]
    rows = []
    for k, (setting, failure) in enumerate(
        zip(result["setting"].values, result["failure"].values, strict=True)
    ):
        answers = ("no result",) if failure else tuple(column[k] for column in columns)
        rows.append(showing.padded((*map(str, setting), *answers), (*setting, *head)))
    return (*map(str, result["parameter"].values), *head), rows


def _tabulate_steps(result: Dataset) -> showing.Rows:
    """Return head and rows of a sweep at all steps of its points, with errors, if it has steps."""
    over = {str(entry.answer.item()): str(entry.item()) for entry in result["answer_over"]}
    along = next(filter(None, over.values()), "")
    if not along:
        return (), []
    names = [along, *(name for name, dimension in over.items() if dimension == along)]
    head = (*map(str, result["parameter"].values), *(_answer_head(result, name) for name in names))
    rows = []
    for k, setting in enumerate(result["setting"].values):
        point = result.isel(point=k)
        for step in np.flatnonzero(np.isfinite(point[along].values)):
            answers = (_with_error(point, name, int(step)) for name in names)
            rows.append((*map(str, setting), *answers))
    return head, rows


def _answer_head(result: Dataset, name: str) -> str:
    label, unit = (result[f"answer_{field}"].sel(answer=name).item() for field in ("label", "unit"))
    return str(label) if unit == "1" else f"{label} ({unit})"


def _with_error(point: Dataset, name: str, step: int) -> str:
    """Write an answer of a point of a sweep at a step, with its error if known."""
    value = float(point[name].values[step])
    if np.isnan(value):
        return "unknown"
    scale = float(point["answer_scale"].sel(answer=name))
    for kind in ("one_part", "mean_law"):
        if f"{name}_{kind}" in point:
            low, high = scale * point[f"{name}_{kind}"].values[:, step]
            half, size, bound = 0.5 * (high - low), abs(scale * value), _bounds(point).item()
            if half >= size:  # of an answer that may be zero, such as a leak rate
                return f"{scale * value:.3g} ({low:.2g} ... {high:.2g}){bound}"
            error = showing.format_sides(scale * value, np.array([low, high]), bound)
            return f"{showing.round_by(scale * value, half)}{showing.format_error_behind(error)}"
    return f"{scale * value:.4g}"


def _column(result: Dataset, name: str) -> list[str]:
    """Write an answer of a sweep at all points, with the interval of the mean law if known."""
    ends, scale = sweep_ends(result, name), float(result["answer_scale"].sel(answer=name))
    texts = []
    for value, limits, bound in zip(
        scale * ends["value"].values, scale * ends["mean_law"].values, _bounds(result), strict=True
    ):
        if np.isnan(value):
            texts.append("unknown")
            continue
        half = 0.5 * float(np.ptp(limits))
        band = showing.format_interval(value, limits, bound) if np.isfinite(half) else ""
        texts.append(f"{showing.round_by(value, half)}{f' ({band})' if band else ''}")
    return texts


def _bounds(result: Dataset) -> np.ndarray:
    """Return the mark of lower bounds at every point of a sweep with an unknown term."""
    if "missing_terms" not in result:
        return np.full(result["failure"].shape, "")
    return np.where(result["missing_terms"].values != "", showing.LOWER_BOUND, "")


POINTS = Shown(
    schema=SWEEP,
    cautions=_list_cautions,
    question=lambda result: (
        f"How do {_and(_drawn(result).values())} depend on {_and(_parameters(result))}?"
    ),
    answer=_answer,
    sections=_sections,
)
