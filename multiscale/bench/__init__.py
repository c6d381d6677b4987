"""Scenes with references, on which this package and others are measured side by side."""

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING

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
    "limit",
    "meshes",
    "micro",
    "nonsmooth",
    "strain",
    "structures",
    "substructures",
)
"""Families of scenes; the module of each has a function that plans what :func:`bench` measures."""

STABILITY_FAMILIES = (
    "structure",
    "motion",
    "cut_structure",
    "joint",
    "joint_path",
    "bolts",
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
    from multiscale.bench.trials import measure_family

    plan = getattr(import_module(f"multiscale.bench.{family}_family"), f"plan_{family}")
    return measure_family(plan(quick=quick), report)
