"""Pieces of road under sliding rubber: solved, and kept in a folder."""

from collections.abc import Callable
from concurrent.futures import Executor
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from multiscale.convergence import Status
from multiscale.io import write_dataset
from multiscale.micro.ensemble import run_realisations
from multiscale.micro.viscoelastic_sliding import solve_sliding
from multiscale.pipeline.tyre_settings import TyreCase
from multiscale.schema import MICRO_RESPONSE
from multiscale.surfaces import nayak_parameter, rms_height, rms_slope, self_affine
from multiscale.surfaces.surface import Surface

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["make_roads", "slide_road", "slide_roads"]

STEEP = 0.3  # root mean square slope


def make_roads(case: TyreCase) -> list[Surface]:
    """Road of each realisation."""
    return [
        self_affine(
            case.cell.points, case.cell.size, case.sliding.seed + k, **case.road.model_dump()
        )
        for k in range(case.sliding.realisations)
    ]


def slide_road(case: TyreCase, road: Surface) -> "xr.Dataset":
    """Slide rubber over one road at every temperature, pressure and speed, in this order.

    Returns
    -------
    Dataset
        Follows ``MICRO_RESPONSE``, with temperature and speed along ``step``.
    """
    slides = case.sliding
    steps = list(product(slides.temperatures, slides.pressures, slides.speeds))
    found, times, start = [], [], None
    for temperature, pressure, speed in steps:
        begin = perf_counter()
        one = solve_sliding(
            road,
            case.rubber.solid,
            pressure,
            speed,
            shift=case.rubber.shift(temperature),
            start=start if speed > slides.speeds[0] else None,
        )
        converged = one.status is Status.CONVERGED
        start = one.pressure if converged else None
        found.append(one)
        times.append(perf_counter() - begin)
    p = np.array([pressure for _, pressure, _ in steps])
    mean_gap = np.array([one.mean_gap for one in found])
    traction, jump = np.zeros((2, 1, len(steps), 3))
    traction[0, :, 0] = -p
    traction[0, :, 1] = p * [one.friction for one in found]
    jump[0, :, 0] = mean_gap - (road.heights.max() - road.heights.mean())
    statistics = (rms_height, rms_slope, nayak_parameter)
    return MICRO_RESPONSE.build(
        {
            "displacement_jump": jump,
            "traction": traction,
            "mean_gap": mean_gap[None],
            "contact_fraction": [[one.contact_fraction for one in found]],
            "converged": [[int(one.status is Status.CONVERGED) for one in found]],
            "active_set_iterations": [[one.active_sets for one in found]],
            "linear_iterations": [[one.linear_iterations for one in found]],
            "wall_time": np.array(times)[None],
            "nominal_pressure": p,
            "sliding_speed": [speed for *_, speed in steps],
            "temperature": [temperature for temperature, *_ in steps],
            **{one.__name__: [one(road)] for one in statistics},
        }
    )


def slide_roads(
    case: TyreCase,
    file: Path,
    *,
    executor: Executor | None = None,
    progress: Callable[[int], None] = lambda finished: None,
) -> "xr.Dataset":
    """Slide rubber over all roads and write the response; finished roads found are kept.

    Parameters
    ----------
    case : TyreCase
    file : Path
        Gets the response; realisations go to the folder ``micro`` beside it.
    executor : Executor, optional
        See :func:`multiscale.executors.run_jobs`.
    progress : callable
        Gets the number of finished realisations.

    Returns
    -------
    Dataset
        Follows ``MICRO_RESPONSE``.
    """
    identity = case.identity()
    response = run_realisations(
        slide_road,
        [(case, road) for road in make_roads(case)],
        executor=executor,
        folder=file.parent / "micro",
        identity=identity,
        progress=progress,
    )
    response = response.assign_attrs(
        title=case.title,
        bodies="rubber on a rigid road, in steady sliding; small slopes",
        identity=identity,
        cautions="\n".join([*case.cautions(), *_steepness(response)]),
    )
    write_dataset(response, file, MICRO_RESPONSE)
    return response


def _steepness(response: "xr.Dataset") -> list[str]:
    """Caution against slopes for which the half-space is no longer right."""
    steepest = float(response["rms_slope"].max())
    if steepest <= STEEP:
        return []
    return [
        f"the road has a root mean square slope of {steepest:.2g}; above {STEEP:g} friction by "
        f"small slopes is only an estimate"
    ]
