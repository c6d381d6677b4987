"""What a case needs, told before anything heavy starts."""

from multiscale.needs import Needs, join_needs
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stages import stages_of
from multiscale.pipeline.tyre_settings import TyreCase

__all__ = ["requirements"]


def requirements(case: Case | TyreCase) -> Needs:
    """Return what the stages of a case need and what they leave out.

    Parameters
    ----------
    case : Case or TyreCase

    Examples
    --------
    >>> from multiscale.pipeline import load_case
    >>> needs = requirements(load_case("ground_steel"))
    >>> needs.unknowns_per_contact, needs.omitted["tilt"]
    (1, "Poisson's ratio below 0.4, or no elements")
    """
    return join_needs(stage.needs(case) for stage in stages_of(case.tables))
