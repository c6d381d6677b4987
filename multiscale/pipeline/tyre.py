"""From the roughness of a road to the braking force of a tread block: cells, law, footprint."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.errors import CaseError, ConvergenceError
from multiscale.io import make_folder, save_law, write_dataset
from multiscale.laws import BellFriction, Exponential, SteadySliding
from multiscale.macro.data_range import load_shares, with_load_shares
from multiscale.macro.joint import Footprint, TreadBlock, condense_tread, slide_tread
from multiscale.macro.joint.tread import CondensedTread
from multiscale.micro.viscoelastic_sliding import wlf_shift
from multiscale.needs import Needs
from multiscale.pipeline.run import Results
from multiscale.pipeline.run_folder import claim_folder
from multiscale.pipeline.tyre_budget import with_braking_budget
from multiscale.pipeline.tyre_cells import slide_roads
from multiscale.pipeline.tyre_settings import TyreCase
from multiscale.schema import MACRO_RESULT
from multiscale.upscaling import (
    cell_share,
    fit_law,
    fitted_law,
    fitted_laws,
    friction_observations,
    law_from_dataset,
    observe,
    require_law,
)

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "fit_friction",
    "friction_at",
    "run_tyre",
    "solve_treads",
    "tyre_requirements",
]

FAINT = 0.01
"""Friction over its peak, below which it is not fitted."""

TELLING = 0.05
"""Error of the law over the peak of the friction, from which a user is told."""

MOST_SAMPLES = 20
"""Of the law, that braking forces are computed for."""


def run_tyre(
    case: TyreCase,
    out: str | Path,
    *,
    executor: Executor | None = None,
    progress: Callable[[int], None] = lambda finished: None,
) -> Results:
    """Run the whole chain: sliding cells, friction law, tread blocks.

    Parameters
    ----------
    case : TyreCase
    out : path
        Run folder; made if needed. Finished cells of the same case found there are kept.
    executor : Executor, optional
        See :func:`multiscale.executors.run_jobs`.
    progress : callable
        Gets the number of finished realisations.

    Raises
    ------
    MultiscaleError
        If an input is refused, a file cannot be written, or nothing converged.
    """
    out = make_folder(Path(out))
    claim_folder(out, case)
    response = slide_roads(case, out / "micro_response.nc", executor=executor, progress=progress)
    law = fit_friction(case, response)
    save_law(law, out / "interface_law.nc")
    result = solve_treads(case, response, law)
    write_dataset(result, out / "macro_result.nc", MACRO_RESULT)
    if not result["converged"].values.any():
        raise ConvergenceError(
            f"the tread block did not converge at any speed and temperature:\n"
            f"{result.attrs['cautions']}"
        )
    return Results(response, law, result)


def fit_friction(case: TyreCase, response: "xr.Dataset") -> "xr.Dataset":
    r"""Fit the friction of all temperatures at once.

    Returns
    -------
    Dataset
        Follows ``INTERFACE_LAW``: a bell over the speed at the reference temperature;
        :func:`friction_at` makes the law of another one of it.

    Notes
    -----
    Rubber at a temperature T answers to a speed :math:`v` as at the reference to :math:`a_T v`,
    so that all temperatures together cover more of one curve; errors of the fit count by their
    size in :math:`\mu`, and a hundredth of its peak is below what a grid resolves:

    .. math:: \mu(p, v, T) = \mu_r(p, a_T v).    \tag{1}
    """
    shift = np.array([case.rubber.shift(T) for T in response["temperature"].values])
    speed = response["sliding_speed"]
    shifted = response.assign_coords(
        sliding_speed=("step", shift * speed.values, speed.attrs)  # (1)
    )
    mean, peak = _mean_friction(response)
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


def _mean_friction(response: "xr.Dataset") -> tuple[np.ndarray, float]:
    """Mean friction coefficient of the roads that converged at each step, and its largest value."""
    good = response["converged"] == 1
    shear = response["traction"].isel(component=1).where(good).mean("realisation").values
    mean = np.asarray(shear / response["nominal_pressure"].values)
    if not np.any(mean > 0.0):
        raise ConvergenceError("no cell has friction at any speed and temperature")
    return mean, float(np.nanmax(mean))


def friction_at(law: "xr.Dataset", temperature: float) -> BellFriction:
    """Friction law at a temperature, K, from a fitted one.

    Raises
    ------
    CaseError
        If the dataset holds no bell, or not what shifts it.
    """
    return _frictions_at(law, temperature, [None])[0]


def _frictions_at(
    law: "xr.Dataset", temperature: float, samples: Sequence[int | None]
) -> list[BellFriction]:
    """Do the same for the mean law (None) and for samples."""
    bells = fitted_laws(law, samples)
    if not isinstance(bells[0], BellFriction):
        raise CaseError(
            f"the dataset holds a law of the family {law.attrs.get('family')!r}, expected a bell "
            f"of friction; pass the law of a run of rubber on a road"
        )
    names = ("reference_temperature", "wlf_c1", "wlf_c2")
    require_law(law, *names)
    shift = wlf_shift(temperature, *(float(law.attrs[name]) for name in names))
    return [replace(bell, peak_speed=bell.peak_speed / shift) for bell in bells]


def solve_treads(case: TyreCase, response: "xr.Dataset", law: "xr.Dataset") -> "xr.Dataset":
    """Brake a tread block at every temperature and speed.

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``, with temperature and speed along ``step``.
    """
    pressure, elements = case.tread.pressure, case.tread.elements
    fewer = tuple(-(-count // 2) for count in elements)
    tread, coarse = _condense(case, elements), _condense(case, fewer)
    steps = list(product(case.sliding.temperatures, case.sliding.speeds))
    samples = range(min(MOST_SAMPLES, law.sizes.get("sample", 0)))
    found, coarser, times, ranges = [], [], [], []
    sampled = np.full((len(samples), len(steps)), np.nan)
    for k, (temperature, speed) in enumerate(steps):
        begin = perf_counter()
        normal = _normal_law(response, temperature, speed)
        ranges.append(normal.pressure_range)
        frictions = _frictions_at(law, temperature, [None, *samples])
        mean, *drawn = (SteadySliding(normal, one, (speed, 0.0)) for one in frictions)
        found.append(slide_tread(tread, mean, pressure))
        coarser.append(_force(slide_tread(coarse, mean, pressure)))
        sampled[:, k] = [_force(slide_tread(tread, one, pressure)) for one in drawn]
        times.append(perf_counter() - begin)
    good = np.array([one.solution.converged for one in found])
    failures = [
        f"no braking force at {speed:.3g} m/s and {temperature - 273.15:.4g} °C: "
        f"{one.solution.detail}"
        for (temperature, speed), one in zip(steps, found, strict=True)
        if not one.solution.converged
    ]
    force = np.array([_force(one) for one in found])
    load = pressure * tread.block.area
    result = MACRO_RESULT.build(
        {
            "converged": good.astype(int),
            "residual": [one.solution.residuals[-1] for one in found],
            "wall_time": times,
            "preload": np.full(len(steps), pressure),
            "temperature": [temperature for temperature, _ in steps],
            "sliding_speed": [speed for _, speed in steps],
            "braking_force": force,
            "braking_coefficient": force / load,
            **({"braking_force_sample": sampled} if samples else {}),
            "traction": np.where(good[:, None, None], [one.traction.T for one in found], np.nan),
            "point_position": np.vstack([tread.position, np.zeros(tread.weight.size)]).T,
            "point_area": tread.weight,
        },
        title=case.title,
        cautions="\n".join(filter(None, [_missed(law), *failures])),
    )
    pressure_of = np.array(
        [np.where(one.solution.converged, -one.traction[0], np.nan) for one in found]
    )
    data = np.array(ranges)
    shares = load_shares(pressure_of, tread.weight, data)[..., None]
    ends = np.array([[data[:, 0].max(), data[:, 1].min()]])
    result = with_load_shares(result, shares, ends, extrapolate=case.law.extrapolate)
    ratio = float(np.prod(elements) / np.prod(fewer)) ** (1.0 / 3.0)
    coarse_force = {ratio: np.array(coarser)} if ratio > 1.0 else {}
    result = with_braking_budget(result, law, coarse_force)
    total = result["error_total"].where(result["known"] == 1)
    edge = min(case.tread.length, case.tread.width)
    return result.assign(error_total=total).assign_attrs(
        facts=cell_share(max(case.cell.size), edge)
    )


def _condense(case: TyreCase, elements: tuple[int, ...]) -> CondensedTread:
    """Condense the tread block on so many elements."""
    block, (nx, ny, nz) = case.tread, elements
    size = (block.length, block.width, block.height)
    rubber = case.rubber
    return condense_tread(
        TreadBlock(size, rubber.relaxed_modulus, rubber.poissons_ratio, (nx, ny, nz))
    )


def _force(footprint: Footprint) -> float:
    """Braking force, N; NaN if it did not converge."""
    return footprint.braking_force if footprint.solution.converged else np.nan


def _missed(law: "xr.Dataset") -> str:
    """Caution against forces where the bell misses the cells."""
    error = float(law.attrs["largest_error_over_peak"])
    if error <= TELLING:
        return ""
    return (
        f"the bell misses the cells by up to {100.0 * error:.2g} % of its peak, most at "
        f"{law.attrs['largest_error_speed']:.3g} m/s and "
        f"{law.attrs['largest_error_temperature'] - 273.15:.4g} °C, more than the bands of the "
        f"forces say, which hold the scatter of the road alone"
    )


def _normal_law(response: "xr.Dataset", temperature: float, speed: float) -> Exponential:
    """Exponential law of the mean gaps at one temperature and speed."""
    at = (response["temperature"].values == temperature) & (
        response["sliding_speed"].values == speed
    )
    part = response.isel(step=np.flatnonzero(at))
    gaps = np.where(part["converged"].values == 1, part["mean_gap"].values, np.nan)
    seen = observe("gap", part["nominal_pressure"].values, gaps)
    law = law_from_dataset(fit_law(seen, family="exponential", n_samples=0))
    if not isinstance(law, Exponential):
        raise TypeError(f"expected an exponential law, got {type(law).__name__}")
    return law


def tyre_requirements(case: TyreCase) -> Needs:
    """Return what a case of sliding rubber needs and what it leaves out."""
    nx, ny = case.cell.points
    ex, ey, ez = case.tread.elements
    face = 3 * (2 * ex + 1) * (2 * ey + 1) + 1
    return Needs(
        unknowns_per_contact=1,
        kinematics="small slopes and small strain, steady sliding",
        operators={
            "complex compliance": "stiffness and loss of the rubber, for each wave of the road",
            "tread block": f"{face} unknowns on its face stand for all of it",
            "friction law": "a bell over speed and temperature, with samples for its bands",
        },
        left_out={
            "time steps": "sliding is steady in the frame of the road",
            "mesh of the road": "a half-space of rubber is known in closed form for each wave",
            "heat": "the temperature is even, and each of the case is given",
        },
        fields=("traction of the footprint",),
        libraries=("matplotlib", "scikit-fem"),
        memory=int(8 * max(30 * nx * ny, 6 * face**2 + 40 * face * face * ez)),
    )
