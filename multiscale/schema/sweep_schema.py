"""Dataset of a sweep."""

from multiscale.schema.dataset_schema import Schema, Variable

__all__ = ["SWEEP"]

SWEEP = Schema(
    name="sweep",
    version=1,
    variables={
        "setting": Variable(("point", "parameter"), "1", "what the case of a point says"),
        "folder": Variable(("point",), "1", "run folder of a point"),
        "failure": Variable(("point",), "1", "why a point has no result; empty if it has one"),
        "converged": Variable(("point", "step"), "1", "whether the macro solver converged"),
        "preload": Variable(("point", "step"), "Pa", "nominal preload"),
        "joint_stiffness": Variable(
            ("point", "step"), "Pa m-1", "normal stiffness of the whole joint"
        ),
        "joint_stiffness_low": Variable(
            ("point", "step"), "Pa m-1", "lower end of the 95 % band of the joint stiffness"
        ),
        "joint_stiffness_high": Variable(
            ("point", "step"), "Pa m-1", "upper end of the 95 % band of the joint stiffness"
        ),
        "mean_gap": Variable(("point", "step"), "m", "area mean of the gap of the joint"),
        "contact_fraction": Variable(("point", "step"), "1", "real over nominal contact area"),
    },
    optional={
        "interface_stiffness": Variable(
            ("point", "step"), "Pa m-1", "normal stiffness of the interface alone"
        ),
        "solid_stiffness": Variable(
            ("point", "step"), "Pa m-1", "normal stiffness of the bodies alone"
        ),
        "real_pressure": Variable(
            ("point", "step"), "Pa", "mean pressure on the real contact area"
        ),
        "error_total": Variable(
            ("point", "quantity", "step"), "1", "total error of a stiffness, relative"
        ),
        "caution": Variable(("point",), "1", "what to beware of at a point, a line for each"),
    },
)
