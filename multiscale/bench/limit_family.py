"""Kernels of elastic cells against the memory: time of an application over a copy of its bytes."""

from collections.abc import Callable, Iterable
from functools import partial
from time import perf_counter

import numpy as np

from multiscale.bench.trials import BenchFamily, Columns, Runs, Trial

__all__ = ["LIMIT_SCENES", "plan_limit"]

POINTS, QUICK_POINTS = (64, 128, 256, 512), (64, 128)
LAYERS, LEAST = 20, 0.2  # s that repeated applications take, at least

Kernel = tuple[Callable[[], object], float, float]
"""One application, the bytes that it must read and write, and its operations."""


def _stiffness(dtype: type[np.floating], points: int) -> Kernel:
    """Stiffness of the conforming cell: 2 x 2 x 2 Gauss points in each hexahedron."""
    from multiscale.bench.micro_family import scene_surface
    from multiscale.micro.elastic.stiffness import stiffness_operator
    from multiscale.micro.layer import GraphMesh, graded_planes

    surface = scene_surface(points)
    mesh = GraphMesh(surface, graded_planes(surface.size[0], LAYERS, surface.spacing[0]))
    apply = stiffness_operator(mesh, *np.ones((2, LAYERS)))
    u = np.random.default_rng(seed=1).standard_normal((points, LAYERS, 3, points)).astype(dtype)
    out = np.empty_like(u)
    return partial(apply, u, out), 2.0 * u.nbytes, 1000.0 * u.size / 3.0


def _inverse(points: int) -> Kernel:
    """Preconditioner of the conforming cell: transforms and eliminations in single precision."""
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
    """Compliance of the flat cell: a transform there and back."""
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
"""How each kernel is made, by the number of points along an edge."""


def seconds(application: Callable[[], object]) -> float:
    """Time an application that is repeated: the fastest one, s, after a first that is not timed."""
    application()
    fastest, begin = np.inf, perf_counter()
    while perf_counter() - begin < LEAST:
        start = perf_counter()
        application()
        fastest = min(fastest, perf_counter() - start)
    return float(fastest)


def measure_limit(scene: str, points: int) -> tuple[float, float, float, float]:
    """Return the time of an application over a copy, that time, s, bytes and operations."""
    application, moved, flops = LIMIT_SCENES[scene](points)
    source = np.ones(int(moved) // 16)  # a copy reads as much as it writes
    copy = partial(np.copyto, np.empty_like(source), source)
    time = seconds(application)
    return time / seconds(copy), time, moved, flops


def plan_limit(*, quick: bool) -> BenchFamily:
    """Plan to time one application of each kernel on all grids.

    If quick, the two coarse grids.

    Notes
    -----
    There is no error: ``over_copy`` tells how far a kernel is from the memory's limit, beside
    ``bytes_moved``, which counts arrays that must be read or written once, and ``operations``,
    counted on paper within a few tenths. The copy runs on one thread, the kernels on all.
    """
    return BenchFamily(
        [
            Trial(
                scene,
                "multiscale",
                partial(measure_limit, scene, n),
                partial(measure_limit, scene, QUICK_POINTS[0]),
                {"points": n},
            )
            for scene in LIMIT_SCENES
            for n in (QUICK_POINTS if quick else POINTS)
        ],
        _judge,
        title="kernels of elastic cells: time over a copy of the same bytes",
        packages=("numba", "scipy"),
    )


def _judge(scene: str, runs: Runs) -> Iterable[tuple[Trial, Columns]]:
    """Tell what was measured; there is no error."""
    for trial, run in runs.items():
        if run.value is not None:
            ratio, time, moved, flops = run.value
            yield (
                trial,
                {
                    "wall_time": time,
                    "over_copy": ratio,
                    "bytes_moved": moved,
                    "operations": flops,
                    "converged": 1,
                },
            )
