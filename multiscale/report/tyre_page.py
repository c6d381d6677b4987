"""The page of a run of rubber on a road."""

from typing import TYPE_CHECKING

import numpy as np

from multiscale.report.rows import list_facts, say_error, tabulate_braking
from multiscale.report.section import Section
from multiscale.upscaling import require_law
from multiscale.upscaling.budget import how_attribute

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["braking_answer", "braking_question", "braking_sections"]

ZERO_CELSIUS = 273.15

LAW = (
    "n_realisations",
    "pressure_min",
    "pressure_max",
    "reference_temperature",
    "peak_coefficient",
    "peak_speed",
    "reference_pressure",
    "speed_exponent",
    "rms_error_over_peak",
    "largest_error_over_peak",
    "largest_error_speed",
    "largest_error_temperature",
    "admissibility",
)
"""What the page says of a law of friction."""


def braking_question(result: "xr.Dataset") -> str:
    """Say what was asked."""
    speed, warm = result["sliding_speed"].values, result["temperature"].values - ZERO_CELSIUS
    return (
        f"How hard does the tread block brake under {1e-3 * float(result['preload'][0]):.4g} kPa, "
        f"at {speed.min():.3g} to {speed.max():.3g} m/s and {warm.min():.3g} to "
        f"{warm.max():.3g} °C?"
    )


def braking_answer(result: "xr.Dataset") -> list[str]:
    """Say where the force of every temperature is largest."""
    lines = []
    for temperature in np.unique(result["temperature"].values):
        at = np.flatnonzero(
            (result["temperature"].values == temperature)
            & np.isfinite(result["braking_force"].values)
        )
        if at.size == 0:
            lines.append(f"At {temperature - ZERO_CELSIUS:.4g} °C no force is known.")
            continue
        best = _hardest(result.isel(step=at))
        error = ""
        if "error_total" in result:
            said = say_error(float(best["error_total"].squeeze()))
            error = " ± an unknown error" if said == "unknown" else f" ± {said} %"
        lines.append(
            f"At {temperature - ZERO_CELSIUS:.4g} °C it brakes by at most "
            f"{float(best['braking_force']):.4g} N{error}, "
            f"{float(best['braking_coefficient']):.3g} of its load, at "
            f"{float(best['sliding_speed']):.3g} m/s."
        )
    return lines


def _hardest(result: "xr.Dataset") -> "xr.Dataset":
    """Step of the largest force."""
    return result.isel(step=int(np.nanargmax(result["braking_force"].values)))


def _budget(result: "xr.Dataset") -> Section:
    """Say of each term of the error budget how large it is and how it was estimated."""
    if "error_total" not in result:
        return Section("Error budget", ["Nothing was estimated."])
    best = _hardest(result).squeeze("quantity")
    rows = []
    for term, half in zip(
        result["error_term"].values, best["error_half_width"].values, strict=True
    ):
        known = f"{100.0 * half:.2g}" if np.isfinite(half) else ""
        rows.append((str(term), known, result.attrs[how_attribute(str(term))]))
    return Section(
        "Error budget",
        ["Half-widths of 95 % intervals of the braking force, where it is largest of all."],
        ("term", "half-width (%)", "rests on"),
        rows,
    )


def braking_sections(law: "xr.Dataset", result: "xr.Dataset", bodies: str) -> list[Section]:
    """Give table and figures of the forces, and what the law of friction is."""
    require_law(law, *LAW)
    values = law.attrs
    return [
        Section("Tread block", list_facts(result), *tabulate_braking(result), ("braking_force",)),
        Section(
            "Friction law",
            [
                f"The law stands for {bodies}; it rests on {values['n_realisations']} realisations "
                f"between {1e-3 * values['pressure_min']:.4g} and "
                f"{1e-3 * values['pressure_max']:.4g} kPa.",
                f"At {values['reference_temperature'] - ZERO_CELSIUS:.4g} °C friction peaks at "
                f"{float(law['peak_coefficient']):.3g} and {float(law['peak_speed']):.3g} m/s "
                f"under {1e-3 * float(law['reference_pressure']):.3g} kPa; the speed of the "
                f"peak goes with the power {float(law['speed_exponent']):.2g} of the pressure, and "
                f"other temperatures shift it.",
                f"The bell misses the cells by {100.0 * values['rms_error_over_peak']:.2g} % of "
                f"the peak, root mean square, and by at most "
                f"{100.0 * values['largest_error_over_peak']:.2g} %, at "
                f"{values['largest_error_speed']:.3g} m/s and "
                f"{values['largest_error_temperature'] - ZERO_CELSIUS:.4g} °C.",
                "It is friction by hysteresis on the waves of the road that the case names: no "
                "adhesion, no finer texture.",
                f"Admissibility: {values['admissibility']}.",
            ],
            figures=("friction",),
        ),
        _budget(result),
        Section("Footprint", [], figures=("footprint_pressure", "footprint_friction")),
        Section("Road", [], figures=("road",)),
    ]
