"""Statistics of a measured surface, its proposed case, and the sections of its report."""

from collections.abc import Iterator, Sequence
from os.path import realpath
from pathlib import Path
from typing import Any, Literal

import numpy as np

from multiscale.errors import CaseError
from multiscale.io import write_bytes
from multiscale.io.surface_file import Topography, open_topography
from multiscale.pipeline.measured_sides import HELD
from multiscale.pipeline.proposal import MeasuredFace, propose_case, write_structure
from multiscale.pipeline.stage import Datasets, Section, Shown
from multiscale.pipeline.surface_rows import reliable_range, tabulate_statistics
from multiscale.pipeline.tables.rough_bodies import InstrumentSurface
from multiscale.plotting.figure import WIDE, on_axes
from multiscale.plotting.surface_figures import (
    plot_bearing_curve,
    plot_measured_heights,
    plot_spectral_density,
)
from multiscale.schema import SURFACE_STATISTICS, Dataset, with_cautions
from multiscale.surfaces import describe_surface, find_spikes, spectrum
from multiscale.units import readable

PLAUSIBLE_SLOPES = (1e-5, 3.0)
FILLED = 0.1  # share of undefined points that needs a caution
SPIKED = 30.0  # kurtosis of heights that needs a caution; 3 is Gaussian
SELF_AFFINE = 0.4  # decades between spectrum and fit that need a caution


def inspect_surface(file: Path, **reading: Any) -> Dataset:
    """Describe a measured surface, and propose a case for it; see :func:`inspect_surfaces`."""
    return inspect_surfaces([file], **reading)[0]


def inspect_surfaces(
    files: Sequence[Path],
    *,
    structure: str = "",
    preload: str = "",
    channel: int | str | None = None,
    size: Sequence[float] | None = None,
    unit: float | None = None,
    detrend_order: int = 2,
    spikes: Literal["keep", "remove"] = "keep",
) -> list[Dataset]:
    """Describe one or two measured surfaces; the last result has the proposed case for all."""
    further = write_structure(structure, preload) if structure else ""
    faces, described = [], []
    for file in files:
        topography = open_topography(file, channel=channel, size=size, unit=unit)
        if spikes == "remove":
            topography = topography.without_spikes()
        settings = InstrumentSurface(
            file=Path(realpath(file)),
            channel=channel,
            detrend_order=detrend_order,
            fill_undefined=bool(np.isnan(topography.heights).sum() > topography.spikes),
            spikes=spikes,
            profile="isotropic" if topography.is_profile else None,
        ).model_copy(update={"size": None if size is None else tuple(size), "unit": unit})
        surface = topography.to_surface(detrend_order=detrend_order, fill_undefined=True)
        density = spectrum([surface], periodic=False)
        statistics = describe_surface(surface, resolution=topography.resolution, waves=density)
        ends = float(statistics["shortest_reliable"]), float(statistics["longest_reliable"])
        faces.append(MeasuredFace(surface, settings, density, ends))
        described.append(_described(statistics, topography, settings))
    return _with_proposal(described, faces, further)


def _described(statistics: Dataset, topography: Topography, settings: InstrumentSurface) -> Dataset:
    """Return statistics with the facts on their file, cautions, and no proposal yet."""
    cautions = [*topography.say_spikes(), *_doubts(statistics, topography)]
    if topography.interpolated:
        cautions.append("the points of the line scan are uneven, and heights were interpolated")
    nx, ny = topography.heights.shape
    return statistics.assign_attrs(
        title=settings.file.name,
        format=topography.format,
        channels="\n".join(topography.channels),
        channel=topography.channel,
        points=f"{nx} x {ny}" if ny > 1 else f"{nx} along a line",
        trend=("mean", "plane", "curvature")[settings.detrend_order],
        resolution=topography.resolution or np.nan,
        proposal="",
        held="",
        cautions="\n".join(cautions),
    )


def _with_proposal(
    described: list[Dataset], faces: Sequence[MeasuredFace], further: str
) -> list[Dataset]:
    """Return statistics with the case that is proposed for all faces, or the reason of none."""
    try:
        proposal = propose_case(faces, further)
    except CaseError as error:
        return [
            *described[:-1],
            with_cautions(described[-1], f"no case is proposed: {error}"),
        ]
    listed = []
    for k, (statistics, face) in enumerate(zip(described, faces, strict=True)):
        height, slope = proposal.shares(k)
        cautions = [*proposal.measured[k].cautions]
        if max(height, slope) > 1.0 / HELD and face.settings.profile is None:
            cautions.append(
                "the windows of the proposed cells are rougher than the map: more realisations "
                "cover more of it"
            )
        shares = f"The cells have {height:.2f} of the rms height and {slope:.2f} of the rms slope."
        listed.append(with_cautions(statistics, *cautions).assign_attrs(held=shares))
    listed[-1] = listed[-1].assign_attrs(proposal=proposal.text)
    return listed


def _doubts(statistics: Dataset, topography: Topography) -> Iterator[str]:
    slope, filled = float(statistics["rms_slope"]), float(statistics["filled_share"])
    low, high = PLAUSIBLE_SLOPES
    if not low <= slope <= high:
        lengths = " x ".join(f"{edge:.4g} m" for edge in statistics["size"].values)
        yield (
            f"the rms slope is {slope:.2g}, implausible for a machined surface: the size of "
            f"{lengths} or rms height of {float(statistics['rms_height']):.3g} m in the file is "
            f"wrong; give size or unit"
        )
    if filled > FILLED:
        yield (
            f"{100.0 * filled:.0f} % of the points are undefined; spectrum, Hurst exponent and lay "
            f"are of the filled map"
        )
    if (kurtosis := float(statistics["kurtosis"])) > SPIKED:
        spikes = 0 if topography.spikes else int(np.count_nonzero(find_spikes(topography.heights)))
        removed = (
            f'remove {spikes} spikes by --remove-spikes, or spikes = "remove" in the surface '
            f"table; remove wider dust and holes in the instrument's software"
            if spikes
            else "remove dust and holes wider than spikes in the instrument's software"
        )
        yield (
            f"few points cause most of the rms height, since the kurtosis is {kurtosis:.3g}: "
            f"{removed}, or measure another place"
        )
    if (deviation := float(statistics["fit_deviation"])) > SELF_AFFINE:
        yield (
            f"the spectrum differs by {deviation:.2g} decades from the self-affine fit, so Hurst "
            f"exponent and roll-off are poor descriptions"
        )


def inspection_lines(statistics: Dataset) -> list[str]:
    """Return the lines of an inspected surface for the command line, without its case."""
    lines = [f"{statistics.attrs['title']}: {statistics.attrs['format']}"]
    lines += [f"  channel {channel}" for channel in statistics.attrs["channels"].splitlines()]
    rows = tabulate_statistics(statistics, measured=True)
    width = max(len(name) for name, _ in rows)
    lines += [f"{name:<{width}}  {value}" for name, value in rows]
    lines += ["", statistics.attrs["held"]] * bool(statistics.attrs["held"])
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
    height = readable(f"{float(statistics['rms_height']):.3g} m")
    yield (
        f"The surface has an rms height of {height} and an rms slope of "
        f"{float(statistics['rms_slope']):.3g}; "
        f"reliable wavelengths: {reliable_range(statistics)}."
    )
    yield from filter(None, [statistics.attrs["held"]])


INSPECTION = Shown(
    schema=SURFACE_STATISTICS,
    question="How rough is this surface, and which cells represent it?",
    answer=_answer,
    sections=_sections,
)
