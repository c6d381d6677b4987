"""The main job: from the surfaces of a case to the stiffness of its joint."""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from multiscale.convergence import Status
from multiscale.errors import CaseError, ConvergenceError
from multiscale.io import (
    make_folder,
    open_dataset,
    save_law,
    write_bytes,
    write_dataset,
    write_surface_fields,
)
from multiscale.micro import Cell, contact_modulus, run_ensemble
from multiscale.micro import Path as LoadPath
from multiscale.pipeline.case import load_case
from multiscale.pipeline.cells import composite_material, longest_wave, make_cells
from multiscale.pipeline.joint import joint_scales, solve_joint
from multiscale.pipeline.settings import Case
from multiscale.schema import FIELDS, MACRO_RESULT, MICRO_RESPONSE
from multiscale.upscaling import error_budget, fit_law, with_budget

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Results", "run", "run_micro"]


STEEP = 0.3  # root mean square slope


@dataclass(frozen=True)
class Results:
    """What a run has computed; the datasets follow the schemas of the same names."""

    micro_response: "xr.Dataset"
    interface_law: "xr.Dataset"
    macro_result: "xr.Dataset"


def run_micro(
    case: Case,
    file: Path,
    *,
    executor: Executor | None = None,
    progress: Callable[[int], None] = lambda finished: None,
) -> "xr.Dataset":
    """Solve all cells of a case and write their response; finished cells found are kept.

    Parameters
    ----------
    case : Case
    file : Path
        Gets the response; cells and fields go to the folders ``micro`` and ``fields`` beside it.
    executor : Executor, optional
        See :func:`multiscale.micro.run_ensemble`.
    progress : callable
        Gets the number of finished realisations.

    Returns
    -------
    Dataset
        Follows ``MICRO_RESPONSE``.
    """
    cells, identity = make_cells(case), case.identity()
    response = run_ensemble(
        cells,
        LoadPath(pressure=case.micro.pressures),
        executor=executor,
        folder=file.parent / "micro",
        identity=identity,
        keep_fields=True,
        progress=progress,
    )
    _write_fields(cells[0], file.parent)
    response = response.assign_attrs(
        title=case.title,
        contact_modulus=contact_modulus(composite_material(case)),
        longest_wave=longest_wave(case),
        cell_size=max(case.cell.size),
        bodies="composite surface of body_1 and body_2; 1/E* = sum (1 - nu^2)/E; small slopes",
        identity=identity,
        cautions="\n".join([*case.cautions(), *_steepness(response)]),
    )
    write_dataset(response, file, MICRO_RESPONSE)
    return response


def run(
    case: Case,
    out: str | Path,
    *,
    executor: Executor | None = None,
    progress: Callable[[int], None] = lambda finished: None,
) -> Results:
    """Run the whole chain: cells, response, law, joint.

    Parameters
    ----------
    case : Case
    out : path
        Run folder; made if needed. Finished cells of the same case found there are kept.
    executor : Executor, optional
        See :func:`multiscale.micro.run_ensemble`.
    progress : callable
        Gets the number of finished realisations.

    Returns
    -------
    Results

    Raises
    ------
    MultiscaleError
        If an input is refused, a file cannot be written, or no realisation converged.
    """
    out = make_folder(Path(out))
    _claim(out, case)
    response = run_micro(case, out / "micro_response.nc", executor=executor, progress=progress)

    law = fit_law(response, n_terms=case.law.terms, n_samples=case.law.samples)
    law = with_budget(law, error_budget(response, law, scales=joint_scales(case)))
    save_law(law, out / "interface_law.nc")

    result = solve_joint(case, law)
    write_dataset(result, out / "macro_result.nc", MACRO_RESULT)
    if not result["converged"].values.any():
        raise ConvergenceError(
            f"the joint did not converge at any of {result.sizes['step']} preloads: "
            f"{Status.MAX_ITERATIONS.value}"
        )
    return Results(response, law, result)


def _steepness(response: "xr.Dataset") -> list[str]:
    """Caution against slopes for which one body cannot stand for two."""
    steepest = float(response["rms_slope"].max())
    if steepest <= STEEP:
        return []
    return [
        f"the composite surface has a root mean square slope of {steepest:.2g}; above {STEEP:g} "
        f"one elastic body no longer stands for two"
    ]


def _claim(out: Path, case: Case) -> None:
    """Write the case into its run folder, unless the folder belongs to another one."""
    file = out / "case.toml"
    if file.exists():
        other = load_case(file)
        if other.identity() != case.identity():
            raise CaseError(
                f"{out} holds another run, {other.title!r} with {other.cell.points[0]} x "
                f"{other.cell.points[1]} points; choose another folder, or delete this one"
            )
    write_bytes(file, case.to_toml().encode())


def _write_fields(cell: Cell, out: Path) -> None:
    """Write the surface fields of realisation 0, as dataset and for ParaView."""
    local = open_dataset(out / "micro" / "realisation-0000.nc", MICRO_RESPONSE).isel(realisation=0)
    fields = FIELDS.build(
        {
            "height": cell.surface.heights.T,
            "pressure": local["pressure"].values,
            "gap": local["gap"].values,
            "nominal_pressure": local["nominal_pressure"].values,
        },
        size_x=cell.surface.size[0],
        size_y=cell.surface.size[1],
    )
    folder = make_folder(out / "fields")
    write_dataset(fields, folder / "fields.nc", FIELDS)
    write_surface_fields(fields, cell.surface.size, folder)
