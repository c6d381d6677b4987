"""Statistics of a measured surface, its proposed case, and the sections of its report."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from multiscale.errors import CaseError
from multiscale.io import write_bytes
from multiscale.io.surface_file import Topography, open_topography
from multiscale.pipeline.measured_sides import HELD
from multiscale.pipeline.proposal import propose_case
from multiscale.pipeline.stage import Datasets, Section, Shown
from multiscale.pipeline.tables.rough_bodies import InstrumentSurface
from multiscale.plotting.figure import WIDE, on_axes
from multiscale.plotting.surface_figures import (
    plot_bearing_curve,
    plot_measured_heights,
    plot_spectral_density,
)
from multiscale.schema import SURFACE_STATISTICS, Dataset
from multiscale.surfaces import describe_surface, find_spikes, spectrum
from multiscale.units import readable

PLAUSIBLE_SLOPES = (1e-5, 3.0)
FILLED = 0.1  # share of undefined points that needs a caution
SPIKED = 30.0  # kurtosis of heights that needs a caution; 3 is Gaussian
SELF_AFFINE = 0.4  # decades between spectrum and fit that need a caution


def inspect_surface(
    file: Path,
    *,
    channel: int | str | None = None,
    size: Sequence[float] | None = None,
    unit: float | None = None,
    detrend_order: int = 2,
    spikes: Literal["keep", "remove"] = "keep",
) -> Dataset:
    """Describe a measured surface, and propose a case for it."""
    topography = open_topography(file, channel=channel, size=size, unit=unit)
    if spikes == "remove":
        topography = topography.without_spikes()
    undefined = np.count_nonzero(np.isnan(topography.heights)) - topography.spikes
    surface = topography.to_surface(detrend_order=detrend_order, fill_undefined=True)
    density = spectrum([surface], periodic=False)
    statistics = describe_surface(surface, resolution=topography.resolution, waves=density)
    settings = InstrumentSurface(
        file=file.resolve(),
        channel=channel,
        detrend_order=detrend_order,
        fill_undefined=undefined > 0,
        spikes=spikes,
        profile="isotropic" if topography.is_profile else None,
    ).model_copy(update={"size": None if size is None else tuple(size), "unit": unit})
    cautions = [*topography.say_spikes(), *_doubts(statistics, topography)]
    if topography.interpolated:
        cautions.append("the points of the line scan are uneven, and heights were interpolated")
    proposal, shares = "", ""
    try:
        proposed = propose_case(
            surface,
            settings,
            density,
            reliable=(
                float(statistics["shortest_reliable"]),
                float(statistics["longest_reliable"]),
            ),
        )
    except CaseError as error:
        cautions.append(f"no case is proposed: {error}")
    else:
        proposal = proposed.text
        height, slope = proposed.shares.values()
        shares = f"The cells hold {height:.2f} of the rms height and {slope:.2f} of the rms slope."
        cautions.extend(proposed.measured.cautions)
        if max(height, slope) > 1.0 / HELD and not topography.is_profile:
            cautions.append(
                "the windows of the proposed cells are rougher than the map: more realisations "
                "cover more of it"
            )
    nx, ny = topography.heights.shape
    return statistics.assign_attrs(
        title=file.name,
        format=topography.format,
        channels="\n".join(topography.channels),
        channel=topography.channel,
        points=f"{nx} x {ny}" if ny > 1 else f"{nx} along a line",
        trend=("mean", "plane", "curvature")[detrend_order],
        resolution=topography.resolution or np.nan,
        proposal=proposal,
        held=shares,
        cautions="\n".join(cautions),
    )


def _doubts(statistics: Dataset, topography: Topography) -> Iterator[str]:
    """Yield cautions about implausible statistics."""
    slope, filled = float(statistics["rms_slope"]), float(statistics["filled_share"])
    low, high = PLAUSIBLE_SLOPES
    if not low <= slope <= high:
        lengths = " x ".join(f"{edge:.4g} m" for edge in statistics["size"].values)
        yield (
            f"the rms slope is {slope:.2g}, which no machined surface has: the file states a size "
            f"of {lengths} and an rms height of {float(statistics['rms_height']):.3g} m, at least "
            f"one of which is wrong; give size or unit"
        )
    if filled > FILLED:
        yield (
            f"{100.0 * filled:.0f} % of the points are undefined; spectrum, Hurst exponent and lay "
            f"count them as filled"
        )
    if (kurtosis := float(statistics["kurtosis"])) > SPIKED:
        spikes = 0 if topography.spikes else int(np.count_nonzero(find_spikes(topography.heights)))
        removed = (
            f'{spikes} spikes go with --remove-spikes, and with spikes = "remove" in the surface '
            f"table; remove wider dust and holes in the instrument's software"
            if spikes
            else "remove dust and holes wider than spikes in the instrument's software"
        )
        yield (
            f"few points have most of the rms height, as the kurtosis of {kurtosis:.3g} shows: "
            f"{removed}, or measure another place"
        )
    if (deviation := float(statistics["fit_deviation"])) > SELF_AFFINE:
        yield (
            f"the spectrum is {deviation:.2g} decades off the self-affine fit, so that Hurst "
            f"exponent and roll-off describe it poorly"
        )


def inspection_lines(statistics: Dataset) -> list[str]:
    """Return the lines of an inspected surface for the command line."""
    lines = [f"{statistics.attrs['title']}: {statistics.attrs['format']}"]
    lines += [f"  channel {channel}" for channel in statistics.attrs["channels"].splitlines()]
    rows = tabulate_statistics(statistics, measured=True)
    width = max(len(name) for name, _ in rows)
    lines += [f"{name:<{width}}  {value}" for name, value in rows]
    if statistics.attrs["proposal"]:
        lines += ["", statistics.attrs["held"], "", *statistics.attrs["proposal"].splitlines()]
    return lines


def _sections(datasets: Datasets, out: Path) -> Iterator[Section]:
    statistics = datasets[INSPECTION.name]
    yield Section(
        "Surface",
        [f"Channel {statistics.attrs['channel']}; {statistics.attrs['format']}."],
        rows=tabulate_statistics(statistics, measured=True),
        figures={
            "measured_heights": on_axes(plot_measured_heights, statistics),
            "bearing_curve": on_axes(plot_bearing_curve, statistics),
            "spectral_density": on_axes(plot_spectral_density, statistics, size=WIDE),
        },
    )
    yield Section(
        "Channels of the file",
        rows=[tuple(line.split(": ", 1)) for line in statistics.attrs["channels"].splitlines()],
    )
    if statistics.attrs["proposal"]:
        keys = [
            line.partition(" = ") for line in statistics.attrs["proposal"].splitlines()[1:] if line
        ]
        rows = [(key, value) for key, _, value in keys]
        text = statistics.attrs["proposal"].encode()
        files = {"case.toml": lambda file: write_bytes(file, text)}
        yield Section("Proposed case", [statistics.attrs["held"]], rows=rows, files=files)


def _answer(statistics: Dataset) -> Iterator[str]:
    """Report rms height and slope of the surface, and its reliable wavelengths."""
    height = readable(f"{float(statistics['rms_height']):.3g} m")
    yield (
        f"The surface has an rms height of {height} and an rms slope of "
        f"{float(statistics['rms_slope']):.3g}; "
        f"reliable wavelengths: {_reliable_range(statistics)}."
    )
    yield from filter(None, [statistics.attrs["held"]])


LAY = 1.5  # ratio of slopes from which a surface has a lay


def _reliable_range(statistics: Dataset) -> str:
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
        ("reliable wavelengths", _reliable_range(statistics)),
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


INSPECTION = Shown(
    schema=SURFACE_STATISTICS,
    question="How rough is this surface, and which cells stand for it?",
    answer=_answer,
    sections=_sections,
)
