"""The error budget of a case: unknown terms name the keys of its file that would tell them."""

from collections.abc import Mapping

from multiscale.pipeline.case_cells import longest_wave
from multiscale.pipeline.settings import Case
from multiscale.schema import Dataset
from multiscale.upscaling import compare_scales, error_budget
from multiscale.upscaling.budget import how_attribute
from multiscale.upscaling.sampling import FEWEST_REALISATIONS
from multiscale.upscaling.scales import ScaleSeparation

__all__ = ["case_budget", "joint_scales"]


def joint_scales(case: Case) -> ScaleSeparation | None:
    """Compare the scales of the cells with the width of an interface under even pressure.

    Nothing varies over less than its width, which holds only so many cells. Returns None if the
    pressure on the interface is not even, or the case has no structure.
    """
    if case.interface_width is None:
        return None
    return compare_scales(longest_wave(case), max(case.cell.size), case.interface_width)


def case_budget(
    case: Case,
    response: Dataset,
    law: Dataset,
    pressed: Mapping[float, Dataset] = {},
    sheared: Mapping[float, Dataset] = {},
    control: Dataset | None = None,
) -> Dataset:
    """Estimate the errors of the law of a case whose cells have one size.

    The response is of the loading, and the control, if any, of flat cells; by the ratio of the
    spacings, ``pressed`` are responses of the first cells on several grids, and ``sheared`` laws
    with a tangential branch. The estimate follows ``ERROR_BUDGET``.
    """
    budget = error_budget(
        response,
        law,
        resolutions=pressed,
        scales=joint_scales(case),
        apart=bool(pressed),
        tangential=None if case.micro.shear is None else sheared,
        control=control,
    )
    other_size = "a target in [accuracy] solves others"
    if case.micro.unload is not False:  # which excludes a target
        other_size = "run the case with another size in [cell], and compare"
    told = {
        "sampling": f"one realisation tells nothing of the scatter; give realisations = "
        f"{FEWEST_REALISATIONS} or more in [micro]",
        "cell size": f"cells of one size were solved; {other_size}",
        "micro discretisation": "cells on one grid were solved; give coarser = 1 in [micro], "
        "which --quick leaves out",
        "scale separation": "it depends on the pressure of the structure, which a law alone does "
        "not have",
    }
    unknown = str(budget.attrs["unknown"]).split(", ")
    return budget.assign_attrs(
        {how_attribute(term): f"not known: {told[term]}" for term in told if term in unknown}
    )
