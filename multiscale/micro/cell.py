"""Cells of every kind: choice of the kind, and the loop over the steps of a path."""

import logging
import sys
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path as FilePath
from time import perf_counter
from typing import TYPE_CHECKING, Any, Literal
from zipfile import BadZipFile

import numpy as np

from multiscale.convergence import Status, check_limits
from multiscale.errors import CaseError
from multiscale.io.files import make_folder, replacing
from multiscale.laws.bulk import J2, BulkLaw, Elastic, GradedElastic, NeoHookean, Prony
from multiscale.laws.bulk.bulk_law import contact_modulus as contact_modulus
from multiscale.micro.averages import SPOTS, Keep, average_surface, pad_spots
from multiscale.micro.elastic.elastic_cells import FlatCell, GraphCell
from multiscale.micro.finite.finite_cell import FiniteCell
from multiscale.micro.layer import Coating, LayerLaw, SecondBody
from multiscale.micro.mesh.mesh_cell import MeshCell
from multiscale.micro.path import CellModel, Path, State
from multiscale.schema import MICRO_RESPONSE, Dataset, PlainDataset
from multiscale.surfaces import self_affine as self_affine
from multiscale.surfaces.surface import Surface as Surface

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

logger = logging.getLogger(__name__)

GridCell = FlatCell | GraphCell | FiniteCell
AnyCell = GridCell | MeshCell
Steps = list[dict[str, Any]]

WORTH = 2.0
"""Computing time, s, above which a step is stored, and in sparing runs also a realisation and a
dataset; results below it are computed again."""

NONE = np.zeros(0)  # None in a file
NOT_STORED = {"status", "residuals", "linear_iterations"}  # fields that no step starts from


def Cell(  # noqa: N802  reads like the kinds that it builds
    surface: Surface,
    depth: float,
    layers: int,
    youngs_modulus: float | np.ndarray,
    poissons_ratio: float | np.ndarray,
    obstacle: Surface | None = None,
    geometry: Literal["conforming", "flat"] = "conforming",
    hardness: float | None = None,
    bulk: BulkLaw | None = None,
    friction_coefficient: float = 0.0,
    opposite: SecondBody | None = None,
    slope_order: int = 1,
    coating: tuple[Coating, ...] = (),
) -> GridCell:
    """Build the kind of cell that fits the arguments.

    Parameters
    ----------
    surface, depth, layers : see :class:`~multiscale.micro.layer.PeriodicLayer`
    youngs_modulus, poissons_ratio : float or ndarray
        Moduli, Pa and 1: a value for the whole cell, an array of the layers from the base up,
        shape (layers,), or of the elements, shape (nx, layers, ny). For two bodies, a material
        with their contact modulus.
    obstacle, hardness, friction_coefficient : see :class:`FlatCell` and :class:`FiniteCell`
    geometry : {"conforming", "flat"}
        Whether the mesh follows the surface, or the surface only makes the gap above a flat layer.
    bulk : NeoHookean, J2 or Prony, optional
        Law at large strain, with the moduli above; small strain if not given.
    opposite : SecondBody, optional
        Makes the obstacle deformable, as ``second`` of :class:`FlatCell` and :class:`FiniteCell`.
    slope_order : int, see :class:`FlatCell`; other cells are exact in the slope
    coating : tuple of Coating
        Layers of other materials at the top of the first body, outermost first.

    Returns
    -------
    FlatCell, GraphCell or FiniteCell
        A finite cell if there is a law at large strain, friction or a second body.
    """
    moduli = {"youngs_modulus": youngs_modulus, "poissons_ratio": poissons_ratio}
    law: LayerLaw
    if bulk is None:
        graded = bool(np.ndim(youngs_modulus) or np.ndim(poissons_ratio))
        law = GradedElastic(**moduli) if graded else Elastic(*map(float, moduli.values()))
    elif not isinstance(bulk, NeoHookean | J2 | Prony):
        raise CaseError(
            f"a cell takes NeoHookean, J2 or Prony as its law at large strain, got "
            f"{type(bulk).__name__}; leave bulk out for linear elasticity"
        )
    else:
        law = bulk
        for name, value in moduli.items():  # the law has them too
            if not np.all(np.isclose(value, given := getattr(law, name), rtol=1e-12, atol=0.0)):
                raise CaseError(
                    f"{name} of the bulk law is {given:g}, but of the cell "
                    f"{np.ravel(value)[0]:g}; give the same value for the whole cell"
                )
    if geometry not in ("conforming", "flat"):
        raise CaseError(f"geometry must be 'conforming' or 'flat', got {geometry!r}")
    if geometry == "flat":
        if friction_coefficient != 0.0:
            raise CaseError(
                "a flat cell has neither friction nor a law at large strain; use the conforming "
                "geometry"
            )
        flat = obstacle, hardness, slope_order, opposite
        return FlatCell(surface, depth, layers, law, *flat, coating=coating)
    if hardness is not None:
        raise CaseError("a hardness limits the pressure of a flat cell only; use geometry='flat'")
    if slope_order != 1:
        raise CaseError("slope_order belongs to flat cells, as others follow the surface")
    if bulk is None and friction_coefficient == 0.0 and opposite is None:
        return GraphCell(surface, depth, layers, law, obstacle, coating=coating)
    more = obstacle, friction_coefficient, opposite
    return FiniteCell(surface, depth, layers, law, *more, coating=coating)


@dataclass(frozen=True)
class Checkpoint:
    """File of the finished steps of a path and the last state, to resume a killed run."""

    file: FilePath
    identity: str  # checksum of the origin of the cell; steps of other cells are ignored

    def write(self, steps: Steps, state: Any) -> None:
        """Write steps and state, if the last step took longer than :data:`WORTH`."""
        if steps[-1]["wall_time"] < WORTH:
            return
        content: dict[str, Any] = {"identity": self.identity, "count": len(steps)}
        for k, step in enumerate(steps):
            content |= {f"{k}/{name}": value for name, value in step.items()}
        for name in vars(state).keys() - NOT_STORED:
            value = vars(state)[name]
            items: list[Any] = [*enumerate(value)] if isinstance(value, tuple) else [("", value)]
            for k, item in items:
                content[f"state/{name}/{k}"] = NONE if item is None else item
        make_folder(self.file.parent)
        with replacing(self.file) as temporary, temporary.open("wb") as file:
            np.savez(file, allow_pickle=False, **content)

    def read(self, rest: State) -> tuple[Steps, State]:
        """Read steps and state; no steps and ``rest`` without a valid file of this cell."""
        try:
            with np.load(self.file, allow_pickle=False) as archive:
                content = {name: value[()] for name, value in archive.items()}
        except (OSError, ValueError, EOFError, BadZipFile):
            return [], rest
        if content.pop("identity") != self.identity:
            return [], rest
        steps: Steps = [{} for _ in range(content.pop("count"))]
        state: dict[str, Any] = {}
        for key, value in content.items():
            place, name = key.split("/", 1)
            if place == "state":
                name, item = name.split("/")
                array = None if np.size(value) == 0 else value
                state[name] = (*state.get(name, ()), array) if item else array
            else:
                steps[int(place)][name] = value
        last = replace(rest, status=Status.CONVERGED, residuals=(0.0,), **state)
        if np.shape(vars(last)["displacement"]) != np.shape(vars(rest)["displacement"]):
            return [], rest  # written by a version with other unknowns
        return steps, last


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
    keep_fields : bool
        Keep pressure and gap at every surface node, or at the points of a cell on a mesh.
    keep_spots : bool
        Keep area and share in the averages of every contact spot, largest first, as
        ``spot_area``, ``spot_traction`` and ``spot_traction_by_normal``; NaN beyond the last spot.
    keep_flow : bool
        Keep the flow through the gap along x and y, as ``hydraulic_aperture`` and
        ``percolating_share``; see :func:`~.averages.gap_flow`.
    recover_stress : bool
        Also integrate the averages from the recovered Cauchy stress: a check of the averages from
        contact forces, as expensive as the contact itself. Flat and finite cells ignore it.
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
                "keep_fields stores values on a grid, but this general mesh has no grid; give the "
                "cell points, or leave keep_fields out"
            )
        asked |= dict.fromkeys(("pressure", "gap"), cell.field_shape[::-1])
    if keep.flow:
        if cell.grid_spacing is None:
            raise CaseError(
                "keep_flow computes flow through the gap on a grid, but this general mesh has no "
                "grid; leave it out"
            )
        asked |= dict.fromkeys(("hydraulic_aperture", "percolating_share"), (2,))
    for caution in cell.cautions():
        logger.warning("caution: %s", caution)
    # threads of linear algebra would compete with the threads of the kernels
    with _libraries(len(sys.modules)).limit(limits=1, user_api="blas"):
        model = cell.model(path, recover_stress=keep.stress and cell.recovers_stress)
        steps = _follow_path(model, path, keep, cell.grid_spacing, tolerance, checkpoint)
    if keep.spots:
        for name, shape in SPOTS.items():
            spots = pad_spots([step.get(name, np.zeros((0, *shape))) for step in steps], axis=0)
            for step, padded in zip(steps, spots, strict=True):
                step[name] = padded
    return _record(steps, path, asked)


@lru_cache(maxsize=1)
def _libraries(modules: int) -> "ThreadpoolController":
    """List the libraries with threads, again only after imports: as slow as a small cell."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def _follow_path(
    model: CellModel[State],
    path: Path,
    keep: Keep,
    spacing: tuple[float, float] | None,
    tolerance: float,
    checkpoint: Checkpoint | None,
) -> Steps:
    """Solve a path, each step from the state of the previous step; return a dict per step."""
    steps, state = Steps(), model.rest()
    if checkpoint is not None:
        steps, state = checkpoint.read(state)
    for k in range(len(steps), len(path)):
        begin = perf_counter()
        # after a failure a body with memory has no further steps
        if model.remembers and any("ended" in step for step in steps):
            nothing = dict.fromkeys(("converged", "active_set_iterations", "linear_iterations"), 0)
            steps.append({**nothing, "wall_time": 0.0})
            continue
        result = model.step(state, path.target(k, model.area), tolerance)
        state = result.state
        step: dict[str, Any] = {"converged": int(not result.ended), **result.cost}
        if result.ended:
            step["ended"] = f"step {k} ended after {result.ended}"
            logger.warning("%s", step["ended"])
        else:
            step |= average_surface(model.surface(state), keep, spacing)
        steps.append(step | {"wall_time": perf_counter() - begin})
        if checkpoint is not None:
            checkpoint.write(steps, state)
        logger.info("step %d: %s", k, ", ".join(f"{n} {name}" for name, n in result.cost.items()))
    return steps


def _record(
    steps: list[dict[str, Any]], path: Path, asked: dict[str, tuple[int, ...]]
) -> PlainDataset:
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
