"""Stages: rubber slides over sections of road; its friction over speed and temperature."""

from collections.abc import Iterator
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from multiscale.convergence import Status
from multiscale.errors import ConvergenceError
from multiscale.micro.elastic.viscoelastic import solve_sliding
from multiscale.micro.ensemble import run_realisations
from multiscale.needs import Choice, Needs
from multiscale.pipeline.plans.case_knobs import road_knobs
from multiscale.pipeline.stage import Datasets, Job, Section, Stage
from multiscale.pipeline.stages.cells import caution_steep, count_cells
from multiscale.pipeline.tables.settings import Case
from multiscale.pipeline.tables.toml_model import read_toml, validate
from multiscale.plotting.figure import Axes, on_axes
from multiscale.plotting.law_figures import plot_friction_bell
from multiscale.plotting.surface_figures import plot_road
from multiscale.schema import INTERFACE_LAW, MACRO_RESULT, MICRO_RESPONSE, Dataset, PlainDataset
from multiscale.surfaces import rms_height, rms_slope, self_affine
from multiscale.surfaces.fourier import nayak_parameter
from multiscale.surfaces.surface import Surface
from multiscale.units import ZERO_CELSIUS
from multiscale.upscaling import fit_law, fitted_law, friction_observations, require_law

NOT_BUILT = {
    "time steps": "sliding is steady in the frame of the road",
    "mesh of the road": "a half-space of rubber has a closed form for each mode",
    "heat": "the temperature is uniform, and the case gives it",
}
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
    solved, times, start = [], [], None
    for temperature, pressure, speed in steps:
        begin = perf_counter()
        slide = solve_sliding(
            road,
            case.rubber.solid,
            pressure,
            speed,
            shift=case.rubber.shift(temperature),
            start=start if speed > slides.speeds[0] else None,
        )
        converged = slide.status is Status.CONVERGED
        start = slide.pressure if converged else None
        solved.append(slide)
        times.append(perf_counter() - begin)
    p = np.array([pressure for _, pressure, _ in steps])
    mean_gap = np.array([slide.mean_gap for slide in solved])
    traction, jump = np.zeros((2, 1, len(steps), 3))
    traction[0, :, 0] = -p
    traction[0, :, 1] = p * [slide.friction for slide in solved]
    jump[0, :, 0] = mean_gap - (road.heights.max() - road.heights.mean())
    statistics = (rms_height, rms_slope, nayak_parameter)
    return PlainDataset(
        {
            "displacement_jump": jump,
            "traction": traction,
            "mean_gap": mean_gap[None],
            "contact_fraction": [[slide.contact_fraction for slide in solved]],
            "converged": [[int(slide.status is Status.CONVERGED) for slide in solved]],
            "active_set_iterations": [[slide.active_sets for slide in solved]],
            "linear_iterations": [[slide.linear_iterations for slide in solved]],
            "wall_time": np.array(times)[None],
            "nominal_pressure": p,
            "branch": np.zeros(len(steps), int),  # every step is a new contact
            "sliding_speed": [speed for *_, speed in steps],
            "temperature": [temperature for temperature, *_ in steps],
            **{statistic.__name__: [statistic(road)] for statistic in statistics},
        }
    )


def _run(case: Case, datasets: Datasets, job: Job) -> Dataset:
    """Slide rubber over all roads; finished roads are not solved again."""
    identity = case.identity()
    roads = make_roads(case)
    options = job.ensemble("micro", identity, len(roads), "roads")
    response = run_realisations(slide_road, [(case, road) for road in roads], **options)
    steep = caution_steep(response, "road", "friction by small slopes is only an estimate")
    return response.assign_attrs(
        title=case.title,
        bodies="rubber on a rigid road, in steady sliding; small slopes",
        identity=identity,
        cautions="\n".join([*case.cautions(), *steep]),
    )


def _needs(case: Case) -> Needs:
    (nx, ny), sliding = case.cell.points, case.sliding
    steps = len(sliding.pressures) * len(sliding.speeds) * len(sliding.temperatures)
    steps *= sliding.realisations
    each = "stiffness and loss of the rubber, for each mode of the road"
    built = Choice("complex compliance", each)
    return Needs(
        kinematics="small slopes and small strain, steady sliding",
        choices=(built, *(Choice(part, why, built=False) for part, why in NOT_BUILT.items())),
        memory=8 * 30 * nx * ny,
        seconds=STEP_TIME * nx * ny * steps,
    )


def _first_road(case: Case) -> Surface:
    sliding = case.sliding.model_copy(update={"realisations": 1})
    return make_roads(case.model_copy(update={"sliding": sliding}))[0]


def _sections(datasets: Datasets, out: Path) -> Iterator[Section]:
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
    work=count_cells,
    knobs=road_knobs,
    folders=("micro",),
)


LAW = (
    "n_realisations",
    "pressure_min",
    "pressure_max",
    "reference_temperature",
    "peak_coefficient",
    "peak_speed",
    "reference_pressure",
    "speed_exponent",
    "rms_error_over_peak",
    "largest_error_over_peak",
    "largest_error_speed",
    "largest_error_temperature",
    "admissibility",
)
"""Attributes of a law of friction on the page."""


BELL = Choice("friction law", "a bell over speed and temperature, with samples for its intervals")
FAINT = 0.01  # friction over its peak below which the law is not fitted


def fit_friction(case: Case, response: Dataset) -> Dataset:
    r"""Fit the friction of all temperatures at once, :math:`\mu(p, v, T) = \mu_r(p, a_T v)` (1)."""
    shift = np.array([case.rubber.shift(T) for T in response["temperature"].values])
    speed = response["sliding_speed"]
    shifted = response.assign_coords(
        sliding_speed=("step", shift * speed.values, speed.attrs)  # (1)
    )
    good = response["converged"] == 1
    shear = response["traction"].isel(component=1).where(good).mean("realisation").values
    mean = np.asarray(shear / response["nominal_pressure"].values)
    peak = float(np.nanmax(mean, initial=0.0))
    if peak <= 0.0:
        raise ConvergenceError("no cell has friction at any speed and temperature")
    seen = np.flatnonzero(mean > FAINT * peak)
    law = fit_law(
        friction_observations(shifted.isel(step=seen)),
        family="bell",
        n_samples=case.law.samples,
        weights=(mean[seen] / peak) ** 2,
    )
    bell: Any = fitted_law(law)
    error = bell.coefficient(response["nominal_pressure"].values, shifted["sliding_speed"].values)
    error = np.abs(error - mean) / peak
    worst = int(np.nanargmax(error))
    return law.assign_attrs(
        reference_temperature=case.rubber.reference_temperature,
        wlf_c1=case.rubber.wlf_c1,
        wlf_c2=case.rubber.wlf_c2,
        rms_error_over_peak=float(np.sqrt(np.nanmean(error**2))),
        largest_error_over_peak=float(error[worst]),
        largest_error_speed=float(speed[worst]),
        largest_error_temperature=float(response["temperature"][worst]),
    )


def _law_sections(datasets: Datasets, out: Path) -> Iterator[Section]:
    response, law = datasets[MICRO_RESPONSE.name], datasets[FRICTION_LAW.name]
    require_law(law, *LAW)
    count = int(law.attrs["n_realisations"])
    values = law.attrs
    pressure = float(datasets[MACRO_RESULT.name]["preload"][0])
    bell = on_axes(plot_friction_bell, response, law, pressure)
    yield Section(
        "Friction law",
        [
            f"The law describes: {response.attrs['bodies']}. It is fitted to {count} "
            f"realisation{'s' * (count > 1)} between {1e-3 * values['pressure_min']:.4g} and "
            f"{1e-3 * values['pressure_max']:.4g} kPa.",
            f"At {values['reference_temperature'] - ZERO_CELSIUS:.4g} °C friction peaks at "
            f"{float(law['peak_coefficient']):.3g} and {float(law['peak_speed']):.3g} m/s "
            f"under {1e-3 * float(law['reference_pressure']):.3g} kPa; the speed of the "
            f"peak varies with the power {float(law['speed_exponent']):.2g} of the pressure, and "
            f"shifts with the temperature.",
            "The fitted curve differs from the cells by "
            f"{100.0 * values['rms_error_over_peak']:.2g} % of the peak (root mean square), and by "
            f"at most {100.0 * values['largest_error_over_peak']:.2g} %, at "
            f"{values['largest_error_speed']:.3g} m/s and "
            f"{values['largest_error_temperature'] - ZERO_CELSIUS:.4g} °C.",
            "The friction is hysteresis on the wavelengths of the road in the case, without "
            "adhesion or finer texture.",
            f"Admissibility: {values['admissibility']}.",
        ],
        figures={"friction": bell},
    )


FRICTION_LAW = Stage(
    schema=INTERFACE_LAW,
    tables=("rubber", "sliding"),
    reads={"law"},
    takes=(ROADS,),
    run=lambda case, datasets, job: fit_friction(case, datasets[MICRO_RESPONSE.name]),
    needs=lambda case: Needs(choices=(BELL,), seconds=1.0),
    sections=_law_sections,
)
