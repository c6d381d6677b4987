"""Stage: a tread block brakes on the road, by the law of friction."""

from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path
from time import perf_counter

import numpy as np

from multiscale import macro, upscaling
from multiscale.errors import ConvergenceError
from multiscale.laws import Exponential, SteadySliding
from multiscale.macro.data_range import data_ends, load_shares, with_load_shares
from multiscale.needs import Choice, Needs
from multiscale.pipeline.plans.case_knobs import tread_knobs
from multiscale.pipeline.showing import Table, View, list_facts, list_missing, tabulate_budget
from multiscale.pipeline.stage import Datasets, Section, Stage, with_sample_band
from multiscale.pipeline.stages.rubber_friction import FRICTION_LAW
from multiscale.pipeline.tables.settings import Case
from multiscale.plotting.figure import WIDE, on_axes
from multiscale.plotting.law_figures import plot_footprint
from multiscale.plotting.lines import plot_lines
from multiscale.schema import INTERFACE_LAW, MACRO_RESULT, MICRO_RESPONSE, Dataset
from multiscale.units import ZERO_CELSIUS
from multiscale.upscaling.budget import MACRO, NORMAL, Term
from multiscale.upscaling.reading import frictions_at
from multiscale.upscaling.shear_budget import NORMAL_ALONE

OTHERS = "not known: {} were solved; run the case with {} in [cell], and compare"

REPORTED = 0.05  # error of the law over the peak of the friction from which a caution is issued
SLIDE_TIME = 1.2e-9  # s of a footprint, over the cube of its unknowns, about
MOST_SAMPLES = 20  # samples of the law for which braking forces are computed, at most


def solve_treads(case: Case, response: Dataset, law: Dataset) -> Dataset:
    """Brake a tread block at every temperature and speed."""
    pressure, elements = case.tread.pressure, case.tread.elements
    fewer = tuple(-(-count // 2) for count in elements)
    tread, coarse = _condense(case, elements), _condense(case, fewer)
    steps = list(product(case.sliding.temperatures, case.sliding.speeds))
    samples = range(min(MOST_SAMPLES, law.sizes.get("sample", 0)))
    footprints, coarser, times, ranges = [], [], [], []
    sampled = np.full((len(samples), len(steps)), np.nan)
    for k, (temperature, speed) in enumerate(steps):
        begin = perf_counter()
        normal = _normal_law(response, temperature, speed)
        ranges.append(data_ends(normal))
        frictions = frictions_at(law, temperature, [None, *samples])
        mean, *drawn = (SteadySliding(normal, friction, (speed, 0.0)) for friction in frictions)
        footprints.append(macro.joint.slide_tread(tread, mean, pressure))
        coarser.append(_force(macro.joint.slide_tread(coarse, mean, pressure)))
        sampled[:, k] = [
            _force(macro.joint.slide_tread(tread, sample, pressure)) for sample in drawn
        ]
        times.append(perf_counter() - begin)
    good = np.array([footprint.solution.converged for footprint in footprints])
    failures = [
        f"no braking force at {speed:.3g} m/s and {temperature - ZERO_CELSIUS:.4g} °C: "
        f"{footprint.solution.detail}"
        for (temperature, speed), footprint in zip(steps, footprints, strict=True)
        if not footprint.solution.converged
    ]
    force = np.array([_force(footprint) for footprint in footprints])
    load = pressure * tread.block.area
    result = MACRO_RESULT.build(
        {
            "converged": good.astype(int),
            "residual": [footprint.solution.residuals[-1] for footprint in footprints],
            "wall_time": times,
            "preload": np.full(len(steps), pressure),
            "temperature": [temperature for temperature, _ in steps],
            "sliding_speed": [speed for _, speed in steps],
            "braking_force": force,
            "braking_coefficient": force / load,
            **({"braking_force_sample": sampled} if samples else {}),
            "traction": np.where(
                good[:, None, None], [footprint.traction.T for footprint in footprints], np.nan
            ),
            "point_position": np.vstack([tread.position, np.zeros(tread.weight.size)]).T,
            "point_area": tread.weight,
        },
        title=case.title,
        cautions="\n".join(filter(None, [_missed(law), *failures])),
    )
    data, pressures = np.array(ranges), -result["traction"].to_numpy()[..., 0]
    shares = load_shares(pressures, tread.weight, data)[..., None]
    ends = np.array([[data[:, 0].max(), *data[:, 1:].min(axis=0)]])
    result = with_load_shares(result, shares, ends, extrapolate=case.law.extrapolate)
    ratio = float(np.prod(elements) / np.prod(fewer)) ** (1.0 / 3.0)
    coarse_force = {ratio: np.array(coarser)} if ratio > 1.0 else {}
    result = _with_budget(result, law, coarse_force)
    total = result["error_total"].where(result["known"] == 1)
    edge = min(case.tread.length, case.tread.width)
    return result.assign(error_total=total).assign_attrs(
        facts=upscaling.cell_share(max(case.cell.size), edge)
    )


def _condense(case: Case, elements: tuple[int, ...]) -> "macro.joint.CondensedTread":
    block, (nx, ny, nz) = case.tread, elements
    size = (block.length, block.width, block.height)
    rubber = case.rubber
    return macro.joint.condense_tread(
        macro.joint.TreadBlock(size, rubber.relaxed_modulus, rubber.poissons_ratio, (nx, ny, nz))
    )


def _force(footprint: "macro.joint.Footprint") -> float:
    """Braking force, N; NaN if it did not converge."""
    return footprint.braking_force if footprint.solution.converged else np.nan


def _missed(law: Dataset) -> str:
    error = float(law.attrs["largest_error_over_peak"])
    if error <= REPORTED:
        return ""
    return (
        f"the fitted curve differs from the cells by up to {100.0 * error:.2g} % of its peak, at "
        f"{law.attrs['largest_error_speed']:.3g} m/s and "
        f"{law.attrs['largest_error_temperature'] - ZERO_CELSIUS:.4g} °C, which is more than "
        f"the intervals of the forces, as these contain only the scatter of the road"
    )


def _normal_law(response: Dataset, temperature: float, speed: float) -> Exponential:
    """Exponential law of the mean gaps at one temperature and speed."""
    at = (response["temperature"].values == temperature) & (
        response["sliding_speed"].values == speed
    )
    steps = response.isel(step=np.flatnonzero(at))
    gaps = np.where(steps["converged"].values == 1, steps["mean_gap"].values, np.nan)
    seen = upscaling.observe("gap", steps["nominal_pressure"].values, gaps)
    law = upscaling.law_from_dataset(upscaling.fit_law(seen, family="exponential", n_samples=0))
    if not isinstance(law, Exponential):
        raise TypeError(f"expected an exponential law, got {type(law).__name__}")
    return law


def _needs(case: Case) -> Needs:
    ex, ey, ez = case.tread.elements
    face = 3 * (2 * ex + 1) * (2 * ey + 1) + 1
    steps = len(case.sliding.temperatures) * len(case.sliding.speeds)
    return Needs(
        choices=(Choice("tread block", f"condensed onto the {face} unknowns of its face"),),
        fields=("traction of the footprint",),
        libraries=("matplotlib", "scikit-fem"),
        memory=8 * (6 * face**2 + 40 * face * face * ez),
        seconds=SLIDE_TIME * face**3 * steps * (1 + min(MOST_SAMPLES, case.law.samples)),
    )


def _check(result: Dataset) -> None:
    if not result["converged"].values.any():
        raise ConvergenceError(
            f"the tread block did not converge at any speed and temperature:\n"
            f"{result.attrs['cautions']}"
        )


def braking_answer(result: Dataset) -> Iterator[str]:
    """Report the largest braking force at every temperature, and its speed."""
    for temperature in np.unique(result["temperature"].values):
        at = result.isel(step=np.flatnonzero(result["temperature"].values == temperature))
        if at["braking_force"].isnull().all():
            yield f"At {temperature - ZERO_CELSIUS:.4g} °C no force is known."
        else:
            yield from View(result).sentences(
                _hardest(at),
                "At {temperature} the braking force is at most {braking_force:±}, "
                "{braking_coefficient} of the load, at {sliding_speed}.",
            )
    yield from list_missing(result)


def _hardest(result: Dataset) -> Dataset:
    return result.isel(step=int(np.nanargmax(result["braking_force"].values)))


def _sections(datasets: Datasets, out: Path) -> Iterator[Section]:
    result = datasets[BRAKING.name]
    shown = with_sample_band(result, "braking_force")
    force = on_axes(plot_lines, shown, "braking_force", by="temperature", xscale="log", size=WIDE)
    rows = TABLE.rows(shown)
    yield Section(
        "Tread block", (), *rows, figures={"braking_force": force}, remarks=list_facts(result)
    )
    best = int(np.nanargmax(result["braking_force"].values))
    yield Section(
        "Error budget",
        ["Half-widths of the 95 % intervals of the largest braking force."],
        *tabulate_budget(result.isel(step=[best])),
        notes=True,
        printed=False,
    )
    pressed = on_axes(plot_footprint, result, best)
    rubbed = on_axes(plot_footprint, result, best, quantity="friction")
    yield Section(
        "Footprint", figures={"footprint_pressure": pressed, "footprint_friction": rubbed}
    )


TABLE = Table(
    (
        "temperature",
        "sliding_speed",
        "braking_force",
        "braking_force:mean_law",
        "braking_coefficient",
    ),
    {"braking_force:mean_law": "sampling, 95 %", "braking_coefficient": "force / load"},
    answer="braking_force",
    at=2,
)


def _with_budget(result: Dataset, law: Dataset, coarser: Mapping[float, np.ndarray]) -> Dataset:
    """Return the result of a tread block with the error budget of its braking force."""
    force = np.abs(result["braking_force"].to_numpy())
    nothing = np.zeros((1, force.size))
    missed = float(law.attrs["rms_error_over_peak"]) * float(law["peak_coefficient"])
    fit = NORMAL * missed / np.abs(result["braking_coefficient"].to_numpy())
    bounds = {
        "sampling": Term(
            "not known: the law has no samples; give them in [law], and 3 or more realisations in "
            "[sliding]"
        ),
        "fit": Term("root mean square difference between the fitted curve and the cells", fit),
        "cell size": Term(OTHERS.format("cells of one size", "another size")),
        "micro discretisation": Term(OTHERS.format("cells on one grid", "other points")),
        "increments": Term("nothing: rubber does not flow", nothing),
        "small slopes": Term("not known: the half-space of the rubber assumes small slopes"),
        "surface": Term(
            "nothing: the roads are made from a spectrum, which the cells contain completely",
            nothing,
        ),
        "friction bed": NORMAL_ALONE,
        "scale separation": Term(
            "not known: the footprint has uniform pressure over the wavelengths of the road"
        ),
        MACRO: Term(
            "not known: elements of twice the size do not fit; give smaller elements in [tread]"
        ),
    }
    sources: list[upscaling.Source] = []
    if result.sizes.get("sample", 0) > 1:
        samples = result["braking_force_sample"].to_numpy()
        scatter = NORMAL * np.std(samples, axis=0, ddof=1) / force
        bounds["sampling"] = Term(f"{len(samples)} bootstrap samples of the law", scatter)
    if coarser:
        del bounds[MACRO]
        sources.append(
            upscaling.Knob(name="elements", ratios=[*coarser], answers=[*coarser.values()])
        )
    sources.append(upscaling.Bound(name="law of friction", bounds=bounds))
    return upscaling.with_budget(result, upscaling.propagate("braking_force", sources, value=force))


BRAKING = Stage(
    schema=MACRO_RESULT,
    tables=("rubber", "tread"),
    reads={"tread"},
    takes=(FRICTION_LAW,),
    knobs=tread_knobs,
    run=lambda case, datasets, job: solve_treads(
        case, datasets[MICRO_RESPONSE.name], datasets[INTERFACE_LAW.name]
    ),
    needs=_needs,
    check=_check,
    question="Which braking force has the tread block at its speeds and temperatures?",
    answer=braking_answer,
    sections=_sections,
    answers=("braking_force", "braking_coefficient", "sliding_speed"),
    compared=lambda result: with_sample_band(_hardest(result), "braking_force"),
)
