"""Branches of a law beside the loading: of unloading from any pressure, of shear and of damage."""

from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws import HystereticLaw, NormalLaw
from multiscale.schema import DAMAGE_SECTIONS, Dataset, with_cautions
from multiscale.upscaling.family import unloading_family
from multiscale.upscaling.fit import fit_law, say_control, with_branch
from multiscale.upscaling.misfit import Misfit, list_pressures
from multiscale.upscaling.observations import Observations
from multiscale.upscaling.reading import law_from_dataset, pick, require_law
from multiscale.upscaling.response_observations import loading_branch, unloading_observations
from multiscale.upscaling.shear_branch import with_sliding
from multiscale.upscaling.shear_fit import with_shear

__all__ = [
    "ALONG_LOADING",
    "REFUSED",
    "fit_branches",
    "hysteretic_from_dataset",
    "with_damage",
    "with_unloading",
]

ALONG_LOADING, REFUSED = "along the loading curve", "refused"
"""What a law says of an unloading that cells were pressed for and that has no branch."""

LARGEST_EXPONENT = 1000.0  # of unloading, from which its branch is as good as exponential
LEAST_STIFFENING = 5e-3  # of unloading over loading, below which the ratio is at its lower end
PARALLEL = 0.97  # cosine of a normal to that of the interface, within 14 degrees
SPAN = 2.5, 97.5  # percentiles of the planes between which a plane lies


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
