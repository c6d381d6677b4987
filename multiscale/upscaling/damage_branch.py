"""The damage branch of a law: what the material near the surface has lost to voids and cracks."""

from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.schema import DAMAGE_SECTIONS, INTERFACE_LAW, with_cautions
from multiscale.upscaling.fit import say_branches

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["with_damage"]

PARALLEL = 0.97  # cosine of a normal to that of the interface, within 14 degrees
SPAN = 2.5, 97.5  # percentiles of the planes between which a plane lies


def with_damage(law: "xr.Dataset", sections: "xr.Dataset") -> "xr.Dataset":
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
    known = INTERFACE_LAW.assign(law, values).assign_attrs(
        branches=say_branches({"damage": "measured"}, str(law.attrs.get("branches", "")))
    )
    return with_cautions(
        known,
        f"the interface carries what a damage of {mean:.3g} leaves, the mean of {lost.size} "
        f"sections parallel to it, of which 95 % lie from {low:.3g} to {high:.3g}; the error "
        f"budget does not have this range",
    )
