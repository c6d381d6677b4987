"""Rough contact: this package and boundary-element codes on the same heights and pressures."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from typing import Literal, NamedTuple

import numpy as np

from multiscale.bench.measure import THREADS, BenchFamily, Row, Runner, extrapolate
from multiscale.surfaces.surface import Surface

LENGTH, CONTACT_MODULUS, RMS_SLOPE = 1e-3, 1e9, 0.1  # m, Pa, 1
TOLERANCE = 1e-6
"""Overlap in the contact relative to the range of the heights, where a code has this option."""
MAX_ITERATIONS = 5000
POISSONS_RATIO = 0.3


class ContactAnswer(NamedTuple):
    """Averages and cost of the answer of a code."""

    mean_gap: float  # m
    contact_fraction: float  # real over nominal area, with edges determined alike for all codes
    iterations: int  # of conjugate gradients
    unknowns: int
    converged: bool  # by the report of the code


def press_cell(
    geometry: Literal["flat", "conforming"],
    surface: Surface,
    pressure: float,
    contact_modulus: float,
) -> ContactAnswer:
    """Press a flat or conforming cell as deep as its period, so that its base is not felt."""
    from multiscale.micro import Cell, Path, solve_cell

    flat, points = geometry == "flat", surface.heights.size
    layers = 2 if flat else min(max(surface.heights.shape[0] // 8, 8), 20)
    modulus = contact_modulus * (1.0 - POISSONS_RATIO**2)
    cell = Cell(surface, surface.size[0], layers, modulus, POISSONS_RATIO, geometry=geometry)
    response = solve_cell(cell, Path(pressure=(pressure,)), tolerance=TOLERANCE)
    return ContactAnswer(
        float(response["mean_gap"].item()),
        float(response["contact_fraction"].item()),
        int(response["linear_iterations"].item()),
        points if flat else 3 * layers * points,
        bool(response["converged"].item()),
    )


def press_with_tamaas(surface: Surface, pressure: float, contact_modulus: float) -> ContactAnswer:
    """Solve with Tamaas, a code of boundary elements."""
    import tamaas

    class Counter(tamaas.Functional):  # type: ignore[misc]
        """A functional that is zero and counts its gradients, since Tamaas does not count them."""

        calls = 0

        def computeF(self, *_: np.ndarray) -> float:  # noqa: N802
            return 0.0

        def computeGradF(self, *_: np.ndarray) -> None:  # noqa: N802
            self.calls += 1

    tamaas.set_log_level(tamaas.LogLevel.error)
    tamaas.initialize(THREADS)
    heights = surface.heights
    model = tamaas.ModelFactory.createModel(
        tamaas.model_type.basic_2d, list(surface.size), list(heights.shape)
    )
    model.E, model.nu = contact_modulus, 0.0
    # the tolerance of Tamaas is an overlap relative to the standard deviation of the heights
    tolerance = TOLERANCE * float(np.ptp(heights) / heights.std())
    solver = tamaas.PolonskyKeerRey(model, heights, tolerance)
    solver.max_iter = MAX_ITERATIONS
    counter = Counter()
    solver.addFunctionalTerm(counter)
    converged = solver.solve(pressure) <= tolerance
    return _averaged(surface, model.displacement, model.traction, counter.calls, converged)


def press_with_contact_mechanics(
    surface: Surface, pressure: float, contact_modulus: float
) -> ContactAnswer:
    """Solve with ContactMechanics, a code of boundary elements."""
    from ContactMechanics import PeriodicFFTElasticHalfSpace, make_system
    from SurfaceTopography import Topography

    heights, (length, width) = surface.heights, surface.size
    system = make_system(
        substrate=PeriodicFFTElasticHalfSpace(heights.shape, contact_modulus, surface.size),
        surface=Topography(heights, surface.size, periodic=True),
    )
    overlap = TOLERANCE * float(np.ptp(heights))
    result = system.minimize_proxy(
        external_force=pressure * length * width,
        pentol=overlap,
        forcetol=contact_modulus * surface.spacing[0] * overlap,  # force of the overlap
        maxiter=MAX_ITERATIONS,
    )
    return _averaged(surface, result.x, result.jac, int(result.nit), bool(result.success))


def _averaged(
    surface: Surface, displacement: np.ndarray, pressure: np.ndarray, steps: int, converged: bool
) -> ContactAnswer:
    """Average the fields of a boundary-element code, for a half-space without mean displacement."""
    from multiscale.micro.averages import contact_fraction

    gap, active = displacement - surface.heights, pressure > 0.0
    mean_gap = float(np.mean(gap) - np.mean(gap[active]))  # the gap of the contact nodes is zero
    fraction = contact_fraction(pressure, np.ones(pressure.shape))
    return ContactAnswer(mean_gap, fraction, steps, active.size, converged)


class Code(NamedTuple):
    """A code to compare."""

    solve: Callable[[Surface, float, float], ContactAnswer]  # mean pressure, contact modulus, Pa
    module: str  # to import
    small_slope: bool = True  # whether it solves the half-space problem, with roughness as a gap


CODES: Mapping[str, Code] = {
    "multiscale flat": Code(partial(press_cell, "flat"), "multiscale"),
    "multiscale conforming": Code(partial(press_cell, "conforming"), "multiscale", False),
    "Tamaas": Code(press_with_tamaas, "tamaas"),
    "ContactMechanics": Code(press_with_contact_mechanics, "ContactMechanics"),
}
"""The codes side by side, by the name in the dataset."""


def scene_surface(points: int) -> Surface:
    """Sample the surface of the scene on a grid of ``points`` along an edge, at least 33."""
    from multiscale.micro import self_affine

    return self_affine(
        (points, points),
        (LENGTH, LENGTH),
        seed=1,
        hurst_exponent=0.8,
        long_cutoff=LENGTH / 4.0,
        short_cutoff=LENGTH / 16.0,
        rms_slope=RMS_SLOPE,
    )


@partial(
    BenchFamily,
    "rough contact: mean gap and contact fraction",
    packages=tuple(code.module for code in CODES.values()),
    error="error of the mean gap over rms height",
    attributes={
        "surface": f"waves 4 to 16, H = 0.8, rms slope {RMS_SLOPE:g}, E* = {CONTACT_MODULUS:g} Pa",
        "tolerance": TOLERANCE,
    },
)
def micro(run: Runner, quick: bool) -> Iterator[Sequence[Row]]:
    """Measure every installed code on every grid and pressure."""
    grids = (64, 128, 256) if quick else (64, 128, 256, 512)
    for relative_pressure in (0.1,) if quick else (0.02, 0.1, 0.3):
        load = relative_pressure * CONTACT_MODULUS * RMS_SLOPE, CONTACT_MODULUS
        ladders = dict[str, list[Row]]()
        for name, code in CODES.items():
            if not find_spec(code.module):
                reason = "because it is not installed; pip install 'multiscale-contact[bench]'"
                run.leave_out(name, reason)
                continue
            ladders[name] = [
                run(
                    f"micro, p = {relative_pressure:g} E* h'",
                    name,
                    *(code.solve, scene_surface(points), *load),
                    warm=(scene_surface(grids[0]), *load),
                    repeats=1 if quick else 3,
                    points=points,
                    relative_pressure=relative_pressure,
                )
                for points in grids
            ]
        yield _compared(ladders)


def _compared(ladders: Mapping[str, Sequence[Row]]) -> list[Row]:
    """Compare each code with the common limit and with its limit, NaN without an answer."""
    rows = [row for ladder in ladders.values() for row in ladder]
    for row in rows:
        answer = row["value"]
        row |= {"mean_gap": np.nan, "contact_fraction": np.nan} | (
            {} if answer is None else answer._asdict() | {"converged": int(answer.converged)}
        )
    small_slope = [CODES[name].small_slope for name in ladders]
    scales = {"mean_gap": ("", float(scene_surface(64).heights.std()))}
    scales |= {"contact_fraction": ("contact_", np.nan)}  # relative to its limit
    for name, (label, scale) in scales.items():
        values = np.array(
            [
                [row[name] if row["converged"] else np.nan for row in ladder]
                for ladder in ladders.values()
            ]
        )
        order = None if name == "mean_gap" else 1.0
        limits = np.array([extrapolate(ladder, order) for ladder in values])
        exact, apart = common_reference(limits[small_slope], values[small_slope, -1])
        fixed = np.isfinite(scale)
        for row, value, limit in zip(
            rows, values.ravel(), np.repeat(limits, values.shape[1]), strict=True
        ):
            row[name] = value
            row[f"{label}error"] = abs(value - exact) / (scale if fixed else exact)
            row[f"own_{label}error"] = abs(value - limit) / (scale if fixed else limit)
            row[f"{label}error_uncertainty"] = apart / (scale if fixed else exact)
    return rows


def common_reference(limits: np.ndarray, finest: np.ndarray) -> tuple[float, float]:
    """Return the limit with the smallest extrapolation, and the largest distance of the others.

    >>> common_reference(np.array([1.0, 1.25]), np.array([1.5, 1.125]))
    (1.25, 0.25)
    """
    finite = np.isfinite(limits)
    if not finite.any():
        return np.nan, np.nan
    limits, finest = limits[finite], finest[finite]
    reference = float(limits[np.argmin(np.abs(limits - finest))])
    distance = float(np.max(np.abs(limits - reference)))
    return reference, distance if limits.size > 1 else np.nan
