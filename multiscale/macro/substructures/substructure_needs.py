"""What a structure that is cut needs, from its size."""

from multiscale.macro.substructures.problem import CutProblem
from multiscale.needs import Needs, choose

__all__ = ["cut_needs", "needs_of"]

PER_LINK, PER_UNKNOWN, PER_FILL = 5000, 2800, 1300
"""Peak memory, byte: of a link; of an unknown of a body, for matrices and results; of that to the
power of 4/3 in a substructure, for the factors of three matrices."""


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

    Parameters
    ----------
    unknowns : int
        Of the whole structure.
    links : int
        None in elastic bodies.
    joint_points : int
        Points with an interface law.
    substructures : int
    coarse : bool
        Whether a coarse problem is wanted.
    moving : bool
        Whether the structure is followed in time.
    slabs : int
        Sliders at a point of a joint, if its law has them.

    Examples
    --------
    >>> needs = cut_needs(3000, substructures=4)
    >>> "coarse problem" in needs, "joint laws" in needs
    (True, False)
    """
    faces = substructures > 1 or joint_points > 0
    judged = coarse and not moving
    choices = {
        "substructure stiffness": (True, "factorised for each part by itself", ""),
        "links": (
            links > 0,
            "cables and bars inside the parts, some of which may go slack",
            "the parts are elastic bodies",
        ),
        "joint laws": (
            joint_points > 0,
            "jump and traction, three components a point"
            + (f"; {slabs} slabs of sliders" if slabs else ""),
            "the parts hang together",
        ),
        "coarse problem": (
            coarse and faces,
            "balances the parts as wholes: more parts take hardly more iterations",
            "coarse = false" if faces else "there is one part and no joint",
        ),
        "error bound": (
            judged and not joint_points,
            "guaranteed, from forces in balance",
            "friction has no bound" if joint_points else "of statics with a coarse problem alone",
        ),
        "error indicator": (
            judged and joint_points > 0,
            "heuristic, of the laws of the joints",
            "without joints there is a bound" if judged else "of statics with a coarse problem",
        ),
        "mass": (moving, "of the nodes, a stiffness of the parts", "at rest"),
        "geometric stiffness": (False, "", "substructures move little"),
    }
    operators, left_out = choose(choices)
    return Needs(
        unknowns_per_contact=3 if joint_points else min(1, links),
        kinematics="small displacements",
        operators=operators,
        left_out=left_out,
        state_variables=(
            *(("state of the laws of joints",) if joint_points else ()),
            *(("displacement", "velocity") if moving else ()),
        ),
        fields=("displacement", *(("tension", "slack") if links else ("stress", "energy"))),
        libraries=("numba",) if links else ("numba", "scikit-fem"),
        memory=_memory(unknowns, links, substructures),
    )


def needs_of(problem: CutProblem, *, coarse: bool = True, moving: bool = False) -> Needs:
    """Return what a problem takes; see :func:`cut_needs`."""
    return cut_needs(
        problem.n,
        links=problem.n_links,
        joint_points=sum(joint.weight.size for joint in problem.joints),
        substructures=len(problem.substructures),
        coarse=coarse,
        moving=moving,
    )


def _memory(unknowns: int, links: int, substructures: int) -> int:
    """Estimated peak, byte."""
    if links:
        return PER_LINK * links
    fill = substructures * (unknowns / substructures) ** (4.0 / 3.0)
    return int(PER_UNKNOWN * unknowns + PER_FILL * fill)
