"""Stage: the law of the friction of rubber, over speed and temperature."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from multiscale.errors import ConvergenceError
from multiscale.needs import Choice, Needs
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Datasets, Section, Stage
from multiscale.pipeline.stages.roads import ROADS
from multiscale.plotting.figure import on_axes
from multiscale.plotting.tyre_figures import plot_friction_bell
from multiscale.schema import INTERFACE_LAW, MACRO_RESULT, MICRO_RESPONSE, Dataset
from multiscale.units import ZERO_CELSIUS
from multiscale.upscaling import fit_law, fitted_law, friction_observations, require_law

__all__ = ["FRICTION_LAW", "fit_friction"]

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
"""What the page says of a law of friction."""


FAINT = 0.01
"""Friction over its peak, below which it is not fitted."""


def fit_friction(case: Case, response: Dataset) -> Dataset:
    r"""Fit the friction of all temperatures at once.

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


def _needs(case: Case) -> Needs:
    told = "a bell over speed and temperature, with samples for its bands"
    return Needs(choices=(Choice("friction law", told),), seconds=1.0)


def _sections(found: Datasets, out: Path) -> Iterator[Section]:
    response, law = found[MICRO_RESPONSE.name], found[FRICTION_LAW.name]
    require_law(law, *LAW)
    count = int(law.attrs["n_realisations"])
    values = law.attrs
    pressure = float(found[MACRO_RESULT.name]["preload"][0])
    bell = on_axes(plot_friction_bell, response, law, pressure)
    yield Section(
        "Friction law",
        [
            f"The law stands for {response.attrs['bodies']}; it rests on "
            f"{count} realisation{'s' * (count > 1)} between "
            f"{1e-3 * values['pressure_min']:.4g} and "
            f"{1e-3 * values['pressure_max']:.4g} kPa.",
            f"At {values['reference_temperature'] - ZERO_CELSIUS:.4g} °C friction peaks at "
            f"{float(law['peak_coefficient']):.3g} and {float(law['peak_speed']):.3g} m/s "
            f"under {1e-3 * float(law['reference_pressure']):.3g} kPa; the speed of the "
            f"peak goes with the power {float(law['speed_exponent']):.2g} of the pressure, and "
            f"other temperatures shift it.",
            f"The bell misses the cells by {100.0 * values['rms_error_over_peak']:.2g} % of "
            f"the peak, root mean square, and by at most "
            f"{100.0 * values['largest_error_over_peak']:.2g} %, at "
            f"{values['largest_error_speed']:.3g} m/s and "
            f"{values['largest_error_temperature'] - ZERO_CELSIUS:.4g} °C.",
            "It is friction by hysteresis on the waves of the road that the case names: no "
            "adhesion, no finer texture.",
            f"Admissibility: {values['admissibility']}.",
        ],
        figures={"friction": bell},
    )


FRICTION_LAW = Stage(
    schema=INTERFACE_LAW,
    tables=("rubber", "sliding"),
    reads={"law"},
    takes=(ROADS,),
    run=lambda case, found, job: fit_friction(case, found[MICRO_RESPONSE.name]),
    needs=_needs,
    sections=_sections,
    pictures=("friction",),
)
