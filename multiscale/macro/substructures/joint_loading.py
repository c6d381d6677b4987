"""Press bodies with joints, shear them to and fro; measure stiffness, slip and lost energy."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.macro.bodies.assembly import Assembly
from multiscale.macro.data_range import with_load_shares
from multiscale.macro.substructures.assembly_methods import LatinMethod
from multiscale.macro.substructures.bolted_path import Method, follow_bolts
from multiscale.macro.substructures.closed_cycles import closed_cycle, with_amplitudes
from multiscale.macro.substructures.followed_path import FollowedPath, condense_assembly, solve_path
from multiscale.macro.substructures.joint_state import contact_state, joint_shares
from multiscale.macro.substructures.load_path import LoadPath
from multiscale.macro.substructures.problem import CutProblem
from multiscale.schema import MACRO_RESULT, Dataset

__all__ = [
    "FEW_STEPS",
    "FollowedJoint",
    "JointLoading",
    "follow_joint",
    "load_joint",
    "measure_joint",
]

FEW_STEPS = 2
"""Load steps from zero to an amplitude in the cycles at every preload."""


@dataclass(frozen=True)
class JointLoading:
    """Preloads one after the other, then cycles of shear at the last of them, or at all.

    Parameters
    ----------
    preloads : tuple of float, pressures on the pressed face, Pa
    shear : float, amplitude of the tangential traction on the sheared face, Pa
    cycles : int, closed cycles from the positive amplitude to the negative one and back; 0 for none
    steps : int, load steps from zero to the amplitude: 4 of these make a cycle
    amplitudes : tuple of float
        Amplitudes of the shear, Pa, rising: one cycle of each at every preload, beside the path.
    amplitude_steps : int, load steps from zero to each of these amplitudes in its cycle

    Raises
    ------
    CaseError
        If a value is outside its range.
    """

    preloads: tuple[float, ...]
    shear: float = 0.0
    cycles: int = 0
    steps: int = 10
    amplitudes: tuple[float, ...] = ()
    amplitude_steps: int = FEW_STEPS

    def __post_init__(self) -> None:
        if not self.preloads or not all(0.0 < p < np.inf for p in self.preloads):
            raise CaseError(f"preloads must be positive (Pa), got {list(self.preloads)}")
        if self.cycles < 0 or self.steps < 1 or (self.cycles and not 0.0 < self.shear < np.inf):
            raise CaseError(
                f"cycles need a positive shear (Pa) and one step or more, got {self.cycles} "
                f"cycles, {self.shear:g} Pa and {self.steps} steps"
            )
        if not np.all(np.diff(self.amplitudes, prepend=0.0) > 0.0):
            raise CaseError(
                f"amplitudes must be positive and rise (Pa), got {list(self.amplitudes)}"
            )

    def path(self, areas: Sequence[float] = (1.0, 1.0)) -> LoadPath:
        """Return the path over preload and shear of 1 Pa on faces of some areas, m²."""
        return LoadPath(
            ("preload", "shear"),
            tuple(areas),
            tuple((preload, 0.0) for preload in self.preloads),
            cycled="shear",
            amplitude=self.shear or 1.0,
            cycles=self.cycles,
            cycle_steps=self.steps,
        )


def load_joint(
    assembly: Assembly,
    loading: JointLoading,
    *,
    method: Method = LatinMethod(),  # noqa: B008  # frozen
    extrapolate: bool = False,
) -> Dataset:
    r"""Press and shear bodies with rough joints.

    Parameters
    ----------
    assembly : Assembly
        Its load cases are a preload and a shear of 1 Pa, with the areas of the faces that they act
        on: from :func:`stacked_blocks` or :func:`lap_joint`, for instance. Bolts, with preloads of
        1 Pa under their washers, take the place of the first; they are locked in the cycles.
    loading : JointLoading
    method : Method, see :func:`solve_assembly`
    extrapolate : bool
        Whether steps far outside the data of a law keep what it extrapolates; see
        :func:`~multiscale.macro.data_range.with_load_shares`.

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``: what :func:`solve_assembly` gives, and approach, shear, stiffness,
        open, sticking and slipping shares of the joints, their load outside the data of their
        laws, and energy per cycle; and what :func:`with_amplitudes` measures at every preload.

    Raises
    ------
    CaseError
        If faces do not match, a substructure is in pieces, a law is one of rigid contact, or there
        are not two areas.

    Notes
    -----
    With the nodal forces :math:`f` of 1 Pa on a face of area A, the displacement of the face is
    :math:`q = f \cdot u / A`. The stiffness :math:`A / (f \cdot u)` at a preload is that for
    vibrations too small for any point to slip, with u of (1) of
    :meth:`~.followed_path.FollowedPath.tangent_work`, and joints and bodies stand in series by the
    work that each of them stores. The energy of a cycle is the work of the shear on
    its face, :func:`~.closed_cycles.cycle_work`.
    """
    if len(assembly.areas) != 2:
        raise CaseError(
            f"a joint needs two load cases, preload and shear, with the area that each acts on, "
            f"got {len(assembly.areas)} areas"
        )
    joint = condense_assembly(assembly, method)
    followed = follow_joint(joint.small, loading, method=method)
    return joint.restore(measure_joint(followed, assembly.areas, extrapolate=extrapolate))


@dataclass(frozen=True, eq=False)
class FollowedJoint:
    """Joints that have been loaded.

    Attributes
    ----------
    loading : JointLoading
    path : FollowedPath, at the preloads, then in cycles
    cycles : list of Dataset
        Of all amplitudes from each preload, its path first: from each preload the shear rises in
        one step to an amplitude, makes a closed cycle there and rises to the next. None from the
        first preload that has failed.
    """

    loading: JointLoading
    path: FollowedPath
    cycles: list[Dataset]


def follow_joint(
    problem: CutProblem, loading: JointLoading, *, method: Method, near: FollowedJoint | None = None
) -> FollowedJoint:
    """Press and shear a cut structure.

    Parameters
    ----------
    problem : CutProblem
        The small problem of :func:`~.followed_path.condense_assembly`, for instance.
    loading : JointLoading
    method : Method
    near : FollowedJoint, optional
        The same structure and loading with other laws, from which the method may begin.
    """
    before = near.path.result if near else None
    path = solve_path(problem, loading.path().factors(), method, before)
    top, known = np.array(loading.amplitudes), near.cycles if near else []
    shear = np.ravel(top[:, None] * np.append(1.0, closed_cycle(loading.amplitude_steps)))
    cycles: list[Dataset] = []
    for level, preload in enumerate(loading.preloads if loading.amplitudes else ()):
        if path.result["converged"].values[level] != 1:
            break
        factors = np.stack([np.full(shear.size, preload), shear], axis=1)
        start = path.result.isel(step=slice(level + 1))
        like = known[level] if level < len(known) else None
        cycles.append(follow_bolts(problem, factors, method, start, like))
    return FollowedJoint(loading, path, cycles)


def measure_joint(
    followed: FollowedJoint, areas: Sequence[float], *, extrapolate: bool = False
) -> Dataset:
    """Measure what :func:`load_joint` returns, with the areas of both loaded faces, m²."""
    loading, path, area = followed.loading, followed.path, np.array(areas)
    problem, result, loads = path.problem, path.result, loading.path(areas)
    (preload, shear), (approach, along) = loads.factors().T, (path.work / area).T
    values: dict[str, Any] = {
        "preload": preload,
        "shear": shear,
        "approach": approach,
        "shear_displacement": along,
        **contact_state(problem, result),
    }
    whole, of_joints, of_bodies = path.tangent_work(range(len(loading.preloads)))[0]
    values |= {
        "joint_stiffness": area[0] / whole[:, 0],
        "tangential_stiffness": area[1] / whole[:, 1],
        "interface_stiffness": area[0] / of_joints[:, 0],
        "solid_stiffness": area[0] / of_bodies[:, 0],
    }
    shares, data = joint_shares(problem, result)
    result = MACRO_RESULT.assign(result, values)
    result = with_load_shares(result, shares, data, extrapolate=extrapolate)
    if loading.cycles:
        moved = np.stack([result[name] for name in ("approach", "shear_displacement")], axis=1)
        lost = {"cycle_energy": loads.cycle_energy(moved)}
        result = MACRO_RESULT.assign(result, lost).assign_coords(cycle=range(loading.cycles))
    if loading.amplitudes:
        result = with_amplitudes(result, followed, float(area[1]), extrapolate=extrapolate)
    return result
