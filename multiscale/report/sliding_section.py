"""What a page says of bodies that slide over each other."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["describe_sliding"]


def describe_sliding(response: "xr.Dataset") -> list[str]:
    """Say the friction of each pressure: its largest value, and where it settles."""
    way = float(response["sliding_distance"][-1])
    lines = []
    for load in range(response.sizes["load"]):
        one = response.isel(load=load)
        friction = one["effective_friction"].values[1:]
        pressure = 1e-6 * float(one["nominal_pressure"])
        if not np.isfinite(friction).any():
            lines.append(f"Under {pressure:.4g} MPa nothing slid.")
            continue
        steady = float(one["steady_friction"])
        last = friction[np.isfinite(friction)][-1]
        end = (
            f"{steady:.3g} over the last length of the cell"
            if np.isfinite(steady)
            else f"{last:.3g} at the end"
        )
        lines.append(
            f"Under {pressure:.4g} MPa the friction of the cell over {1e6 * way:.4g} µm is at most "
            f"{np.nanmax(friction):.3g}, and {end}."
        )
    return lines
