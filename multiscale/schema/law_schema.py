"""Datasets of laws: fits, their errors and their comparison."""

from functools import partial

from multiscale.schema.dataset_schema import BUDGET, SENSITIVITY, Schema, Variable

_step = partial(Variable, ("step",))
_flow = partial(Variable, ("direction", "step"))
_number = partial(Variable, ())
_down = partial(Variable, ("unloading_step",))
_sheared = partial(Variable, ("shear_step", "tangent"))
_family = partial(Variable, ("family",))

SCATTER = {
    "cell_scatter": Variable(
        ("quantity", "step"), "1", "coefficient of variation over single cells"
    )
}

INTERFACE_LAW = Schema(
    name="interface_law",
    version=1,
    variables={"fit_pressure": _step("Pa", "mean pressure of the data fitted")},
    optional={
        "knot": Variable(("term",), "m", "gap at which a term of the normal law vanishes"),
        "coefficient": Variable(("term",), "Pa m-3", "coefficient of the normal law"),
        "table_pressure": Variable(("term",), "Pa", "pressures of a table, zero first"),
        "table_gap": Variable(("term",), "m", "gaps at the pressures of a table"),
        "area_pressure": Variable(("area_term",), "Pa", "pressure knots of the area law"),
        "area_fraction": Variable(("area_term",), "1", "contact fraction at the pressure knots"),
        "fit_mean_gap": _step("m", "mean gap of the data fitted"),
        "fit_stiffness": _step("Pa m-1", "stiffness of the data fitted"),
        "fit_contact_fraction": _step("1", "contact fraction of the data fitted"),
        "fit_friction_coefficient": _step("1", "friction coefficient of the data fitted"),
        "fit_recovery": _step("m", "recovery of the gap of the data fitted"),
        "fit_speed": _step("m s-1", "sliding speed of the data fitted"),
        "fit_peak_pressure": _step("Pa", "largest pressure before unloading"),
        "fit_error": _step(
            "1", "relative error of a fit without this point, of the quantity fitted"
        ),
        "stiffness_fit_error": _step(
            "1", "relative error of the stiffness of a fit without this point"
        ),
        "area_fit_error": Variable(
            ("area_term",), "1", "relative error of an area law without this point"
        ),
        "gap_fit_share": _number("1", "share of fit_error between the data"),
        "stiffness_fit_share": _number("1", "share of stiffness_fit_error at the data"),
        "area_fit_share": _number("1", "share of area_fit_error between the data"),
        "unloading_stiffness_ratio": _number(
            "1", "stiffness at the start of unloading over stiffness of loading"
        ),
        "unloading_exponent": _number("1", "exponent of the unloading branch"),
        "unloading_pressure": _down("Pa", "mean pressure of the unloading data"),
        "unloading_peak_pressure": _down("Pa", "largest pressure before the unloading data"),
        "unloading_recovery": _down("m", "recovery of the gap of the unloading data"),
        "unloading_fit_error": _down("1", "error of a fit without this point over the recovery"),
        "shear_stiffness_ratio": Variable(
            ("tangent",), "1", "tangential over normal stiffness, along x and y"
        ),
        "shear_friction": _number("1", "friction coefficient of the bed of sliders"),
        "shear_friction_error": _number(
            "1", "relative half-width of the 95 % interval of a friction without samples"
        ),
        "shear_pressure": Variable(("shear_step",), "Pa", "mean pressure of the shear data"),
        "shear_slip": _sheared("m", "slip of the shear data"),
        "shear_traction": _sheared("Pa", "tangential traction of the shear data"),
        "shear_bed_traction": _sheared("Pa", "tangential traction of the bed along the shear data"),
        "shear_loss_ratio": Variable(
            ("control",),
            "1",
            "loss of the cells in closed cycles over the loss of the bed, at equal slip and at "
            "equal traction",
        ),
        "shear_loss_grid_error": _number(
            "1", "half-width of the 95 % interval of the loss ratio by the grid of the cells"
        ),
        "shear_cycle_pressure": Variable(("shear_cycle",), "Pa", "mean pressure of a closed cycle"),
        "shear_cycle_amplitude": Variable(
            ("shear_cycle",), "1", "amplitude of the traction of a closed cycle over full slip"
        ),
        "shear_cycle_loss_ratio": Variable(
            ("shear_cycle", "control"),
            "1",
            "loss of the cells over the loss of the bed in a closed cycle",
        ),
        "thermal_conductance_ratio": _number(
            "W m-1 K-1 Pa-1", "thermal conductance over the stiffness of loading"
        ),
        "electrical_conductance_ratio": _number(
            "S m-1 Pa-1", "electrical conductance over the stiffness of loading"
        ),
        "hydraulic_aperture": _flow("m", "hydraulic aperture of the interface"),
        "percolating_cells": _flow("1", "share of the cells with a percolating path of the gap"),
        "hydraulic_aperture_mean_law": Variable(
            ("limit", "direction", "step"), "m", "95 % interval of the hydraulic aperture"
        ),
        "interface_damage": _number(
            "1", "mean damage of the sections parallel to the interface, eq (1)"
        ),
        "interface_damage_band": Variable(
            ("limit",), "1", "ends of the 95 % interval of the damage over the sections"
        ),
        "sliding_pressure": Variable(("load",), "Pa", "mean pressure of the sliding data"),
        "sliding_friction": Variable(("load",), "1", "steady friction coefficient of sliding"),
        **BUDGET,
        **SCATTER,
    },
).with_samples(
    sample=("coefficient", "area_fraction"),
    shear_sample=("shear_stiffness_ratio", "shear_friction", "shear_loss_ratio"),
    unloading_sample=("unloading_stiffness_ratio", "unloading_exponent"),
)
"""A law of a family with parameters also has each parameter as a scalar, and its samples."""

ERROR_BUDGET = Schema(
    name="error_budget",
    version=1,
    variables=BUDGET,
    optional={"nominal_pressure": _step("Pa", "pressure of the steps"), **SCATTER, **SENSITIVITY},
)

LAW_COMPARISON = Schema(
    name="law_comparison",
    version=1,
    variables={
        "cross_validated_error": _family(
            "1", "root mean square error at points left out of the fit"
        ),
        "n_parameters": _family("1", "number of free parameters"),
        "akaike_criterion": _family("1", "corrected information criterion"),
        "akaike_weight": _family("1", "relative likelihood of the family"),
        "admissible": _family("1", "whether the law is admissible"),
    },
)
