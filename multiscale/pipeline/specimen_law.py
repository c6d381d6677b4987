"""The law of a table of measured specimens, with its predictions at pressures."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multiscale.pipeline.showing import Rows, Table
from multiscale.schema import Dataset
from multiscale.upscaling import best_family, fit_law, predict, read_observations
from multiscale.upscaling.specimens import Prediction, with_specimen_budget
from multiscale.upscaling.tables import quantity_of

PREDICTED = 5  # number of pressures of a prediction that are chosen in the range of the data


@dataclass(frozen=True, eq=False)
class SpecimenLaw:
    """Law of measured specimens, and the table of its predictions."""

    law: Dataset
    cautions: list[str]
    title: str
    predictions: Rows


def fit_specimens(file: Path, family: str = "", pressures: Sequence[float] = ()) -> SpecimenLaw:
    """Fit a table of specimens by a family, or by the best family, and predict at pressures, Pa."""
    observations = read_observations(file, quantity_of(file))
    chosen = family or best_family(observations)[0]
    law = with_specimen_budget(fit_law(observations, family=chosen), observations)
    low, high = (float(law.attrs[f"pressure_{end}"]) for end in ("min", "max"))
    pressure = np.array(pressures or np.geomspace(low, high, PREDICTED))
    predictions = predict(law, observations, pressure)
    cautions = [*law.attrs["cautions"].splitlines(), *predictions.unknown]
    outside = pressure[(pressure < 0.999 * low) | (pressure > 1.001 * high)]
    if outside.size:
        listed = ", ".join(f"{1e-6 * p:.4g}" for p in outside)
        cautions.append(f"pressures of {listed} MPa lie outside the data; the law extrapolates")
    n, points = observations.n_realisations, observations.pressure.size
    name = "mean_gap" if observations.quantity == "gap" else "stiffness"
    error = law["error_half_width"].sel(quantity=name, error_term="fit").max().item()
    fit = f"{100.0 * error:.2g} % error" if np.isfinite(error) else "unknown error"
    title = (
        f"{chosen}{'' if family else ' (the best family)'}: {n} specimen{'s' * (n > 1)} at "
        f"{points} pressures, {fit} of the fit between pressures"
    )
    return SpecimenLaw(law, cautions, title, _tabulate(name, pressure, predictions))


def _tabulate(name: str, pressure: np.ndarray, prediction: Prediction) -> Rows:
    """Head and rows of predictions at pressures, Pa, with their intervals."""
    import xarray as xr

    ends = ("limit", "step")
    values = {
        "nominal_pressure": ("step", pressure),
        name: ("step", prediction.value),
        f"{name}_mean_law": (ends, prediction.mean_law),
        f"{name}_next": (ends, prediction.next_specimen),
    }
    heads = {f"{name}:next": "next specimen, 95 %"}
    columns = ("nominal_pressure", *(f"{name}{form}" for form in ("", ":mean_law", ":next")))
    return Table(columns, heads).rows(xr.Dataset(values))
