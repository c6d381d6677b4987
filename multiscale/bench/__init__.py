"""Scenes with references, on which this package and others are measured side by side."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from multiscale.bench.table import tabulate

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["SCENES", "tabulate"]

Scene = Callable[[bool, Callable[[str], None]], "xr.Dataset"]


def _micro(quick: bool, report: Callable[[str], None]) -> "xr.Dataset":
    from multiscale.bench.micro import bench_micro

    return bench_micro(quick=quick, report=report)


def _nonsmooth(quick: bool, report: Callable[[str], None]) -> "xr.Dataset":
    from multiscale.bench.nonsmooth import bench_nonsmooth

    return bench_nonsmooth(quick=quick, report=report)


def _joints(quick: bool, report: Callable[[str], None]) -> "xr.Dataset":
    from multiscale.bench.joints import bench_joints

    return bench_joints(quick=quick, report=report)


def _structures(quick: bool, report: Callable[[str], None]) -> "xr.Dataset":
    from multiscale.bench.structures import bench_structures

    return bench_structures(quick=quick, report=report)


def _damage(quick: bool, report: Callable[[str], None]) -> "xr.Dataset":
    from multiscale.bench.damage import bench_damage

    return bench_damage(quick=quick, report=report)


def _substructures(quick: bool, report: Callable[[str], None]) -> "xr.Dataset":
    from multiscale.bench.substructures import bench_substructures

    return bench_substructures(quick=quick, report=report)


SCENES: dict[str, Scene] = {
    "damage": _damage,
    "joints": _joints,
    "micro": _micro,
    "nonsmooth": _nonsmooth,
    "structures": _structures,
    "substructures": _substructures,
}
"""Families of scenes: whether to be quick, and what gets a line for each run, to the dataset."""
