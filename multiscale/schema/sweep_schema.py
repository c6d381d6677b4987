"""Dataset of a sweep."""

from functools import partial

from multiscale.schema.dataset_schema import Schema, Variable

__all__ = ["SWEEP"]

_step = partial(Variable, ("point", "step"))
_point = partial(Variable, ("point",))

SWEEP = Schema(
    name="sweep",
    version=1,
    variables={
        "setting": Variable(("point", "parameter"), "1", "what the case of a point says"),
        "folder": _point("1", "run folder of a point"),
        "failure": _point("1", "why a point has no result; empty if it has one"),
        "converged": _step("1", "whether the macro solver converged"),
        "preload": _step("Pa", "nominal preload"),
        "joint_stiffness": _step("Pa m-1", "normal stiffness of the whole joint"),
        "joint_stiffness_low": _step("Pa m-1", "lower end of the 95 % band of the joint stiffness"),
        "joint_stiffness_high": _step(
            "Pa m-1", "upper end of the 95 % band of the joint stiffness"
        ),
        "mean_gap": _step("m", "area mean of the gap of the joint"),
        "contact_fraction": _step("1", "real over nominal contact area"),
    },
    optional={
        "interface_stiffness": _step("Pa m-1", "normal stiffness of the interface alone"),
        "solid_stiffness": _step("Pa m-1", "normal stiffness of the bodies alone"),
        "real_pressure": _step("Pa", "mean pressure on the real contact area"),
        "error_total": Variable(
            ("point", "quantity", "step"), "1", "total error of a stiffness, relative"
        ),
        "caution": _point("1", "what to beware of at a point, a line for each"),
    },
)
