"""Thermal and electrical conductance of a rough interface, from its stiffness."""

from collections.abc import Mapping

import numpy as np

from multiscale.schema import INTERFACE_LAW, Dataset, with_cautions
from multiscale.upscaling.bootstrap import half_range
from multiscale.upscaling.branches import ALONG_LOADING, REFUSED
from multiscale.upscaling.fit import told_branches
from multiscale.upscaling.propagation import Uncertainty
from multiscale.upscaling.reading import law_from_dataset, require_law

__all__ = [
    "CONDUCTANCES",
    "conductance_ratios",
    "conductances",
    "elastic_source",
    "with_conductance",
]

CONDUCTANCES = {"thermal_conductance": "W m-2 K-1", "electrical_conductance": "S m-2"}
"""What an interface conducts, and the units."""


def with_conductance(
    law: Dataset,
    conductivities: Mapping[str, tuple[float, float]],
    contact_modulus: float,
    *,
    flows: bool,
) -> Dataset:
    r"""Return a law with the conductances of its interface.

    Parameters
    ----------
    law : Dataset, follows ``INTERFACE_LAW``
    conductivities : mapping of str to tuple of float
        Conductivities :math:`k_1, k_2` of both bodies, positive, by a name of
        :data:`CONDUCTANCES`: thermal, W m-1 K-1, or electrical, S m-1.
    contact_modulus : float, :math:`E^*` of both bodies, Pa
    flows : bool
        Whether a body of the cells flows. The elastic stiffness is then the stiffness at the start
        of unloading; a law without that branch has a caution.

    Notes
    -----
    Spots of contact hinder a current as they hinder a small further displacement: the fields of
    both problems are the same harmonic function [1]_. With the elastic stiffness
    :math:`\beta K(p)` of the interface for a small change of the pressure,

    .. math:: h(p) = \frac{2\, \beta K(p)}{E^* (1/k_1 + 1/k_2)}.    \tag{1}

    Currents through the open gap, by radiation or through a fluid, come on top; films on the spots
    hinder an electrical current further.

    References
    ----------
    .. [1] J. R. Barber, Proc. R. Soc. Lond. A 459 (2003) 53-66, doi:10.1098/rspa.2002.1038.
    """
    if not conductivities:
        return law
    unloads = flows and "unloading_stiffness_ratio" in law
    beta = float(law["unloading_stiffness_ratio"]) if unloads else 1.0
    ratios = {
        f"{name}_ratio": 2.0 * beta / (contact_modulus * (1.0 / one + 1.0 / two))  # (1)
        for name, (one, two) in conductivities.items()
    }
    law = INTERFACE_LAW.assign(law, ratios).assign_attrs(
        conductance_branch="unloading" if unloads else "loading"
    )
    branch = told_branches(law).get("unloading", "")
    if not flows or unloads or branch == ALONG_LOADING:
        return law
    advice = "the cells tell no such branch" if branch == REFUSED else "ask for unload in [micro]"
    return with_cautions(
        law,
        f"the conductance rests on the stiffness of loading, and metal that flows is stiffer at "
        f"the start of unloading: it is too small; {advice}",
    )


def conductances(law: Dataset, pressure: np.ndarray) -> dict[str, np.ndarray]:
    """Return the conductances of a law at pressures of the interface, Pa, as far as it has them.

    By names of :data:`CONDUCTANCES`, of the shape of the pressures, W m-2 K-1 and S m-2.
    """
    normal = law_from_dataset(law)
    stiffness = normal.stiffness(normal.gap_at(pressure))
    return {name: ratio * stiffness for name, ratio in conductance_ratios(law).items()}


def conductance_ratios(law: Dataset) -> dict[str, float]:
    """Return conductances over the stiffness of loading, W m-1 K-1 Pa-1 and S m-1 Pa-1."""
    names = {name: f"{name}_ratio" for name in CONDUCTANCES}
    return {name: float(law[ratio]) for name, ratio in names.items() if ratio in law.variables}


def elastic_source(law: Dataset, answers: np.ndarray) -> Uncertainty:
    """Return the start of unloading as a source of error of the answers that are conductances.

    ``answers``, shape (answers, steps), is 1 for conductances and 0 for other answers.
    """
    require_law(law, "conductance_branch")
    half = 0.0
    if law.attrs["conductance_branch"] == "unloading":
        half = np.nan
        if law.sizes.get("unloading_sample"):
            drawn = law["unloading_stiffness_ratio_sample"].to_numpy()
            half = float(half_range(drawn) / law["unloading_stiffness_ratio"])
    return Uncertainty(name="start of unloading", half_width={"sampling": half}, rate=1.0 * answers)
