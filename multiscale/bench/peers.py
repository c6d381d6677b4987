"""The same contact by several codes: heights and a mean pressure in, mean gap and area out."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from multiscale.bench.measure import THREADS
from multiscale.surfaces.surface import Surface

__all__ = [
    "CODES",
    "Code",
    "ContactAnswer",
    "press_cell",
    "press_with_contact_mechanics",
    "press_with_tamaas",
]

TOLERANCE = 1e-6
"""Overlap in the contact relative to the range of the heights, where a code lets us say so."""

MAX_ITERATIONS = 5000
POISSONS_RATIO = 0.3


@dataclass(frozen=True)
class ContactAnswer:
    """Answer of a code.

    Attributes
    ----------
    mean_gap : float, nominal-area mean of obstacle minus deformed surface, m
    contact_fraction : float
        Real over nominal contact area, 1, with its edges found in the same way for all.
    iterations : int, steps of conjugate gradients
    unknowns : int, contact pressures or displacements that the code solves for
    converged : bool, by the code's own account
    """

    mean_gap: float
    contact_fraction: float
    iterations: int
    unknowns: int
    converged: bool


def press_cell(
    geometry: Literal["flat", "conforming"],
    surface: Surface,
    pressure: float,
    contact_modulus: float,
) -> ContactAnswer:
    """Press a flat cell, which is exact in depth, or a conforming one.

    Notes
    -----
    The cell is as deep as its period, so that its base is not felt: it lowers the compliance of
    the longest wave by less than 0.1 %. A conforming cell of n points is n/8 but at most 20 layers
    deep, so that the errors of depth and surface fall together.
    """
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
    """Solve with Tamaas: boundary elements; arguments and answer as of :func:`press_cell`."""
    import tamaas

    class Counter(tamaas.Functional):  # type: ignore[misc]
        """A functional that is zero and counts its gradients: Tamaas keeps no such count."""

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
    # its tolerance is an overlap relative to the standard deviation of the heights
    tolerance = TOLERANCE * float(np.ptp(heights) / heights.std())
    solver = tamaas.PolonskyKeerRey(model, heights, tolerance)
    solver.max_iter = MAX_ITERATIONS
    counter = Counter()
    solver.addFunctionalTerm(counter)
    error = solver.solve(pressure)
    return _answer(
        surface, model.displacement, model.traction, counter.calls, converged=error <= tolerance
    )


def press_with_contact_mechanics(
    surface: Surface, pressure: float, contact_modulus: float
) -> ContactAnswer:
    """Solve with ContactMechanics; arguments and answer as of :func:`press_cell`."""
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
    return _answer(surface, result.x, result.jac, int(result.nit), converged=bool(result.success))


def _answer(
    surface: Surface,
    displacement: np.ndarray,
    pressure: np.ndarray,
    iterations: int,
    *,
    converged: bool,
) -> ContactAnswer:
    """Average the fields of a boundary-element code, whose half-space has no mean displacement."""
    from multiscale.micro.contact_area import contact_fraction

    gap, active = displacement - surface.heights, pressure > 0.0
    return ContactAnswer(
        float(np.mean(gap) - np.mean(gap[active])),  # the gap of the contact nodes is zero
        contact_fraction(pressure, np.ones(pressure.shape)),
        iterations,
        active.size,
        converged,
    )


@dataclass(frozen=True)
class Code:
    """A code that can be measured.

    Attributes
    ----------
    solve : callable, surface, mean pressure (Pa) and contact modulus (Pa) to :class:`ContactAnswer`
    module : str, name by which the code is installed and imported
    small_slope : bool, whether it solves the half-space problem, with the roughness as a gap
    """

    solve: Callable[[Surface, float, float], ContactAnswer]
    module: str
    small_slope: bool = True


CODES: Mapping[str, Code] = {
    "multiscale flat": Code(partial(press_cell, "flat"), "multiscale"),
    "multiscale conforming": Code(
        partial(press_cell, "conforming"), "multiscale", small_slope=False
    ),
    "Tamaas": Code(press_with_tamaas, "tamaas"),
    "ContactMechanics": Code(press_with_contact_mechanics, "ContactMechanics"),
}
"""The codes side by side, by the name in the dataset."""
