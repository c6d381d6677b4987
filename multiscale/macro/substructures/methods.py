r"""Methods for bodies with joints: one function for all, and one rule that chooses.

With n unknowns, m of them in a substructure, SuperLU takes about :math:`a n^2` seconds for factors,
:math:`b n^{4/3}` for a solve and :math:`c n^{4/3}` bytes. Newton's method on the whole factorises
in every step, or once and solves for all unknowns on the joints if these are few; LATIN factorises
once and solves for the points of the joints, then once for each iteration and substructure. The
constants are those of lap joints and stacked blocks of 8,000 and 24,000 unknowns on one process,
with errors of a factor of two; they are seconds of no other machine, but their ratio decides.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from multiscale.executors import usable_memory
from multiscale.macro.bodies.assembly import Assembly
from multiscale.macro.substructures.cut import cut_assembly
from multiscale.macro.substructures.latin_solver import LatinMethod
from multiscale.macro.substructures.stepping import Method
from multiscale.macro.substructures.whole import DENSE, AssembledNewton
from multiscale.needs import Needs, choose
from multiscale.schema import Dataset

__all__ = [
    "JointSize",
    "MethodChoice",
    "MethodCost",
    "choose_method",
    "cut_needs",
    "solve_assembly",
]

FACTORS, SOLVE, DENSE_FACTORS = 4e-9, 4e-8, 2.5e-11
"""Seconds: of sparse factors over the square of the unknowns, of a solve over their power of 4/3,
and of full factors over their cube."""

PER_FILL = 650
"""Peak memory of the factors of one matrix, byte, over the power of 4/3 of its unknowns."""

PER_LINK, PER_UNKNOWN, PER_PART = 5000, 2800, 1300
"""Peak memory, byte: of a link; of an unknown of a body, for matrices and results; of that to the
power of 4/3 in a substructure, for the factors of three matrices."""

NEWTON_STEPS, ITERATIONS, OVERHEAD = 5, 27, 6e-3
"""Newton steps and iterations of LATIN for a load step; seconds of an iteration for a substructure
beside its solve: joint, coarse problem and acceleration."""

PAYS = 0.5
"""Time, over the time of Newton's method, below which LATIN is taken: it is less accurate."""

CUTS = ((1, 1), (2, 1), (2, 2), (4, 2), (4, 4), (8, 4), (8, 8))
"""Substructures of a body along x and y that are tried in turn until the factors fit."""


def solve_assembly(
    assembly: Assembly,
    load_factor: float | np.ndarray = 1.0,
    *,
    method: Method = AssembledNewton(),  # noqa: B008  # frozen
) -> Dataset:
    """Solve elastic bodies with interfaces, step by step.

    Parameters
    ----------
    assembly : Assembly
    load_factor : float or ndarray, shape (steps,) or (steps, cases)
        Factors of the load cases, one row for each step; each starts from the one before, the first
        from rest. Where there are bolts, the first factor is of their preloads, and a step that
        changes it tightens them: :func:`follow`, which goes on from an earlier path as well.
    method : Method, :class:`AssembledNewton`, :class:`LatinMethod` or :class:`NewtonSchur`

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``: displacement of the nodes of all bodies one after the other,
        jump and traction at the points of the interfaces, which are nodes, in the frame of each
        (normal, then both tangents), and the force of the bolts. A step that did not converge, or
        at which a bolt comes loose, is NaN with ``converged`` 0, the later ones are not tried, and
        the attribute ``failure`` has the reason. Points come in the order of the pairs of
        substructures that meet; ``point_joint`` is the interface of each.

    Raises
    ------
    CaseError
        If a body is not elastic, a support moves, faces do not match, a substructure is in
        pieces, or load factors do not fit the load cases.

    Examples
    --------
    >>> from multiscale.laws import Exponential, Sliders
    >>> from multiscale.laws.bulk import Elastic
    >>> from multiscale.macro.bodies import stacked_blocks
    >>> law = Sliders(Exponential(1e9, 0.2e-6), 0.2, pressures=(1e6, 1e8))
    >>> blocks = stacked_blocks((0.02, 0.02, 0.02), (2, 2, 1), [Elastic(210e9, 0.3)] * 2, [law])
    >>> pressed = solve_assembly(blocks, np.array([[10e6, 0.0]]))  # Pa
    >>> float((pressed["traction"][0, :, 0] @ pressed["point_area"]).round(6))  # N
    -4000.0
    """
    return method.solve(cut_assembly(assembly, method.parts), load_factor)


@dataclass(frozen=True)
class JointSize:
    """What the cost of bodies with joints depends on.

    Attributes
    ----------
    unknowns, joint_points, bodies, steps : int, of all bodies, all joints, and the whole path
    compliant : bool, whether the laws give the traction of a jump; rigid contact does not
    """

    unknowns: int
    joint_points: int
    bodies: int
    steps: int
    compliant: bool = True


@dataclass(frozen=True)
class MethodCost:
    """Cost of a method: peak memory, byte, and about how many seconds on one process.

    The whole is one substructure.
    """

    method: Method
    substructures: int
    memory: int
    seconds: float

    def __str__(self) -> str:
        """Return method, memory and time in words."""
        x, y = self.method.parts
        cut = "" if x * y == 1 else f" in {x} x {y} parts a body"
        size, time = f"{1e-9 * self.memory:.2g} GB", f"{self.seconds:.2g} s"
        return f"{self.method.name}{cut} takes {size} and about {time}"


@dataclass(frozen=True)
class MethodChoice:
    """The method to take, the reason, and the costs of the others."""

    taken: MethodCost
    why: str
    others: tuple[MethodCost, ...]

    def explain(self) -> str:
        """Return choice, reason and costs in a line."""
        others = "; ".join(str(other) for other in self.others)
        return f"{self.taken}: {self.why}" + (f" ({others})" if others else "")


def choose_method(
    size: JointSize,
    asked: LatinMethod | AssembledNewton | None = None,
    *,
    memory: float | None = None,
) -> MethodChoice:
    """Choose the method that solves bodies with joints.

    Parameters
    ----------
    size : JointSize
    asked : LatinMethod or AssembledNewton, optional, what the user asks for, which is taken
    memory : float, optional, byte that the solve may take; four fifths of this machine if not given

    Returns
    -------
    MethodChoice
        Newton's method on the whole if its factors fit into the memory; LATIN on the bodies as
        they are if it takes less than half of the time; else LATIN with the first cut that fits. On
        one process a cut never saves time, and saves memory from 4 x 2 parts a body on, because all
        parts keep their factors.

    Examples
    --------
    >>> small, long = JointSize(8000, 220, 2, 23), JointSize(24000, 325, 2, 75)
    >>> [type(choose_method(size, memory=1e10).taken.method).__name__ for size in (small, long)]
    ['AssembledNewton', 'LatinMethod']
    """
    limit = usable_memory() if memory is None else memory
    newton, bodies, *cuts = _costs(size)
    if isinstance(asked, AssembledNewton):
        return MethodChoice(newton, "the case asks for it", (bodies,))
    if asked is not None:
        taken = _latin_cost(size, asked)
        return MethodChoice(taken, "the case asks for it", (newton, bodies))
    room = f"of {1e-9 * limit:.2g} GB"
    if size.compliant and newton.memory <= limit:
        if not (bodies.memory <= limit and bodies.seconds < PAYS * newton.seconds):
            why = f"its factors fit into the memory {room}, and it is the most accurate"
            return MethodChoice(newton, why, (bodies,))
        why = "factors of single bodies that last for the whole path take less than half the time"
        return MethodChoice(bodies, why, (newton,))
    reason = f"the factors of the whole do not fit into the memory {room}"
    if not size.compliant:
        reason = "Newton's method takes no rigid contact"
    fits = [cost for cost in (bodies, *cuts) if cost.memory <= limit]
    if fits:
        return MethodChoice(fits[0], reason, (newton,))
    last = cuts[-1]
    return MethodChoice(last, f"{reason}, nor do those of its parts on one process", (newton,))


def _costs(size: JointSize) -> Iterator[MethodCost]:
    """Costs of Newton's method on the whole, of LATIN on bodies as they are, and cut."""
    n, kept = size.unknowns, 6 * size.joint_points
    seconds = NEWTON_STEPS * size.steps * FACTORS * n**2
    if kept <= DENSE:
        condensed = FACTORS * n**2 + kept * SOLVE * n ** (4.0 / 3.0)
        seconds = condensed + NEWTON_STEPS * size.steps * DENSE_FACTORS * kept**3
    memory = int(PER_UNKNOWN * n + PER_FILL * n ** (4.0 / 3.0))
    yield MethodCost(AssembledNewton(), 1, memory, seconds)
    for parts in CUTS:
        yield _latin_cost(size, LatinMethod(parts))


def _latin_cost(size: JointSize, method: LatinMethod) -> MethodCost:
    count = size.bodies * method.parts[0] * method.parts[1]
    part = size.unknowns / count
    solve = SOLVE * part ** (4.0 / 3.0)
    prepare = 3 * count * FACTORS * part**2 + 3 * size.joint_points * solve
    seconds = prepare + ITERATIONS * size.steps * count * (solve + OVERHEAD)
    return MethodCost(method, count, latin_memory(size.unknowns, count), seconds)


def latin_memory(unknowns: int, substructures: int) -> int:
    """Peak memory of LATIN on elastic bodies, byte."""
    fill = substructures * (unknowns / substructures) ** (4.0 / 3.0)
    return int(PER_UNKNOWN * unknowns + PER_PART * fill)


def cut_needs(
    unknowns: int,
    *,
    links: int = 0,
    joint_points: int = 0,
    substructures: int = 1,
    coarse: bool = True,
    moving: bool = False,
    slabs: int = 0,
) -> Needs:
    """Return what :func:`solve_latin` takes, or :func:`simulate_latin`.

    Examples
    --------
    >>> needs = cut_needs(3000, substructures=4)
    >>> "coarse problem" in needs.built, "joint laws" in needs.built
    (True, False)
    """
    memory = PER_LINK * links if links else latin_memory(unknowns, substructures)
    faces = substructures > 1 or joint_points > 0
    judged = coarse and not moving
    parts = (
        ("substructure stiffness", True, "factorised for each part by itself", ""),
        (
            "links",
            links > 0,
            "cables and bars inside the parts, some of which may go slack",
            "the parts are elastic bodies",
        ),
        (
            "joint laws",
            joint_points > 0,
            "jump and traction, three components a point"
            + (f"; {slabs} slabs of sliders" if slabs else ""),
            "the parts hang together",
        ),
        (
            "coarse problem",
            coarse and faces,
            "balances the parts as wholes: more parts take hardly more iterations",
            "none is asked for, or needed by the method"
            if faces
            else "there is one part and no joint",
        ),
        (
            "error bound",
            judged and not joint_points,
            "guaranteed, from forces in balance",
            "friction has no bound" if joint_points else "of statics with a coarse problem alone",
        ),
        (
            "error indicator",
            judged and joint_points > 0,
            "heuristic, of the laws of the joints",
            "without joints there is a bound" if judged else "of statics with a coarse problem",
        ),
        ("mass", moving, "of the nodes, a stiffness of the parts", "at rest"),
        ("geometric stiffness", False, "", "substructures move little"),
    )
    libraries = {"numba": links or joint_points, "scikit-fem": not links}
    return Needs(
        unknowns_per_contact=3 if joint_points else min(1, links),
        kinematics="small displacements",
        choices=tuple(choose(*part) for part in parts),
        state_variables=(
            *(("state of the laws of joints",) if joint_points else ()),
            *(("displacement", "velocity") if moving else ()),
        ),
        fields=("displacement", *(("tension", "slack") if links else ("stress", "energy"))),
        libraries=tuple(name for name, used in libraries.items() if used),
        memory=memory,
    )
