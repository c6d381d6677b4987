"""Build the law, its samples and its bands from the dataset of a fitted law."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws import (
    AreaLaw,
    BellFriction,
    ConvexDecreasing,
    NormalLaw,
    Tabulated,
    wlf_shift,
)
from multiscale.schema import INTERFACE_LAW, Dataset
from multiscale.upscaling.family import FAMILIES, Family
from multiscale.upscaling.sampling import most_confident, widening

BY_REALISATION = "bootstrap over realisations"  # attribute ``uncertainty`` of a law of cells

TABLE = "table"  # family of laws that are linear between the points of a table of the user


def law_from_dataset(
    dataset: Dataset, sample: int | None = None, *, family: Family | None = None
) -> NormalLaw:
    """Build the normal law of a dataset.

    Parameters
    ----------
    dataset : Dataset, follows ``INTERFACE_LAW``
    sample : int, optional, which bootstrap sample; the mean law if not given
    family : Family, optional, defined by the user, if the family of the law is not built in

    Raises
    ------
    CaseError
        If the dataset has no normal law, an unknown family, or not this sample.
    """
    law = fitted_law(dataset, sample, family=family)
    if not isinstance(law, NormalLaw):
        raise CaseError(
            f"the dataset has a law of {dataset.attrs.get('quantity')}, expected a normal law"
        )
    return law


def fitted_law(dataset: Dataset, sample: int | None = None, *, family: Family | None = None) -> Any:
    """Build the law of a dataset, of any quantity; arguments as for :func:`law_from_dataset`."""
    return fitted_laws(dataset, [sample], family=family)[0]


def fitted_laws(
    dataset: Dataset, samples: Sequence[int | None], *, family: Family | None = None
) -> list[Any]:
    """Build several laws of a dataset, which is checked and read once; see :func:`fitted_law`."""
    INTERFACE_LAW.check(dataset)
    name = dataset.attrs.get("family", "convex_decreasing")
    ends = dataset.attrs
    data = float(ends.get("pressure_min", 0.0)), float(ends.get("pressure_max", np.inf))
    if name == "convex_decreasing":
        require_law(dataset, "knot", "coefficient")
        knot = dataset["knot"].to_numpy()
        coefficients = pick(dataset, "coefficient", samples)
        limit = float(ends.get("pressure_limit", np.inf))
        return [
            ConvexDecreasing(knot, coefficient, pressure_range=data, pressure_limit=limit)
            for coefficient in coefficients
        ]
    if name == TABLE:
        require_law(dataset, "table_pressure", "table_gap")
        points = dataset["table_pressure"].to_numpy(), dataset["table_gap"].to_numpy()
        return [Tabulated(*points, pressure_range=data) for _ in samples]
    family = family or FAMILIES.get(str(name))
    if family is None or family.name != name:
        raise CaseError(
            f"the law is of the family {name!r}, which is not built in; pass it as family=..."
        )
    require_law(dataset, "held", *family.parameters)
    held = str(dataset.attrs["held"]).split()
    require_law(dataset, *held)
    given: dict[str, Any] = {key: float(dataset[key]) for key in held}
    columns = [pick(dataset, key, samples) for key in family.parameters]
    laws = [
        family.make(**dict(zip(family.parameters, map(float, row), strict=True)), **given)
        for row in zip(*columns, strict=True)
    ]
    if not (laws and isinstance(laws[0], NormalLaw)):
        return laws
    try:
        return [replace(law, pressure_range=data) for law in laws]
    except TypeError:
        raise CaseError(
            f"{type(laws[0]).__name__} has no field for the pressures of its data: make it a "
            f"dataclass with the fields gap and pressure_range, see NormalLaw"
        ) from None


def frictions_at(
    law: Dataset, temperature: float, samples: Sequence[int | None]
) -> list[BellFriction]:
    """Build the friction laws at a temperature, K: the mean bell (None), and samples of it."""
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


def area_from_dataset(dataset: Dataset, sample: int | None = None) -> AreaLaw:
    """Build the area law of a dataset; see :func:`law_from_dataset`."""
    return areas_from_dataset(dataset, [sample])[0]


def areas_from_dataset(dataset: Dataset, samples: Sequence[int | None]) -> list[AreaLaw]:
    """Build several area laws of a dataset, which is checked and read once."""
    INTERFACE_LAW.check(dataset)
    require_law(dataset, "area_pressure", "area_fraction")
    p = dataset["area_pressure"].to_numpy()
    return [AreaLaw(p, fraction) for fraction in pick(dataset, "area_fraction", samples)]


def law_band(
    dataset: Dataset,
    evaluate: Callable[[Any], np.ndarray],
    *,
    confidence: float = 0.95,
    family: Family | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the interval of an answer of a law, from its bootstrap samples.

    Parameters
    ----------
    dataset : Dataset, follows ``INTERFACE_LAW``
    evaluate : callable, from a law to an array, for instance ``lambda law: law.gap_at(pressures)``
    confidence : float, between 0 and 1
    family : Family, optional, see :func:`law_from_dataset`

    Returns
    -------
    low, high : ndarray, shaped as the answer

    Raises
    ------
    CaseError
        If samples or realisations are too few for this confidence.
    """
    if not 0.0 < confidence < 1.0:
        raise CaseError(f"confidence must lie between 0 and 1, got {confidence:g}")
    if refusal := refuse_band(dataset, confidence):
        raise CaseError(refusal)
    n_samples, n = int(dataset.sizes["sample"]), int(dataset.attrs["n_realisations"])
    by_realisation = dataset.attrs["uncertainty"] == BY_REALISATION
    laws = fitted_laws(dataset, [None, *range(n_samples)], family=family)
    centre, *answers = (evaluate(law) for law in laws)
    tail = 50.0 * (1.0 - confidence)
    ends = np.percentile(np.array(answers), [tail, 100.0 - tail], axis=0)
    # the samples are spread for 95 %
    spread = widening(n - 1, confidence) / widening(n - 1) if by_realisation else 1.0
    low, high = centre + spread * (ends - centre)
    return np.asarray(low), np.asarray(high)


def refuse_band(dataset: Dataset, confidence: float = 0.95) -> str:
    """Return why the samples of a law are too few for a band; empty if they suffice."""
    require_law(dataset, "n_realisations", "uncertainty")
    n_samples, n = int(dataset.sizes.get("sample", 0)), int(dataset.attrs["n_realisations"])
    by_realisation = dataset.attrs["uncertainty"] == BY_REALISATION
    if (n_samples == 0 or by_realisation) and confidence > most_confident(n):
        enough = next(m for m in range(3, 1000) if most_confident(m) >= confidence)
        few = f"{count_realisations(dataset)} {'are' if n > 1 else 'is'} too few"
        return f"{few} for a band of {100 * confidence:g} %; use at least {enough}"
    needed = int(np.ceil(round(4.0 / (1.0 - confidence), 6)))
    if n_samples < needed:
        return (
            f"{n_samples} samples are too few for a band of {100 * confidence:g} %; fit the law "
            f"with {needed} samples or more"
        )
    return ""


def count_realisations(dataset: Dataset) -> str:
    """Return the number of realisations of a law in words, such as "2 specimens"."""
    n = int(dataset.attrs["n_realisations"])
    return f"{n} {dataset.attrs.get('realisation', 'realisation')}{'s' * (n > 1)}"


def require_law(dataset: Dataset, *names: str) -> None:
    """Refuse a law that lacks variables or attributes, as laws of earlier versions may."""
    missing = [name for name in names if name not in {**dataset.variables, **dataset.attrs}]
    if missing:
        place = dataset.encoding.get("source", "the law")
        family = dataset.attrs.get("family", "convex_decreasing")
        raise CaseError(
            f"{place}: a law of the family {family!r} needs {', '.join(missing)}, which the "
            f"dataset, perhaps of an earlier version, does not have; run the fit again"
        )


def pick(
    dataset: Dataset, name: str, samples: Sequence[int | None], *, of: str = "law"
) -> list[np.ndarray]:
    """Return values of the mean (None) and of samples, of the law or of its unloading."""
    n_samples = int(dataset.sizes.get("sample" if of == "law" else f"{of}_sample", 0))
    for sample in samples:
        if sample is not None and not 0 <= sample < n_samples:
            raise CaseError(f"the {of} has no sample {sample}; it has {n_samples}, counted from 0")
    mean = drawn = dataset[name].to_numpy()
    if n_samples:
        require_law(dataset, f"{name}_sample")
        drawn = dataset[f"{name}_sample"].to_numpy()
    return [np.asarray(mean if sample is None else drawn[sample]) for sample in samples]
