"""The tangential branch of a law: measured, assumed or stated, and the law that it makes."""

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws import GapLaw, Sliders
from multiscale.schema import INTERFACE_LAW, SLIDING_RESPONSE, Dataset, with_cautions
from multiscale.upscaling.fit import told_branches, with_branch
from multiscale.upscaling.misfit import list_pressures
from multiscale.upscaling.reading import law_from_dataset, pick, require_law

__all__ = [
    "assume_shear",
    "say_shear",
    "sliders_from_dataset",
    "sliding_friction_at",
    "state_shear",
    "take_sliding_friction",
    "tangential_values",
    "with_sliding",
]

SAME = 1e-6  # relative difference of pressures that are the same

WORDS = {"friction": "friction coefficient", "stiffness_ratio": "tangential stiffness ratio"}
"""Names of the tangential values in sentences."""


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
