"""Stage: rubber slides over pieces of road."""

from collections.abc import Iterator
from itertools import product
from pathlib import Path
from time import perf_counter

import numpy as np

from multiscale.convergence import Status
from multiscale.micro.ensemble import run_realisations
from multiscale.micro.flat.viscoelastic import solve_sliding
from multiscale.needs import Choice, Needs
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Datasets, Job, Section, Stage
from multiscale.pipeline.stages.cells import caution_steep, count_cells
from multiscale.pipeline.toml_model import read_toml, validate
from multiscale.plotting.figure import Axes, on_axes
from multiscale.plotting.surface_figures import plot_road
from multiscale.schema import MICRO_RESPONSE, Dataset, PlainDataset
from multiscale.surfaces import nayak_parameter, rms_height, rms_slope, self_affine
from multiscale.surfaces.surface import Surface

__all__ = ["ROADS", "make_roads", "slide_road"]

STEP_TIME = 5e-6  # s of a point of a road at one pressure, speed and temperature


def make_roads(case: Case) -> list[Surface]:
    """Road of each realisation."""
    return [
        self_affine(case.cell.points, case.cell.size, case.sliding.seed + k, **case.road.options)
        for k in range(case.sliding.realisations)
    ]


def slide_road(case: Case, road: Surface) -> PlainDataset:
    """Slide rubber over one road at every temperature, pressure and speed, in this order."""
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
    return PlainDataset(
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
            "branch": np.zeros(len(steps), int),  # every step starts anew
            "sliding_speed": [speed for *_, speed in steps],
            "temperature": [temperature for temperature, *_ in steps],
            **{one.__name__: [one(road)] for one in statistics},
        }
    )


def _run(case: Case, found: Datasets, job: Job) -> Dataset:
    """Slide rubber over all roads; finished roads that are found are kept."""
    identity = case.identity()
    roads = make_roads(case)
    kept = job.ensemble("micro", identity, len(roads), "roads")
    response = run_realisations(slide_road, [(case, road) for road in roads], **kept)
    return response.assign_attrs(
        title=case.title,
        bodies="rubber on a rigid road, in steady sliding; small slopes",
        identity=identity,
        cautions="\n".join(
            [
                *case.cautions(),
                *caution_steep(response, "road", "friction by small slopes is only an estimate"),
            ]
        ),
    )


def _needs(case: Case) -> Needs:
    (nx, ny), told = case.cell.points, case.sliding
    steps = len(told.pressures) * len(told.speeds) * len(told.temperatures) * told.realisations
    return Needs(
        kinematics="small slopes and small strain, steady sliding",
        choices=(
            Choice(
                "complex compliance", "stiffness and loss of the rubber, for each wave of the road"
            ),
            Choice("time steps", "sliding is steady in the frame of the road", built=False),
            Choice(
                "mesh of the road",
                "a half-space of rubber is known in closed form for each wave",
                built=False,
            ),
            Choice("heat", "the temperature is even, and each of the case is given", built=False),
        ),
        memory=8 * 30 * nx * ny,
        seconds=STEP_TIME * nx * ny * steps,
    )


def _first_road(case: Case) -> Surface:
    one = case.sliding.model_copy(update={"realisations": 1})
    return make_roads(case.model_copy(update={"sliding": one}))[0]


def _sections(found: Datasets, out: Path) -> Iterator[Section]:
    def plot(ax: Axes) -> Axes:
        case = validate(Case, read_toml(out / "case.toml"), out / "case.toml", {})
        return plot_road(_first_road(case), ax=ax)

    yield Section("Road", figures={"road": on_axes(plot)})


ROADS = Stage(
    schema=MICRO_RESPONSE,
    tables=("rubber", "sliding"),
    reads={"title", "rubber", "road", "cell", "sliding"},
    run=_run,
    needs=_needs,
    prepare=_first_road,
    sections=_sections,
    pictures=("road",),
    work=count_cells,
    folders=("micro",),
)
