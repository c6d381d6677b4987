"""What a case needs, told before anything heavy starts."""

from dataclasses import replace

import numpy as np

from multiscale.micro.cell_needs import cell_needs
from multiscale.needs import Needs
from multiscale.pipeline.case_cells import cell_of
from multiscale.pipeline.case_slide import pair_of
from multiscale.pipeline.forecast import GRIDS, REALISATIONS, SIZES
from multiscale.pipeline.rough_bodies import InstrumentSurface
from multiscale.pipeline.settings import Case
from multiscale.surfaces.surface import Surface

__all__ = ["requirements"]


def requirements(case: Case) -> Needs:
    """Return what a case needs and what it leaves out.

    Parameters
    ----------
    case : Case

    Examples
    --------
    >>> from multiscale.pipeline import load_case
    >>> needs = requirements(load_case("ground_steel"))
    >>> needs.unknowns_per_contact, "tilt" in needs
    (1, False)
    """
    cell = cell_of(case, Surface(np.zeros(case.cell.points), case.cell.size))
    needs = cell_needs(cell, keep_fields=True)
    measured = any(isinstance(body.surface, InstrumentSurface) for body in case.bodies)
    libraries = {*needs.libraries, "matplotlib"}  # the report
    if measured:
        libraries.add("SurfaceTopography")
    nx, ny = case.cell.points
    operators = {
        "cells": f"{case.micro.realisations} of {nx} x {ny} points, each under "
        f"{len(case.micro.path)} pressures",
        **needs.operators,
        "joint": "blocks and interface law in series, in closed form",
    }
    if case.accuracy is not None:
        operators["planner"] = (
            "starts from these cells, whose memory this is, and chooses size, grid and number of "
            f"those of the answer: at most {2 ** SIZES[-1]} times as large, {2 ** GRIDS[-1]} times "
            f"as fine, {REALISATIONS[-1]}"
        )
    left_out = needs.left_out | {
        "joint mesh": "the pressure on the joint is even, and a closed form is exact"
    }
    memory = needs.memory
    if case.slide is not None:
        pair = cell_needs(pair_of(case, case.slide, cell.surface, cell.surface))
        operators["slide"] = "both bodies, deformable and at large strain, a pressure at a time"
        memory = max(memory, pair.memory)
    return replace(
        needs,
        operators=operators,
        left_out=left_out,
        libraries=tuple(sorted(libraries)),
        memory=memory,
    )
