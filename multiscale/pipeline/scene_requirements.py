"""What a scene needs, told before anything heavy starts."""

from dataclasses import replace
from importlib.util import find_spec
from math import ceil

from multiscale.macro.discrete.link_needs import link_needs
from multiscale.macro.granulate import ContactLaw, Solver
from multiscale.macro.granulate.grain_needs import grain_needs
from multiscale.macro.substructures.substructure_needs import cut_needs
from multiscale.needs import Needs
from multiscale.pipeline.body_settings import BODIES, LapJoint, Plate, StackedBlocks, Substructures
from multiscale.pipeline.grain_settings import Biaxial, GrainScene, Silo
from multiscale.pipeline.scene_settings import Scene
from multiscale.pipeline.scenes import make_structure

__all__ = ["scene_requirements"]


def scene_requirements(scene: Scene | GrainScene, *, processes: int = 1) -> Needs:
    """Return what a scene needs and what it leaves out.

    Parameters
    ----------
    scene : Scene or GrainScene
    processes : int
        That share its substructures.

    Examples
    --------
    >>> from multiscale.macro.discrete.link_needs import LinkPart
    >>> from multiscale.pipeline.scene_settings import Statics, TensegrityGrid
    >>> grid = TensegrityGrid(kind="tensegrity_grid", n=4)
    >>> scene = Scene(title="grid", structure=grid, statics=Statics(load_factors=(1.0,)))
    >>> needs = scene_requirements(scene)
    >>> LinkPart.GEOMETRIC_STIFFNESS in needs.built, "scikit-fem" in needs.libraries
    (False, False)
    """
    if isinstance(scene, GrainScene):
        return _with_libraries(_grain_needs(scene), "meshio")
    matrices = ("meshio", *(("pypardiso",) if find_spec("pypardiso") else ()))
    parallel = ("mpi4py",) if processes > 1 else ()
    if isinstance(scene.structure, BODIES):
        mesher = ("gmsh",) if isinstance(scene.structure, LapJoint) else ()
        return _with_libraries(_body_needs(scene), *matrices, *parallel, *mesher)
    return _with_libraries(_link_needs(scene), *matrices, *parallel)


def _with_libraries(needs: Needs, *more: str) -> Needs:
    """Add what reads, writes and solves."""
    return replace(needs, libraries=tuple(sorted({*needs.libraries, *more})))


def _grain_needs(scene: GrainScene) -> Needs:
    """Grains in motion."""
    grains, motion = scene.grains, scene.motion
    law = ContactLaw(grains.friction, grains.restitution, grains.compliance)
    solver = Solver(motion.tolerance, motion.max_iterations, motion.threads)
    wall = scene.structure.wall_friction if isinstance(scene.structure, Silo) else 0.0
    strained = isinstance(scene.structure, Biaxial)
    return grain_needs(
        grains.number, motion.frames, law, solver, wall_friction=wall, strained=strained
    )


def _link_needs(scene: Scene) -> Needs:
    """Bars and cables, whole or cut."""
    system, statics, motion = make_structure(scene), scene.statics, scene.dynamics
    cut, moving = scene.substructures, motion is not None
    if cut is not None:
        return cut_needs(
            int((~system.fixed).sum()),
            links=system.n_links,
            substructures=cut.parts[0] * cut.parts[1],
            coarse=cut.coarse,
            moving=moving,
        )
    if statics is None:
        assert motion is not None  # the scene has been validated
        return link_needs(system, moving=True, steps=1 + ceil(motion.duration / motion.step))
    return link_needs(
        system,
        exact=statics.exact,
        stability=statics.stability,
        steps=len(statics.load_factors),
    )


def _body_needs(scene: Scene) -> Needs:
    """Elastic bodies, their joints and their cut."""
    cut = scene.substructures or Substructures()
    nodes, face, bodies = _size(scene.structure)
    joints = 0 if isinstance(scene.structure, Plate) else bodies - 1
    return cut_needs(
        3 * nodes * bodies,
        joint_points=face * joints,
        substructures=bodies * cut.parts[0] * cut.parts[1],
        coarse=cut.coarse,
        slabs=scene.loading.slabs if scene.loading else 0,
    )


def _size(given: object) -> tuple[int, int, int]:
    """Nodes of a body and of its face, and the number of bodies."""
    if isinstance(given, LapJoint):
        plan = given.length * given.width / given.element**2
        overlap = given.overlap * given.width / given.element**2
        return ceil(plan * (given.layers + 1)), ceil(overlap), 2
    assert isinstance(given, Plate | StackedBlocks)
    x, y, z = (number + 1 for number in given.elements)
    return x * y * z, x * y, given.blocks if isinstance(given, StackedBlocks) else 1
