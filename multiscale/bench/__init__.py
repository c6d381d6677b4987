"""Scenes with references, on which this package and others are measured side by side."""

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, cast

from multiscale.bench.table import tabulate_runs

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["FAMILIES", "STABILITY_FAMILIES", "bench", "tabulate_runs"]

FAMILIES = (
    "chain",
    "damage",
    "grains",
    "joints",
    "laws",
    "micro",
    "nonsmooth",
    "strain",
    "structures",
    "substructures",
)
"""Families of scenes; each is a module with a function of its name, as :func:`bench` calls it."""

STABILITY_FAMILIES = (
    "structure",
    "motion",
    "cut_structure",
    "joint",
    "friction",
    "wedge",
    "complementarity",
    "rough_cell",
    "large_strain",
    "grains",
    "voids",
)
"""Families of stiff and extreme cases, in the order of their table."""


def bench(
    family: str, *, quick: bool = False, report: Callable[[str], None] = lambda line: None
) -> "xr.Dataset":
    """Measure a family of scenes.

    Parameters
    ----------
    family : str
        One of ``FAMILIES``.
    quick : bool
        Fewer scenes and grids, one run of each.
    report : callable
        Gets a line after each measurement.

    Returns
    -------
    Dataset
        Follows ``WORK_PRECISION``.
    """
    module = import_module(f"multiscale.bench.{family}_family")
    return cast("xr.Dataset", getattr(module, f"bench_{family}")(quick=quick, report=report))
