"""Branches of a law other than the loading: unloading, shear and sliding."""

from typing import Any

import numpy as np

from multiscale.errors import CaseError, require
from multiscale.laws import HystereticLaw, NormalLaw, Sliders
from multiscale.laws.interface_law import GapLaw
from multiscale.schema import (
    INTERFACE_LAW,
    SLIDING_RESPONSE,
    Dataset,
    with_cautions,
)
from multiscale.upscaling.family import unloading_family
from multiscale.upscaling.fit import branch_origins, describe_control, fit_law, with_branch
from multiscale.upscaling.observations import Misfit, Observations, list_pressures
from multiscale.upscaling.reading import law_from_dataset, pick, require_law
from multiscale.upscaling.response_observations import (
    friction_observations,
    loading_branch,
    unloading_observations,
    usable_steps,
)
from multiscale.upscaling.sampling import student
from multiscale.upscaling.shear_fit import with_shear

SAME = 1e-6  # relative difference of pressures that are the same

WORDS = {"friction": "friction coefficient", "stiffness_ratio": "tangential stiffness ratio"}
"""Names of the tangential values in sentences."""

ALONG_LOADING, REFUSED = "along the loading curve", "refused"
"""Origin, in a law, of the unloading of cells that have unloaded but give no branch."""

LARGEST_EXPONENT = 1000.0  # of unloading, from which its branch is equivalent to an exponential

LEAST_STIFFENING = 5e-3  # of unloading over loading, below which the ratio is at its lower end


def assume_shear(
    law: Dataset, *, friction: float | None = None, stiffness_ratio: float | None = None
) -> Dataset:
    """Return a law with assumed tangential values and a caution that names them.

    Parameters
    ----------
    law : Dataset, follows ``INTERFACE_LAW``
    friction, stiffness_ratio : float, optional
        Friction coefficient, and tangential over normal stiffness, for instance
        2 (1 - nu) / (2 - nu) between equal bodies; the value of the law if not given.
    """
    names, law = _set_shear(law, "assumed", friction, stiffness_ratio)
    both = friction is not None and stiffness_ratio is not None
    verb, them = ("are", "them") if both else ("is", "it")
    return with_cautions(law, f"{names} {verb} assumed; shear the cells to measure {them}")


def state_shear(
    law: Dataset, *, friction: float | None = None, stiffness_ratio: float | None = None
) -> Dataset:
    """Return a law with tangential values of a user, and cautions with the replaced values."""
    stated = {"friction": friction, "stiffness_ratio": stiffness_ratio}
    replaced = {
        name: value for name, value in tangential_values(law).items() if stated[name] is not None
    }
    return with_cautions(
        _set_shear(law, "given", friction, stiffness_ratio)[1],
        *(
            f"the given {WORDS[name]} of {stated[name]:.3g} replaces the {value:.3g} of the law"
            for name, value in replaced.items()
        ),
    )


def tangential_values(law: Dataset) -> dict[str, float]:
    """Return ``friction`` and ``stiffness_ratio`` (mean of x and y) of a law, if it has them."""
    names = {"friction": "shear_friction", "stiffness_ratio": "shear_stiffness_ratio"}
    return {
        short: float(np.nanmean(law[name]))
        for short, name in names.items()
        if name in law.variables
    }


def describe_shear(law: Dataset) -> list[str]:
    """Write friction and stiffness ratio of a law, with their bands if they are measured."""
    lines = []
    for name, value in tangential_values(law).items():
        band = ""
        if law.sizes.get("shear_sample", 0):
            drawn = law[f"shear_{name}_sample"].to_numpy()
            drawn = drawn.mean(axis=1) if drawn.ndim > 1 else drawn
            low, high = np.nanpercentile(drawn, (2.5, 97.5))
            band = f" ({low:.3g} ... {high:.3g}, 95 %)" if high > low else ""
        lines.append(f"{WORDS[name]}: {value:.3g}{band}")
    return lines


def _set_shear(
    law: Dataset, origin: str, friction: float | None, stiffness_ratio: float | None
) -> tuple[str, Dataset]:
    """Set tangential values in a law and all its samples; return their names in words, too."""
    n = law.sizes.get("shear_sample", 0)
    values: dict[str, object] = {}
    names, short = [], []
    if stiffness_ratio is not None:
        values["shear_stiffness_ratio"] = [stiffness_ratio] * 2
        values |= {"shear_stiffness_ratio_sample": np.full((n, 2), stiffness_ratio)} if n else {}
        names.append(f"the {WORDS['stiffness_ratio']} of {stiffness_ratio:.3g}")
        short.append(f"stiffness ratio {stiffness_ratio:.3g}")
    if friction is not None:
        values["shear_friction"] = friction
        values |= {"shear_friction_sample": np.full(n, friction)} if n else {}
        names.append(f"the {WORDS['friction']} of {friction:.3g}")
        short.append(f"friction {friction:.3g}")
    before = branch_origins(law).get("shear") if tangential_values(law) else None
    text = f"{origin}, {' and '.join(short)}"
    if before is not None:
        text = f"{before}, but {' and '.join(short)} {origin}"
    if values:
        law = with_branch(law, "shear", text, values)
    return " and ".join(names), law


def with_sliding(law: Dataset, sliding: Dataset) -> Dataset:
    """Add the friction coefficient of large sliding over the pressure to a law."""
    SLIDING_RESPONSE.check(sliding)
    steady = sliding["steady_friction"].to_numpy()
    finite = np.isfinite(steady)
    if not np.any(finite):
        raise CaseError(
            "the cell slid over less than one period at every pressure, so no friction "
            "coefficient is steady; slide farther"
        )
    pressure, friction = sliding["nominal_pressure"].to_numpy()[finite], steady[finite]
    order = np.argsort(pressure)
    values = {
        "sliding_pressure": pressure[order],
        "sliding_friction": friction[order],
    }
    return with_branch(law, "sliding", "measured", values)


def with_steady_friction(law: Dataset, response: Dataset) -> Dataset:
    """Add the friction of a response that slides steadily at one speed to its normal law.

    The law is valid at this speed, the attribute ``sliding_speed``; for others see
    :func:`at_speed`.
    """
    seen = friction_observations(response)
    (speed,) = np.unique(seen.conditions[1])
    n = seen.counted.sum(axis=0)
    variance = np.nanvar(seen.values, axis=0) / np.maximum(n - 1, 1)
    half = np.where(n > 1, student(n - 1) * np.sqrt(variance), np.nan)
    values = {
        "sliding_pressure": seen.pressure,
        "sliding_friction": seen.mean,
        "sliding_friction_error": half / seen.mean,
    }
    law = with_branch(law, "sliding", "measured", values).assign_attrs(sliding_speed=float(speed))
    lost = np.setdiff1d(usable_steps(response)[1], seen.pressure)
    if not lost.size:
        return law
    return with_cautions(
        law, f"no layer slides steadily at {list_pressures(lost)}, where the law has no data"
    )


def at_speed(law: Dataset, speed: float | None) -> Dataset:
    r"""Return the law of rigid grains at another speed.

    Parameters
    ----------
    law : Dataset, follows ``INTERFACE_LAW``; of a third body, with the attribute ``sliding_speed``
    speed : float or None, m/s; a law without a speed takes None only

    Raises
    ------
    CaseError
        If the law depends on the speed and none is given, or the other way round.

    Notes
    -----
    Rigid grains have no time scale, so gap and friction depend on
    :math:`v / \sqrt p` only, and the law at the speed v is the law at :math:`v_0` with all
    pressures multiplied by :math:`(v / v_0)^2`.
    """
    measured = law.attrs.get("sliding_speed")
    if (measured is None) != (speed is None):
        raise CaseError(
            "speed in [interface] belongs to a law of grains, and this is another law; leave it out"
            if measured is None
            else f"the law of grains depends on the speed of sliding, {measured:.4g} m/s in its "
            f"cells; give speed in [interface]"
        )
    if speed is None:
        return law
    require("speed", speed, "(0, inf)", "m/s")
    factor = (speed / float(law.attrs["sliding_speed"])) ** 2
    scaled = {
        name: (values.dims, factor * values.to_numpy(), values.attrs)
        for name, values in law.variables.items()
        if str(values.attrs.get("units")).startswith("Pa")  # linear in pressures
    }
    ends = ("pressure_min", "pressure_max", "pressure_limit")
    limits = {name: factor * float(law.attrs[name]) for name in ends if name in law.attrs}
    return law.assign(scaled).assign_attrs(sliding_speed=speed, **limits)


def sliding_friction_at(dataset: Dataset, pressure: np.ndarray) -> np.ndarray:
    """Interpolate the friction coefficient of large sliding at pressures, Pa."""
    require_law(dataset, "sliding_pressure", "sliding_friction")
    p, mu = (dataset[f"sliding_{name}"].to_numpy() for name in ("pressure", "friction"))
    return np.asarray(np.interp(np.log(pressure), np.log(p), mu))


def take_sliding_friction(law: Dataset, pressure: float) -> Dataset:
    """Return a law with the friction of large sliding at a pressure, Pa, with an unknown error."""
    friction = float(sliding_friction_at(law, np.array(pressure)))
    origin = f"measured by sliding at {1e-6 * pressure:.4g} MPa"
    name, changed = _set_shear(law, origin, friction, None)
    slid = law["sliding_pressure"].to_numpy()
    known = np.asarray(law.get("sliding_friction_error", np.full(slid.size, np.nan)))
    error = float(np.interp(np.log(pressure), np.log(slid), known))
    changed = INTERFACE_LAW.assign(changed, {"shear_friction_error": error})
    nearest = slid[np.argmin(np.abs(np.log(slid / pressure)))]
    source, remedy = "slide of one cell", "shear the cells to measure it with its scatter"
    if "sliding_speed" in law.attrs:
        source, remedy = "shear of too few layers of grains", "shear two or more realisations"
    outside = (
        f"no cell slid at {list_pressures(np.array([pressure]))}, which lies outside "
        f"{list_pressures(slid)}: the friction there is taken from "
        f"{list_pressures(np.array([nearest]))}"
    )
    beyond = not slid.min() * (1.0 - SAME) <= pressure <= slid.max() * (1.0 + SAME)
    return with_cautions(
        changed,
        outside if beyond else "",
        f"{name} comes from the {source} at {1e-6 * pressure:.4g} MPa, with an unknown error; "
        f"{remedy}"
        if np.isnan(error)
        else "",
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
    """Build the frictional law of a dataset with a tangential branch.

    Parameters
    ----------
    dataset : Dataset, follows ``INTERFACE_LAW``; of :func:`fit_branches` or :func:`assume_shear`
    sample : int, optional
        Which bootstrap sample of the normal and of the tangential branch; the mean if not given.
    normal : GapLaw, optional
        Instead of the normal law of the dataset, such as its law with unloading.
    along : {0, 1}, optional, direction of the stiffness, x or y; the mean if not given
    pressures : tuple of float, optional, where the bed is fine, Pa; the data if not given
    slabs : int, see :class:`~multiscale.laws.Sliders`

    Raises
    ------
    CaseError
        If the dataset has no tangential branch, or not this sample.
    """
    if len(tangential_values(dataset)) < 2:
        raise CaseError(
            "the law has no tangential branch; shear cells ([micro.shear] of a case, or "
            "fit_branches in Python), or take assume_shear(law, friction=..., stiffness_ratio=...)"
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
    """Fit the law of the loading, and each branch with data.

    Parameters
    ----------
    response : Dataset
        Follows ``MICRO_RESPONSE``; gives the loading, and the unloading if cells have flowed and
        were unloaded.
    shear : Dataset, optional
        Follows ``MICRO_RESPONSE``: cells with friction on the surfaces of some of these
        realisations, with the same numbers, that are pressed, sheared until they slip and
        released, such as along :func:`multiscale.micro.shear_path`.
    sliding : Dataset, optional
        Follows ``SLIDING_RESPONSE``, of :func:`multiscale.micro.slide_cell`.
    apart : bool, optional
        Whether the stiffness ratios along x and y are two numbers, as for surfaces with a lay, or
        their mean; if not given, two numbers where they differ by more than chance.
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
    """Add the unloading branch to the law of the loading."""
    loading = law_from_dataset(law)
    observations = unloading_observations(response, control)
    within = observations.conditions[1] <= (1.0 + 1e-6) * loading.pressure_limit
    if not np.any(within):
        raise CaseError(
            f"the cells unload from {list_pressures(observations.conditions[1])}, but the law of "
            f"the loading ends at {list_pressures(np.array([loading.pressure_limit]))}; "
            f"unload from a lower pressure"
        )
    observations = observations.at(within)
    family = unloading_family(loading)
    fitted = fit_law(observations, family=family, n_samples=n_samples)
    if float(fitted["exponent"]) > LARGEST_EXPONENT:
        fixed = {"exponent": LARGEST_EXPONENT}
        fitted = fit_law(observations, family=family, n_samples=n_samples, fixed=fixed)
    if float(fitted["stiffness_ratio"]) < 1.0 + LEAST_STIFFENING:
        return _without_unloading(law, loading, observations)
    earlier, new = (str(data.attrs["cautions"]).splitlines() for data in (law, fitted))
    law = with_cautions(law, *(caution for caution in new if caution not in earlier))
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
        text = f"{law.attrs['control']}; {describe_control('spring back', observations)}"
        law = law.assign_attrs(control=text)
    return with_branch(law, "unloading", "measured", values).assign_attrs(
        unloading_admissible=fitted.attrs["admissible"],
        unloading_admissibility=fitted.attrs["admissibility"],
    )


def _without_unloading(law: Dataset, loading: NormalLaw, observed: Observations) -> Dataset:
    """Return a law without unloading branch, since its ratio is at the lower end."""
    pressure, peak = observed.conditions
    distance = loading.gap_at(pressure) - loading.gap_at(peak) - observed.mean
    relative = distance / observed.scale
    apart = f"{100.0 * float(np.max(np.abs(relative))):.2g} % of its length"
    if Misfit("", pressure, relative, observed.scatter).missed.any():
        origin = REFUSED
        reason = f"no unloading branch describes how the cells spring back, up to {apart} from it"
    else:
        origin, reason = ALONG_LOADING, f"the cells spring back along it, to {apart}"
    return with_cautions(
        with_branch(law, "unloading", origin, {}),
        f"the law has the loading curve for unloading too: {reason}; press the cells to pressures "
        f"with more plastic flow",
    )


def hysteretic_from_dataset(dataset: Dataset, sample: int | None = None) -> HystereticLaw:
    """Build the law of a dataset with its unloading branch: the mean, or a bootstrap sample.

    Raises
    ------
    CaseError
        If the dataset has no unloading branch, or not this sample.
    """
    if "unloading_stiffness_ratio" not in dataset.variables:
        raise CaseError(
            "the law has no unloading branch; unload the cells (unload = true in [micro]), and "
            "add the branch by fit_branches"
        )
    names = ("unloading_stiffness_ratio", "unloading_exponent")
    require_law(dataset, *names)
    ratio, exponent = (float(pick(dataset, name, [sample], of="unloading")[0]) for name in names)
    return HystereticLaw(law_from_dataset(dataset), ratio, exponent)
