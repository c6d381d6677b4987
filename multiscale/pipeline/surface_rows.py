"""Statistics of a surface as rows of names and values."""

import numpy as np

from multiscale.schema import Dataset
from multiscale.units import readable

LAY = 1.5  # ratio of slopes from which a surface has a lay


def reliable_range(statistics: Dataset) -> str:
    """Return shortest and longest reliable wavelength of a surface, or "none"."""
    ends = [float(statistics[f"{end}_reliable"]) for end in ("shortest", "longest")]
    return " to ".join(readable(f"{end:.3g} m") for end in ends) if ends[0] < ends[1] else "none"


def tabulate_statistics(statistics: Dataset, *, measured: bool) -> list[tuple[str, str]]:
    """Return names and values of ``SURFACE_STATISTICS`` as rows."""

    def value_of(name: str, unit: str = "m", digits: int = 3) -> str:
        value = float(statistics[name])
        if not np.isfinite(value):
            return "not known"
        return f"{value:.{digits}g}" if unit == "1" else readable(f"{value:.{digits}g} {unit}")

    edges = [readable(f"{edge:.4g} m") for edge in statistics["size"].values]
    is_map = int(statistics["dimensions"]) == 2
    of_measured = [
        ("undefined points", f"{100.0 * float(statistics['filled_share']):.3g} %"),
        ("reliable wavelengths", reliable_range(statistics)),
        ("Hurst exponent", value_of("hurst_exponent", "1", 2)),
        ("spectrum flat above", value_of("roll_off")),
        ("decades from the spectrum to this fit, rms", value_of("fit_deviation", "1", 2)),
    ]
    bearing = (  # heights of which a tenth, a half and nine tenths of the surface lie above
        readable(
            f"{np.interp(at, statistics['bearing_share'], statistics['bearing_height']):.3g} m"
        )
        for at in (0.1, 0.5, 0.9)
    )
    rows = [
        ("size", " x ".join(edges) if is_map else edges[0]),
        ("points", statistics.attrs["points"]),
        (f"rms height without {statistics.attrs['trend']}", value_of("rms_height", digits=4)),
        ("rms slope" if is_map else "rms slope of the line", value_of("rms_slope", "1", 4)),
        ("highest to lowest point", value_of("peak_to_valley")),
        ("skewness, kurtosis", f"{value_of('skewness', '1')}, {value_of('kurtosis', '1')}"),
        ("99 % of the mean square height: wavelengths up to", value_of("longest_wave")),
        ("99 % of the mean square slope: wavelengths down to", value_of("shortest_wave")),
        *(of_measured if measured else ()),
        (
            f"Nayak's parameter{' of the reliable wavelengths' * measured}",
            value_of("nayak_parameter", "1"),
        ),
        ("bearing curve: height above 10, 50, 90 %", ", ".join(bearing)),
    ]
    if is_map:
        degrees, ratio = np.rad2deg(float(statistics["lay_angle"])), float(statistics["lay_ratio"])
        lay = f"at {round(degrees) % 180} degrees to x" if ratio >= LAY else "no lay"
        rows.append(("rms slope across the lay over along it", f"{ratio:.3g}, {lay}"))
    return rows
