"""Solution of bodies with joints by any method, and the choice of the method.

For n unknowns SuperLU needs about :math:`a n^2` seconds for factors, :math:`b n^{4/3}` for a solve
and :math:`c n^{4/3}` bytes; the constants were measured at 8,000 and 24,000 unknowns on a process,
with errors of a factor of two. Newton's method with multigrid was measured at 1e5 and 1e6 unknowns.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from multiscale.executors import usable_memory
from multiscale.macro.bodies.assembly import Assembly
from multiscale.macro.substructures.cut import cut_assembly
from multiscale.macro.substructures.latin_solver import LatinMethod
from multiscale.macro.substructures.stepping import Method
from multiscale.macro.substructures.whole import DENSE, AssembledNewton, MultigridNewton
from multiscale.needs import Needs, choose
from multiscale.schema import Dataset

FACTORS, SOLVE, DENSE_FACTORS = 4e-9, 4e-8, 2.5e-11
"""Seconds for sparse factors over the square of the unknowns, for a solve over their power of 4/3,
and for dense factors over their cube."""

CYCLES = 6e-5
"""Seconds of a Newton step with multigrid, over its unknowns."""

PER_FILL = 650
"""Peak memory of the factors of a matrix, byte, over the power of 4/3 of its unknowns."""

PER_LINK, PER_UNKNOWN, PER_LATIN_FILL, PER_MULTIGRID = 5000, 2800, 1300, 8500
"""Peak memory, byte: for a link; for matrices and results of an unknown of a body; for the factors
of three matrices of a substructure, over the power of 4/3 of its unknowns; for an unknown with
multigrid."""

NEWTON_STEPS, ITERATIONS, OVERHEAD = 5, 27, 6e-3
"""Newton steps and iterations of LATIN for a load step; seconds of an iteration for joint, coarse
problem and acceleration of a substructure."""

PAYS = 0.5
"""Time relative to a more accurate method below which a method is chosen."""

FASTER: dict[type[Method], str] = {
    MultigridNewton: "multigrid needs less than half the time of factors",
    LatinMethod: "factors of single bodies, used for the whole path, need less than half the time",
}
"""Reasons for the choice of a method that is not the first."""

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
    load_factor : float or ndarray, shape (steps,) or (steps, cases)
        Factors of the load cases, a row for each step; the first step starts from rest, each other
        from the step before. With bolts, the first factor multiplies their preloads, and a step
        that changes it tightens them; :func:`follow` can also continue an earlier path.
    method : Method
        :class:`AssembledNewton`, :class:`MultigridNewton`, :class:`LatinMethod` or
        :class:`NewtonSchur`

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``: displacement of the nodes of all bodies in turn, jump and traction
        at the points of the interfaces, which are nodes, in the frame of each interface (normal,
        then both tangents), and the force of the bolts. A step that did not converge, or after
        which a bolt has no force, is NaN with ``converged`` 0, later steps are not tried, and the
        attribute ``failure`` has the reason. Points follow the order of the pairs of adjacent
        substructures; ``point_joint`` is the interface of each.

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
    """Size of bodies with joints, on which the cost of a solve depends.

    Attributes
    ----------
    unknowns, joint_points, bodies, steps : int
        Unknowns of all bodies, points of all joints, bodies, and load steps of the path.
    compliant : bool, whether the laws give the traction of a jump; rigid contact does not
    """

    unknowns: int
    joint_points: int
    bodies: int
    steps: int
    compliant: bool = True


@dataclass(frozen=True)
class MethodCost:
    """Cost of a method."""

    method: Method
    substructures: int  # 1 for the whole
    memory: int  # peak, byte
    seconds: float  # estimate on one process

    def __str__(self) -> str:
        """Return method, memory and time in words."""
        x, y = self.method.parts
        cut = "" if x * y == 1 else f" with {x} x {y} substructures a body"
        size, time = f"{1e-9 * self.memory:.2g} GB", f"{self.seconds:.2g} s"
        return f"{self.method.name}{cut} needs {size} and about {time}"


@dataclass(frozen=True)
class MethodChoice:
    """The chosen method, the reason, and the costs of the other methods."""

    taken: MethodCost
    why: str
    others: tuple[MethodCost, ...]

    def explain(self) -> str:
        """Return choice, reason and costs in a line."""
        others = "; ".join(str(other) for other in self.others)
        return f"{self.taken}: {self.why}" + (f" ({others})" if others else "")


def choose_method(
    size: JointSize,
    asked: Method | None = None,
    *,
    memory: float | None = None,
) -> MethodChoice:
    """Choose the method that solves bodies with joints.

    Parameters
    ----------
    asked : Method, optional, choice of the user, which is followed
    memory : float, optional, byte available; four fifths of the memory of this machine if not given

    Returns
    -------
    MethodChoice
        Newton's method on the whole, with factors if they fit into the memory, with multigrid if
        they do not or if it needs less than half of their time; LATIN on uncut bodies if it needs
        less than half of that; else LATIN with the first cut that fits. On one process a cut never
        saves time, and saves memory from 4 x 2 substructures a body on, because the factors of all
        substructures are stored.

    Examples
    --------
    >>> small, long = JointSize(8000, 220, 2, 23), JointSize(24000, 325, 2, 75)
    >>> [type(choose_method(size, memory=1e10).taken.method).__name__ for size in (small, long)]
    ['AssembledNewton', 'LatinMethod']
    """
    limit = usable_memory() if memory is None else memory
    newton, multigrid, bodies, *cuts = _costs(size)
    if asked is not None:
        named = {type(cost.method): cost for cost in (newton, multigrid)}
        taken = named.get(type(asked)) or _latin_cost(size, asked)
        others = [cost for cost in (newton, bodies) if cost.method != taken.method]
        return MethodChoice(taken, "it is the choice of the case", tuple(others))
    room = f"of {1e-9 * limit:.2g} GB"
    reason = f"the factors of the whole do not fit into the memory {room}"
    if not size.compliant:
        reason = "Newton's method does not support rigid contact"
    elif newton.memory <= limit:
        reason = f"its factors fit into the memory {room}, and it is the most accurate"

    # the first that fits, unless a later method needs less than half of its time
    whole = [newton, multigrid] if size.compliant else []
    fits = [cost for cost in (*whole, bodies, *cuts) if cost.memory <= limit]
    if not fits:
        reason += ", nor do the factors of its substructures on one process"
        return MethodChoice(cuts[-1], reason, (newton,))
    taken = fits[0]
    for cost in fits[1:]:
        if cost in (multigrid, bodies) and cost.seconds < PAYS * taken.seconds:
            taken, reason = cost, FASTER[type(cost.method)]
    others = [cost for cost in (newton, multigrid, bodies) if cost in fits or cost is newton]
    return MethodChoice(taken, reason, tuple(cost for cost in others if cost is not taken))


def _costs(size: JointSize) -> Iterator[MethodCost]:
    """Costs of Newton's method by factors and multigrid, then of LATIN on uncut and cut bodies."""
    n, boundary = size.unknowns, 6 * size.joint_points
    seconds = NEWTON_STEPS * size.steps * FACTORS * n**2
    if boundary <= DENSE:
        condensed = FACTORS * n**2 + boundary * SOLVE * n ** (4.0 / 3.0)
        seconds = condensed + NEWTON_STEPS * size.steps * DENSE_FACTORS * boundary**3
    memory = int(PER_UNKNOWN * n + PER_FILL * n ** (4.0 / 3.0))
    yield MethodCost(AssembledNewton(), 1, memory, seconds)
    cycles = NEWTON_STEPS * size.steps * CYCLES * n
    yield MethodCost(MultigridNewton(), 1, PER_MULTIGRID * n, cycles)
    for parts in CUTS:
        yield _latin_cost(size, LatinMethod(parts))


def _latin_cost(size: JointSize, method: Method) -> MethodCost:
    count = size.bodies * method.parts[0] * method.parts[1]
    m = size.unknowns / count  # of a substructure
    solve = SOLVE * m ** (4.0 / 3.0)
    prepare = 3 * count * FACTORS * m**2 + 3 * size.joint_points * solve
    seconds = prepare + ITERATIONS * size.steps * count * (solve + OVERHEAD)
    return MethodCost(method, count, latin_memory(size.unknowns, count), seconds)


def latin_memory(unknowns: int, substructures: int) -> int:
    """Peak memory of LATIN on elastic bodies, byte."""
    fill = substructures * (unknowns / substructures) ** (4.0 / 3.0)
    return int(PER_UNKNOWN * unknowns + PER_LATIN_FILL * fill)


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
    """Return the needs of :func:`solve_latin` or :func:`simulate_latin`.

    Examples
    --------
    >>> needs = cut_needs(3000, substructures=4)
    >>> "coarse problem" in needs.built, "joint laws" in needs.built
    (True, False)
    """
    memory = PER_LINK * links if links else latin_memory(unknowns, substructures)
    faces = substructures > 1 or joint_points > 0
    judged = coarse and not moving
    choices = (
        ("substructure stiffness", True, "factorised for each substructure separately", ""),
        (
            "links",
            links > 0,
            "cables and bars inside the substructures, some of which may go slack",
            "the substructures are elastic bodies",
        ),
        (
            "joint laws",
            joint_points > 0,
            "jump and traction, three components a point"
            + (f"; {slabs} slabs of sliders" if slabs else ""),
            "the substructures are connected without joints",
        ),
        (
            "coarse problem",
            coarse and faces,
            "balances the resultants: the iterations hardly grow with the number of substructures",
            "it is switched off, or the method does not need it"
            if faces
            else "there is one substructure and no joint",
        ),
        (
            "error bound",
            judged and not joint_points,
            "guaranteed, from forces in equilibrium",
            "friction has no bound" if joint_points else "only for statics with a coarse problem",
        ),
        (
            "error indicator",
            judged and joint_points > 0,
            "heuristic, of the laws of the joints",
            "without joints there is a bound"
            if judged
            else "only for statics with a coarse problem",
        ),
        ("mass", moving, "of the nodes, a stiffness of the substructures", "at rest"),
        ("geometric stiffness", False, "", "displacements are small"),
    )
    libraries = {"numba": links or joint_points, "scikit-fem": not links}
    return Needs(
        unknowns_per_contact=3 if joint_points else min(1, links),
        kinematics="small displacements",
        choices=tuple(choose(*choice) for choice in choices),
        state_variables=(
            *(("state of the laws of joints",) if joint_points else ()),
            *(("displacement", "velocity") if moving else ()),
        ),
        fields=("displacement", *(("tension", "slack") if links else ("stress", "energy"))),
        libraries=tuple(name for name, used in libraries.items() if used),
        memory=memory,
    )
