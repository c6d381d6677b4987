r"""Capacity of friction: the kinematic theorem of limit analysis for bodies on joints."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import null_space
from scipy.sparse import block_array, csr_array, eye_array

from multiscale.errors import CaseError
from multiscale.fe.elasticity import free_motions
from multiscale.macro.bodies.assembly import Assembly
from multiscale.macro.substructures.cut import cut_assembly
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.stack import stack_substructures

CORNERS, CUTS, CLOSE = 8, 20, 1e-6
"""Initial tangents of the slip of a point; limit of the cutting planes added afterwards; change of
the work, relative to the work of all friction for slip of 1, at which they stop."""

ZERO_MOTION = 1e-6
"""Size of a rigid motion, relative to the largest, up to which it is zero."""

NOTHING = 1e-6
"""Share of a load with a power that is zero, and of the largest slip that is zero."""


@dataclass(frozen=True)
class Slide:
    """Rigid motion of bodies that the load drives; forces are NaN where bodies rotate."""

    load: float  # power of the load over the largest slip, N
    capacity: float  # power dissipated by friction over the largest slip, N
    joints: tuple[int, ...]  # sliding joints; empty where bodies lift, tip or are unconstrained

    def __str__(self) -> str:
        """Return the reason for missing equilibrium."""
        if not self.joints:
            return (
                "there is no equilibrium: the load lifts, tips or moves a body that no supports "
                "or interfaces fix; add supports or press the interfaces"
            )
        named = " and ".join(str(joint) for joint in self.joints)
        return (
            f"there is no equilibrium: the bodies slide on interface {named} under a load of "
            f"{self.load:.4g} N; friction carries about {self.capacity:.4g} N at the pressures "
            f"before sliding; reduce the load, or increase the pressure"
        )


def find_slide(problem: CutProblem, load: np.ndarray, *pressures: np.ndarray) -> Slide | None:
    r"""Compute the rigid motion that friction resists least, if the load exceeds the capacity.

    With the rigid motions :math:`Z a` that supports leave to the bodies, jumps :math:`J Z a` and
    areas :math:`w`, loads up to the share

    .. math:: \lambda = \min_a \sum w \mu p\, |J_T Z a|, \qquad f \cdot Z a = 1, \quad J_N Z a \ge 0
        \tag{1}

    have an equilibrium with a friction of at most :math:`\mu p`; any motion bounds it from above.
    """
    if not problem.joints:
        return None
    modes = _free_motions(problem)
    power = load @ modes
    if not np.any(np.abs(power) > NOTHING * np.abs(load).sum()):
        return None
    normal, *across = np.split(problem.jump @ modes, 3)
    known = [pressure for pressure in pressures if pressure.size and np.isfinite(pressure).all()]
    sliding = np.concatenate([normal, -normal])
    # motions without opening first: bodies that slide and tip have a capacity
    for rows, pressure in [*product([sliding], known), *product([normal], known)]:
        bound = problem.weight * problem.law.friction_limit(np.maximum(pressure, 0.0))
        a = _weakest(power, rows, across, bound)
        if a is None:
            continue
        slip, work = np.hypot(*(J @ a for J in across)), float(power @ a)
        taken, largest = float(bound @ slip), float(slip.max())
        if taken < work and rows is normal:
            return Slide(np.nan, np.nan, ())
        if taken < work and largest > 0.0:
            slides = tuple(np.unique(problem.point_joint[slip > NOTHING * largest]).tolist())
            return Slide(work / largest, taken / largest, slides)
    return None


def _name_free_motions(problem: CutProblem, names: Sequence[str]) -> str:
    """Name bodies that supports, interfaces and bolts leave free, and their rigid motions."""
    # jumps of joints, in the mean of each, and stretches of bolts, which must be zero
    modes = _free_motions(problem)
    normal, *across = np.split(problem.jump @ modes, 3)
    rough = problem.law.friction_limit(np.ones(problem.weight.size)) > 0.0
    each = 1.0 / np.sqrt(np.bincount(problem.point_joint)[problem.point_joint])[:, None]
    constraints = [each * normal, *((each * jump)[rough] for jump in across)]
    constraints += [np.diff(modes[list(bolt.unknown)], axis=0) for bolt in problem.bolts]
    if constraints and modes.shape[1]:
        R = np.linalg.qr(np.concatenate(constraints), mode="r")
        modes = modes @ null_space(R, rcond=ZERO_MOTION)

    # translations and rotations of each body in the remaining modes
    sentences = []
    for name, substructure in zip(names, problem.substructures, strict=False):
        moved = modes[substructure.unknown]
        rigid = np.linalg.lstsq(substructure.rigid_motions, moved, rcond=None)[0]
        rigid[3:] *= np.ptp(substructure.position, axis=0).max()  # displacements by rotation
        size = np.abs(rigid).max(axis=1, initial=0.0)
        free = size > ZERO_MOTION * max(1.0, size.max())
        moves, turns = (
            " and ".join(filter(None, [", ".join(axes[:-1]), *axes[-1:]]))
            for axes in (np.array(list("xyz"))[group] for group in (free[:3], free[3:]))
        )
        how = [f"to move along {moves}"] * bool(moves) + [f"to turn about {turns}"] * bool(turns)
        if how:
            sentences.append(f"{name} is free {' and '.join(how)}")
    return ", ".join(sentences)


def require_held(assembly: Assembly) -> None:
    """Refuse bodies that may move freely.

    Raises
    ------
    CaseError
        With the bodies and their motions, or as :func:`cut_assembly`.
    """
    refuse_free(assembly, cut_assembly(assembly))


def refuse_free(assembly: Assembly, problem: CutProblem, more: str = "") -> None:
    """Refuse bodies that may move freely in the cut problem of an assembly."""
    names = [body.name or f"body {number}" for number, body in enumerate(assembly.bodies)]
    if free := _name_free_motions(problem, names):
        raise CaseError(
            f"{free}: fix each body by supports, by an interface with friction or by bolts{more}"
        )


def _free_motions(problem: CutProblem) -> np.ndarray:
    """Rigid motions that no support, link or shank resists, shape (n, motions)."""
    stacked, place = stack_substructures(problem), problem.placement
    K = csr_array(place.T @ stacked.matrix(stacked.links.stiffness, None) @ place)  # links taut
    motions = problem.motions
    free = free_motions(K, motions[:, np.any(motions != 0.0, axis=0)])
    return np.asarray(free / np.abs(free).max(axis=0))


def _weakest(
    power: np.ndarray, normal: np.ndarray, across: list[np.ndarray], bound: np.ndarray
) -> np.ndarray | None:
    """Minimise (1) by cutting planes; None if no motion has the power 1."""
    from scipy.optimize import linprog

    points, count = across[0].shape
    drive, weight = power / np.abs(power).max(), bound / (bound.sum() or 1.0)
    angles = [np.full((points, 1), 2.0 * np.pi * k / CORNERS) for k in range(CORNERS)]
    rows = [[csr_array(-normal), None]]
    for _ in range(CUTS):
        for at in angles:
            slip = csr_array(np.cos(at) * across[0] + np.sin(at) * across[1])
            rows.append([slip, -eye_array(points)])
        program = linprog(
            np.append(np.zeros(count), weight),
            A_ub=block_array(rows, format="csr"),
            b_ub=np.zeros(len(normal) + (len(rows) - 1) * points),
            A_eq=np.append(drive, np.zeros(points))[None],
            b_eq=[1.0],
            bounds=[(None, None)] * count + [(0.0, None)] * points,
        )
        if program.status != 0:
            return None
        slips = [J @ program.x[:count] for J in across]
        if weight @ np.hypot(*slips) <= program.fun + CLOSE:
            break
        angles = [np.arctan2(*slips[::-1])[:, None]]
    return np.asarray(program.x[:count])
