"""Stage: the cells of two rough bodies, pressed together."""

from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path

import numpy as np

from multiscale.errors import CaseError
from multiscale.io import make_folder, open_dataset, write_dataset
from multiscale.io.fields import write_surface_fields
from multiscale.micro import FlatCell, contact_modulus, run_ensemble
from multiscale.micro import Path as LoadPath
from multiscale.needs import Choice, Needs
from multiscale.pipeline import case_cells
from multiscale.pipeline.measured_sides import STAGES, Measured
from multiscale.pipeline.plans.case_knobs import cell_knobs
from multiscale.pipeline.real_contact import with_real_pressure
from multiscale.pipeline.showing import Table
from multiscale.pipeline.stage import (
    Datasets,
    Job,
    Section,
    ShowProgress,
    Stage,
    unseen,
)
from multiscale.pipeline.surface_rows import tabulate_statistics
from multiscale.pipeline.tables.settings import Case
from multiscale.plotting import surface_figures
from multiscale.plotting.figure import on_axes
from multiscale.schema import FIELDS, MACRO_RESULT, MICRO_RESPONSE, Dataset
from multiscale.surfaces import Roughness, describe_surface, spectrum
from multiscale.surfaces.surface import Surface

COMPOSITE = "heights and compliances of both bodies, added up, at small slopes"
MESHED = "mesh against a rigid flat, each volume with the compliance of both bodies"
MESH_CAUTION = (
    "each volume of the mesh has the compliances of both bodies, against a rigid flat: this is "
    "exact if body_2 is much stiffer, or has the moduli of the mesh at every depth"
)

STEEP = 0.3  # root mean square slope
MAP = (4.7, 4.0)  # width and height of a figure of a square map with its colour bar, inches
SLOPE_OF_PAIR = 8.0  # error of the second order over its change times the slope; 6 to 11 measured

MEASURED = Table(
    (
        "place",
        "body_rms_height",
        "body_rms_slope",
        "body_longest_wave",
        "body_shortest_wave",
        "filled",
    ),
    along=("body", "stage"),
)


def run_micro(
    case: Case,
    file: Path,
    *,
    executor: Executor | None = None,
    progress: ShowProgress = unseen,
    fields: bool = True,
) -> Dataset:
    """Solve all cells of a case and write their response; finished cells are not solved again.

    Parameters
    ----------
    file : Path, response; cells and fields go to the folders ``micro`` and ``fields`` next to it
    executor, progress
        As of :func:`~multiscale.pipeline.run`.
    fields : bool, whether to write the fields of the first realisation, too

    Returns
    -------
    Dataset, follows ``MICRO_RESPONSE``
    """
    response = _press(case, Job(file.parent, executor, progress))
    if fields:
        write_fields(case, file.parent, file.parent)
    write_dataset(response, file, MICRO_RESPONSE)
    return response


def _run(case: Case, datasets: Datasets, job: Job) -> Dataset:
    response = _press(case, job)
    if not job.sparing:
        write_fields(case, job.out, job.out)
    return response


def _press(case: Case, job: Job) -> Dataset:
    (cells, measured), identity = case_cells.measured_cells(case), case.identity()
    response = run_ensemble(
        cells,
        LoadPath(pressure=case.micro.path),
        keep_fields=not job.sparing,
        keep_spots=case.micro.spots,
        keep_flow=case.micro.leakage,
        **job.ensemble("micro", identity, len(cells), "realisations"),
    )
    if case.yield_stress is not None:
        halved = run_ensemble(
            cells[:1],
            LoadPath(pressure=case.micro.path, refinement=2),
            folder=job.out / "micro-halved-increments",
            sparing=job.sparing,
            identity=identity,
        )
        response = MICRO_RESPONSE.assign(response, increment_errors(response, halved))
    if case.cell.mesh is None:
        pair, folder = case_cells.flat_bodies(case), job.out / "micro-slope-order"
        composite = None if isinstance(cells[0], FlatCell) else case_cells.flat_composite(case)
        response = with_slope_errors(
            response, pair, folder, identity, composite, sparing=job.sparing
        )
    beyond = "one elastic body no longer represents two"
    of_mesh = case.cell.mesh is not None
    cautions = [
        *case.cautions(),
        *case_cells.coating_caution(case),
        *([MESH_CAUTION] if of_mesh else caution_steep(response, "composite surface", beyond)),
        *_missing_roughness(measured),
        *_increments(response),
        *str(response.attrs.get("ended", "")).splitlines(),
    ]
    response = _with_roughness(response, measured).assign_attrs(
        title=case.title,
        contact_modulus=contact_modulus(case_cells.composite_material(case)),
        surface_modulus=case_cells.surface_modulus(case),
        coatings=" and ".join(f"body_{k}" for k, body in enumerate(case.bodies, 1) if body.coating),
        longest_wave=case_cells.longest_wave(case),
        cell_size=max(case.cell.size),
        bodies=MESHED if of_mesh else COMPOSITE,
        identity=identity,
        cautions="\n".join(cautions),
    )
    return with_real_pressure(case, response)


def write_fields(case: Case, cells: Path, out: Path) -> None:
    """Write the surface fields of realisation 0 in the folder ``cells`` into the folder ``out``."""
    file = cells / "micro" / "realisation-0000.nc"
    local = open_dataset(file, MICRO_RESPONSE).isel(realisation=0)
    fields = FIELDS.build(
        {name: local[name].values for name in ("height", "pressure", "gap", "nominal_pressure")},
        size_x=case.cell.size[0],
        size_y=case.cell.size[1],
    )
    folder = make_folder(out / "fields")
    write_dataset(fields, folder / "fields.nc", FIELDS)
    write_surface_fields(fields, case.cell.size, folder)


def increment_errors(response: Dataset, halved: Dataset) -> dict[str, np.ndarray]:
    """Relative errors of the increments, from a realisation with half of each, to first order."""
    errors = {}
    for name in ("mean_gap", "contact_fraction"):
        full, half = (result[name].to_numpy()[0] for result in (response, halved))
        errors[f"{name}_increment_error"] = 2.0 * (full - half) / half
    return errors


def with_slope_errors(
    response: Dataset,
    pair: FlatCell,
    folder: Path,
    identity: str,
    composite: FlatCell | None = None,
    *,
    sparing: bool = False,
) -> Dataset:
    """Return a response with its errors from slopes, estimated on one of its realisations."""
    # Flat cells, to first and second order: the error of the second is about the difference times
    # the rms slope, twice on a rigid flat and SLOPE_OF_PAIR times between two bodies; of the first
    # it is the difference plus that. Conforming cells: difference of the composite from the pair,
    # of second order.
    names = ("mean_gap", "contact_fraction")
    path = LoadPath(pressure=tuple(response["nominal_pressure"].to_numpy()))
    try:
        first = replace(composite or pair, slope_order=2 if composite else 1)
        solved = [first, replace(pair, slope_order=2)]
    except CaseError as error:
        errors, how = dict.fromkeys(names, np.full(len(path), np.nan)), f"not known: {error}"
    else:
        results = run_ensemble(solved, path, folder=folder, identity=identity, sparing=sparing)
        rest = (SLOPE_OF_PAIR if pair.second else 2.0) * float(response["rms_slope"].max())
        share = rest if pair.slope_order == 2 else 1.0 + rest
        changes = {name: results[name].to_numpy() for name in names}
        errors = {name: share * (taken - best) / best for name, (taken, best) in changes.items()}
        how = "expanded in the slopes in one realisation, without coatings"
        if composite:
            how = f"one body for two in conforming cells, {how}"
    values = {f"{name}_slope_error": error for name, error in errors.items()}
    return MICRO_RESPONSE.assign(response, values).assign_attrs(small_slopes=how)


def _missing_roughness(measured: Mapping[str, Measured]) -> list[str]:
    """Cautions for roughness of measured bodies that the cells lack, relative to both bodies."""
    if len(measured) != 2:
        return [f"{name}: {line}" for name, body in measured.items() for line in body.cautions]
    pairs = zip(measured.items(), list(measured.values())[::-1], strict=True)
    return [
        f"{name}: {line}" for (name, body), other in pairs for line in body.cautions_beside(other)
    ]


def _increments(response: Dataset) -> list[str]:
    """Caution with the errors by the increments in cells with plastic flow."""
    names = ("mean_gap_increment_error", "contact_fraction_increment_error")
    if names[0] not in response.variables:
        return []
    gap, area = (100.0 * float(np.abs(response[name]).max()) for name in names)
    return [
        f"the pressure increments of the yielding body cause errors of up to {gap:.2g} % in the "
        f"mean gap and {area:.2g} % in the contact fraction, from half increments in one "
        f"realisation"
    ]


def caution_steep(response: Dataset, surface: str, beyond: str) -> list[str]:
    """Caution against a surface with slopes beyond those for which its cells are right."""
    steepest = float(response["rms_slope"].max())
    if steepest <= STEEP:
        return []
    return [
        f"the {surface} has a root mean square slope of {steepest:.2g}; above {STEEP:g} {beyond}"
    ]


def _with_roughness(response: Dataset, measured: Mapping[str, Measured]) -> Dataset:
    """Add the roughness of measured bodies from map to cell, and the filled share of windows."""
    if not measured:
        return response
    records = list(measured.values())
    values = {
        f"body_{name}": [[getattr(stage, name) for stage in body.stages] for body in records]
        for name in Roughness.__annotations__
    }
    filled = {
        "map_filled_share": [body.map_filled for body in records],
        "filled_share": [body.filled for body in records],
    }
    return (
        MICRO_RESPONSE.assign(response, values | filled)
        .assign_coords(body=list(measured), stage=list(STAGES))
        .assign_attrs({f"cutoff_{name}": body.cutoff for name, body in measured.items()})
    )


def _needs(case: Case) -> Needs:
    cell = case_cells.cell_of(case, Surface(np.zeros(case.cell.points), case.cell.size))
    needs = cell.needs()
    reader = ("SurfaceTopography",) if case.from_maps else ()
    nx, ny = case.cell.points
    cells = Choice(
        "cells",
        f"{case.micro.realisations} of {nx} x {ny} points, each under "
        f"{len(case.micro.path)} pressures",
    )
    choices = needs.choices
    if case.micro.leakage:
        flow = "Reynolds' equation on the gap at every pressure, along x and along y"
        choices = (*choices, Choice("leakage", flow))
    if case.micro.shear is not None:
        apart = ("friction", "opposite body")
        choices = tuple(
            replace(choice, why=f"{choice.why}; the sheared cells have it")
            if choice.part in apart and not choice.built
            else choice
            for choice in choices
        )
    steps = len(case.micro.path) * case.micro.realisations
    halved = 2 * len(case.micro.path) if case.yield_stress is not None else 0
    return replace(
        needs,
        fields=("pressure", "gap"),
        seconds=needs.seconds * (steps + halved),
        choices=(cells, *choices),
        libraries=(*needs.libraries, *reader),
    )


def _measured(response: Dataset) -> Iterator[Section]:
    """Show each measured body as map, windows and cells, with the shortest wavelength of cells."""
    if "body" not in response.dims:
        return
    places = [
        [f"{body} {stage}".replace("_", " ") for stage in response["stage"].values]
        for body in response["body"].values
    ]
    filled = [
        [f"{100.0 * float(of_map):.2g}", ", ".join(f"{100.0 * share:.2g}" for share in windows), ""]
        for of_map, windows in zip(
            response["map_filled_share"].values, response["filled_share"].values, strict=True
        )
    ]
    both = ("body", "stage")
    rows = MEASURED.rows(response.assign(place=(both, places), filled=(both, filled)))
    lines = [
        f"The cells of {body} contain wavelengths down to {response.attrs[f'cutoff_{body}']}."
        for body in response["body"].values
    ]
    yield Section("Measured surfaces", (), *rows, remarks=lines)


def count_cells(datasets: Datasets) -> list[tuple[str, str]]:
    """Return rows with the number of steps of the cells that converged, and their time."""
    response = datasets[MICRO_RESPONSE.name]
    converged = response["converged"].values
    return [
        ("cell steps", f"{int((converged == 1).sum())} of {converged.size} converged"),
        ("solver time of the cells", f"{float(response['wall_time'].sum()):.1f} s"),
    ]


def _sections(datasets: Datasets, out: Path) -> Iterator[Section]:
    response, fields = datasets[CELLS.name], open_dataset(out / "fields" / "fields.nc", FIELDS)
    of_cells, pressure = response["nominal_pressure"], fields["nominal_pressure"].to_numpy()
    result = datasets.get(MACRO_RESULT.name)
    preloads = of_cells if result is None else result.get("preload", of_cells)
    asked = float(np.quantile(preloads.values, 0.5, method="higher"))  # the middle preload, Pa
    step = int(np.abs(np.log(pressure / asked)).argmin())
    caption = f"The map shows the first cell under {1e-6 * pressure[step]:.4g} MPa"
    if not np.isclose(pressure[step], asked):
        caption += f", the pressure of the cells that is nearest to {1e-6 * asked:.4g} MPa"
    figures = {
        "surface": on_axes(surface_figures.plot_surface, fields, size=MAP),
        "contact_map": on_axes(surface_figures.plot_contact_map, fields, step=step, size=MAP),
    }
    yield Section("Contact", [f"{caption}."], figures=figures)
    yield from _roughness(fields)
    yield from _measured(response)


def _roughness(fields: Dataset) -> Iterator[Section]:
    """Show statistics and spectrum of the heights of a cell, unless it is smooth."""
    size = (float(fields.attrs["size_x"]), float(fields.attrs["size_y"]))
    surface = Surface(fields["height"].to_numpy().T, size)
    if not np.ptp(surface.heights) > 0.0:
        return
    statistics = describe_surface(surface, waves=spectrum([surface])).assign_attrs(
        points=" x ".join(map(str, surface.heights.shape)), trend="mean"
    )
    yield Section(
        "Surface",
        ["Statistics of the sum of the heights of both bodies, in the first realisation."],
        rows=tabulate_statistics(statistics, measured=False),
        figures={
            "spectral_density": on_axes(
                surface_figures.plot_spectral_density, statistics, measured=False
            ),
            "bearing_curve": on_axes(surface_figures.plot_bearing_curve, statistics),
        },
    )


CELLS: Stage = Stage(
    schema=MICRO_RESPONSE,
    tables=("micro",),
    reads={
        **dict.fromkeys(("title", "elastic", "body_1", "body_2", "cell"), True),
        "micro": {"realisations", "pressures", "seed", "unload", "spots", "leakage"},
    },
    run=_run,
    needs=_needs,
    prepare=case_cells.try_cells,
    again=lambda case: run_ensemble(
        case_cells.measured_cells(case, made=1)[0][:1], LoadPath(pressure=case.micro.path)
    ),
    sections=_sections,
    work=count_cells,
    knobs=cell_knobs,
    folders=("micro", "micro-halved-increments", "micro-slope-order", "adaptive"),
)
