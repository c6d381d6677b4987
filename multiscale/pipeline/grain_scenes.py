"""Scenes of grains: from what a file says to a dataset."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from multiscale.io import make_folder, write_dataset, write_grain_fields
from multiscale.macro import granulate
from multiscale.macro.granulate import ContactLaw, Model, Solver
from multiscale.pipeline.grain_settings import (
    Biaxial,
    ColumnCollapse,
    Deposit,
    GrainScene,
    Motion,
    Silo,
)
from multiscale.schema import GRANULATE

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["make_granulate", "run_grain_scene"]


def make_granulate(scene: GrainScene) -> Model:
    """Build the grains and walls of a scene.

    Parameters
    ----------
    scene : GrainScene

    Returns
    -------
    Model
        At the beginning of the motion that the scene asks for: the column of a collapse has
        settled, and the grains of a shear cell or of a biaxial test are pressed.

    Raises
    ------
    CaseError
        If the grains do not fit.
    ConvergenceError
        If the grains of a biaxial test do not come to rest under their pressure.
    """
    given, grains = scene.structure, scene.grains
    law = ContactLaw(grains.friction, grains.restitution, grains.compliance)
    radii = granulate.draw_radii(grains.number, *grains.radius, seed=grains.seed)
    options: Any = {"density": grains.density, "seed": grains.seed}
    if isinstance(given, Deposit):
        return granulate.deposit(radii, given.size, law, **options)
    if isinstance(given, Silo):
        return granulate.silo(
            radii,
            given.diameter,
            law,
            wall_friction=given.wall_friction,
            sinking=given.sinking,
            **options,
        )
    if isinstance(given, ColumnCollapse):
        model = granulate.column(radii, given.width, law, **options)
        step = scene.motion.step
        still = granulate.simulate_grains(model, given.settling, step, solver=_solver(scene.motion))
        return granulate.release(model, granulate.final_grains(model, still))
    if isinstance(given, Biaxial):
        return granulate.biaxial_cell(
            radii, given.pressure, given.strain_rate, law, planar=given.planar, **options
        )[0]
    return granulate.shear_layer(radii, given.size, given.pressure, given.speed, law, **options)[0]


def run_grain_scene(scene: GrainScene, out: str | Path) -> "xr.Dataset":
    """Follow the grains of a scene; write the result and, in ``fields``, a series for ParaView.

    Parameters
    ----------
    scene : GrainScene
    out : path
        Dataset to write; its folder is made if needed.

    Returns
    -------
    Dataset
        Follows ``GRANULATE``. The attribute ``cautions`` counts steps that missed the tolerance.

    Raises
    ------
    CaseError
        If the grains do not fit.
    """
    out, motion = Path(out), scene.motion
    model = make_granulate(scene)
    result = granulate.simulate_grains(
        model,
        motion.duration,
        motion.step,
        accuracy=motion.accuracy,
        solver=_solver(motion),
        n_frames=motion.frames,
    ).assign_attrs(title=scene.title, scene=scene.to_toml())
    make_folder(out.parent)
    write_dataset(result, out, GRANULATE)
    write_grain_fields(result, make_folder(out.parent / "fields"), name=out.stem)
    return result


def _solver(motion: Motion) -> Solver:
    """Return how the contacts are solved."""
    return Solver(motion.tolerance, motion.max_iterations, motion.threads)
