"""The results of a run as a table, and as one self-contained page."""

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.io import open_run, read_bytes, read_text, write_bytes

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "list_cycles",
    "tabulate",
    "tabulate_braking",
    "tabulate_grains",
    "tabulate_links",
    "tabulate_scene",
    "tabulate_sweep",
    "write_report",
]

PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ title }}</title>
<style>
body { font: 16px/1.5 sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; } td, th { padding: .2rem .8rem; text-align: right; }
th { border-bottom: 1px solid #888; } img { max-width: 100%; } pre { overflow-x: auto; }
figure { display: inline-block; margin: 0; max-width: 29rem; }
</style>
<h1>{{ title }}</h1>
<p>{{ summary }}</p>
{% for caution in cautions %}<p><strong>Caution:</strong> {{ caution }}.</p>
{% endfor %}{% for line in plan %}<p>{{ line }}.</p>
{% endfor %}<table>
<tr>{% for name in head %}<th>{{ name }}</th>{% endfor %}</tr>
{% for row in rows %}<tr>{% for value in row %}<td>{{ value }}</td>{% endfor %}</tr>
{% endfor %}</table>
{% for name, image in figures %}<figure><img alt="{{ name }}"
src="data:image/png;base64,{{ image }}"></figure>
{% endfor %}<h2>Case</h2>
<pre>{{ case }}</pre>
<p>{{ provenance }}</p>
</html>
"""

HEAD = (
    "preload (MPa)",
    "joint stiffness (MPa/µm)",
    "95 % band",
    "error (%)",
    "mean gap (µm)",
    "contact (%)",
)

MOST_ROWS = 11
"""Of the table of a structure of links."""


def tabulate(result: "xr.Dataset") -> list[tuple[str, ...]]:
    """Return the results of a joint as rows of text, in the order of ``HEAD``.

    Parameters
    ----------
    result : Dataset
        Follows ``MACRO_RESULT``.
    """
    rows: list[tuple[str, ...]] = []
    for k in range(result.sizes["step"]):
        step = result.isel(step=k)
        if not int(step["converged"]):
            rows.append((f"{1e-6 * float(step['preload']):.4g}", "not converged", "", "", "", ""))
            continue
        band = np.full(2, np.nan)
        if "joint_stiffness_sample" in result:
            band = np.nanpercentile(step["joint_stiffness_sample"], (2.5, 97.5))
        rows.append(_row(step, band))
    return rows


def tabulate_sweep(result: "xr.Dataset") -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return head and rows of a sweep as text: each point at its largest converged preload.

    Parameters
    ----------
    result : Dataset
        Follows ``SWEEP``.
    """
    head = (*map(str, result["parameter"].values), *HEAD)
    rows = []
    for k in range(result.sizes["point"]):
        point = result.isel(point=k)
        said = tuple(map(str, point["setting"].values))
        done = np.flatnonzero(point["converged"].values)
        if done.size == 0:
            rows.append((*said, "", "no result", "", "", "", ""))
            continue
        step = point.isel(step=done[-1])
        band = (float(step[f"joint_stiffness_{end}"]) for end in ("low", "high"))
        rows.append((*said, *_row(step, tuple(band))))
    return head, rows


def _row(step: "xr.Dataset", band: "Sequence[float] | np.ndarray") -> tuple[str, ...]:
    """Results at one preload, in the order of ``HEAD``."""
    low, high = (1e-12 * end for end in band)
    return (
        f"{1e-6 * float(step['preload']):.4g}",
        f"{1e-12 * float(step['joint_stiffness']):.4g}",
        "none" if np.isnan(low) else f"{low:.4g} ... {high:.4g}",
        f"{100.0 * float(step['error_total'][0]):.2g}" if "error_total" in step else "",
        f"{1e6 * float(step['mean_gap']):.4g}",
        f"{100.0 * float(step['contact_fraction']):.3g}",
    )


def tabulate_links(result: "xr.Dataset") -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return head and rows of text for a structure of links, at most ``MOST_ROWS`` of its steps.

    Parameters
    ----------
    result : Dataset
        Follows ``MACRO_RESULT``.
    """
    along, name = ("time", "time (s)") if "time" in result.coords else ("load_factor", "load")
    steps = result.sizes["step"]
    rows: list[tuple[str, ...]] = []
    for k in np.unique(np.linspace(0, steps - 1, min(steps, MOST_ROWS)).round().astype(int)):
        step = result.isel(step=k)
        at = f"{float(step[along]):.4g}"
        if not int(step["converged"]):
            rows.append((at, "not converged", "", f"{float(step['residual']):.1e}"))
            continue
        slack, largest = int((step["slack"] > 0.0).sum()), float(step["tension"].max())
        rows.append((at, f"{slack}", f"{1e-3 * largest:.4g}", f"{float(step['residual']):.1e}"))
    return (name, "slack links", "largest tension (kN)", "residual"), rows


def tabulate_grains(result: "xr.Dataset") -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return head and rows of text for a granulate, at most ``MOST_ROWS`` of its steps.

    Parameters
    ----------
    result : Dataset
        Follows ``GRANULATE``.
    """
    steps = result.sizes["step"]
    names = ("time", "n_contacts", "kinetic_energy", "penetration", "iterations", "residual")
    head = ("time (s)", "contacts", "kinetic (J)", "overlap / R", "sweeps", "error")
    chosen = np.unique(np.linspace(0, steps - 1, min(steps, MOST_ROWS)).round().astype(int))
    return head, [tuple(f"{float(result[name][k]):.4g}" for name in names) for k in chosen]


def tabulate_scene(result: "xr.Dataset") -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return head and rows of text for what a scene has given.

    Parameters
    ----------
    result : Dataset
        Follows ``MACRO_RESULT``: links, joints at their preloads, or a body under its loads.
    """
    if "tension" in result:
        return tabulate_links(result)
    if "contact_force" in result:
        return tabulate_grains(result)
    if "tangential_stiffness" in result:
        head: tuple[str, ...] = (
            "preload (MPa)",
            "joint stiffness (MPa/µm)",
            "tangential (MPa/µm)",
            "stick (%)",
            "slip (%)",
            "open (%)",
        )
        scales = (1e-6, 1e-12, 1e-12, 100.0, 100.0, 100.0)
        names = (
            "preload",
            "joint_stiffness",
            "tangential_stiffness",
            *(f"{state}_fraction" for state in ("stick", "slip", "open")),
        )
        shown = result.isel(step=np.flatnonzero(result["shear"].values == 0.0))
        shown = shown.isel(step=np.flatnonzero(np.isfinite(shown["joint_stiffness"].values)))
        columns = [scale * shown[name].values for name, scale in zip(names, scales, strict=True)]
        if "error_total" in shown:
            head = (*head, "error (%)")
            columns.append(100.0 * shown["error_total"].values[0])
        return head, [tuple(f"{value:.4g}" for value in row) for row in zip(*columns, strict=True)]
    largest = 1e6 * np.abs(result["displacement"].values).max(axis=(1, 2))
    return ("load", "largest displacement (µm)", "iterations", "residual"), [
        (f"{load:.4g}", f"{u:.4g}", f"{n}", f"{residual:.1e}")
        for load, u, n, residual in zip(
            result["load_factor"].values,
            largest,
            result["iterations"].values,
            result["residual"].values,
            strict=True,
        )
    ]


def tabulate_braking(result: "xr.Dataset") -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return head and rows of text for a tread block: each temperature at its speeds.

    Parameters
    ----------
    result : Dataset
        Follows ``MACRO_RESULT``, with braking forces.
    """
    head = ("temperature (°C)", "speed (m/s)", "braking force (N)", "95 % band", "force / load")
    rows: list[tuple[str, ...]] = []
    for k in range(result.sizes["step"]):
        step = result.isel(step=k)
        at = (f"{float(step['temperature']) - 273.15:.4g}", f"{float(step['sliding_speed']):.3g}")
        if not int(step["converged"]):
            rows.append((*at, "not converged", "", ""))
            continue
        band = "none"
        if "braking_force_sample" in result:
            low, high = np.nanpercentile(step["braking_force_sample"], (2.5, 97.5))
            band = f"{low:.4g} ... {high:.4g}"
        force = f"{float(step['braking_force']):.4g}"
        rows.append((*at, force, band, f"{float(step['braking_coefficient']):.3g}"))
    return head, rows


def list_cycles(result: "xr.Dataset") -> list[str]:
    """Say what every cycle of a joint has lost; nothing for other results."""
    if "cycle_energy" not in result:
        return []
    return [f"cycle {k}: {loss:.4g} J lost" for k, loss in enumerate(result["cycle_energy"].values)]


def _terms(result: "xr.Dataset") -> list[str]:
    """Say of each term of the error budget how it was estimated."""
    if "error_total" not in result:
        return []
    how = {term: f"how_{term.replace(' ', '_')}" for term in result["error_term"].values}
    lines = [f"{term}: {result.attrs[name]}" for term, name in how.items()]
    return ["The error of the joint stiffness holds " + "; ".join(lines)]


def _of_cells(response: "xr.Dataset") -> str:
    """Say what the cells were."""
    converged = response["converged"].values
    return (
        f"{converged.sum()} of {converged.size} cell steps converged in "
        f"{float(response['wall_time'].sum()):.1f} s of solver time; "
        f"{response.sizes['realisation']} realisations."
    )


def _of_normal_law(law: "xr.Dataset") -> str:
    """Say how good a normal law is."""
    return (
        f" The law is {'' if law.attrs['admissible'] else 'not '}positive, decreasing and convex; "
        f"at a pressure that the fit has not seen, it errs by at most "
        f"{100.0 * law.attrs['cross_validated_error']:.2g} % in pressure and "
        f"{100.0 * law.attrs['cross_validated_stiffness_error']:.2g} % in stiffness."
        f"{_unloading(law)}"
    )


def _of_friction(law: "xr.Dataset") -> str:
    """Say what a friction law of rubber is."""
    return (
        f" Friction at {law.attrs['reference_temperature'] - 273.15:.4g} °C peaks at "
        f"{float(law['peak_coefficient']):.3g} and {float(law['peak_speed']):.3g} m/s under "
        f"{1e-3 * float(law['reference_pressure']):.3g} kPa; other temperatures shift the speed. "
        f"The bell misses the cells by {100.0 * law.attrs['rms_error_over_peak']:.2g} % of the "
        f"peak, root mean square, and by {100.0 * law.attrs['largest_error_over_peak']:.2g} % at "
        f"{law.attrs['largest_error_speed']:.3g} m/s and "
        f"{law.attrs['largest_error_temperature'] - 273.15:.4g} °C. It is friction by hysteresis "
        f"on the waves of the road that the case names: no adhesion, no finer texture."
    )


def _unloading(law: "xr.Dataset") -> str:
    """Say how the interface unloads, if that is known."""
    if "unloading_stiffness_ratio" not in law:
        return ""
    error = float(np.sqrt(np.mean(law["unloading_fit_error"].values ** 2)))
    return (
        f" Unloaded, it is {float(law['unloading_stiffness_ratio']):.3g} times as stiff at first "
        f"as it was under load, and springs back with the exponent "
        f"{float(law['unloading_exponent']):.3g}; at a pressure that the fit has not seen, the "
        f"spring back errs by {100.0 * error:.2g} %."
    )


def write_report(out: str | Path) -> Path:
    """Write ``report.html`` of a finished run whose figures are drawn.

    Parameters
    ----------
    out : path
        Run folder.
    """
    from jinja2 import Environment

    out = Path(out)
    tree = open_run(out, finished=True)
    response, law, result = (
        tree[name].to_dataset() for name in ("micro_response", "interface_law", "macro_result")
    )
    braking = "braking_force" in result
    head, rows = tabulate_braking(result) if braking else (HEAD, tabulate(result))
    page = Environment(autoescape=True).from_string(PAGE)
    text = page.render(
        title=response.attrs["title"],
        summary=_of_cells(response)
        + (_of_friction(law) if braking else _of_normal_law(law))
        + f" The law stands for the {response.attrs['bodies']}.",
        cautions=response.attrs.get("cautions", "").splitlines(),
        plan=[*result.attrs.get("plan", "").splitlines(), *_terms(result)],
        head=head,
        rows=rows,
        figures=[
            (file.stem, base64.b64encode(read_bytes(file)).decode())
            for file in sorted((out / "figures").glob("*.png"))
        ],
        case=read_text(out / "case.toml"),
        provenance=f"{result.attrs['source']}, {result.attrs['history']}",
    )
    write_bytes(out / "report.html", text.encode())
    return out / "report.html"
