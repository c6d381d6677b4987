"""One path on one cell: from geometry to averaged response."""

import logging
import sys
from collections.abc import Callable
from functools import lru_cache, partial, singledispatch
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.convergence import Status, check_limits
from multiscale.errors import CaseError
from multiscale.micro.cell import AnyCell, FiniteCell, FlatCell, GraphCell, MeshCell
from multiscale.micro.checkpoint import Checkpoint
from multiscale.micro.contact_state import CellProblem, ContactState, average_contact
from multiscale.micro.path import Path
from multiscale.schema import MICRO_RESPONSE, Dataset, PlainDataset

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

__all__ = ["SPOTS", "record_cell", "solve_cell"]

logger = logging.getLogger(__name__)

_EXTRA = ("slip_fraction", "friction_work", "flowing_fraction", "increments")

SPOTS = {"spot_area": (), "spot_traction": (3,), "spot_traction_by_normal": (3,)}

Steps = list[dict[str, Any]]


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
    """Press a cell along a path and average what its surface carries.

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
        Keep what the gap lets through along x and y, as ``hydraulic_aperture`` and
        ``percolating_share``; see :func:`~.gap_flow.gap_flow`.
    recover_stress : bool
        Also integrate the averages from the recovered Cauchy stress: a check of the averages from
        contact forces, and as dear as the contact itself. Flat and finite cells do without.
    tolerance : float, tolerance of the contact solver, relative to the norm of the contact forces
    checkpoint : Checkpoint, optional
        Gets the steps that took long as they are finished; those found there are not solved again.

    Returns
    -------
    Dataset
        Follows ``MICRO_RESPONSE``, with one realisation. A step that did not converge is ``NaN``
        with ``converged`` 0, and the attribute ``ended`` says why. Later steps are still tried if
        the body has no memory; with friction, at large strain or sliding the path ends there.

    Raises
    ------
    CaseError
        If the cell cannot be meshed, or is asked for what its kind does not have.
    """
    check_limits(tolerance)
    record = record_cell(
        cell,
        path,
        keep_fields=keep_fields,
        keep_spots=keep_spots,
        keep_flow=keep_flow,
        recover_stress=recover_stress,
        tolerance=tolerance,
        checkpoint=checkpoint,
    )
    return MICRO_RESPONSE.build(record.values, **record.attributes)


def record_cell(
    cell: AnyCell,
    path: Path,
    *,
    keep_fields: bool = False,
    keep_spots: bool = False,
    keep_flow: bool = False,
    recover_stress: bool = False,
    tolerance: float = 1e-8,
    checkpoint: Checkpoint | None = None,
) -> PlainDataset:
    """Return the arrays and attributes of which :func:`solve_cell` makes a dataset."""
    check_limits(tolerance)
    shapes: dict[str, tuple[int, ...]] = {}
    if recover_stress and cell.recovers_stress:
        shapes["recovered_traction"] = (3,)
    if keep_fields:
        if cell.field_shape is None:
            raise CaseError(
                "keep_fields keeps values on a grid, and this general mesh has none; give the cell "
                "points, or leave it out"
            )
        shapes |= dict.fromkeys(("pressure", "gap"), cell.field_shape[::-1])
    if keep_flow:
        if cell.grid_spacing is None:
            raise CaseError(
                "keep_flow lets a liquid through the gap of a surface, and this general mesh has "
                "none; leave it out"
            )
        shapes |= dict.fromkeys(("hydraulic_aperture", "percolating_share"), (2,))
    for caution in cell.cautions():
        logger.warning("caution: %s", caution)
    # threads of linear algebra would wait for the kernels' and spin
    with _libraries(len(sys.modules)).limit(limits=1, user_api="blas"):
        follow = _follower(cell, path, recover_stress)
        kept = {"fields": keep_fields or keep_flow, "spots": keep_spots}
        steps = follow(path, **kept, tolerance=tolerance, checkpoint=checkpoint)
    if keep_spots:
        _pad_spots(steps)
    if keep_flow:
        steps = [step | _let_through(step, cell.grid_spacing) for step in steps]
    return _record(steps, path, shapes)


@lru_cache(maxsize=1)
def _libraries(modules: int) -> "ThreadpoolController":
    """Find the libraries with threads, anew after imports: it takes as long as a small cell."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


@singledispatch
def _follower(cell: AnyCell, path: Path, recover_stress: bool) -> Callable[..., Steps]:
    """Set up a cell and return what follows a path with it."""
    raise TypeError(f"{type(cell).__name__} is no kind of cell")


@_follower.register
def _(cell: FlatCell, path: Path, recover_stress: bool) -> Callable[..., Steps]:
    from multiscale.micro.flat_cell import assemble_flat_cell

    _check_still(path)
    return partial(_press, assemble_flat_cell(cell))


@_follower.register
def _(cell: GraphCell, path: Path, recover_stress: bool) -> Callable[..., Steps]:
    if path.slide is not None:  # normals turn as the obstacle passes
        fields = cell.surface, cell.depth, cell.layers, cell.law, cell.obstacle
        moving = FiniteCell(*fields, coating=cell.coating)
        return _follower(moving, path, recover_stress)
    from multiscale.micro.graph_cell import assemble_graph_cell

    _check_still(path)
    return partial(_press, assemble_graph_cell(cell, recover_stress=recover_stress))


@_follower.register
def _(cell: MeshCell, path: Path, recover_stress: bool) -> Callable[..., Steps]:
    from multiscale.micro.mesh.mesh_problem import assemble_mesh_cell

    if cell.remembers:
        from multiscale.micro.mesh.mesh_history import follow_mesh_path

        return partial(follow_mesh_path, cell)
    _check_still(path)
    return partial(_press, assemble_mesh_cell(cell, recover_stress=recover_stress))


@_follower.register
def _(cell: FiniteCell, path: Path, recover_stress: bool) -> Callable[..., Steps]:
    from multiscale.micro.finite.finite_path import follow_path

    return partial(follow_path, cell)


def _check_still(path: Path) -> None:
    """Refuse slide and time for a cell whose answer has no history."""
    if path.slide is not None or path.time is not None:
        raise CaseError(
            "a linear elastic body has no time, and slides neither as a flat cell nor on a mesh "
            "without friction; leave out slide and time"
        )


def _press(
    problem: CellProblem,
    path: Path,
    *,
    fields: bool,
    spots: bool,
    tolerance: float,
    checkpoint: Checkpoint | None,
) -> Steps:
    """Press a linear elastic body: each step is solved, from the state of the one before."""
    state: ContactState | None = None
    steps: Steps = []
    if checkpoint is not None:
        steps, state = checkpoint.found(ContactState)
    for k in range(len(steps), len(path)):
        begin = perf_counter()
        found = problem.solve(
            load=None if path.pressure is None else path.pressure[k] * problem.nominal_area,
            approach=None if path.approach is None else path.approach[k],
            start=state,
            tolerance=tolerance,
        )
        converged = found.status is Status.CONVERGED
        state = found if converged else state
        step = average_contact(problem, found, fields=fields, spots=spots) if converged else {}
        steps.append(
            step
            | {
                "converged": int(converged),
                "active_set_iterations": len(found.residuals),
                "linear_iterations": found.linear_iterations,
                "wall_time": perf_counter() - begin,
            }
        )
        if not converged:
            steps[-1]["ended"] = (
                f"step {k} ended after {len(found.residuals)} active sets and "
                f"{found.linear_iterations} linear iterations: {found.status.value}"
            )
            logger.warning("%s", steps[-1]["ended"])
        if checkpoint is not None:
            checkpoint.keep(steps, state)
        logger.info(
            "step %d: %s, %d active sets, %d linear iterations",
            k,
            found.status.value,
            len(found.residuals),
            found.linear_iterations,
        )
    return steps


def _let_through(step: dict[str, Any], spacing: tuple[float, float] | None) -> dict[str, Any]:
    """Return what the gap of a step lets through along x and y; nothing if the step failed."""
    if "gap" not in step or spacing is None:
        return {}
    from multiscale.micro.gap_flow import gap_flow, open_gap

    free = open_gap(step["gap"].T, step["pressure"].T)
    flows = [gap_flow(free, spacing, axis) for axis in (0, 1)]
    return {
        "hydraulic_aperture": [one.aperture for one in flows],
        "percolating_share": [one.share for one in flows],
    }


def _pad_spots(steps: Steps) -> None:
    """Give the spots of all steps one number of rows; rows without a spot are NaN."""
    most = max((len(step["spot_area"]) for step in steps if "spot_area" in step), default=0)
    for name, shape in SPOTS.items():
        for step in steps:
            padded = np.full((most, *shape), np.nan)
            found = step.get(name, padded[:0])
            padded[: len(found)] = found
            step[name] = padded


def _record(steps: Steps, path: Path, asked: dict[str, tuple[int, ...]]) -> PlainDataset:
    """Join the steps with the fields asked for beside; values that a failed step lacks are NaN."""
    shapes: dict[str, tuple[int, ...]] = {"traction": (3,), "displacement_jump": (3,)}
    shapes |= dict.fromkeys(("mean_gap", "contact_fraction"), ()) | asked
    known = {name for step in steps for name in step}
    shapes |= {name: () for name in _EXTRA if name in known}
    shapes |= {name: (3,) for name in ("traction_by_normal",) if name in known}
    shapes |= {name: np.shape(steps[0][name]) for name in SPOTS if name in known}
    values: dict[str, Any] = {
        name: np.array([step.get(name, np.full(shape, np.nan)) for step in steps])[None]
        for name, shape in shapes.items()
    }
    for name in ("converged", "active_set_iterations", "linear_iterations", "wall_time"):
        values[name] = np.array([step[name] for step in steps])[None]
    values["branch"] = path.branch
    if path.pressure is not None:
        values["nominal_pressure"] = np.array(path.pressure)
    if path.time is not None:
        values["time"] = np.array(path.time)
    ended = "; ".join(str(step["ended"]) for step in steps if "ended" in step)
    return PlainDataset(values, {"ended": ended} if ended else {})
