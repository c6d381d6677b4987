"""Datasets of surfaces and cells: statistics, responses and fields."""

from dataclasses import replace
from functools import partial

import numpy as np

from multiscale.schema.dataset_schema import Schema, Variable

BRANCHES = ("loading", "unloading", "holding")
LOADING, UNLOADING, HOLDING = range(3)


def branch_of(load: np.ndarray) -> np.ndarray:
    """Return the branch of each step of a path."""
    load = np.maximum(np.asarray(load, dtype=float), 0.0)
    before = np.maximum.accumulate([0.0, *load[:-1]])
    above, below = (load > before * (1.0 + 1e-9)), (load < before * (1.0 - 1e-9))
    return np.select([above, below], [LOADING, UNLOADING], HOLDING)


_cell = partial(Variable, ("realisation", "step"))
_vector = partial(Variable, ("realisation", "step", "component"))
_flow = partial(Variable, ("realisation", "step", "direction"))
_step = partial(Variable, ("step",))
_surface = partial(Variable, ("realisation",))
_stage = partial(Variable, ("body", "stage"))

MICRO_RESPONSE = Schema(
    name="micro_response",
    version=2,
    news="the branch of every step, from solve_cell and branch_of",
    variables={
        "displacement_jump": _vector("m", "mean displacement jump"),
        "traction": _vector("Pa", "averaged traction, eqs (2)-(3)"),
        "mean_gap": _cell("m", "mean distance of obstacle and deformed surface"),
        "contact_fraction": _cell("1", "real over nominal contact area"),
        "branch": _step("1", "branch of the path", BRANCHES, coordinate=True),
        "converged": _cell("1", "whether the contact solver converged"),
        "active_set_iterations": _cell("1", "number of active-set iterations"),
        "linear_iterations": _cell("1", "number of conjugate-gradient iterations"),
        "wall_time": _cell("s", "wall time of the step"),
    },
    optional={
        "real_pressure": _cell("Pa", "mean pressure on the real contact area"),
        "recovered_traction": _vector("Pa", "averaged traction from the recovered Cauchy stress"),
        "traction_by_normal": _vector(
            "Pa", "averaged traction of the local normal tractions only, eqs (2)-(3)"
        ),
        "spot_area": Variable(
            ("realisation", "step", "spot"), "m2", "real area of each contact spot"
        ),
        "spot_traction": Variable(
            ("realisation", "step", "spot", "component"),
            "Pa",
            "share of each contact spot in the averaged traction, eqs (2)-(3)",
        ),
        "spot_traction_by_normal": Variable(
            ("realisation", "step", "spot", "component"),
            "Pa",
            "share of each spot from the local normal tractions only",
        ),
        "hydraulic_aperture": _flow("m", "hydraulic aperture of the gap along x and y"),
        "percolating_share": _flow("1", "share of the cell in percolating paths of the gap"),
        "slip_fraction": _cell("1", "share of the contact nodes that slip"),
        "friction_work": _cell("J m-2", "work of friction since the start, per area"),
        "flowing_fraction": _cell("1", "share of the yielding Gauss points"),
        "increments": _cell("1", "number of increments of the step"),
        "mean_gap_increment_error": _step(
            "1", "relative error of the gap by the increments of a yielding body"
        ),
        "contact_fraction_increment_error": _step(
            "1", "relative error of the area by the increments of a yielding body"
        ),
        "mean_gap_slope_error": _step(
            "1", "relative error of the gap by the assumption of small slopes"
        ),
        "contact_fraction_slope_error": _step(
            "1", "relative error of the area by the assumption of small slopes"
        ),
        "time": _step("s", "time at the end of the step"),
        "pressure": Variable(("realisation", "step", "y", "x"), "Pa", "local contact pressure"),
        "gap": Variable(("realisation", "step", "y", "x"), "m", "local gap"),
        "height": Variable(("realisation", "y", "x"), "m", "height of the surface"),
        "nominal_pressure": _step("Pa", "prescribed mean pressure"),
        "sliding_speed": _step("m s-1", "prescribed speed of sliding"),
        "temperature": _step("K", "temperature of the body"),
        "rms_height": _surface("m", "root mean square height"),
        "rms_slope": _surface("1", "root mean square slope"),
        "nayak_parameter": _surface("1", "Nayak parameter"),
        "body_rms_height": _stage("m", "root mean square height of a measured body"),
        "body_rms_slope": _stage("1", "root mean square slope of a measured body"),
        "body_longest_wave": _stage(
            "m", "wavelength above which a hundredth of the mean square height lies"
        ),
        "body_shortest_wave": _stage(
            "m", "wavelength below which a hundredth of the mean square slope lies"
        ),
        "map_filled_share": Variable(("body",), "1", "filled points of the map over all points"),
        "filled_share": Variable(
            ("body", "realisation"), "1", "filled points of the window over all points"
        ),
    },
)

SHEAR_RESPONSE = replace(MICRO_RESPONSE, name="shear_response", version=1, news="")
"""Cells of two bodies that are pressed over the pressures of a law, then sheared."""

CONTROL_RESPONSE = replace(MICRO_RESPONSE, name="control_response", version=1, news="")
"""Flat control cells, the first of them on the surfaces of the cells of a response."""

COARSER_RESPONSE = replace(MICRO_RESPONSE, name="coarser_response", version=1, news="")
COARSER_SHEAR_RESPONSE = replace(SHEAR_RESPONSE, name="coarser_shear_response")
"""The first cells on half of the points, pressed, and pressed and sheared."""

_slide = partial(Variable, ("load", "step"))

SLIDING_RESPONSE = Schema(
    name="sliding_response",
    version=1,
    variables={
        "traction": Variable(("load", "step", "component"), "Pa", "averaged traction, eqs (2)-(3)"),
        "effective_friction": _slide("1", "traction along the motion over normal traction"),
        "steady_friction": Variable(("load",), "1", "mean friction over the last period"),
        "mean_gap": _slide("m", "mean distance of the deformed surfaces"),
        "contact_fraction": _slide("1", "real over nominal contact area"),
        "converged": _slide("1", "whether the contact solver converged"),
        "active_set_iterations": _slide("1", "number of Newton iterations"),
        "linear_iterations": _slide("1", "number of Krylov iterations"),
        "increments": _slide("1", "number of increments of the step"),
        "wall_time": _slide("s", "wall time of the step"),
    },
    optional={
        "nominal_pressure": Variable(("load",), "Pa", "prescribed mean pressure"),
        "sliding_distance": _step("m", "distance slid since the start"),
        "slip_fraction": _slide("1", "share of the contact nodes that slip"),
        "friction_work": _slide("J m-2", "work of friction since the start, per area"),
        "flowing_fraction": _slide("1", "share of the yielding Gauss points"),
    },
)

FIELDS = Schema(
    name="fields",
    version=1,
    variables={
        "height": Variable(("y", "x"), "m", "height of the composite surface"),
        "pressure": Variable(("step", "y", "x"), "Pa", "local contact pressure"),
        "gap": Variable(("step", "y", "x"), "m", "local gap"),
    },
    optional={"nominal_pressure": _step("Pa", "prescribed mean pressure")},
)

_number = partial(Variable, ())

SURFACE_STATISTICS = Schema(
    name="surface_statistics",
    version=1,
    variables={
        "height": Variable(("y", "x"), "m", "height without trend, at some of the points"),
        "wavenumber": Variable(("bin",), "rad m-1", "wavenumber", coordinate=True),
        "bearing_share": Variable(
            ("level",), "1", "share of points at or above a height", coordinate=True
        ),
        "bearing_height": Variable(("level",), "m", "height above the mean"),
        "dimensions": _number("1", "2 for a map and 1 for a line scan"),
        "size": Variable(("direction",), "m", "edge lengths along x and y"),
        "rms_height": _number("m", "root mean square height"),
        "rms_slope": _number("1", "root mean square slope"),
        "longest_wave": _number("m", "wavelength above which 1 % of the mean square height lies"),
        "shortest_wave": _number("m", "wavelength below which 1 % of the mean square slope lies"),
        "longest_reliable": _number("m", "longest reliable wavelength"),
        "shortest_reliable": _number("m", "shortest reliable wavelength"),
        "skewness": _number("1", "skewness of the heights"),
        "kurtosis": _number("1", "kurtosis of the heights, 3 if they are Gaussian"),
        "peak_to_valley": _number("m", "highest less lowest height"),
        "nayak_parameter": _number("1", "Nayak's parameter of the reliable wavelengths"),
        "filled_share": _number("1", "share of undefined points, which were filled"),
        "hurst_exponent": _number("1", "Hurst exponent of the self-affine fit"),
        "roll_off": _number("m", "wavelength above which the fit is flat"),
        "fitted_to": _number("m", "shortest wavelength of the fit"),
        "fit_level": _number("1", "density of the plateau, in the unit of the density"),
        "fit_deviation": _number("1", "rms deviation of the density from the fit, decades"),
        "lay_angle": _number("rad", "angle of the lay to the x axis"),
        "lay_ratio": _number("1", "rms slope across the lay over the slope along it"),
    },
    optional={
        "power_spectral_density": Variable(("bin",), "m4", "radially averaged spectral density"),
        "profile_density": Variable(("bin",), "m3", "spectral density of the line scan"),
    },
)
