"""Results as rows of text under a head.

A ``result`` follows ``MACRO_RESULT``, a result of grains ``GRANULATE``, of a sweep ``SWEEP``.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from multiscale.units import ZERO_CELSIUS

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "list_cycles",
    "list_facts",
    "say_error",
    "tabulate",
    "tabulate_braking",
    "tabulate_grains",
    "tabulate_links",
    "tabulate_loads",
    "tabulate_preloads",
    "tabulate_sweep",
]

HEAD = (
    "preload (MPa)",
    "joint stiffness (MPa/µm)",
    "95 % band",
    "error (%)",
    "interface (MPa/µm)",
    "bodies (MPa/µm)",
    "mean gap (µm)",
    "contact (%)",
    "real pressure (MPa)",
)

MOST_ROWS = 11
"""Of the table of a structure of links."""


def tabulate(result: "xr.Dataset") -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return head and rows of text for a joint."""
    unloaded = "unloading_stiffness" in result
    head = (*HEAD, "unloading (MPa/µm)") if unloaded else HEAD
    rows: list[tuple[str, ...]] = []
    for k in range(result.sizes["step"]):
        step = result.isel(step=k)
        if missing := _missing(step):
            rows.append(_padded((f"{1e-6 * float(step['preload']):.4g}", missing), head))
            continue
        band = np.full(2, np.nan)
        if "joint_stiffness_sample" in result:
            band = np.nanpercentile(step["joint_stiffness_sample"], (2.5, 97.5))
        last = (f"{1e-12 * float(step['unloading_stiffness']):.4g}",) if unloaded else ()
        rows.append(_row(step, band) + last)
    return head, rows


def tabulate_sweep(result: "xr.Dataset") -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return head and rows of a sweep as text: each point at its largest converged preload."""
    head = (*map(str, result["parameter"].values), *HEAD)
    rows = []
    for k in range(result.sizes["point"]):
        point = result.isel(point=k)
        said = tuple(map(str, point["setting"].values))
        done = np.flatnonzero(np.isfinite(point["joint_stiffness"].values))
        if done.size == 0:
            rows.append(_padded((*said, "", "no result"), head))
            continue
        step = point.isel(step=done[-1])
        band = (float(step[f"joint_stiffness_{end}"]) for end in ("low", "high"))
        rows.append((*said, *_row(step, tuple(band))))
    return head, rows


def _row(step: "xr.Dataset", band: "Sequence[float] | np.ndarray") -> tuple[str, ...]:
    """Results at one preload, in the order of ``HEAD``; no band beside an unknown error."""
    low, high = (1e-12 * end for end in band)
    error = _error(step, "joint_stiffness")
    return (
        f"{1e-6 * float(step['preload']):.4g}",
        f"{1e-12 * float(step['joint_stiffness']):.4g}",
        "none" if np.isnan(low) or error == "unknown" else f"{low:.4g} ... {high:.4g}",
        error,
        _part(step, "interface_stiffness"),
        _part(step, "solid_stiffness"),
        f"{1e6 * float(step['mean_gap']):.4g}",
        f"{100.0 * float(step['contact_fraction']):.3g}",
        f"{1e-6 * float(step['real_pressure']):.4g}" if "real_pressure" in step else "",
    )


def say_error(total: float) -> str:
    """Total of an error budget in per cent, or that a term it must hold could not be computed."""
    return f"{100.0 * total:.2g}" if np.isfinite(total) else "unknown"


def _missing(step: "xr.Dataset") -> str:
    """Why a step has no answer; empty if it has."""
    if not int(step["converged"]):
        return "not converged"
    return "unknown" if "known" in step and np.isnan(step["approach"]) else ""


def _padded(row: tuple[str, ...], head: Sequence[str]) -> tuple[str, ...]:
    return row + ("",) * (len(head) - len(row))


def _error(step: "xr.Dataset", name: str) -> str:
    """Total error of a quantity, per cent; empty if nothing was estimated."""
    if "error_total" not in step or name not in step["quantity"].values:
        return ""
    return say_error(float(step["error_total"].sel(quantity=name)))


def _part(step: "xr.Dataset", name: str) -> str:
    """Stiffness of a part of the joint, MPa/µm, with its error; empty in an earlier version."""
    if name not in step:
        return ""
    error = _error(step, name)
    beside = f" ± {error} %" if error not in ("", "unknown") else ""
    return f"{1e-12 * float(step[name]):.4g}{beside}"


def tabulate_links(result: "xr.Dataset") -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return head and rows of text for a structure of links, at most ``MOST_ROWS`` of its steps."""
    along, name = ("time", "time (s)") if "time" in result.coords else ("load_factor", "load")
    rows: list[tuple[str, ...]] = []
    for k in _steps_shown(result):
        step = result.isel(step=k)
        at = f"{float(step[along]):.4g}"
        if not int(step["converged"]):
            rows.append((at, "not converged", "", f"{float(step['residual']):.1e}"))
            continue
        slack, largest = int((step["slack"] > 0.0).sum()), float(step["tension"].max())
        rows.append((at, f"{slack}", f"{1e-3 * largest:.4g}", f"{float(step['residual']):.1e}"))
    return (name, "slack links", "largest tension (kN)", "residual"), rows


def tabulate_grains(result: "xr.Dataset") -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return head and rows of text for a granulate, at most ``MOST_ROWS`` of its steps."""
    names = ("time", "n_contacts", "kinetic_energy", "penetration", "iterations", "residual")
    head = ("time (s)", "contacts", "kinetic (J)", "overlap / R", "sweeps", "error")
    rows = [tuple(f"{float(result[name][k]):.4g}" for name in names) for k in _steps_shown(result)]
    if "stress" not in result:
        return head, rows
    from multiscale.macro.granulate import biaxial_curve

    curve = biaxial_curve(result).isel(step=_steps_shown(result))
    more = zip(curve["axial_strain"].values, curve["stress_ratio"].values, strict=True)
    return (*head, "axial strain", "q/p"), [
        (*row, f"{strain:.4g}", f"{ratio:.4g}")
        for row, (strain, ratio) in zip(rows, more, strict=True)
    ]


def _steps_shown(result: "xr.Dataset") -> np.ndarray:
    """At most ``MOST_ROWS`` steps, evenly spread, the first and the last among them."""
    steps = result.sizes["step"]
    return np.unique(np.linspace(0, steps - 1, min(steps, MOST_ROWS)).round().astype(int))


def tabulate_preloads(result: "xr.Dataset") -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows of bodies with joints at their preloads."""
    states = ("stick", "slip", "open")
    head = (
        "preload (MPa)",
        "joint stiffness (MPa/µm)",
        "error (%)",
        "interface (MPa/µm)",
        "bodies (MPa/µm)",
        "tangential (MPa/µm)",
        *(f"{state} (%)" for state in states),
        "real pressure (MPa)",
    )
    rows: list[tuple[str, ...]] = []
    for k in range(int(np.argmax(result["shear"].values != 0.0)) or result.sizes["step"]):
        step = result.isel(step=k)
        preload = f"{1e-6 * float(step['preload']):.4g}"
        if missing := _missing(step):
            rows.append(_padded((preload, missing), head))
            continue
        row = (
            preload,
            f"{1e-12 * float(step['joint_stiffness']):.4g}",
            _error(step, "joint_stiffness"),
            _part(step, "interface_stiffness"),
            _part(step, "solid_stiffness"),
            f"{1e-12 * float(step['tangential_stiffness']):.4g}",
            *(f"{100.0 * float(step[f'{state}_fraction']):.4g}" for state in states),
            f"{1e-6 * float(step['real_pressure']):.4g}" if "real_pressure" in step else "",
        )
        rows.append(row)
    return head, rows


def tabulate_loads(result: "xr.Dataset") -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows of a body under its loads."""
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


def list_facts(result: "xr.Dataset") -> list[str]:
    """Say what stands beside the table of a result: what flows, and how large a cell is."""
    return str(result.attrs.get("facts", "")).splitlines()


def tabulate_braking(result: "xr.Dataset") -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return head and rows of text for a tread block: each temperature at its speeds."""
    head = ("temperature (°C)", "speed (m/s)", "braking force (N)", "95 % band", "force / load")
    rows: list[tuple[str, ...]] = []
    for k in range(result.sizes["step"]):
        step = result.isel(step=k)
        warm = float(step["temperature"]) - ZERO_CELSIUS
        at = (f"{warm:.4g}", f"{float(step['sliding_speed']):.3g}")
        if not int(step["converged"]):
            rows.append((*at, "not converged", "", ""))
            continue
        if np.isnan(step["braking_force"]):
            rows.append((*at, "unknown", "", ""))
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
    missing = "unknown" if result["converged"].values.all() else "not closed"
    return [
        f"cycle {k}: {missing}" if np.isnan(loss) else f"cycle {k}: {loss:.4g} J lost"
        for k, loss in enumerate(result["cycle_energy"].values)
    ]
