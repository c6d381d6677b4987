"""What a measured surface holds, and how it is shown."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from multiscale.errors import CaseError
from multiscale.io import Topography, open_topography, write_bytes
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

__all__ = ["INSPECTION", "inspect_surface", "inspection_lines", "tabulate_statistics"]

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
    found = open_topography(file, channel=channel, size=size, unit=unit)
    if spikes == "remove":
        found = found.without_spikes()
    undefined = np.count_nonzero(np.isnan(found.heights)) - found.spikes
    surface = found.to_surface(detrend_order=detrend_order, fill_undefined=True)
    waves = spectrum([surface], periodic=False)
    told = describe_surface(surface, resolution=found.resolution, waves=waves)
    settings = InstrumentSurface(
        file=file.resolve(),
        channel=channel,
        detrend_order=detrend_order,
        fill_undefined=undefined > 0,
        spikes=spikes,
        profile="isotropic" if found.is_profile else None,
    ).model_copy(update={"size": None if size is None else tuple(size), "unit": unit})
    cautions = [*found.say_spikes(), *_doubts(told, found)]
    if found.interpolated:
        cautions.append("the points of the line scan are uneven, and heights were interpolated")
    proposal, held = "", ""
    try:
        proposed = propose_case(
            surface,
            settings,
            waves,
            reliable=(float(told["shortest_reliable"]), float(told["longest_reliable"])),
        )
    except CaseError as error:
        cautions.append(f"no case is proposed: {error}")
    else:
        proposal = proposed.text
        height, slope = proposed.held.values()
        held = f"The cells hold {height:.2f} of the rms height and {slope:.2f} of the rms slope."
        cautions.extend(proposed.measured.cautions)
        if max(height, slope) > 1.0 / HELD and not found.is_profile:
            cautions.append(
                "the windows of the proposed cells are rougher than the map: more realisations "
                "cover more of it"
            )
    nx, ny = found.heights.shape
    return told.assign_attrs(
        title=file.name,
        format=found.format,
        channels="\n".join(found.channels),
        channel=found.channel,
        points=f"{nx} x {ny}" if ny > 1 else f"{nx} along a line",
        trend=("mean", "plane", "curvature")[detrend_order],
        resolution=found.resolution or np.nan,
        proposal=proposal,
        held=held,
        cautions="\n".join(cautions),
    )


def _doubts(told: Dataset, found: Topography) -> Iterator[str]:
    """Say what makes the statistics doubtful."""
    slope, filled = float(told["rms_slope"]), float(told["filled_share"])
    low, high = PLAUSIBLE_SLOPES
    if not low <= slope <= high:
        lengths = " x ".join(f"{edge:.4g} m" for edge in told["size"].values)
        yield (
            f"the rms slope is {slope:.2g}, which no machined surface has: the file says a size "
            f"of {lengths} and an rms height of {float(told['rms_height']):.3g} m, of which one "
            f"is probably wrong; give size or unit"
        )
    if filled > FILLED:
        yield (
            f"{100.0 * filled:.0f} % of the points are undefined; spectrum, Hurst exponent and lay "
            f"count them as filled"
        )
    if (kurtosis := float(told["kurtosis"])) > SPIKED:
        spikes = 0 if found.spikes else int(np.count_nonzero(find_spikes(found.heights)))
        removed = (
            f'{spikes} spikes go with --remove-spikes, and with spikes = "remove" in the surface '
            f"table; remove wider dust and holes in the instrument's software"
            if spikes
            else "remove dust and holes wider than spikes in the instrument's software"
        )
        yield (
            f"few points have most of the rms height, as the kurtosis of {kurtosis:.3g} tells: "
            f"{removed}, or measure another place"
        )
    if float(told["fit_deviation"]) > SELF_AFFINE:
        yield (
            f"the spectrum is {float(told['fit_deviation']):.2g} decades off the self-affine fit, "
            f"so that Hurst exponent and roll-off describe it poorly"
        )


def inspection_lines(told: Dataset) -> list[str]:
    """Return what the command line prints of an inspected surface."""
    lines = [f"{told.attrs['title']}: {told.attrs['format']}"]
    lines += [f"  channel {one}" for one in told.attrs["channels"].splitlines()]
    rows = tabulate_statistics(told, measured=True)
    width = max(len(name) for name, _ in rows)
    lines += [f"{name:<{width}}  {value}" for name, value in rows]
    if told.attrs["proposal"]:
        lines += ["", told.attrs["held"], "", *told.attrs["proposal"].splitlines()]
    return lines


def _sections(found: Datasets, out: Path) -> Iterator[Section]:
    told = found[INSPECTION.name]
    yield Section(
        "Surface",
        [f"Channel {told.attrs['channel']}; {told.attrs['format']}."],
        rows=tabulate_statistics(told, measured=True),
        figures={
            "measured_heights": on_axes(plot_measured_heights, told),
            "bearing_curve": on_axes(plot_bearing_curve, told),
            "spectral_density": on_axes(plot_spectral_density, told, size=WIDE),
        },
    )
    yield Section(
        "Channels of the file",
        rows=[tuple(one.split(": ", 1)) for one in told.attrs["channels"].splitlines()],
    )
    if told.attrs["proposal"]:
        keys = [line.partition(" = ") for line in told.attrs["proposal"].splitlines()[1:] if line]
        rows = [(key, value) for key, _, value in keys]
        text = told.attrs["proposal"].encode()
        files = {"case.toml": lambda file: write_bytes(file, text)}
        yield Section("Proposed case", [told.attrs["held"]], rows=rows, files=files)


def _answer(told: Dataset) -> Iterator[str]:
    """Report how rough the surface is, and which waves are known."""
    height, slope = readable(f"{float(told['rms_height']):.3g} m"), float(told["rms_slope"])
    yield (
        f"The surface has an rms height of {height} and an rms slope of {slope:.3g}; "
        f"reliable waves: {_say_waves(told)}."
    )
    yield from filter(None, [told.attrs["held"]])


LAY = 1.5
"""Ratio of slopes from which a surface has a lay."""


def _say_waves(told: Dataset) -> str:
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
        ("reliable waves", _say_waves(told)),
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


INSPECTION = Shown(
    schema=SURFACE_STATISTICS,
    question="How rough is this surface, and which cells stand for it?",
    answer=_answer,
    sections=_sections,
)
