"""Single cells: elements and large strain against their limits, kernels against memory."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from time import perf_counter

import numpy as np

from multiscale.bench.measure import BenchFamily, Row, Runner, judge, limit_of
from multiscale.laws.bulk import J2, Elastic, NeoHookean

YOUNG, POISSON = 1e9, 0.3  # Pa, 1


def _waves(amplitude: float, points: int) -> np.ndarray:
    """Return the heights of waves in both directions on a grid, over their wavelength."""
    wave = np.cos(2.0 * np.pi * np.arange(points) / points)
    return amplitude * wave[:, None] * wave


# ---------------------------------------------------------------------------------------------
# meshes: cells on scikit-fem meshes against the kernel of conforming cells


def gap_of_mesh(element: str, points: int) -> float:
    """Press waves meshed with an element, or with the kernel: mean gap over wavelength."""
    from multiscale.micro import GraphCell, Path, Surface, solve_cell
    from multiscale.micro.mesh.meshing import ElementKind, graph_mesh_cell

    surface, path = Surface(_waves(0.02, points), (1.0, 1.0)), Path(pressure=(0.01 * YOUNG,))
    layer = (surface, 0.5, points // 2, Elastic(YOUNG, POISSON))
    if element == "kernel":
        response = solve_cell(GraphCell(*layer), path)
    else:
        response = solve_cell(graph_mesh_cell(*layer, ElementKind(element)), path)
    return float(response["mean_gap"].values[0, 0])


@partial(
    BenchFamily,
    "cells on meshes: mean gap",
    packages=("numba", "scikit-fem", "pyamg"),
    error="error of the mean gap",
)
def meshes(run: Runner, quick: bool) -> Iterator[Sequence[Row]]:
    """Press waves with the kernel and with meshes of every element."""
    grids: dict[str, tuple[int, ...]] = {"kernel": (8, 16, 32) if quick else (8, 16, 32, 64)}
    grids |= dict.fromkeys(("hex8", "hex27", "tet4", "tet10"), (8,) if quick else (8, 16, 32))
    rows = [
        run("elastic waves", method, gap_of_mesh, method, n, warm=(method, grid[0]), points=n)
        for method, grid in grids.items()
        for n in grid
    ]
    yield judge(rows, *limit_of(rows[: len(grids["kernel"])]))


# ---------------------------------------------------------------------------------------------
# strain: cells at large strain

STRAIN_SCENES = {
    "rubber waves": (NeoHookean(YOUNG, POISSON), 0.06),
    "plastic waves": (J2(YOUNG, POISSON, 0.005 * YOUNG, 0.01 * YOUNG), 0.006),
}
"""Law of the body, and mean pressure over Young's modulus."""


def gap_at_large_strain(scene: str, points: int) -> float:
    """Press waves on a grid of ``points`` along an edge: mean gap over wavelength."""
    from multiscale.micro import Cell, Path, Surface, solve_cell

    law, pressure = STRAIN_SCENES[scene]
    surface = Surface(_waves(0.04, points), (1.0, 1.0))  # slopes up to a quarter
    cell = Cell(surface, 0.5, max(4, points // 2), YOUNG, POISSON, bulk=law)
    response = solve_cell(cell, Path(pressure=(pressure * YOUNG,)))
    if not response["converged"].values.all():
        return np.nan
    return float(response["mean_gap"].values.ravel()[-1])


@partial(BenchFamily, "cells at large strain: mean gap", packages=("numba",))
def strain(run: Runner, quick: bool) -> Iterator[Sequence[Row]]:
    """Press waves of rubber and of plastic steel on grids of all sizes."""
    for scene, (law, _) in STRAIN_SCENES.items():
        method, warm = type(law).__name__, ("plastic waves", 8)
        rows = [
            run(scene, method, gap_at_large_strain, scene, n, warm=warm, points=n)
            for n in ((8, 12, 16) if quick else (8, 16, 32, 64))
        ]
        yield judge(rows, *limit_of(rows))


# ---------------------------------------------------------------------------------------------
# limit: kernels of elastic cells against the memory

LAYERS, LEAST = 20, 0.2  # s that repeated applications take, at least

Kernel = tuple[Callable[[], object], float, float]
"""One application, the bytes that it must read and write, and its operations."""


def _stiffness(dtype: type[np.floating], points: int) -> Kernel:
    """Prepare the stiffness of the conforming cell: 2 x 2 x 2 Gauss points in each hexahedron."""
    from multiscale.bench.rough_contact import scene_surface
    from multiscale.micro.elastic.stiffness import stiffness_operator
    from multiscale.micro.layer import GraphMesh, graded_planes

    surface = scene_surface(points)
    mesh = GraphMesh(surface, graded_planes(surface.size[0], LAYERS, surface.spacing[0]))
    apply = stiffness_operator(mesh, *np.ones((2, LAYERS)))
    u = np.random.default_rng(seed=1).standard_normal((points, LAYERS, 3, points)).astype(dtype)
    out = np.empty_like(u)
    return partial(apply, u, out), 2.0 * u.nbytes, 1000.0 * u.size / 3.0


def _inverse(points: int) -> Kernel:
    """Prepare the preconditioner of the conforming cell, in single precision."""
    from multiscale.micro.elastic.lateral_fft import factorise_flat_cell

    planes = np.linspace(0.0, 1.0, LAYERS + 1)
    grid = (points, points), (1.0 / points, 1.0 / points)
    factors = factorise_flat_cell(*grid, planes, *np.ones((2, LAYERS)), dtype=np.float32)
    force = np.random.default_rng(seed=1).standard_normal((points, LAYERS, 3, points))
    out = np.empty_like(force)
    moved = 16.0 * force.size + factors.inverse.nbytes
    flops = (10.0 * np.log2(points) + 30.0) * force.size  # two transforms, two eliminations
    return partial(factors.solve, force, None, out), moved, flops


def _convolution(points: int) -> Kernel:
    """Prepare the compliance of the flat cell: a transform and its inverse."""
    from multiscale.micro.elastic.lateral_fft import SurfaceFilter

    values = np.random.default_rng(seed=1).standard_normal((points, points))
    symbol = np.ones((points, points // 2 + 1))
    flops = (10.0 * np.log2(points) + 1.0) * values.size
    return partial(SurfaceFilter(symbol), values), 16.0 * values.size + symbol.nbytes, flops


LIMIT_SCENES: dict[str, Callable[[int], Kernel]] = {
    "stiffness of a conforming cell, double precision": partial(_stiffness, np.float64),
    "stiffness of a conforming cell, single precision": partial(_stiffness, np.float32),
    "inverse of a flat cell": _inverse,
    "compliance of a flat cell": _convolution,
}
"""From the number of points along an edge to the prepared kernel."""


def fastest(application: Callable[[], object]) -> float:
    """Return the time of the fastest of repeated applications, s, after an untimed application."""
    application()
    least, begin = np.inf, perf_counter()
    while perf_counter() - begin < LEAST:
        start = perf_counter()
        application()
        least = min(least, perf_counter() - start)
    return float(least)


def measure_kernel(scene: str, points: int) -> dict[str, float]:
    """Measure an application of a kernel, and a copy of its bytes on one thread."""
    application, moved, flops = LIMIT_SCENES[scene](points)
    source = np.ones(int(moved) // 16)  # a copy reads as much as it writes
    time = fastest(application)
    ratio = time / fastest(partial(np.copyto, np.empty_like(source), source))
    return {"wall_time": time, "over_copy": ratio, "bytes_moved": moved, "operations": flops}


@partial(
    BenchFamily,
    "kernels of elastic cells: time over a copy of the same bytes",
    packages=("numba", "scipy"),
)
def limit(run: Runner, quick: bool) -> Iterator[Sequence[Row]]:
    """Time one application of each kernel on all grids."""
    grids = (64, 128) if quick else (64, 128, 256, 512)
    for scene in LIMIT_SCENES:
        rows = [
            run(scene, "multiscale", measure_kernel, scene, n, warm=(scene, 64), points=n)
            for n in grids
        ]
        yield [row | (row["value"] or {}) | {"converged": int(bool(row["value"]))} for row in rows]
