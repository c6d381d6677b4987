"""Scenes with references, on which this package and others are measured side by side."""

import tomllib
from collections.abc import Callable
from importlib import import_module, resources
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from multiscale.schema import Dataset

__all__ = ["FAMILIES", "STABILITY_FAMILIES", "bench"]

STABILITY_FILE = resources.files("multiscale.bench").joinpath("stability.toml")

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
    "volumes",
)
"""Families of scenes; the module of each has a function that plans what :func:`bench` measures."""

STABILITY_FAMILIES = tuple(tomllib.loads(STABILITY_FILE.read_text()))
"""Families of stiff and extreme cases, in the order of their table."""


def bench(
    family: str,
    *,
    quick: bool = False,
    report: Callable[[str], None] = lambda line: None,
    keep: "Callable[[Dataset], object]" = lambda found: None,
) -> "Dataset":
    """Measure a family of scenes.

    Parameters
    ----------
    family : str, one of ``FAMILIES``
    quick : bool, fewer scenes and grids, one run of each
    report, keep : callable, see :func:`~.trials.measure_family`

    Returns
    -------
    Dataset, follows ``WORK_PRECISION``
    """
    from multiscale.bench.trials import measure_family

    plan = getattr(import_module(f"multiscale.bench.{family}_family"), f"plan_{family}")
    return measure_family(plan(quick=quick), report, keep)
