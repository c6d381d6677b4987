"""What a measured surface holds, and how it is shown."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.io import open_topography
from multiscale.pipeline.proposal import propose_case
from multiscale.pipeline.rough_bodies import InstrumentSurface
from multiscale.pipeline.stage import Datasets, Section, Shown, Summary
from multiscale.pipeline.windows import HELD
from multiscale.plotting.figure import on_axes
from multiscale.plotting.inspection_figures import (
    plot_bearing_curve,
    plot_measured_heights,
    plot_spectral_density,
)
from multiscale.schema import SURFACE_STATISTICS
from multiscale.surfaces import describe_surface, spectrum
from multiscale.units import readable

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["INSPECTION", "inspect_surface"]

PLAUSIBLE_SLOPES = (1e-5, 3.0)
FILLED = 0.1  # share of undefined points that needs a caution
SELF_AFFINE = 0.4  # decades between spectrum and fit that need a caution
LAY = 1.5  # ratio of slopes from which a surface has a lay


def inspect_surface(
    file: Path,
    *,
    channel: int | str | None = None,
    size: Sequence[float] | None = None,
    unit: float | None = None,
    detrend_order: int = 2,
) -> "xr.Dataset":
    """Describe a measured surface, and propose a case for it.

    Parameters
    ----------
    file, channel, size, unit, detrend_order
        See :func:`multiscale.io.read_surface`; line scans may be inspected, too.

    Returns
    -------
    Dataset
        Follows ``SURFACE_STATISTICS``. The attribute ``proposal`` is a case file, empty where no
        cells can be cut, with the reason in ``cautions``.

    Raises
    ------
    CaseError
        If the file cannot be read, or is flat.
    """
    found = open_topography(file, channel=channel, size=size, unit=unit)
    surface = found.to_surface(detrend_order=detrend_order, fill_undefined=True)
    waves = spectrum([surface], periodic=False)
    told = describe_surface(surface, resolution=found.resolution, waves=waves)
    settings = InstrumentSurface(
        file=file.resolve(),
        channel=channel,
        detrend_order=detrend_order,
        fill_undefined=surface.filled is not None,
        profile="isotropic" if found.is_profile else None,
    ).model_copy(update={"size": None if size is None else tuple(size), "unit": unit})
    cautions = list(_doubts(told))
    if found.interpolated:
        cautions.append("the points of the line scan are uneven, and heights were interpolated")
    proposal, held = "", ""
    try:
        proposed = propose_case(
            surface, settings, waves, shortest_reliable=float(told["shortest_reliable"])
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


def _doubts(told: "xr.Dataset") -> Iterator[str]:
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
    if float(told["fit_deviation"]) > SELF_AFFINE:
        yield (
            f"the spectrum is {float(told['fit_deviation']):.2g} decades off the self-affine fit, "
            f"so that Hurst exponent and roll-off describe it poorly"
        )
    if not float(told["longest_reliable"]) > float(told["shortest_reliable"]):
        yield "no wave is reliable: the map has too few points"


def _describe(told: "xr.Dataset") -> list[tuple[str, str]]:
    """Return names and values of the statistics as rows."""

    def say(name: str, unit: str = "m", digits: int = 3) -> str:
        value = float(told[name])
        if not np.isfinite(value):
            return "not known"
        return f"{value:.{digits}g}" if unit == "1" else readable(f"{value:.{digits}g} {unit}")

    edges = [readable(f"{edge:.4g} m") for edge in told["size"].values]
    is_map = int(told["dimensions"]) == 2
    rows = [
        ("size", " x ".join(edges) if is_map else edges[0]),
        ("points", told.attrs["points"]),
        ("undefined points", f"{100.0 * float(told['filled_share']):.3g} %"),
        (f"rms height without {told.attrs['trend']}", say("rms_height", digits=4)),
        ("rms slope" if is_map else "rms slope of the line", say("rms_slope", "1", 4)),
        ("highest to lowest point", say("peak_to_valley")),
        ("skewness, kurtosis", f"{say('skewness', '1')}, {say('kurtosis', '1')}"),
        ("99 % of the mean square height: waves up to", say("longest_wave")),
        ("99 % of the mean square slope: waves down to", say("shortest_wave")),
        ("reliable waves", f"{say('shortest_reliable')} to {say('longest_reliable')}"),
        ("Hurst exponent", say("hurst_exponent", "1", 2)),
        ("spectrum flat above", say("roll_off")),
        ("rms distance of the spectrum from this fit", f"{say('fit_deviation', '1', 2)} decades"),
        ("Nayak's parameter of the reliable waves", say("nayak_parameter", "1")),
        ("bearing curve: height above 10, 50, 90 %", _bearing(told)),
    ]
    if is_map:
        degrees, ratio = np.rad2deg(float(told["lay_angle"])), float(told["lay_ratio"])
        lay = f"at {degrees:.0f} degrees to x" if ratio >= LAY else "no lay"
        rows.append(("rms slope across over along the lay", f"{ratio:.3g}, {lay}"))
    return rows


def _bearing(told: "xr.Dataset") -> str:
    """Heights of which a tenth, a half and nine tenths of the surface lie above."""
    share, height = told["bearing_share"].values, told["bearing_height"].values
    return ", ".join(readable(f"{np.interp(at, share, height):.3g} m") for at in (0.1, 0.5, 0.9))


def _lines(found: Datasets) -> list[str]:
    told = found[INSPECTION.name]
    lines = [f"{told.attrs['title']}: {told.attrs['format']}"]
    lines += [f"  channel {one}" for one in told.attrs["channels"].splitlines()]
    width = max(len(name) for name, _ in _describe(told))
    lines += [f"{name:<{width}}  {value}" for name, value in _describe(told)]
    if told.attrs["proposal"]:
        lines += ["", told.attrs["held"], "", *told.attrs["proposal"].splitlines()]
    return lines


def _sections(found: Datasets, out: Path) -> Iterator[Section]:
    told = found[INSPECTION.name]

    def draw(plot: Callable[..., object]) -> Callable[[Path], Path]:
        return on_axes(lambda ax: plot(told, ax=ax))

    yield Section(
        "Surface",
        [f"Channel {told.attrs['channel']}; {told.attrs['format']}."],
        rows=_describe(told),
        figures={
            "measured_heights": draw(plot_measured_heights),
            "spectral_density": draw(plot_spectral_density),
            "bearing_curve": draw(plot_bearing_curve),
        },
    )
    yield Section(
        "Channels of the file",
        rows=[tuple(one.split(": ", 1)) for one in told.attrs["channels"].splitlines()],
    )
    if told.attrs["proposal"]:
        keys = [line.partition(" = ") for line in told.attrs["proposal"].splitlines()[1:] if line]
        rows = [(key, value) for key, _, value in keys]
        yield Section("Proposed case", [told.attrs["held"]], rows=rows)


def _summary(found: Datasets) -> Summary:
    """Say in a sentence how rough the surface is, and which waves are known."""
    told = found[INSPECTION.name]
    height, slope = readable(f"{float(told['rms_height']):.3g} m"), float(told["rms_slope"])
    ends = (readable(f"{float(told[f'{end}_reliable']):.3g} m") for end in ("shortest", "longest"))
    return Summary(
        told.attrs["title"],
        "How rough is this surface, and which cells stand for it?",
        [
            f"Its rms height is {height} and its rms slope {slope:.3g}; waves from "
            f"{' to '.join(ends)} are reliable.",
            *([told.attrs["held"]] if told.attrs["held"] else []),
        ],
    )


INSPECTION = Shown(schema=SURFACE_STATISTICS, lines=_lines, sections=_sections, summary=_summary)
