"""Scenes with references, to measure this package and others side by side."""

import tomllib
from collections.abc import Callable, Mapping
from importlib import import_module, resources
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from multiscale.schema import Dataset

__all__ = ["FAMILIES", "STABILITY_FAMILIES", "bench"]

STABILITY_FILE = resources.files("multiscale.bench").joinpath("stability.toml")

FAMILIES: Mapping[str, str] = {
    "chain": "answers",
    "damage": "answers",
    "grains": "grain_scenes",
    "growth": "growth",
    "laws": "answers",
    "limit": "cell_scenes",
    "meshes": "cell_scenes",
    "micro": "rough_contact",
    "nonsmooth": "nonsmooth",
    "strain": "cell_scenes",
    "structures": "structures",
    "substructures": "substructures",
    "volumes": "answers",
}
"""Families of scenes and their modules; a module has its family under its name."""

STABILITY_FAMILIES: Mapping[str, str] = {
    family: f"stability_{module}"
    for module, families in tomllib.loads(STABILITY_FILE.read_text()).items()
    for family in families
}
"""Families of stiff and extreme cases, in the order of their table, and their modules."""


def bench(
    family: str,
    *,
    quick: bool = False,
    report: Callable[[str], None] = lambda line: None,
    keep: "Callable[[Dataset], object]" = lambda dataset: None,
) -> "Dataset":
    """Measure a family; ``report`` gets a line a run, ``keep`` the runs after each scene."""
    from multiscale.bench.measure import measure_family

    module = import_module(f"multiscale.bench.{FAMILIES[family]}")
    return measure_family(getattr(module, family), quick=quick, report=report, keep=keep)
