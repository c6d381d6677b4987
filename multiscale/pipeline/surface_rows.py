"""Statistics of a surface as rows of text."""

import numpy as np

from multiscale.schema import Dataset
from multiscale.units import readable

__all__ = ["say_reliable_waves", "tabulate_statistics"]

LAY = 1.5
"""Ratio of slopes from which a surface has a lay."""


def say_reliable_waves(told: Dataset) -> str:
    """Return both ends of the reliable waves of a surface, or "none"."""
    ends = [float(told[f"{end}_reliable"]) for end in ("shortest", "longest")]
    return " to ".join(readable(f"{end:.3g} m") for end in ends) if ends[0] < ends[1] else "none"


def tabulate_statistics(told: Dataset, *, measured: bool) -> list[tuple[str, str]]:
    """Return names and values of ``SURFACE_STATISTICS`` as rows.

    Undefined points, reliable waves and the fit to the spectrum are of a measured surface alone.
    """

    def say(name: str, unit: str = "m", digits: int = 3) -> str:
        value = float(told[name])
        if not np.isfinite(value):
            return "not known"
        return f"{value:.{digits}g}" if unit == "1" else readable(f"{value:.{digits}g} {unit}")

    edges = [readable(f"{edge:.4g} m") for edge in told["size"].values]
    is_map = int(told["dimensions"]) == 2
    of_measured = [
        ("undefined points", f"{100.0 * float(told['filled_share']):.3g} %"),
        ("reliable waves", say_reliable_waves(told)),
        ("Hurst exponent", say("hurst_exponent", "1", 2)),
        ("spectrum flat above", say("roll_off")),
        ("decades from the spectrum to this fit, rms", say("fit_deviation", "1", 2)),
    ]
    bearing = (  # heights of which a tenth, a half and nine tenths of the surface lie above
        readable(f"{np.interp(at, told['bearing_share'], told['bearing_height']):.3g} m")
        for at in (0.1, 0.5, 0.9)
    )
    rows = [
        ("size", " x ".join(edges) if is_map else edges[0]),
        ("points", told.attrs["points"]),
        (f"rms height without {told.attrs['trend']}", say("rms_height", digits=4)),
        ("rms slope" if is_map else "rms slope of the line", say("rms_slope", "1", 4)),
        ("highest to lowest point", say("peak_to_valley")),
        ("skewness, kurtosis", f"{say('skewness', '1')}, {say('kurtosis', '1')}"),
        ("99 % of the mean square height: waves up to", say("longest_wave")),
        ("99 % of the mean square slope: waves down to", say("shortest_wave")),
        *(of_measured if measured else ()),
        (f"Nayak's parameter{' of the reliable waves' * measured}", say("nayak_parameter", "1")),
        ("bearing curve: height above 10, 50, 90 %", ", ".join(bearing)),
    ]
    if is_map:
        degrees, ratio = np.rad2deg(float(told["lay_angle"])), float(told["lay_ratio"])
        lay = f"at {round(degrees) % 180} degrees to x" if ratio >= LAY else "no lay"
        rows.append(("rms slope across the lay over along it", f"{ratio:.3g}, {lay}"))
    return rows
