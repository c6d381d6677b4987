"""The error budget of a case: unknown terms name the keys of its file that would tell them."""

from typing import TYPE_CHECKING

from multiscale.pipeline.case_cells import longest_wave
from multiscale.pipeline.settings import Case
from multiscale.upscaling import compare_scales, error_budget
from multiscale.upscaling.bootstrap import FEWEST_REALISATIONS
from multiscale.upscaling.budget import how_attribute
from multiscale.upscaling.scales import ScaleSeparation

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["case_budget", "joint_scales"]


def joint_scales(case: Case) -> ScaleSeparation | None:
    """Compare the scales of the cells with the width of an interface under even pressure.

    Nothing varies over less than its width, which holds only so many cells. Returns None if the
    pressure on the interface is not even, or the case has no structure.
    """
    if case.interface_width is None:
        return None
    return compare_scales(longest_wave(case), max(case.cell.size), case.interface_width)


def case_budget(case: Case, response: "xr.Dataset", law: "xr.Dataset") -> "xr.Dataset":
    """Estimate the errors of the law of a case whose cells have one size and one grid.

    The response is of the loading; the estimate follows ``ERROR_BUDGET``.
    """
    tangential: dict[float, xr.Dataset] | None = None if case.micro.shear is None else {}
    budget = error_budget(response, law, scales=joint_scales(case), tangential=tangential)
    remedy = "a target in [accuracy] solves others"
    if case.micro.unload is not False:  # which excludes a target
        remedy = "run the case with another {} in [cell], and compare"
    told = {
        "sampling": f"one realisation tells nothing of the scatter; give realisations = "
        f"{FEWEST_REALISATIONS} or more in [micro]",
        "cell size": f"cells of one size were solved; {remedy.format('size')}",
        "micro discretisation": f"cells on one grid were solved; {remedy.format('points')}",
        "scale separation": "it depends on the pressure of the structure, which a law alone does "
        "not have",
    }
    unknown = str(budget.attrs["unknown"]).split(", ")
    return budget.assign_attrs(
        {how_attribute(term): f"not known: {told[term]}" for term in told if term in unknown}
    )
