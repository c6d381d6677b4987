"""Scene files: read, solved, and written as a dataset and for ParaView."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.errors import CaseError, ConvergenceError
from multiscale.io import (
    make_folder,
    open_mesh,
    read_table,
    write_body_fields,
    write_dataset,
    write_link_fields,
)
from multiscale.laws.link import Bar, Cable, LinkLaw, Strut
from multiscale.macro import (
    LinkSystem,
    cable_net,
    simulate,
    solve_static,
    system_from_mesh,
    system_from_table,
    tensegrity_grid,
)
from multiscale.macro.discrete.description import describe
from multiscale.macro.substructures import (
    CutProblem,
    Team,
    cut_links,
    homogenise,
    simulate_latin,
    solve_latin,
    split_grid,
)
from multiscale.pipeline.body_scenes import cut_scene, solve_bodies
from multiscale.pipeline.body_settings import BODIES, LapJoint, Plate, StackedBlocks, Substructures
from multiscale.pipeline.grain_scenes import run_grain_scene
from multiscale.pipeline.grain_settings import (
    GRANULATES,
    Biaxial,
    ColumnCollapse,
    Deposit,
    GrainScene,
    ShearCell,
    Silo,
)
from multiscale.pipeline.scene_settings import (
    CableNet,
    Dynamics,
    LinkLawSettings,
    LinkMesh,
    LinkTable,
    Scene,
    Statics,
    TensegrityGrid,
)
from multiscale.pipeline.toml_model import Settings, read_toml, validate
from multiscale.schema import HOMOGENISED, MACRO_RESULT, with_cautions

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["homogenised_file", "load_scene", "make_structure", "run_scene"]

KINDS: dict[str, type[Settings]] = {
    "tensegrity_grid": TensegrityGrid,
    "cable_net": CableNet,
    "table": LinkTable,
    "mesh": LinkMesh,
    "plate": Plate,
    "stacked_blocks": StackedBlocks,
    "lap_joint": LapJoint,
    "deposit": Deposit,
    "silo": Silo,
    "column_collapse": ColumnCollapse,
    "shear_cell": ShearCell,
    "biaxial": Biaxial,
}
FURTHEST = 0.05
"""Displacement of the ends of a link against each other, over its length, that counts as small."""

STRAINED = 0.1
"""Strain of a link that carries above which its law, linear elastic, is beyond what cables do."""

LAWS: dict[str, type[LinkLaw]] = {"bar": Bar, "cable": Cable, "strut": Strut}


def load_scene(path: str | Path) -> Scene | GrainScene:
    """Read a scene file.

    Parameters
    ----------
    path : path
        Of a TOML file; the files that it names are looked for beside it.

    Raises
    ------
    CaseError
        If there is no such file, or with every fault of it, one a line.
    """
    path = Path(path)
    if path.is_dir():
        raise CaseError(f"{path} is a folder; give the scene file in it")
    content = read_toml(path)
    if "structure" not in content and not {"body_1", "rubber"}.isdisjoint(content):
        raise CaseError(f"{path}: is a case and no scene; use multiscale run")
    for table, keys in (
        ("structure", ("nodes", "links", "file", "stiffness")),
        ("joint", ("law",)),
    ):
        given = content.get(table)
        for key in keys:
            if isinstance(given, dict) and isinstance(given.get(key), str):
                given[key] = str(path.parent.resolve() / given[key])
    given = content.get("structure")
    if isinstance(given, dict) and given.get("kind") in GRANULATES:
        return validate(GrainScene, content, path, KINDS)
    return validate(Scene, content, path, KINDS)


def make_structure(scene: Scene) -> LinkSystem:
    """Build the structure of a scene of bars and cables.

    Raises
    ------
    CaseError
        If the structure is refused, or a file that it names cannot be read.
    """
    given = scene.structure
    if isinstance(given, Plate | StackedBlocks | LapJoint):
        raise CaseError(f"a structure of kind {given.kind!r} has no links")
    options = given.model_dump(exclude={"kind", "n", "m", "cable_rigidity", "bar_rigidity"})
    if isinstance(given, TensegrityGrid):
        cable, bar = Cable(given.cable_rigidity), Bar(given.bar_rigidity)
        return tensegrity_grid(given.n, given.m, cable=cable, bar=bar, **options)
    if isinstance(given, CableNet):
        return cable_net(given.n, given.m, cable=Cable(given.cable_rigidity), **options)
    laws = {name: _law(law) for name, law in given.laws.items()}
    if isinstance(given, LinkTable):
        columns = {"first": int, "second": int, "group": int, "law": str}
        nodes, links = read_table(given.nodes, {}), read_table(given.links, columns)
        return system_from_table(nodes, links, laws)
    mesh = open_mesh(given.file)
    return system_from_mesh(mesh, laws, supports=given.supports, load=given.load, scale=given.unit)


def run_scene(
    scene: Scene | GrainScene,
    out: str | Path,
    *,
    law: str | Path | None = None,
    team: Team | None = None,
) -> "xr.Dataset":
    """Solve a scene; write its result and, beside it in ``fields``, a series for ParaView.

    With ``homogenise`` in ``[substructures]`` their condensed stiffness is written as well.

    Parameters
    ----------
    scene : Scene or GrainScene
    out : path
        Dataset to write; its folder is made if needed.
    law : path, optional
        Interface law of the joints, instead of the one that the scene names.
    team : Team, optional
        Processes that share the substructures. All call this function; the first one writes.

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``, or ``GRANULATE`` for grains. The attribute ``failure`` says which
        steps failed and why, ``cautions`` where a law answered beyond its data, nodes moved
        farther than the structure measures or the contacts of grains missed their tolerance.

    Raises
    ------
    CaseError
        If the structure or its law is refused.
    ConvergenceError
        If no step converged, or the equilibrium from which a motion starts cannot be found.
    """
    if isinstance(scene, GrainScene):
        if law is not None:
            raise CaseError(f"{scene.title}: grains have no joint that the law {law} could be of")
        return run_grain_scene(scene, out)
    out, law = Path(out), None if law is None else Path(law)
    bodies, writes = isinstance(scene.structure, BODIES), team is None or team.rank == 0
    if law is not None and scene.joint is None:
        raise CaseError(f"{scene.title}: the scene has no joint that the law {law} could be of")
    result = solve_bodies(scene, law, team) if bodies else _solve_links(scene, team)
    result = with_cautions(result, *_too_far(result, scene.statics))
    result = result.assign_attrs(title=scene.title, scene=scene.to_toml())
    if writes:
        make_folder(out.parent)
        write_dataset(result, out, MACRO_RESULT)
        write_fields = write_body_fields if bodies else write_link_fields
        write_fields(result, make_folder(out.parent / "fields"), name=out.stem)
    if not result["converged"].values.any():
        raise ConvergenceError(f"{scene.title}: no step converged; {result.attrs['failure']}")
    if "known" in result and np.isnan(result["approach"].values).all():
        raise ConvergenceError(
            f"{scene.title}: the answer is unknown at every step; {result.attrs['cautions']}"
        )
    if writes and scene.substructures is not None and scene.substructures.homogenise:
        condensed = _homogenise(scene, result, law).assign_attrs(title=scene.title)
        write_dataset(condensed, homogenised_file(out), HOMOGENISED)
    return result


def _too_far(result: "xr.Dataset", statics: Statics | None) -> Iterator[str]:
    """Say where nodes move farther than the structure measures, or links turn or strain much."""
    size = float(np.ptp(result["position"].values, axis=0).max())
    moved = float(np.abs(np.nan_to_num(result["displacement"].values)).max(initial=0.0))
    if moved > size:
        yield (
            f"nodes move by up to {moved:.3g} m, more than the structure measures ({size:.3g} m), "
            f"where no law of its parts holds: check loads, moduli and their units"
        )
    elif statics is not None and "ends" in result:
        first, second = result["ends"].values.T
        apart = np.diff(result["position"].values[result["ends"].values], axis=1)[:, 0]
        u = np.nan_to_num(result["displacement"].values)[:, :, :3]
        moved_apart, length = u[:, second] - u[:, first], np.linalg.norm(apart, axis=1)
        turned = np.linalg.norm(moved_apart, axis=2) / length
        strain = np.abs(np.linalg.norm(apart + moved_apart, axis=2) / length - 1.0)
        strain = np.where(result["slack"].values > 0.0, 0.0, strain)
        if statics.exact and strain.max() > STRAINED:
            link = int(np.argmax(strain.max(axis=0)))
            yield (
                f"link {link} changes its length by up to {strain.max():.2g} of it, and more than "
                f"{STRAINED:g} is outside the linear law of its material: check loads, rigidities "
                f"and their units"
            )
        if not statics.exact and turned.max() > FURTHEST:
            yield (
                f"the ends of a link move against each other by up to {turned.max():.2g} of its "
                f"length, and small displacements err by about as much: set exact to true in "
                f"[statics]"
            )


def homogenised_file(out: Path) -> Path:
    """Where the condensed substructures of a scene go, beside its result."""
    return out.with_name(f"{out.stem}-homogenised.nc")


def _law(settings: LinkLawSettings) -> LinkLaw:
    """Return the law that the settings name."""
    return LAWS[settings.kind](settings.rigidity)


def _solve_links(scene: Scene, team: Team | None) -> "xr.Dataset":
    """Solve a structure of links, whole or cut."""
    system, statics = make_structure(scene), scene.statics
    if statics is None:
        assert scene.dynamics is not None  # the scene has been validated
        return _move(system, scene.dynamics, scene.substructures, team)
    if scene.substructures is not None:
        cut, factors = scene.substructures, np.array(statics.load_factors)
        how = _options(cut, team)
        return _with_links(
            solve_latin(_cut(system, cut), factors, coarse=cut.coarse, **how), system
        )
    return solve_static(
        system, statics.load_factors, exact=statics.exact, stability=statics.stability
    )


def _cut(system: LinkSystem, cut: Substructures) -> CutProblem:
    """Cut a structure of links into boxes."""
    return cut_links(system, split_grid(system, cut.parts))


def _move(
    system: LinkSystem, settings: Dynamics, cut: Substructures | None, team: Team | None
) -> "xr.Dataset":
    """Find the equilibrium at the start, and follow the motion from it."""
    steps = int(np.ceil(settings.duration / settings.step * (1.0 - 1e-12)))
    times, factor = np.linspace(0.0, settings.duration, steps + 1), settings.start_load_factor
    history = np.array(settings.load_history)

    def load_factor(time: float) -> float:
        return float(np.interp(time, *history.T))

    if cut is None:
        start = _at_rest(solve_static(system, factor))
        options: dict[str, Any] = {"theta": settings.theta, "restitution": settings.restitution}
        return simulate(
            system, times, settings.mass, load_factor=load_factor, start=start, **options
        )
    problem, how = _cut(system, cut), _options(cut, team)
    start = _at_rest(solve_latin(problem, factor, coarse=cut.coarse, **how).isel(step=0))
    result = simulate_latin(
        problem, times, settings.mass, load_factor=load_factor, start=start, **how
    )
    return _with_links(result, system)


def _at_rest(begin: "xr.Dataset") -> tuple[np.ndarray, np.ndarray]:
    """Displacement and velocity of an equilibrium."""
    if not int(begin["converged"]):
        raise ConvergenceError(f"no equilibrium to start from: {begin.attrs['failure']}")
    displacement = begin["displacement"].values
    return displacement, np.zeros_like(displacement)


def _options(cut: Substructures, team: Team | None) -> dict[str, Any]:
    """How substructures are solved."""
    return {"tolerance": cut.tolerance, "max_iterations": cut.max_iterations, "team": team}


def _with_links(result: "xr.Dataset", system: LinkSystem) -> "xr.Dataset":
    """Add the description of the links."""
    return MACRO_RESULT.assign(result, describe(system)).assign_coords(end=range(2))


def _homogenise(scene: Scene, result: "xr.Dataset", law: Path | None) -> "xr.Dataset":
    """Condense the substructures of a scene, at its last step that converged."""
    if isinstance(scene.structure, BODIES):
        problem = cut_scene(scene, law)
    else:
        assert scene.substructures is not None
        problem = _cut(make_structure(scene), scene.substructures)
    solved = np.isfinite(result["displacement"].values).all(axis=(1, 2))
    return homogenise(problem, result, step=int(np.flatnonzero(solved)[-1]))
