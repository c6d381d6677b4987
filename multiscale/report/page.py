"""A finished run as one page that opens anywhere: no script, nothing from elsewhere."""

import base64
import tomllib
from collections.abc import Iterator, Mapping
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.io import open_dataset, open_run, read_bytes, read_text, reading_run, write_bytes
from multiscale.pipeline import read_cautions, read_sliding
from multiscale.report.roughness_section import list_cutoffs, tabulate_roughness
from multiscale.report.rows import list_facts, tabulate
from multiscale.report.section import Section, provenance
from multiscale.report.sliding_section import describe_sliding
from multiscale.report.sweep_page import (
    list_sweep_cautions,
    sweep_answer,
    sweep_question,
    sweep_sections,
)
from multiscale.report.tyre_page import braking_answer, braking_question, braking_sections
from multiscale.schema import SWEEP
from multiscale.units import readable
from multiscale.upscaling import require_law

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["write_report"]


def write_report(out: str | Path) -> Path:
    """Write ``report.html`` of a finished run or sweep whose figures are drawn.

    Parameters
    ----------
    out : path
        Run folder.
    """
    from jinja2 import Environment

    out = Path(out)
    with reading_run(out):
        content = _sweep(out) if (out / "sweep.nc").exists() else _run(out)
    template = resources.files("multiscale.report").joinpath("page.html").read_text()
    text = Environment(autoescape=True).from_string(template).render(content)
    write_bytes(out / "report.html", text.encode())
    return out / "report.html"


def _run(out: Path) -> dict[str, Any]:
    """Say what the page of a run says."""
    tree = open_run(out, finished=True)
    response, law, result = (
        tree[name].to_dataset() for name in ("micro_response", "interface_law", "macro_result")
    )
    case, sliding = tomllib.loads(read_text(out / "case.toml")), read_sliding(out)
    drawn = _drawn(out)
    if "braking_force" in result:
        question, answer = braking_question(result), braking_answer(result)
        sections = braking_sections(law, result, response.attrs["bodies"])
    else:
        question, answer = _question(result), _answer(result)
        surface = Section(
            "Surface",
            list_cutoffs(response),
            *tabulate_roughness(response),
            ("surface", "contact_map"),
        )
        sections = [_joint(result), _law(response, law), _budget(result), surface]
        if sliding is not None:
            sections.append(Section("Sliding", describe_sliding(sliding), figures=("sliding",)))
    sections += [Section("Inputs", [], rows=list(_inputs(case))), _work(response, result)]
    return {
        "title": response.attrs["title"],
        "question": question,
        "answer": answer,
        "cautions": read_cautions(out),
        "sections": [_with_images(section, drawn) for section in sections],
    }


def _sweep(out: Path) -> dict[str, Any]:
    """Say what the page of a sweep says."""
    result, drawn = open_dataset(out / "sweep.nc", SWEEP), _drawn(out)
    return {
        "title": result.attrs["title"],
        "question": sweep_question(result),
        "answer": sweep_answer(result),
        "cautions": list_sweep_cautions(result),
        "sections": [_with_images(section, drawn) for section in sweep_sections(result)],
    }


def _drawn(out: Path) -> dict[str, Path]:
    """Figures of a run by their names."""
    return {file.stem: file for file in sorted((out / "figures").glob("*.png"))}


def _question(result: "xr.Dataset") -> str:
    preload = 1e-6 * result["preload"].values
    return (
        f"How stiff is the joint of the two bodies, pressed together by {preload.min():.4g} to "
        f"{preload.max():.4g} MPa, and how much of it touches?"
    )


def _answer(result: "xr.Dataset") -> list[str]:
    """Say the middle one of the preloads with an answer, with its error, and what flows."""
    done = np.flatnonzero(np.isfinite(result["joint_stiffness"].values))
    if done.size == 0:
        return ["The answer is known at no preload."]
    head, rows = tabulate(result.isel(step=[done[done.size // 2]]))
    row = dict(zip(head, rows[0], strict=True))
    error = f" with a 95 % error bound of {row['error (%)']} %" if row["error (%)"] else ""
    if row["error (%)"] == "unknown":
        error = " with an unknown error"
    unloading = (
        f" When the preload begins to fall, it is {row['unloading (MPa/µm)']} MPa/µm."
        if "unloading_stiffness" in result
        else ""
    )
    unknown = result.attrs.get("unknown", "")
    beside = f" The error does not count what is not known of it: {unknown}." if unknown else ""
    if row["error (%)"] == "unknown":
        beside = f" Not known of the error: {unknown}; see the error budget."
    return [
        f"At {row['preload (MPa)']} MPa its stiffness is {row['joint stiffness (MPa/µm)']} MPa/µm"
        f"{error}, and {row['contact (%)']} % of it touches, under "
        f"{row['real pressure (MPa)']} MPa on the mean.{unloading} "
        f"In MPa/µm, the interface alone has {row['interface (MPa/µm)']} and the bodies "
        f"{row['bodies (MPa/µm)']}.{beside}",
        *list_facts(result)[:1],
    ]


def _joint(result: "xr.Dataset") -> Section:
    """Table and figure of the macro result."""
    told = [*result.attrs.get("plan", "").splitlines(), *list_facts(result)]
    return Section("Joint", told, *tabulate(result), ("joint_stiffness",))


def _law(response: "xr.Dataset", law: "xr.Dataset") -> Section:
    """Say what the law stands for, how well it fits, and what it obeys."""
    require_law(
        law,
        "n_realisations",
        "pressure_min",
        "pressure_max",
        "pressures_per_decade",
        "branches",
        "cross_validated_error",
        "cross_validated_stiffness_error",
        "admissibility",
    )
    return Section(
        "Interface law",
        [
            f"The law stands for the {response.attrs['bodies']}; it rests on "
            f"{law.attrs['n_realisations']} realisations between "
            f"{1e-6 * law.attrs['pressure_min']:.4g} and "
            f"{1e-6 * law.attrs['pressure_max']:.4g} MPa, "
            f"{law.attrs['pressures_per_decade']:.2g} pressures a decade. Branches: "
            f"{law.attrs['branches']}.",
            f"At pressures that were left out of the fit it erred by up to "
            f"{100.0 * law.attrs['cross_validated_error']:.2g} % in pressure and "
            f"{100.0 * law.attrs['cross_validated_stiffness_error']:.2g} % in stiffness.",
            f"Admissibility: {law.attrs['admissibility']}.",
            *_unloading(law),
        ],
        figures=("gap_law", "unloading", "area_law"),
    )


def _unloading(law: "xr.Dataset") -> list[str]:
    """Say how the interface unloads, if that is known."""
    if "unloading_stiffness_ratio" not in law:
        return []
    error = float(np.sqrt(np.mean(law["unloading_fit_error"].values ** 2)))
    return [
        f"Unloaded, it is {float(law['unloading_stiffness_ratio']):.3g} times as stiff at first as "
        f"it was under load, and springs back with the exponent "
        f"{float(law['unloading_exponent']):.3g}; at a pressure that the fit has not seen, the "
        f"spring back errs by {100.0 * error:.2g} % of its length."
    ]


def _budget(result: "xr.Dataset") -> Section:
    """Say of each term of the error budget how it was estimated."""
    if "error_total" not in result:
        return Section("Error budget", ["Nothing was estimated."])
    terms = map(str, result["error_term"].values)
    rows = [(term, result.attrs[f"how_{term.replace(' ', '_')}"]) for term in terms]
    return Section(
        "Error budget",
        ["Half-widths of 95 % intervals of the joint stiffness; each term rests on this:"],
        rows=rows,
        figures=("error_budget",),
    )


def _inputs(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, ...]]:
    """Give the keys of a case with their values, tables flattened."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _inputs(value, f"{prefix}{key}.")
        elif isinstance(value, list):
            yield f"{prefix}{key}", ", ".join(readable(item) for item in value)
        elif isinstance(value, bool):
            yield f"{prefix}{key}", str(value).lower()  # as the file says it
        else:
            yield f"{prefix}{key}", readable(value)


def _work(response: "xr.Dataset", result: "xr.Dataset") -> Section:
    """Say what was computed and with what."""
    converged = response["converged"].values
    rows: list[tuple[str, ...]] = [
        ("cell steps", f"{int((converged == 1).sum())} of {converged.size} converged"),
        ("solver time of the cells", f"{float(response['wall_time'].sum()):.1f} s"),
    ]
    return Section("Work and provenance", [], rows=rows + provenance(result))


def _with_images(section: Section, drawn: Mapping[str, Path]) -> dict[str, Any]:
    """Replace the names of figures by their images, as far as they are drawn."""
    images = [
        (name.replace("_", " "), base64.b64encode(read_bytes(drawn[name])).decode())
        for name in section.figures
        if name in drawn
    ]
    return vars(section) | {"figures": images}
