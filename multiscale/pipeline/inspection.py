"""What a measured surface holds, and how it is shown."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from multiscale.errors import CaseError
from multiscale.io import Topography, open_topography, write_bytes
from multiscale.pipeline.measured_sides import HELD
from multiscale.pipeline.proposal import propose_case
from multiscale.pipeline.rough_bodies import InstrumentSurface
from multiscale.pipeline.stage import Datasets, Section, Shown
from multiscale.pipeline.surface_rows import say_reliable_waves, tabulate_statistics
from multiscale.plotting.figure import WIDE, on_axes
from multiscale.plotting.surface_figures import (
    plot_bearing_curve,
    plot_measured_heights,
    plot_spectral_density,
)
from multiscale.schema import SURFACE_STATISTICS, Dataset
from multiscale.surfaces import describe_surface, find_spikes, spectrum
from multiscale.units import readable

__all__ = ["INSPECTION", "inspect_surface", "inspection_lines"]

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
        f"reliable waves: {say_reliable_waves(told)}."
    )
    yield from filter(None, [told.attrs["held"]])


INSPECTION = Shown(
    schema=SURFACE_STATISTICS,
    question="How rough is this surface, and which cells stand for it?",
    answer=_answer,
    sections=_sections,
)
