"""What a structure that is cut needs, from its size."""

from multiscale.needs import Needs, choose

__all__ = ["PER_UNKNOWN", "cut_needs", "latin_memory"]

PER_LINK, PER_UNKNOWN, PER_FILL = 5000, 2800, 1300
"""Peak memory, byte: of a link; of an unknown of a body, for matrices and results; of that to the
power of 4/3 in a substructure, for the factors of three matrices."""


def latin_memory(unknowns: int, substructures: int) -> int:
    """Peak memory of LATIN on elastic bodies, byte."""
    fill = substructures * (unknowns / substructures) ** (4.0 / 3.0)
    return int(PER_UNKNOWN * unknowns + PER_FILL * fill)


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
