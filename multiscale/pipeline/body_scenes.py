"""Scenes of elastic bodies: a plate that is cut, and bodies with rough joints."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.fe.boxes import box_mesh
from multiscale.io import open_dataset, open_law
from multiscale.laws import Damaged, NormalLaw, Sliders
from multiscale.laws.bulk import AnisotropicElastic, Elastic
from multiscale.macro import Body, LatinMethod, solve_assembly
from multiscale.macro.bodies import Assembly, LapShape, lap_joint, stacked_blocks
from multiscale.macro.substructures import (
    CutProblem,
    JointLoading,
    Team,
    add_body_fields,
    cut_assembly,
    load_joint,
)
from multiscale.pipeline.body_budget import with_contact, with_joint_budget
from multiscale.pipeline.body_settings import (
    JointLawSettings,
    LapJoint,
    Loading,
    Plate,
    StackedBlocks,
    Substructures,
)
from multiscale.pipeline.stages.joint import STIFFNESSES
from multiscale.schema import RVE_STIFFNESS, with_cautions
from multiscale.upscaling import law_from_dataset

if TYPE_CHECKING:
    import xarray as xr

    from multiscale.pipeline.scene_settings import Scene

__all__ = ["cut_scene", "make_assembly", "solve_bodies"]


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
    given, cut = scene.structure, scene.substructures or Substructures()
    method = LatinMethod(cut.parts, cut.coarse, cut.tolerance, cut.max_iterations, team)
    if isinstance(given, Plate):
        factors = np.array(scene.statics.load_factors) if scene.statics else 1.0
        plate = _make_plate(given)
        return add_body_fields(solve_assembly(plate, factors, method=method), plate.bodies)
    assert isinstance(given, StackedBlocks | LapJoint)
    assert scene.loading is not None  # the scene has been validated
    loads, dataset = scene.loading, _open_law(scene, law)
    loading = JointLoading(loads.preloads, loads.shear or 0.0, loads.cycles, loads.steps)
    assembly = make_assembly(scene, law_from_dataset(dataset))
    extrapolate = scene.joint is not None and scene.joint.extrapolate
    result = load_joint(assembly, loading, method=method, extrapolate=extrapolate)
    result = with_contact(result, dataset)
    of_law = str(dataset.attrs.get("cautions", "")).splitlines()
    result = with_cautions(result, *(f"its law: {one}" for one in of_law))
    if "error_half_width" in dataset:
        solved = int(
            result["converged"][: len(loads.preloads)].sum()
        )  # the first failure is the end

        def stiffness(normal: NormalLaw, structure: StackedBlocks | LapJoint = given) -> Any:
            changed = scene.model_copy(update={"structure": structure})
            pressed = JointLoading(loads.preloads[:solved])
            parts = make_assembly(changed, normal)
            found = load_joint(parts, pressed, method=method, extrapolate=True)
            return np.stack([found[name].to_numpy() for name in STIFFNESSES])

        result = with_joint_budget(result, dataset, stiffness, given.coarser())
    return add_body_fields(result, assembly.bodies, damage=_damage(given))


def cut_scene(scene: "Scene", law: Path | None = None) -> CutProblem:
    """Cut the bodies of a scene; arguments as for :func:`solve_bodies`."""
    cut = scene.substructures or Substructures()
    if isinstance(scene.structure, Plate):
        return cut_assembly(_make_plate(scene.structure), cut.parts)
    return cut_assembly(make_assembly(scene, law_from_dataset(_open_law(scene, law))), cut.parts)


def make_assembly(scene: "Scene", normal: NormalLaw) -> Assembly:
    """Build the bodies and joints of a scene, whose sound joints have a normal law."""
    given, joint, loading = scene.structure, scene.joint, scene.loading
    assert isinstance(given, StackedBlocks | LapJoint)
    assert joint is not None
    assert loading is not None
    laws = _laws(joint, given.joints, normal, loading)
    materials = [_material(given, 1.0 - D) for D in _damage(given)]
    if isinstance(given, StackedBlocks):
        return stacked_blocks(given.size, given.elements, materials, laws)
    names = ("length", "width", "thickness", "overlap", "hole", "washer", "element", "layers")
    shape = LapShape(**{name: getattr(given, name) for name in names})
    return lap_joint(shape, materials, laws[0])


def _material(given: StackedBlocks | LapJoint, share: float) -> Elastic | AnisotropicElastic:
    """Return the elasticity of a block of which damage has left a share."""
    if given.stiffness is None:
        return Elastic(share * given.youngs_modulus, given.poissons_ratio)
    found = open_dataset(given.stiffness, RVE_STIFFNESS)
    return AnisotropicElastic(share * found["stiffness"].values)


def _damage(given: StackedBlocks | LapJoint) -> tuple[float, ...]:
    """Damage of every body."""
    return given.damage or (0.0,) * (given.joints + 1)


def _open_law(scene: "Scene", law: Path | None) -> "xr.Dataset":
    """Open the law that is given or that the scene names."""
    path = law or (scene.joint.law if scene.joint else None)
    if path is None:
        raise CaseError(
            "the scene has joints but no law: name a file by [joint] law or by --law, such as the "
            "interface_law.nc of a run"
        )
    return open_law(path)


def _laws(joint: JointLawSettings, count: int, sound: NormalLaw, loading: Loading) -> list[Sliders]:
    """Law of every joint: the fitted one, less its damage, with friction."""
    return [
        Sliders(
            Damaged(sound, D) if D else sound,
            joint.friction,
            joint.stiffness_ratio,
            pressures=loading.joint_pressures,
            slabs=loading.slabs,
        )
        for D in joint.damage or (0.0,) * count
    ]


def _make_plate(given: Plate) -> Assembly:
    """Clamp a plate and load it."""
    clamped = (0.0, 0.0, 0.0)
    plate = Body(
        box_mesh(given.size, given.elements),
        Elastic(given.youngs_modulus, given.poissons_ratio),
        supports={"left": clamped, "right": clamped},
        tractions={"top": (0.0, 0.0, -given.pressure)},
    )
    return Assembly((plate,))
