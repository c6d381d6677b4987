"""The error budget of bodies with joints, from the sources of error of their laws and meshes."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from multiscale import upscaling
from multiscale.fe.faces import plane_axes
from multiscale.macro.data_range import LOAD_SHARES, NEGLIGIBLE_LOAD
from multiscale.pipeline.body_sources import Change, ErrorSources, JointsOfLaw
from multiscale.pipeline.real_contact import contact_source
from multiscale.pipeline.stage import Job
from multiscale.schema import Dataset, with_cautions
from multiscale.upscaling.budget import FEW_CELLS, MACRO, Term, how_attribute, known_terms
from multiscale.upscaling.propagation import FEWEST_SAMPLES, FIRST_ORDER
from multiscale.upscaling.sampling import half_range
from multiscale.upscaling.scales import compare_scales, effective_cells, pressure_length_of_points
from multiscale.upscaling.shear_budget import BED, loss_terms

Reader = Callable[["Dataset"], np.ndarray]  # maps a result to the values of an answer

FirstOrder = Callable[[Sequence[Change]], Mapping[str, np.ndarray]]
"""Maps changes to relative changes of answers at rest, shape (changes, preloads), by the tangents
of the path without changes."""

JointSolve = Callable[[Change], "Dataset"]
"""Maps a change to the result at the preloads and, if joints slip, in cycles of few steps; workers
must be able to import it."""

UNKNOWN_LOSS = (
    "the error of the loss of a cycle is not known, since no cells of the law went through closed "
    "cycles; shear cells by [micro.shear]"
)
NO_MESH = (
    "not known: no structure was solved with elements of twice the size; give smaller elements, or "
    "an even number, in [structure], or a coarser mesh of every body"
)

AT_POINTS = ("traction", "point_area", "point_joint", "point_position")
"""Variables of a result at the points of its joints."""


@dataclass(frozen=True, eq=False)
class CycleAnswers:
    """Answers of closed cycles that have an error budget."""

    read: Mapping[str, Reader]  # by the name of an answer, its values in every cycle
    slip: str  # name of the share of the load that slips
    loss: str  # name of the dissipated energy
    steps: np.ndarray  # (cycles,), steps of the result with the pressure of each cycle
    slope: np.ndarray  # (cycles,), logarithmic, of the slipping share over the amplitude
    density: np.ndarray  # (cycles, points), dissipated energy, J/m²
    finer: float  # load steps of a cycle over the steps of paths that are solved again
    part: np.ndarray | float = 1.0  # (cycles,), of the loss, by the joints


@dataclass(frozen=True, eq=False)
class JointAnswers:
    """Answers of joints that have an error budget, and their steps: at rest, then in cycles."""

    read: Mapping[str, Reader]  # by the name of an answer at rest, its values over the steps
    real: Mapping[str, tuple[int, ...]]  # joints of which an answer is the real pressure
    rests: np.ndarray  # steps of these answers
    place: Callable[[Dataset, Dataset], Dataset]  # adds a budget of rests, then cycles, to a result
    cycles: CycleAnswers | None = None
    first_order: FirstOrder | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all answers, the rows of the budget."""
        return (*self.read, *(self.cycles.read if self.cycles else ()))

    @property
    def steps(self) -> np.ndarray:
        """Steps of the result with the pressure of each column of the budget."""
        return np.append(self.rests, self.cycles.steps) if self.cycles else self.rests

    def values(self, result: Dataset) -> np.ndarray:
        """Return the answers of a result, shape (answers, columns); NaN for zeros."""
        in_cycles = self.cycles.read if self.cycles else {}
        rows = np.full((len(self.names), self.steps.size), np.nan)
        for row, read in zip(rows, self.read.values(), strict=False):
            row[: self.rests.size] = read(result)[self.rests]
        for row, read in zip(rows[len(self.read) :], in_cycles.values(), strict=True):
            row[self.rests.size :] = read(result)
        rows[rows == 0.0] = np.nan  # no error is relative to zero
        return rows

    def in_cycles(self, values: np.ndarray | float, name: str = "") -> np.ndarray:
        """Spread values of cycles over the columns, (columns,), or over the budget of an answer."""
        columns = np.zeros(self.steps.size)
        columns[self.rests.size :] = values
        return np.where(np.array(self.names)[:, None] == name, columns, 0.0) if name else columns


def answer_at(name: str, *place: slice | int | np.ndarray) -> Reader:
    """Return a reader of an answer at a place, or of all values."""
    return partial(_read, name, place)


def _read(name: str, place: tuple[Any, ...], result: Dataset) -> np.ndarray:
    """Values of an answer; the real pressure stays as it is."""
    if name == "real_pressure":
        return np.ones(result.sizes["step"])
    return np.asarray(result[name].to_numpy()[place])


def with_joint_budget(
    result: Dataset,
    sources: ErrorSources,
    solve: JointSolve,
    asked: JointAnswers,
    job: Job,
) -> Dataset:
    """Return the result of rough joints with error budget and intervals of their answers."""
    begin = perf_counter()
    result = with_cautions(result, *sources.unknown)
    known = result["known"].to_numpy() == 1
    asked = replace(asked, rests=asked.rests[known[asked.rests]])
    if not asked.rests.size:
        return result
    value, listed = asked.values(result), list[upscaling.Source]()
    for joints in sources.laws:
        of_law, cautions = _of_law(joints, result, asked, value)
        listed += of_law
        result = with_cautions(result, *cautions)
    listed += [*sources.stated, *_of_settings(sources, asked, value)]
    budget = upscaling.propagate(
        asked.names,
        listed,
        solve,
        value if asked.cycles is None else None,
        base=Change(),
        read=asked.values,
        executor=job.executor,
        progress=lambda done, total: job.progress(done, total, "solves for the intervals"),
    )
    return asked.place(result, budget).assign_attrs(interval_seconds=perf_counter() - begin)


def _of_settings(
    sources: ErrorSources, asked: JointAnswers, value: np.ndarray
) -> Iterator[upscaling.Source]:
    """Yield the errors of mesh, beds of sliders and load steps."""
    if sources.meshes:
        changes = [Change(structure=structure) for structure in sources.meshes.values()]
        yield upscaling.Knob(name="mesh", ratios=[*sources.meshes], changes=changes)
    else:
        yield upscaling.Bound(name="mesh", bounds={MACRO: Term(NO_MESH)})
    if asked.cycles is None:
        return
    if sources.beds:
        # the change contains the error of the loss in about 96 % of cycles in which 8 or more slabs
        # slip, in 83-88 % of those with 2 to 8, and in half or less with fewer, by a closed form of
        # an exponential law; the change can cross zero, more often at uniform pressure
        fewer, how = Change(sources.beds, coarse_bed=True), "beds of half of the slabs"
        term = MACRO if sources.meshes else BED  # unknown meshes leave their term unknown
        share = asked.in_cycles(1.0)
        yield upscaling.Knob(name="slabs", changes=[fewer], term=term, share=share, how=how)
    if sources.meshes:
        finer = asked.cycles.finer
        richardson = 1.0 / (finer**2 - 1.0) if finer > 1.0 else np.nan
        share = asked.in_cycles(richardson)
        yield upscaling.Knob(name="load steps", answers=[value], share=share)


def _of_law(
    group: JointsOfLaw, result: Dataset, asked: JointAnswers, value: np.ndarray
) -> tuple[list[upscaling.Source], list[str]]:
    """Return the sources of error of a law at the pressures of its joints, and cautions."""
    drawn = _draw(group, asked, value)
    points = result[[*AT_POINTS]].isel(step=asked.steps)
    inside = np.isin(points["point_joint"].to_numpy(), group.joints)
    area = points["point_area"].to_numpy()
    pressure = np.maximum(-points["traction"].to_numpy()[..., 0], 0.0)
    force = pressure[:, inside] @ area[inside]
    # mean pressure of the closed points at every step
    closed = (pressure[:, inside] > 0.0) @ area[inside]
    mean = force / np.where(closed > 0.0, closed, np.nan)
    group, cells, cautions = _shared_by_cells(group, points.isel(point=inside), inside, asked)
    law, cycles, listed = group.law, asked.cycles, list[upscaling.Source]()
    # errors from the cycles of the cells, in proportion to the loss of the joints
    bounds: dict[str, Term] = {}
    if cycles is not None:
        cautions += [] if "shear_loss_ratio" in law else [UNKNOWN_LOSS]
        total = cycles.density @ area
        share = cycles.density[:, inside] @ area[inside] / np.where(total > 0.0, total, 1.0)
        lost = asked.in_cycles(share * cycles.part, cycles.loss)
        bounds = {name: _part_of(term, lost) for name, term in loss_terms(law).items()}
        if "shear_loss_grid_error" in law:
            grid = Term("the loss ratio on two grids", law["shear_loss_grid_error"].to_numpy())
            bounds["micro discretisation"] = _part_of(grid, lost)
        listed.append(upscaling.Bound(name="cycles of the cells", of=group.name, bounds=bounds))
        rate = asked.in_cycles(cycles.slope, cycles.slip) * (force / (pressure @ area))
        listed.append(_uneven_slip(law, mean, rate, group.name))
    real = [bool({*asked.real.get(name, ())} & {*group.joints}) for name in asked.names]
    if any(real):
        listed.append(contact_source(law, mean, np.array(real), group.name))
    # the error of the loss by the bed is measured by the cycles of the cells
    below, above = (
        bool((result[name].isel(interface=[*group.joints]) > NEGLIGIBLE_LOAD).any())
        for name in LOAD_SHARES[:2]
    )
    is_loss = np.array([[cycles is not None and name == cycles.loss] for name in asked.names])
    of_bed = dict.fromkeys(bounds.keys() - {"sampling"}, is_loss)
    listed += group.sources(mean, of_bed, drawn, (below, above))
    shared = np.where(is_loss, cells[0], cells[1])
    return [source.averaged(shared) for source in listed], cautions


def _draw(group: JointsOfLaw, asked: JointAnswers, value: np.ndarray) -> list[np.ndarray] | None:
    """Return answers by the samples of a law, (samples, answers, steps), NaN if no tangent does."""
    normals = upscaling.fitted_laws(group.law, range(group.law.sizes.get("sample", 0)))
    if len(normals) < FEWEST_SAMPLES:
        return None
    changes: Mapping[str, np.ndarray] = {}
    if asked.first_order is not None:
        changes = asked.first_order([Change(group.joints, normal) for normal in normals])
    drawn = np.full((len(normals), *value.shape), np.nan)
    for row, name in enumerate(asked.names):
        if name in changes:  # a preload is the step of its number
            changed = changes[name][:, asked.rests]
            near = half_range(changed) < FIRST_ORDER
            changed = value[row, : asked.rests.size] * (1.0 + changed)
            drawn[:, row, : asked.rests.size] = np.where(near, changed, np.nan)
    return list(drawn)


def _shared_by_cells(
    group: JointsOfLaw, points: Dataset, inside: np.ndarray, asked: JointAnswers
) -> tuple[JointsOfLaw, np.ndarray, list[str]]:
    """Count the cells that share loss (row 0) and other answers (row 1), with cautions on scales.

    The law of the joints has the terms of their scales, if it contains the scatter of its cells.
    """
    law, cells = group.law, np.ones((2, asked.steps.size))
    if not ({"longest_wave", "cell_size"} <= set(law.attrs) and "cell_scatter" in law):
        return group, cells, []
    wavelength, cell = float(law.attrs["longest_wave"]), float(law.attrs["cell_size"])
    place, number = points["point_position"].to_numpy(), points["point_joint"].to_numpy()
    area, pressure = points["point_area"].to_numpy(), -points["traction"].to_numpy()[..., 0]
    pressure = np.maximum(pressure, 0.0)
    length, extent = _lengths(place, number, area, pressure[asked.rests.size - 1])
    scales = compare_scales(wavelength, cell, length, extent=extent)
    cells[:] = effective_cells(pressure, area, cell)
    if asked.cycles is not None:
        cells[0, asked.rests.size :] = effective_cells(asked.cycles.density[:, inside], area, cell)
    how = f"scatter of single cells, of which {cells.min():.3g} or more share the answers"
    law = upscaling.with_scales(law, scales).assign_attrs({how_attribute(FEW_CELLS): how})
    return replace(group, law=law), cells * scales.cell_ratio**2, list(scales.cautions)


def _uneven_slip(
    law: Dataset, pressure: np.ndarray, rate: np.ndarray, name: str
) -> upscaling.Source:
    """Return the scatter of stiffness between the cells of one joint as a source of its slip."""
    # a stiffer cell carries more shear and slips more, at most in proportion to its stiffness, and
    # by the logarithmic slope of slip over shear
    half_width = {}
    if FEW_CELLS in known_terms(law):
        few = law["error_half_width"].sel(quantity="stiffness", error_term=FEW_CELLS)
        data = np.log(law["fit_pressure"].to_numpy())
        half_width[FEW_CELLS] = np.interp(np.log(pressure), data, few.to_numpy())
    return upscaling.Uncertainty(name="uneven slip", of=name, half_width=half_width, rate=rate)


def _part_of(term: Term, rows: np.ndarray) -> Term:
    """Multiply a term of single numbers by shares, shape (answers, steps); zero without a share."""
    half, bias = (
        np.where(rows != 0.0, rows * np.asarray(value, dtype=float), 0.0)
        for value in (term.half_width, term.bias)
    )
    return replace(term, half_width=half, bias=bias)


def _lengths(
    place: np.ndarray, number: np.ndarray, area: np.ndarray, pressure: np.ndarray
) -> tuple[float, float]:
    """Least length over which the pressure of a joint varies, at most its edge, and edge, m."""
    lengths, extents = [], []
    for joint in np.unique(number):
        inside = number == joint
        extents.append(float(np.sqrt(area[inside].sum())))
        flat = place[inside] @ plane_axes(place[inside])[1:].T
        varies = pressure_length_of_points(flat, pressure[inside], area[inside])
        lengths.append(min(extents[-1], varies))
    return float(min(lengths)), float(min(extents))
