"""The bodies of a case slide over each other: both rough, deformable and at large strain."""

import hashlib
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multiscale.io import open_dataset, write_dataset
from multiscale.laws.bulk import J2, BulkLaw, NeoHookean
from multiscale.micro import Cell, Opposite, slide_cell
from multiscale.pipeline.case_cells import body_surfaces
from multiscale.pipeline.case_tables import SlideSettings
from multiscale.pipeline.rough_bodies import Body
from multiscale.pipeline.settings import Case
from multiscale.pipeline.toml_model import read_toml
from multiscale.schema import SLIDING_RESPONSE
from multiscale.surfaces.surface import Surface

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["make_pair", "pair_of", "read_sliding", "slide_bodies"]

TOLERANCE = 1e-6
"""Of the contact solver, relative to the norm of the contact forces."""


def make_pair(case: Case, slide: SlideSettings) -> Cell:
    """Build the cell of the first realisation, of two deformable bodies; see :func:`pair_of`.

    Raises
    ------
    CaseError
        If a surface cannot be made or read.
    """
    smooth = Surface(np.zeros(case.cell.points), case.cell.size)
    lower, upper = ([*body_surfaces(case, number)[0], smooth][0] for number in (1, 2))
    return pair_of(case, slide, lower, upper)


def pair_of(case: Case, slide: SlideSettings, lower: Surface, upper: Surface) -> Cell:
    """Build the cell of two deformable bodies under their surfaces, heights out of each body.

    A body with a hardness flows (J2), another one is neo-Hookean, whose small strain is Hooke's.
    """
    depth = case.cell.depth if case.cell.depth is not None else max(case.cell.size)
    one, two = case.bodies
    return Cell(
        lower,
        depth,
        case.cell.layers,
        one.youngs_modulus,
        one.poissons_ratio,
        obstacle=Surface(-upper.heights, upper.size),
        bulk=_bulk(one),
        friction_coefficient=slide.friction_coefficient,
        opposite=Opposite(
            depth, case.cell.layers, two.youngs_modulus, two.poissons_ratio, _bulk(two)
        ),
    )


def slide_bodies(
    case: Case, slide: SlideSettings, file: Path, *, executor: Executor | None = None
) -> "xr.Dataset":
    """Slide body 2 over body 1 and write the response; one of the same case found is kept.

    Parameters
    ----------
    case : Case
    slide : SlideSettings
        Of the case.
    file : Path
        Gets the response.
    executor : Executor, optional
        For the pressures; see :func:`multiscale.executors.run_jobs`.

    Returns
    -------
    Dataset
        Follows ``SLIDING_RESPONSE``.
    """
    identity = hashlib.sha256(f"{case.identity()} {slide.model_dump_json()}".encode()).hexdigest()
    if file.exists():
        found = open_dataset(file, SLIDING_RESPONSE)
        if found.attrs.get("identity") == identity:
            return found
    response = slide_cell(
        make_pair(case, slide),
        slide.pressures or case.micro.pressures,
        slide.distance,
        steps=slide.steps,
        executor=executor,
        tolerance=TOLERANCE,
    )
    ended = str(response.attrs.get("ended", ""))
    response = response.assign_attrs(
        title=case.title,
        identity=identity,
        cautions=f"sliding went no further at {ended}" if ended else "",
    )
    write_dataset(response, file, SLIDING_RESPONSE)
    return response


def read_sliding(out: Path) -> "xr.Dataset | None":
    """Open how the bodies of a run slide, if its case says that they do.

    One that an earlier case of the same cells has left waits for it.
    """
    file = out / "sliding_response.nc"
    if not file.exists() or "slide" not in read_toml(out / "case.toml"):
        return None
    return open_dataset(file, SLIDING_RESPONSE)


def _bulk(body: Body) -> BulkLaw:
    """Law of a body at large strain."""
    if body.yield_stress is None:
        return NeoHookean(body.youngs_modulus, body.poissons_ratio)
    return J2(
        body.youngs_modulus,
        body.poissons_ratio,
        body.yield_stress,
        body.hardening_modulus or 0.0,
    )
