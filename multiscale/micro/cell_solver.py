"""One path on one cell: from geometry to averaged response."""

import logging
import sys
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.convergence import check_limits
from multiscale.errors import CaseError
from multiscale.micro.averages import SPOTS, Keep, pad_spots
from multiscale.micro.cell import AnyCell
from multiscale.micro.path import Path
from multiscale.micro.step_loop import Checkpoint, follow_path
from multiscale.schema import MICRO_RESPONSE, Dataset, PlainDataset

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

__all__ = ["record_cell", "solve_cell"]

logger = logging.getLogger(__name__)


def solve_cell(
    cell: AnyCell,
    path: Path,
    *,
    keep_fields: bool = False,
    keep_spots: bool = False,
    keep_flow: bool = False,
    recover_stress: bool = False,
    tolerance: float = 1e-8,
    checkpoint: Checkpoint | None = None,
) -> Dataset:
    """Follow a path with a cell and average the forces on its surface.

    Parameters
    ----------
    cell : FlatCell, GraphCell, FiniteCell or MeshCell
    path : Path
    keep_fields : bool
        Keep pressure and gap at every surface node, or at the points of a cell on a mesh.
    keep_spots : bool
        Keep area and share in the averages of every contact spot, largest first, as
        ``spot_area``, ``spot_traction`` and ``spot_traction_by_normal``; NaN beyond the last spot.
    keep_flow : bool
        Keep the flow through the gap along x and y, as ``hydraulic_aperture`` and
        ``percolating_share``; see :func:`~.gap_flow.gap_flow`.
    recover_stress : bool
        Also integrate the averages from the recovered Cauchy stress: a check of the averages from
        contact forces, and as dear as the contact itself. Flat and finite cells do without.
    tolerance : float, tolerance of the contact solver, relative to the norm of the contact forces
    checkpoint : Checkpoint, optional
        File for finished steps that took long; steps in the file are not solved again.

    Returns
    -------
    Dataset
        Follows ``MICRO_RESPONSE``, with one realisation. A step that did not converge is ``NaN``
        with ``converged`` 0, and the attribute ``ended`` has the reason. Later steps are still
        tried if the body has no memory; with friction, at large strain or sliding the path ends.

    Raises
    ------
    CaseError
        If the cell cannot be meshed, or its kind has no such fields or flow.
    """
    keep = Keep(keep_fields, keep_spots, keep_flow, recover_stress)
    record = record_cell(cell, path, keep, tolerance=tolerance, checkpoint=checkpoint)
    return MICRO_RESPONSE.build(record.values, **record.attributes)


def record_cell(
    cell: AnyCell,
    path: Path,
    keep: Keep,
    *,
    tolerance: float = 1e-8,
    checkpoint: Checkpoint | None = None,
) -> PlainDataset:
    """Return the arrays and attributes of which :func:`solve_cell` makes a dataset."""
    check_limits(tolerance)
    asked: dict[str, tuple[int, ...]] = {}  # shapes, for steps that fail
    if keep.stress and cell.recovers_stress:
        asked["recovered_traction"] = (3,)
    if keep.fields:
        if cell.field_shape is None:
            raise CaseError(
                "keep_fields keeps values on a grid, and this general mesh has none; give the cell "
                "points, or leave it out"
            )
        asked |= dict.fromkeys(("pressure", "gap"), cell.field_shape[::-1])
    if keep.flow:
        if cell.grid_spacing is None:
            raise CaseError(
                "keep_flow lets a liquid through the gap of a surface, and this general mesh has "
                "none; leave it out"
            )
        asked |= dict.fromkeys(("hydraulic_aperture", "percolating_share"), (2,))
    for caution in cell.cautions():
        logger.warning("caution: %s", caution)
    # threads of linear algebra would spin beside those of the kernels
    with _libraries(len(sys.modules)).limit(limits=1, user_api="blas"):
        steps = follow_path(
            cell.model(path, recover_stress=keep.stress and cell.recovers_stress),
            path,
            keep,
            spacing=cell.grid_spacing,
            tolerance=tolerance,
            checkpoint=checkpoint,
        )
    if keep.spots:
        for name, shape in SPOTS.items():
            spots = pad_spots([step.get(name, np.zeros((0, *shape))) for step in steps], axis=0)
            for step, padded in zip(steps, spots, strict=True):
                step[name] = padded
    return _record(steps, path, asked)


@lru_cache(maxsize=1)
def _libraries(modules: int) -> "ThreadpoolController":
    """Find the libraries with threads, anew after imports: it takes as long as a small cell."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def _record(
    steps: list[dict[str, Any]], path: Path, asked: dict[str, tuple[int, ...]]
) -> PlainDataset:
    """Join the steps; values that a failed step lacks are NaN."""
    shapes: dict[str, tuple[int, ...]] = {"traction": (3,), "displacement_jump": (3,)}
    shapes |= dict.fromkeys(("mean_gap", "contact_fraction"), ()) | asked
    shapes |= {name: np.shape(value) for step in steps for name, value in step.items()}
    ended = "; ".join(str(step["ended"]) for step in steps if "ended" in step)
    shapes.pop("ended", None)
    values: dict[str, Any] = {
        name: np.array([step.get(name, np.full(shape, np.nan)) for step in steps])[None]
        for name, shape in shapes.items()
    }
    values["branch"] = path.branch
    if path.pressure is not None:
        values["nominal_pressure"] = np.array(path.pressure)
    if path.time is not None:
        values["time"] = np.array(path.time)
    return PlainDataset(values, {"ended": ended} if ended else {})
