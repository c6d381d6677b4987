"""Datasets of structures of links."""

from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.macro.discrete.link_system import LinkSystem
from multiscale.schema import MACRO_RESULT

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["describe", "link_dataset"]


def describe(system: LinkSystem) -> dict[str, Any]:
    """Return position, ends and law of ``MACRO_RESULT``, from which the structure is drawn."""
    names = np.array([type(law).__name__.lower() for law in system.laws])
    return {"position": system.position, "ends": system.ends, "law": names[system.kind]}


def link_dataset(system: LinkSystem, values: dict[str, Any], **labels: Any) -> "xr.Dataset":
    """Return variables of steps as a dataset that follows ``MACRO_RESULT``, with the structure."""
    import xarray as xr

    labels |= {"link": range(system.n_links), "node": range(system.n_nodes)}
    result = MACRO_RESULT.assign(xr.Dataset(), values | describe(system))
    result = result.assign_coords(component=["x", "y", "z"], **labels)
    MACRO_RESULT.check(result)
    return result
