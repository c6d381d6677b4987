"""What a case needs, told before anything heavy starts."""

from dataclasses import replace

from multiscale.needs import Needs, join_needs
from multiscale.pipeline.case import AnyCase
from multiscale.pipeline.stages import stages_of

__all__ = ["requirements"]


def requirements(case: AnyCase, *, processes: int = 1) -> Needs:
    """Return what the stages of a case need and what they leave out.

    Parameters
    ----------
    case : Case or TyreCase
    processes : int
        That share the substructures of a structure.

    Examples
    --------
    >>> from multiscale.pipeline import load_case
    >>> needs = requirements(load_case("ground_steel"))
    >>> needs.unknowns_per_contact, needs.omitted["tilt"]
    (1, "Poisson's ratio below 0.4, or no elements")
    """
    needs = join_needs(stage.needs(case) for stage in stages_of(case.tables))
    if processes == 1:
        return needs
    return replace(needs, libraries=tuple(sorted({*needs.libraries, "mpi4py"})))
