"""Scenes of elastic bodies: a plate that is cut, and bodies with rough joints."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.io import open_law
from multiscale.laws import Damaged, Frictional, NormalLaw
from multiscale.laws.bulk import Elastic
from multiscale.macro import Body, cut_bodies, solve_latin
from multiscale.macro.continuum import box_mesh
from multiscale.macro.substructures import (
    JointLoading,
    LapShape,
    RoughAssembly,
    Team,
    lap_joint,
    load_joint,
    split_boxes,
    stacked_blocks,
)
from multiscale.pipeline.body_budget import with_joint_budget
from multiscale.pipeline.body_settings import (
    JointLawSettings,
    LapJoint,
    Plate,
    StackedBlocks,
    Substructures,
)
from multiscale.upscaling import law_from_dataset

if TYPE_CHECKING:
    import xarray as xr

    from multiscale.pipeline.scene_settings import Scene

__all__ = ["make_assembly", "solve_bodies"]


def solve_bodies(scene: "Scene", law: Path | None, team: Team | None = None) -> "xr.Dataset":
    """Solve a scene of elastic bodies.

    Parameters
    ----------
    scene : Scene
    law : Path, optional
        Law of the joints, instead of the one that the scene names.
    team : Team, optional
        Processes that share the substructures.

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``.

    Raises
    ------
    MultiscaleError
        If dimensions, cut or law are refused, or there is no law.
    """
    cut = scene.substructures or Substructures()
    options: dict[str, Any] = {
        "coarse": cut.coarse,
        "tolerance": cut.tolerance,
        "max_iterations": cut.max_iterations,
        "team": team,
    }
    if isinstance(scene.structure, Plate):
        plate = _make_plate(scene.structure)
        problem = cut_bodies([plate], [split_boxes(plate, (*cut.parts, 1))])
        factors = np.array(scene.statics.load_factors) if scene.statics else 1.0
        return solve_latin(problem, factors, **options)
    assert scene.loading is not None  # the scene has been validated
    given, dataset = scene.loading, _open_law(scene, law)
    loading = JointLoading(given.preloads, given.shear or 0.0, given.cycles, given.steps)
    assembly = make_assembly(scene, law_from_dataset(dataset))
    result = load_joint(assembly, loading, parts=cut.parts, **options)
    if "error_half_width" not in dataset or not result["converged"].values.all():
        return result

    def stiffness(normal: NormalLaw, structure: StackedBlocks | LapJoint | None = None) -> Any:
        changed = scene.model_copy(update={"structure": structure or scene.structure})
        pressed = load_joint(
            make_assembly(changed, normal),
            JointLoading(given.preloads),
            parts=cut.parts,
            **options,
        )
        return pressed["joint_stiffness"].to_numpy()

    assert isinstance(scene.structure, StackedBlocks | LapJoint)
    return with_joint_budget(result, dataset, stiffness, scene.structure.coarser())


def make_assembly(scene: "Scene", normal: NormalLaw) -> RoughAssembly:
    """Build the bodies and joints of a scene, whose sound joints have a normal law."""
    given, joint = scene.structure, scene.joint
    assert isinstance(given, StackedBlocks | LapJoint)
    assert joint is not None
    laws = _laws(joint, given.joints, normal)
    damage = given.damage or (0.0,) * (given.joints + 1)
    materials = [Elastic((1.0 - D) * given.youngs_modulus, given.poissons_ratio) for D in damage]
    if isinstance(given, StackedBlocks):
        return stacked_blocks(given.size, given.elements, materials, laws)
    names = ("length", "width", "thickness", "overlap", "hole", "washer", "element", "layers")
    shape = LapShape(**{name: getattr(given, name) for name in names})
    return lap_joint(shape, (materials[0], materials[1]), laws[0])


def _open_law(scene: "Scene", law: Path | None) -> "xr.Dataset":
    """Open the law that is given or that the scene names."""
    path = law or (scene.joint.law if scene.joint else None)
    if path is None:
        raise CaseError(
            "the scene has joints but no law: name a file by [joint] law or by --law, such as the "
            "interface_law.nc of a run"
        )
    return open_law(path)


def _laws(joint: JointLawSettings, count: int, sound: NormalLaw) -> list[Frictional]:
    """Law of every joint: the fitted one, less its damage, with friction."""
    return [
        Frictional(Damaged(sound, D) if D else sound, joint.friction, joint.stiffness_ratio)
        for D in joint.damage or (0.0,) * count
    ]


def _make_plate(given: Plate) -> Body:
    """Clamp a plate and load it."""
    clamped = (0.0, 0.0, 0.0)
    return Body(
        box_mesh(given.size, given.elements),
        Elastic(given.youngs_modulus, given.poissons_ratio),
        supports={"left": clamped, "right": clamped},
        tractions={"top": (0.0, 0.0, -given.pressure)},
    )
