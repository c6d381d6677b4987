"""What a case needs, told before anything heavy starts."""

from dataclasses import replace

import numpy as np

from multiscale.io.surfaces import Surface
from multiscale.micro.needs import cell_needs
from multiscale.needs import Needs
from multiscale.pipeline.cells import cell_of
from multiscale.pipeline.settings import Case, InstrumentSurface

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
    libraries = {*needs.libraries, "scikit-fem", "matplotlib"}  # the joint's blocks, the report
    if measured:
        libraries.add("SurfaceTopography")
    return replace(
        needs,
        operators=needs.operators | {"joint": "blocks and interface law, a preload at a time"},
        libraries=tuple(sorted(libraries)),
    )
