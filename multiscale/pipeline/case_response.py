"""The cells of a case: solved, and kept in a folder."""

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.io import make_folder, open_dataset, write_dataset, write_surface_fields
from multiscale.micro import Path as LoadPath
from multiscale.micro import contact_modulus, run_ensemble
from multiscale.pipeline.case_cells import (
    composite_material,
    longest_wave,
    measured_cells,
)
from multiscale.pipeline.real_contact import with_real_pressure
from multiscale.pipeline.settings import Case
from multiscale.pipeline.windows import STAGES, Measured
from multiscale.schema import FIELDS, MICRO_RESPONSE
from multiscale.surfaces import Roughness

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["run_micro", "write_fields"]

STEEP = 0.3  # root mean square slope


def run_micro(
    case: Case,
    file: Path,
    *,
    executor: Executor | None = None,
    progress: Callable[[int], None] = lambda finished: None,
    fields: bool = True,
) -> "xr.Dataset":
    """Solve all cells of a case and write their response; finished cells found are kept.

    Parameters
    ----------
    case : Case
    file : Path
        Gets the response; cells go to the folder ``micro`` beside it, fields to ``fields``.
    executor : Executor, optional
        See :func:`multiscale.micro.run_ensemble`.
    progress : callable
        Gets the number of finished realisations.
    fields : bool
        Whether to write the fields of the first realisation beside the file, too.

    Returns
    -------
    Dataset
        Follows ``MICRO_RESPONSE``.
    """
    (cells, measured), identity = measured_cells(case), case.identity()
    response = run_ensemble(
        cells,
        LoadPath(pressure=case.micro.path),
        executor=executor,
        folder=file.parent / "micro",
        identity=identity,
        keep_fields=True,
        progress=progress,
    )
    if case.yield_stress is not None:
        halved = run_ensemble(
            cells[:1],
            LoadPath(pressure=case.micro.path, refinement=2),
            folder=file.parent / "micro-halved-increments",
            identity=identity,
        )
        response = MICRO_RESPONSE.assign(response, increment_errors(response, halved))
    if fields:
        write_fields(case, file.parent, file.parent)
    response = _with_roughness(response, measured).assign_attrs(
        title=case.title,
        contact_modulus=contact_modulus(composite_material(case)),
        longest_wave=longest_wave(case),
        cell_size=max(case.cell.size),
        bodies="composite surface of body_1 and body_2; 1/E* = sum (1 - nu^2)/E; small slopes",
        identity=identity,
        cautions="\n".join(
            [
                *case.cautions(),
                *_steepness(response),
                *_losses(measured),
                *_increments(response),
                *_ended(response),
            ]
        ),
    )
    response = with_real_pressure(case, response)
    write_dataset(response, file, MICRO_RESPONSE)
    return response


def write_fields(case: Case, cells: Path, out: Path) -> None:
    """Write the surface fields of realisation 0, as dataset and for ParaView.

    Parameters
    ----------
    case : Case
    cells : Path
        Folder with the folder ``micro`` of the cells.
    out : Path
        Folder that gets ``fields``.
    """
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


def increment_errors(response: "xr.Dataset", halved: "xr.Dataset") -> dict[str, np.ndarray]:
    """Errors by the increments, relative, from the first realisation with halved ones.

    They are of first order: halving them takes out a half.
    """
    errors = {}
    for name in ("mean_gap", "contact_fraction"):
        one, half = (found[name].to_numpy()[0] for found in (response, halved))
        errors[f"{name}_increment_error"] = 2.0 * (one - half) / half
    return errors


def _increments(response: "xr.Dataset") -> list[str]:
    """Say what the increments leave in cells that flow."""
    names = ("mean_gap_increment_error", "contact_fraction_increment_error")
    if names[0] not in response.variables:
        return []
    gap, area = (100.0 * float(np.abs(response[name]).max()) for name in names)
    return [
        f"the increments of the body that flows leave up to {gap:.2g} % in the mean gap and "
        f"{area:.2g} % in the contact fraction, as halved ones of one realisation tell"
    ]


def _ended(response: "xr.Dataset") -> list[str]:
    """Say which realisations lack steps, and why."""
    return str(response.attrs.get("ended", "")).splitlines()


def _steepness(response: "xr.Dataset") -> list[str]:
    """Caution against slopes for which one body cannot stand for two."""
    steepest = float(response["rms_slope"].max())
    if steepest <= STEEP:
        return []
    return [
        f"the composite surface has a root mean square slope of {steepest:.2g}; above {STEEP:g} "
        f"one elastic body no longer stands for two"
    ]


def _losses(measured: Mapping[str, Measured]) -> list[str]:
    """Caution against what the cells lack of the measured bodies."""
    return [f"{name}: {caution}" for name, one in measured.items() for caution in one.cautions]


def _with_roughness(response: "xr.Dataset", measured: Mapping[str, Measured]) -> "xr.Dataset":
    """Add the roughness of measured bodies from map to cell, and the filled share of windows."""
    if not measured:
        return response
    records = list(measured.values())
    values = {
        f"body_{name}": [[getattr(stage, name) for stage in one.stages] for one in records]
        for name in Roughness.__annotations__
    }
    filled = {
        "map_filled_share": [one.map_filled for one in records],
        "filled_share": [one.filled for one in records],
    }
    return (
        MICRO_RESPONSE.assign(response, values | filled)
        .assign_coords(body=list(measured), stage=list(STAGES))
        .assign_attrs({f"cutoff_{name}": one.cutoff for name, one in measured.items()})
    )
