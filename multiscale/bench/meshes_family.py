"""Cells on scikit-fem meshes beside the kernel: error of the mean gap against time, per element."""

from functools import partial

import numpy as np

from multiscale.bench.limits import limit_of
from multiscale.bench.trials import BenchFamily, Trial, judge_by

__all__ = ["gap_of_waves", "plan_meshes"]

YOUNG, POISSON = 1e9, 0.3  # Pa, 1
AMPLITUDE = 0.02
"""Amplitude of the waves over their length."""
PRESSURE = 0.01
"""Mean pressure over Young's modulus."""

KERNEL = "kernel"
KERNEL_POINTS, POINTS = (8, 16, 32, 64), (8, 16, 32)
QUICK_KERNEL_POINTS, QUICK_POINTS = (8, 16, 32), (8,)


def gap_of_waves(element: str, points: int) -> float:
    """Press waves meshed with an element, or with the kernel: mean gap over wavelength."""
    from multiscale.laws.bulk import Elastic
    from multiscale.micro import GraphCell, Path, Surface, solve_cell
    from multiscale.micro.mesh.meshing import ElementKind, graph_mesh_cell

    wave = np.cos(2.0 * np.pi * np.arange(points) / points)
    surface = Surface(AMPLITUDE * wave[:, None] * wave, (1.0, 1.0))
    layer = (surface, 0.5, points // 2, Elastic(YOUNG, POISSON))
    if element == KERNEL:
        response = solve_cell(GraphCell(*layer), Path(pressure=(PRESSURE * YOUNG,)))
    else:
        cell = graph_mesh_cell(*layer, ElementKind(element))
        response = solve_cell(cell, Path(pressure=(PRESSURE * YOUNG,)))
    return float(response["mean_gap"].values[0, 0])


def plan_meshes(*, quick: bool) -> BenchFamily:
    """Plan to press waves with the kernel and with meshes of every element.

    If quick, three grids of the kernel and one of each mesh.

    Notes
    -----
    Cells of all elements have the same contact nodes. *Errors* of the mean gap are relative to the
    limit of the kernel, extrapolated from its three finest grids; the distance of its finest grid
    from this limit is their uncertainty. The hexahedra of first order are the kernel's, so that
    their times compare a matrix with its factors to the same matrix that is never built.
    """
    grids: dict[str, tuple[int, ...]] = {KERNEL: QUICK_KERNEL_POINTS if quick else KERNEL_POINTS}
    meshed = QUICK_POINTS if quick else POINTS
    grids |= dict.fromkeys(("hex8", "hex27", "tet4", "tet10"), meshed)
    return BenchFamily(
        [
            Trial(
                "elastic waves",
                method,
                partial(gap_of_waves, method, n),
                partial(gap_of_waves, method, points[0]),
                {"points": n},
            )
            for method, points in grids.items()
            for n in points
        ],
        judge_by(partial(limit_of, len(grids[KERNEL]))),
        title="cells on meshes: mean gap",
        packages=("numba", "scikit-fem", "pyamg"),
        error="error of the mean gap",
    )
