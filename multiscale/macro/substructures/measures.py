"""Measures of a structure under loads: pressure, slip, loss, stiffness, data of the laws."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.interface_law import InterfaceLaw, SideBySide
from multiscale.macro.bodies.assembly import Assembly
from multiscale.macro.data_range import (
    FAR_FACTOR,
    FAR_SHARE,
    data_ends,
    load_shares,
    with_load_shares,
)
from multiscale.macro.substructures.latin_solver import LatinMethod
from multiscale.macro.substructures.load_path import LoadPath, cycle_work
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.stepping import (
    FollowedPath,
    JointState,
    Method,
    PreparedStructure,
    follow,
)
from multiscale.macro.substructures.tangents import Tangents
from multiscale.macro.substructures.whole import condense_assembly
from multiscale.schema import MACRO_RESULT, Dataset, with_cautions
from multiscale.units import readable

OPENED, STICKS, SLIPS = 0, 1, 2
"""States of a point of a joint."""

OPEN = 0.01
"""Pressure, relative to the mean of its joint, up to which a point counts as open. Laws without a
largest gap leave it a pressure; all open points carry less than this share of the force."""

SLIPPING = 0.5
"""Slipping share of the pressure of a point above which the point slips."""


def follow_cut_loads(
    problem: CutProblem,
    path: LoadPath,
    *,
    method: Method,
    extrapolate: bool = False,
    near: "FollowedLoads | None" = None,
) -> Dataset:
    """Load a cut structure by named loads: :func:`follow_loads`, then :func:`measure_loads`."""
    followed = follow_loads(problem, path, method=method, near=near)
    return measure_loads(followed, extrapolate=extrapolate)


def load_joint(
    assembly: Assembly,
    path: LoadPath,
    *,
    method: Method = LatinMethod(),  # noqa: B008  # frozen
    extrapolate: bool = False,
) -> Dataset:
    r"""Press and shear bodies with rough joints.

    Parameters
    ----------
    assembly : Assembly
        Its load cases are a preload and a shear of 1 Pa, with the areas of the loaded faces: from
        :func:`stacked_blocks` or :func:`lap_joint`, for instance. Bolts, with preloads of 1 Pa
        under their washers, replace the preload; they are locked in the cycles.
    path : LoadPath, from :func:`joint_path`
    method : Method, see :func:`solve_assembly`
    extrapolate : bool, see :func:`measure_loads`

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``; see :func:`measure_loads`.

    Raises
    ------
    CaseError
        If faces do not match, a substructure is in pieces, a law is rigid contact, or there are
        not two areas.
    """
    if len(assembly.areas) != 2:
        raise CaseError(
            f"a joint needs two load cases, preload and shear, with the areas of their faces, got "
            f"{len(assembly.areas)} areas"
        )
    joint, path = condense_assembly(assembly, method), replace(path, forces=tuple(assembly.areas))
    return joint.restore(
        follow_cut_loads(joint.small, path, method=method, extrapolate=extrapolate)
    )


@dataclass(frozen=True, eq=False)
class FollowedLoads:
    """A structure after a path of loads.

    Attributes
    ----------
    load : ndarray, shape (n, cases), forces of the loads at the factor 1, N
    work : ndarray, shape (2, 3, steps, cases)
        :meth:`~.tangents.Tangents.work` of each load at the end of each step of the path, J.
    ended : list of JointState, at the ends of the steps of the path
    cycles : list of FollowedPath
        From the end of each step, all amplitudes: the load rises in one step to an amplitude, makes
        a closed cycle and rises to the next. They end before the first step that failed.
    """

    loads: LoadPath
    load: np.ndarray
    work: np.ndarray
    path: FollowedPath
    ended: list[JointState]
    cycles: Sequence[FollowedPath] = ()


def follow_loads(
    problem: CutProblem, path: LoadPath, *, method: Method, near: FollowedLoads | None = None
) -> FollowedLoads:
    """Follow a path of loads, and measure tangents at the ends of its steps.

    Parameters
    ----------
    problem : CutProblem
        Its load cases are the loads of the path; with bolts, the first is their tightening. A
        method on the whole factorises the bodies in every iteration, unless the problem is
        condensed before, as by :func:`condense_assembly`.
    method : Method, as in :func:`solve_assembly`
    near : FollowedLoads, optional, the same path under other laws, as initial guess

    Raises
    ------
    CaseError
        If the path does not have a factor for each load case.
    """
    factors, ends = path.factors(), path.ends()
    tangents = Tangents(problem, method.linear(problem))
    work, ended = np.full((2, 3, *factors.shape), np.nan), list[JointState]()

    def note(step: int, state: JointState) -> None:
        if ends[step] >= 0:
            work[:, :, step] = tangents.work(state, path.rise(step))
            ended.append(state)

    start = PreparedStructure(problem, method)
    followed = follow(start, factors, near=near.path if near else None, note=note)
    # LATIN begins the cycles with its first directions, whatever the path has updated
    prepared, known = PreparedStructure(problem, method), near.cycles if near else ()
    cycles = [
        follow(
            prepared,
            path.beside(step),
            after=state,
            near=known[step] if step < len(known) else None,
        )
        for step, state in enumerate(ended if path.amplitudes else ())
    ]
    return FollowedLoads(path, tangents.whole.load, work, followed, ended, cycles)


def changed_stiffness(followed: FollowedLoads, laws: Sequence[SideBySide]) -> dict[str, np.ndarray]:
    """Return relative changes of the stiffnesses at the preloads by small changes of the laws.

    To first order, shape (laws, preloads); see :meth:`~.tangents.Tangents.changes`.
    """
    problem, n = followed.path.problem, len(followed.ended)
    tangents, work = Tangents(problem), followed.work[0, :, :n]
    changes = [tangents.changes(state, laws) for state in followed.ended]
    relative = -np.stack(changes, axis=2) / work  # (laws, parts, preloads, cases)
    return {
        "joint_stiffness": relative[:, 0, :, 0],
        "tangential_stiffness": relative[:, 0, :, 1],
        "interface_stiffness": relative[:, 1, :, 0],
        "solid_stiffness": relative[:, 2, :, 0],
    }


def measure_loads(followed: FollowedLoads, *, extrapolate: bool = False) -> Dataset:
    r"""Evaluate displacements, stiffnesses, slip and losses of a structure after its path.

    Parameters
    ----------
    extrapolate : bool
        Whether steps far outside the data of a law have the values that the law extrapolates; see
        :func:`~multiscale.macro.data_range.with_load_shares`.

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``: the fields of :func:`solve_assembly`; open, sticking and slipping
        shares of points and interfaces, their load outside the data of their laws, and the energy
        dissipated in cycles. Of named loads, factor, displacement and stiffnesses of each. Of a
        joint, preload and shear, displacements of their faces, stiffnesses per area without slip
        and, at all amplitudes, secant stiffness, slip and loss of the cycles at every preload.

    Notes
    -----
    With the nodal forces :math:`f` of a load at the factor 1 and their resultant F, its
    displacement is :math:`q = f \cdot u / F`: the mean along the load where the load is uniform.
    It counts from bodies without stress and interfaces without gap. Its stiffness is
    :math:`F^2 / (f \cdot u)`, by :meth:`~.tangents.Tangents.work`, against a small
    rise of its factor away from zero, and against changes so small that no point slips. The energy
    of a cycle is :math:`F \oint \lambda\, \mathrm{d}q` with the factor :math:`\lambda`, by
    :func:`~.load_path.cycle_work`; interfaces share it in proportion to the dissipation at their
    points. A joint has the area A of a face in place of F, and :math:`A / (f \cdot u)` as
    stiffness; joints and bodies are in series, with the work that each stores.

    Every cycle is solved: pressing makes points slip, and the shear of a lap joint changes its
    pressure, so that Masing's rule from the first loading does not hold. The secant stiffness is
    the shear over the displacement between both ends of a cycle. The distribution of the loss comes
    from the dissipation of the steps; their sum is of first order in the step and is scaled to the
    work of the cycle.
    """
    path, problem, run = followed.loads, followed.path.problem, followed.path
    moved = np.asarray(run.unknowns @ followed.load / np.array(path.forces))
    values = path.answers(moved, followed.work, bool(problem.joints))
    joints = contact_measures(run) if problem.joints else {}
    result = MACRO_RESULT.assign(run.result, {"path_step": path.ends()} | values | joints)
    if joints:
        shares, data = joint_shares(problem, result)
        loads = path.describe()
        result = with_load_shares(result, shares, data, extrapolate=extrapolate, loads=loads)
        known = extrapolate | (result["known"].to_numpy() == 1)
        moved = np.where(known[:, None], moved, np.nan)
    if path.cycles:
        energy = path.cycle_energy(moved)
        lost = {"cycle_energy": energy}
        if joints:
            lost["interface_energy"] = _interface_energy(result, path, energy)
        result = MACRO_RESULT.assign(result, lost).assign_coords(cycle=range(path.cycles))
    if path.amplitudes:
        result = _with_amplitudes(result, followed, extrapolate)
    return result.assign_coords(path.labels()).assign_attrs(path=path.kind)


def _with_amplitudes(result: Dataset, followed: FollowedLoads, extrapolate: bool) -> Dataset:
    path, area = followed.loads, followed.loads.forces[1]
    preloads, top = [preload for preload, _ in path.steps], np.array(path.amplitudes)
    cautions: list[str] = []
    shape = (len(preloads), top.size)
    loss, secant, slip = (np.full(shape, np.nan) for _ in range(3))
    density = np.full((*shape, result.sizes["point"]), np.nan)
    for level, (preload, run) in enumerate(zip(preloads, followed.cycles, strict=False)):
        # displacement of the sheared face, and amplitudes inside the data of the laws
        along = (run.unknowns @ followed.load[:, 1] / area).reshape(top.size, -1)
        slides = contact_measures(run)["slipping_load"]
        far = joint_shares(run.problem, run.result)[0][2].max(axis=1)
        inside = extrapolate | (far <= FAR_SHARE).reshape(top.size, -1).all(axis=1)
        valid = inside & np.isfinite(along).all(axis=1)

        # loss, secant stiffness and slip; distribution of the loss
        half = along.shape[1] // 2
        apart = 0.5 * (along[:, 0] + along[:, -1]) - along[:, half]
        lost = run.dissipated.reshape(*along.shape, -1)[:, 1:].sum(axis=1)
        loss[level] = np.where(valid, area * cycle_work(top, along), np.nan)
        secant[level] = np.where(valid, 2.0 * top / apart, np.nan)
        slip[level] = np.where(valid, slides.reshape(along.shape)[:, -1], np.nan)
        slipped = lost @ result["point_area"].values  # of first order in the step
        density[level] = (loss[level] / np.where(slipped > 0.0, slipped, 1.0))[:, None] * lost
        if not valid.all():
            failure = run.result.attrs.get("failure", "")
            why = failure.partition(": ")[2] or (  # its step counts from the preload
                f"more than {100.0 * FAR_SHARE:g} % of the load lies more than a factor of "
                f"{FAR_FACTOR:g} outside the pressures of the law"
            )
            cautions.append(
                f"cycles at the preload {readable(f'{preload:.4g} Pa')} have no answer from the "
                f"amplitude {readable(f'{top[~valid][0]:.4g} Pa')} on: {why}"
            )
    values = {
        "cycle_preload": np.array(preloads),
        "cycle_shear": top,
        "cycle_loss": loss,
        "cycle_slip": slip,
        "secant_stiffness": secant,
        "loss_density": density,
    }
    result = MACRO_RESULT.assign(result, values)
    labels = {"level": range(shape[0]), "amplitude": range(shape[1])}
    return with_cautions(result.assign_coords(labels), *cautions)


def contact_measures(followed: FollowedPath) -> dict[str, Any]:
    """State of every point, and shares of area, slip and loss at every step."""
    # force of every point, and its joint
    problem, result, slipping = followed.problem, followed.result, followed.slipping
    pressure, area = -result["traction"].values[..., 0], problem.weight
    failed = np.isnan(pressure)
    joint = np.unique(problem.point_joint, return_inverse=True)[1]
    shares = joint == np.arange(joint.max() + 1)[:, None]  # (joints, points)
    areas, force = shares @ area, np.maximum(pressure, 0.0) * area
    total = force @ shares.T  # (steps, joints)

    # open, stuck and slipping points
    mean = (total / areas)[:, joint]
    state = np.where(slipping > SLIPPING, SLIPS, STICKS)
    state = np.where(pressure <= OPEN * mean, OPENED, state)
    slides = np.where(pressure > 0.0, slipping, 0.0) * force
    area_share = area / area.sum()

    # initial gaps
    laws = [_normal(face.law) for face in problem.joints]
    sizes = [face.weight.size for face in problem.joints]
    initial = [np.broadcast_to(law.gap, size) for law, size in zip(laws, sizes, strict=True)]

    def fraction(where: np.ndarray) -> np.ndarray:
        return np.asarray(np.where(failed, np.nan, where) @ area_share)

    def mean_of_joint(values: np.ndarray) -> np.ndarray:
        return np.asarray((np.where(failed, np.nan, values) * area) @ shares.T / areas)

    def force_share(slipping: np.ndarray, whole: np.ndarray) -> np.ndarray:
        return np.asarray(slipping / np.where(whole > 0.0, whole, 1.0) + 0.0 * whole)

    return {
        "gap": result["jump"].values[..., 0] + np.concatenate(initial) + problem.gap,
        "point_damage": np.repeat([law.damage for law in laws], sizes),
        "contact_state": np.where(failed, np.nan, state),
        "open_fraction": fraction(state == OPENED),
        "stick_fraction": fraction(state == STICKS),
        "slip_fraction": fraction(state == SLIPS),
        "slipping_load": force_share(slides.sum(axis=1), force.sum(axis=1)),
        "interface_slipping_load": force_share(slides @ shares.T, total),
        "interface_pressure": mean_of_joint(pressure),
        "interface_open": mean_of_joint(state == OPENED),
        "interface_slip": mean_of_joint(state == SLIPS),
        "dissipation": followed.dissipated,
    }


def joint_shares(problem: CutProblem, result: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Share of the load of each joint outside the data of its law, and the ends of the data."""
    pressure, number = -result["traction"].values[..., 0], result["point_joint"].values
    area = result["point_area"].values
    ranges = {face.joint: data_ends(_normal(face.law)) for face in problem.joints}
    shares = [
        load_shares(pressure[:, number == joint], area[number == joint], ends)
        for joint, ends in ranges.items()
    ]
    return np.stack(shares, axis=2), np.array(list(ranges.values()))


def _normal(law: InterfaceLaw | None) -> InterfaceLaw:
    assert law is not None  # every joint has a law
    return law.normal_law


def _interface_energy(result: Dataset, path: LoadPath, energy: np.ndarray) -> np.ndarray:
    """Energy of every cycle and interface, J, in proportion to the dissipation at its points."""
    number, area = result["point_joint"].to_numpy(), result["point_area"].to_numpy()
    lost = result["dissipation"].to_numpy() * area
    slipped = np.array([lost[cycle][1:].sum(axis=0) for cycle in path.closed()])
    slipped = slipped @ (number[:, None] == np.unique(number))
    total = slipped.sum(axis=1, keepdims=True)
    return np.asarray(slipped / np.where(total > 0.0, total, 1.0) * energy[:, None])
