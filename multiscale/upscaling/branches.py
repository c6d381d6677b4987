"""Branches of a law beside the loading: unloading, shear, sliding and damage."""

from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws import GapLaw, HystereticLaw, NormalLaw, Sliders
from multiscale.schema import (
    DAMAGE_SECTIONS,
    INTERFACE_LAW,
    SLIDING_RESPONSE,
    Dataset,
    with_cautions,
)
from multiscale.upscaling.family import unloading_family
from multiscale.upscaling.fit import fit_law, say_control, told_branches, with_branch
from multiscale.upscaling.observations import Misfit, Observations, list_pressures
from multiscale.upscaling.reading import law_from_dataset, pick, require_law
from multiscale.upscaling.response_observations import loading_branch, unloading_observations
from multiscale.upscaling.shear_fit import with_shear

__all__ = [
    "ALONG_LOADING",
    "REFUSED",
    "assume_shear",
    "fit_branches",
    "hysteretic_from_dataset",
    "say_shear",
    "sliders_from_dataset",
    "sliding_friction_at",
    "state_shear",
    "take_sliding_friction",
    "tangential_values",
    "with_damage",
    "with_sliding",
    "with_unloading",
]

SAME = 1e-6  # relative difference of pressures that are the same

WORDS = {"friction": "friction coefficient", "stiffness_ratio": "tangential stiffness ratio"}
"""Names of the tangential values in sentences."""

ALONG_LOADING, REFUSED = "along the loading curve", "refused"
"""What a law says of an unloading that cells were pressed for and that has no branch."""

LARGEST_EXPONENT = 1000.0  # of unloading, from which its branch is as good as exponential

LEAST_STIFFENING = 5e-3  # of unloading over loading, below which the ratio is at its lower end

PARALLEL = 0.97  # cosine of a normal to that of the interface, within 14 degrees

SPAN = 2.5, 97.5  # percentiles of the planes between which a plane lies


def assume_shear(
    law: Dataset, *, friction: float | None = None, stiffness_ratio: float | None = None
) -> Dataset:
    """Give a law tangential values that nothing was measured for, and say so in a caution.

    Parameters
    ----------
    law : Dataset, follows ``INTERFACE_LAW``
    friction, stiffness_ratio : float, optional
        Friction coefficient, and tangential over normal stiffness, for instance
        2 (1 - nu) / (2 - nu) between alike bodies; the law keeps its own if not given.
    """
    said, known = _put_shear(law, "assumed", friction, stiffness_ratio)
    both = friction is not None and stiffness_ratio is not None
    verb, them = ("are", "them") if both else ("is", "it")
    return with_cautions(known, f"{said} {verb} assumed; shear the cells to measure {them}")


def state_shear(
    law: Dataset, *, friction: float | None = None, stiffness_ratio: float | None = None
) -> Dataset:
    """Give a law tangential values that a user states; arguments as for :func:`assume_shear`.

    A caution says where they differ from values that the law had.
    """
    stated = {"friction": friction, "stiffness_ratio": stiffness_ratio}
    before = {name: one for name, one in tangential_values(law).items() if stated[name] is not None}
    return with_cautions(
        _put_shear(law, "given", friction, stiffness_ratio)[1],
        *(
            f"the {WORDS[name]} of {stated[name]:.3g} that is given stands instead of the "
            f"{one:.3g} of the law"
            for name, one in before.items()
        ),
    )


def tangential_values(law: Dataset) -> dict[str, float]:
    """Return ``friction`` and ``stiffness_ratio`` (mean of x and y) of a law, as far as known."""
    names = {"friction": "shear_friction", "stiffness_ratio": "shear_stiffness_ratio"}
    return {
        short: float(np.nanmean(law[name]))
        for short, name in names.items()
        if name in law.variables
    }


def say_shear(law: Dataset) -> list[str]:
    """Say friction and stiffness ratio of a law, with their bands if they are measured."""
    said = []
    for name, value in tangential_values(law).items():
        band = ""
        if law.sizes.get("shear_sample", 0):
            drawn = law[f"shear_{name}_sample"].to_numpy()
            drawn = drawn.mean(axis=1) if drawn.ndim > 1 else drawn
            low, high = np.nanpercentile(drawn, (2.5, 97.5))
            band = f" ({low:.3g} ... {high:.3g}, 95 %)" if high > low else ""
        said.append(f"{WORDS[name]}: {value:.3g}{band}")
    return said


def _put_shear(
    law: Dataset, how: str, friction: float | None, stiffness_ratio: float | None
) -> tuple[str, Dataset]:
    """Name tangential values, and put them into a law and all its samples."""
    n = law.sizes.get("shear_sample", 0)
    values: dict[str, object] = {}
    said, short = [], []
    if stiffness_ratio is not None:
        values["shear_stiffness_ratio"] = [stiffness_ratio] * 2
        values |= {"shear_stiffness_ratio_sample": np.full((n, 2), stiffness_ratio)} if n else {}
        said.append(f"the {WORDS['stiffness_ratio']} of {stiffness_ratio:.3g}")
        short.append(f"stiffness ratio {stiffness_ratio:.3g}")
    if friction is not None:
        values["shear_friction"] = friction
        values |= {"shear_friction_sample": np.full(n, friction)} if n else {}
        said.append(f"the {WORDS['friction']} of {friction:.3g}")
        short.append(f"friction {friction:.3g}")
    before = told_branches(law).get("shear") if tangential_values(law) else None
    told = f"{how}, {' and '.join(short)}"
    if before is not None:
        told = f"{before}, but {' and '.join(short)} {how}"
    if values:
        law = with_branch(law, "shear", told, values)
    return " and ".join(said), law


def with_sliding(law: Dataset, sliding: Dataset) -> Dataset:
    """Add the friction coefficient of large sliding over the pressure to a law.

    Parameters
    ----------
    law : Dataset, follows ``INTERFACE_LAW``
    sliding : Dataset, follows ``SLIDING_RESPONSE``, of :func:`multiscale.micro.slide_cell`

    Raises
    ------
    CaseError
        If no pressure has a steady coefficient.
    """
    SLIDING_RESPONSE.check(sliding)
    steady = sliding["steady_friction"].to_numpy()
    known = np.isfinite(steady)
    if not np.any(known):
        raise CaseError(
            "the cell slid over less than one period at every pressure, so that no friction "
            "coefficient is steady; slide farther"
        )
    order = np.argsort(sliding["nominal_pressure"].to_numpy()[known])
    values = {
        "sliding_pressure": sliding["nominal_pressure"].to_numpy()[known][order],
        "sliding_friction": steady[known][order],
    }
    return with_branch(law, "sliding", "measured", values)


def sliding_friction_at(dataset: Dataset, pressure: np.ndarray) -> np.ndarray:
    """Friction coefficient of large sliding at pressures, Pa; constant beyond the data."""
    require_law(dataset, "sliding_pressure", "sliding_friction")
    p, mu = (dataset[f"sliding_{name}"].to_numpy() for name in ("pressure", "friction"))
    return np.asarray(np.interp(np.log(pressure), np.log(p), mu))


def take_sliding_friction(law: Dataset, pressure: float) -> Dataset:
    """Return a law whose sliders have the friction of large sliding at a pressure, Pa.

    The law is of :func:`with_sliding`; its friction was measured in one cell, so that the error
    of the friction is not known.
    """
    friction = float(sliding_friction_at(law, np.array(pressure)))
    how = f"measured by sliding at {1e-6 * pressure:.4g} MPa"
    said, known = _put_shear(law, how, friction, None)
    known = INTERFACE_LAW.assign(known, {"shear_friction_error": np.nan})
    slid = law["sliding_pressure"].to_numpy()
    nearest = slid[np.argmin(np.abs(np.log(slid / pressure)))]
    outside = (
        f"no cell slid at {list_pressures(np.array([pressure]))}, which lies outside "
        f"{list_pressures(slid)}: the friction there is taken from "
        f"{list_pressures(np.array([nearest]))}"
    )
    beyond = not slid.min() * (1.0 - SAME) <= pressure <= slid.max() * (1.0 + SAME)
    return with_cautions(
        known,
        outside if beyond else "",
        f"{said} comes from the slide of one cell at {1e-6 * pressure:.4g} MPa, whose error is "
        f"not known; shear the cells to measure it with its scatter",
    )


def sliders_from_dataset(
    dataset: Dataset,
    sample: int | None = None,
    *,
    normal: GapLaw | None = None,
    along: int | None = None,
    pressures: tuple[float, float] | None = None,
    slabs: int = 48,
) -> Sliders:
    """Make the frictional law of a dataset with a tangential branch.

    Parameters
    ----------
    dataset : Dataset, follows ``INTERFACE_LAW``; of :func:`with_shear` or :func:`assume_shear`
    sample : int, optional
        Which bootstrap sample of the normal and of the tangential branch; the mean if not given.
    normal : GapLaw, optional
        Instead of the normal law of the dataset, such as its law with unloading.
    along : {0, 1}, optional, direction whose stiffness is taken, x or y; the mean if not given
    pressures : tuple of float, optional, where the bed is fine, Pa; the data if not given
    slabs : int, see :class:`~multiscale.laws.Sliders`

    Raises
    ------
    CaseError
        If the dataset has no tangential branch, or not this sample.
    """
    if len(tangential_values(dataset)) < 2:
        raise CaseError(
            "the law has no tangential branch; shear cells and add it with with_shear, or "
            "assume_shear(law, friction=..., stiffness_ratio=...)"
        )
    drawn = sample if dataset.sizes.get("shear_sample", 0) else None
    ratio = pick(dataset, "shear_stiffness_ratio", [drawn], of="shear")[0]
    data = float(dataset.attrs["pressure_min"]), float(dataset.attrs["pressure_max"])
    return Sliders(
        law_from_dataset(dataset, sample) if normal is None else normal,
        float(pick(dataset, "shear_friction", [drawn], of="shear")[0]),
        float(np.nanmean(ratio) if along is None else ratio[along]),
        pressures=data if pressures is None else pressures,
        slabs=slabs,
    )


def fit_branches(
    response: Dataset,
    *,
    control: Dataset | None = None,
    shear: Dataset | None = None,
    sliding: Dataset | None = None,
    apart: bool | None = None,
    n_samples: int = 200,
    **options: Any,
) -> Dataset:
    """Fit the law of the loading with all branches that data are given for.

    Parameters
    ----------
    response : Dataset
        Follows ``MICRO_RESPONSE``; gives the loading, and the unloading if cells have flowed and
        were unloaded.
    shear, sliding : Dataset, optional
        Give the tangential branch and friction over pressure, see :func:`with_shear` and
        :func:`with_sliding`.
    apart : bool, optional, as of :func:`with_shear`
    n_samples : int, of each branch
    control, **options
        As of :func:`~multiscale.upscaling.fit_law`.

    Returns
    -------
    Dataset, follows ``INTERFACE_LAW``
    """
    flows = "flowing_fraction" in response.variables
    loading = loading_branch(response) if flows else response
    law = fit_law(loading, control=control, n_samples=n_samples, **options)
    if loading.sizes["step"] < response.sizes["step"]:
        law = with_unloading(law, response, control=control, n_samples=n_samples)
    if shear is not None:
        law = with_shear(law, loading, shear, apart=apart)
    return law if sliding is None else with_sliding(law, sliding)


def with_unloading(
    law: Dataset,
    response: Dataset,
    *,
    control: Dataset | None = None,
    n_samples: int,
) -> Dataset:
    """Add the unloading branch to the law of the loading.

    Parameters
    ----------
    law : Dataset, follows ``INTERFACE_LAW``: the normal law of the loading branch
    response, control : Dataset, as of :func:`unloading_observations`

    Returns
    -------
    Dataset
        Follows ``INTERFACE_LAW``; :func:`hysteretic_from_dataset` makes the
        :class:`~multiscale.laws.HystereticLaw` of it. Samples are of the spring back alone: the
        loading law has its own. The exponent is at most :data:`LARGEST_EXPONENT`. The branch is
        left out, with a caution, where the cells are no stiffer at first than they were loaded.

    Raises
    ------
    CaseError
        If no step unloads, or none from a pressure of the law.
    """
    loading = law_from_dataset(law)
    seen = unloading_observations(response, control)
    within = seen.conditions[1] <= (1.0 + 1e-6) * loading.pressure_limit
    if not np.any(within):
        raise CaseError(
            f"the cells unload from {list_pressures(seen.conditions[1])}, where the law of the "
            f"loading has ended at {list_pressures(np.array([loading.pressure_limit]))}; unload "
            f"from a lower pressure"
        )
    seen = seen.at(within)
    family = unloading_family(loading)
    fitted = fit_law(seen, family=family, n_samples=n_samples)
    if float(fitted["exponent"]) > LARGEST_EXPONENT:
        held = {"exponent": LARGEST_EXPONENT}
        fitted = fit_law(seen, family=family, n_samples=n_samples, fixed=held)
    if float(fitted["stiffness_ratio"]) < 1.0 + LEAST_STIFFENING:
        return _without_unloading(law, loading, seen)
    known = str(law.attrs["cautions"]).splitlines()
    found = str(fitted.attrs["cautions"]).splitlines()
    law = with_cautions(law, *(one for one in found if one not in known))
    names = ("stiffness_ratio", "exponent")
    values = {f"unloading_{name}": fitted[name].values for name in names}
    values |= {f"unloading_{name}_sample": fitted[f"{name}_sample"].values for name in names}
    values |= {
        "unloading_pressure": fitted["fit_pressure"].values,
        "unloading_peak_pressure": fitted["fit_peak_pressure"].values,
        "unloading_recovery": fitted["fit_recovery"].values,
        "unloading_fit_error": fitted["fit_error"].values,
    }
    if control is not None:
        told = f"{law.attrs['control']}; {say_control('spring back', seen)}"
        law = law.assign_attrs(control=told)
    return with_branch(law, "unloading", "measured", values).assign_attrs(
        unloading_admissible=fitted.attrs["admissible"],
        unloading_admissibility=fitted.attrs["admissibility"],
    )


def _without_unloading(law: Dataset, loading: NormalLaw, seen: Observations) -> Dataset:
    """Report that a law has no unloading branch, since its ratio is at the lower end."""
    pressure, peak = seen.conditions
    along = (loading.gap_at(pressure) - loading.gap_at(peak) - seen.mean) / seen.scale
    apart = f"{100.0 * float(np.max(np.abs(along))):.2g} % of its length"
    if Misfit("", pressure, along, seen.scatter).missed.any():
        how = REFUSED
        told = f"no unloading branch describes how the cells spring back, up to {apart} from it"
    else:
        how, told = ALONG_LOADING, f"the cells spring back along it, to {apart}"
    return with_cautions(
        with_branch(law, "unloading", how, {}),
        f"the law has the loading curve for unloading too: {told}; press the cells to pressures "
        f"under which more of them flows",
    )


def hysteretic_from_dataset(dataset: Dataset, sample: int | None = None) -> HystereticLaw:
    """Make the law of a dataset with its unloading branch, the mean or a bootstrap sample of it.

    Raises
    ------
    CaseError
        If the dataset holds no unloading branch, or not this sample.
    """
    if "unloading_stiffness_ratio" not in dataset.variables:
        raise CaseError(
            "the law has no unloading branch; unload the cells (unload = true in [micro]), or "
            "add one with with_unloading"
        )
    names = ("unloading_stiffness_ratio", "unloading_exponent")
    require_law(dataset, *names)
    found = (pick(dataset, name, [sample], of="unloading")[0] for name in names)
    ratio, exponent = map(float, found)
    return HystereticLaw(law_from_dataset(dataset), ratio, exponent)


def with_damage(law: Dataset, sections: Dataset) -> Dataset:
    """Add the damage of the material near an interface to its law.

    Parameters
    ----------
    law : Dataset, follows ``INTERFACE_LAW``
    sections : Dataset
        Follows ``DAMAGE_SECTIONS``, of :func:`multiscale.micro.damage.max_damage`: a volume of the
        material near the surface, whose axis z is the normal of the interface.

    Returns
    -------
    Dataset
        With ``interface_damage``, the mean of eq. (1) over the sections parallel to the interface,
        since it may lie at any of them, and the ends of 95 of 100 sections.

    Raises
    ------
    CaseError
        If no section of the volume is parallel to the interface, or all of one has been lost.
    """
    DAMAGE_SECTIONS.check(sections)
    cosine = np.abs(sections["normal"].to_numpy()[:, 2])
    nearest = int(np.argmax(cosine))
    if cosine[nearest] < PARALLEL:
        raise CaseError(
            f"no section of the volume is parallel to the interface, whose normal is its axis "
            f"z: the nearest one is {np.degrees(np.arccos(cosine[nearest])):.3g} "
            f"degrees off; take more directions"
        )
    lost = sections["damage"].to_numpy()[nearest]
    lost = lost[np.isfinite(lost)]
    mean, (low, high) = float(lost.mean()), np.percentile(lost, SPAN)
    if not mean < 1.0:
        raise CaseError("nothing is left of the sections parallel to the interface")
    values = {"interface_damage": mean, "interface_damage_band": [low, high]}
    return with_cautions(
        with_branch(law, "damage", "measured", values),
        f"the interface carries what a damage of {mean:.3g} leaves, the mean of {lost.size} "
        f"sections parallel to it, of which 95 % lie from {low:.3g} to {high:.3g}; the error "
        f"budget does not have this range",
    )
