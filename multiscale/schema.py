"""The datasets that pass between the layers: names, dimensions and units, written once."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from multiscale.errors import SchemaError

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "COMPONENTS",
    "DAMAGE_SECTIONS",
    "ERROR_BUDGET",
    "FATIGUE",
    "FIELDS",
    "HOMOGENISED",
    "INTERFACE_LAW",
    "LAW_COMPARISON",
    "MACRO_RESULT",
    "MICRO_RESPONSE",
    "RVE_STIFFNESS",
    "SCHEMAS",
    "WOEHLER",
    "WORK_PRECISION",
    "Schema",
    "Variable",
]

COMPONENTS = ("n", "t1", "t2")
"""Labels of the dimension ``component``: the normal and the two tangents of the joint."""


@dataclass(frozen=True)
class Variable:
    """Dimensions, unit (UDUNITS spelling) and meaning of one variable."""

    dims: tuple[str, ...]
    units: str
    long_name: str


@dataclass(frozen=True)
class Schema:
    """Names, dimensions and units of one kind of dataset.

    Parameters
    ----------
    name, version
        Written into every file; :mod:`multiscale.io` refuses another version.
    variables : mapping of str to Variable
        What must be there.
    optional : mapping of str to Variable
        What may be there, and then in this form. Coordinates are listed here too.
    """

    name: str
    version: int
    variables: Mapping[str, Variable]
    optional: Mapping[str, Variable] = field(default_factory=dict)

    def check(self, dataset: "xr.Dataset") -> None:
        """Raise if a variable is missing or has other dimensions or units.

        Raises
        ------
        SchemaError
            With every fault found, one a line.
        """
        faults = []
        for name, variable in {**self.variables, **self.optional}.items():
            if name not in dataset.variables:
                if name in self.variables:
                    faults.append(f"{name}: missing ({variable.long_name}, {variable.units})")
                continue
            found = dataset[name]
            if found.dims != variable.dims:
                faults.append(f"{name}: dimensions {found.dims}, expected {variable.dims}")
            if found.attrs.get("units") != variable.units:
                faults.append(
                    f"{name}: units {found.attrs.get('units')!r}, expected {variable.units!r}"
                )
        if faults:
            raise SchemaError(
                f"not a {self.name!r} dataset (schema version {self.version}):\n  "
                + "\n  ".join(faults)
            )

    def build(self, values: Mapping[str, Any], **attributes: str | float | int) -> "xr.Dataset":
        """Make a dataset from plain arrays; dimensions, units and labels come from the schema.

        Parameters
        ----------
        values : mapping of str to array_like
            One array per variable or optional variable. A dimension without a coordinate of its
            own name gets integer labels, ``component`` its names.
        **attributes
            Attributes of the dataset, strings and numbers.

        Raises
        ------
        SchemaError
            As :meth:`check`.
        """
        import xarray as xr

        dataset = self.assign(xr.Dataset(attrs=attributes), values)
        for dim, size in dataset.sizes.items():
            if dim == "component":
                dataset = dataset.assign_coords(component=list(COMPONENTS[:size]))
            elif dim not in dataset.coords:
                dataset = dataset.assign_coords({dim: range(size)})
        self.check(dataset)
        return dataset

    def assign(self, dataset: "xr.Dataset", values: Mapping[str, Any]) -> "xr.Dataset":
        """Add variables to a dataset; dimensions and units come from the schema.

        Raises
        ------
        SchemaError
            If the schema has no variable of a name.
        """
        known = {**self.variables, **self.optional}
        added = {}
        for name, value in values.items():
            if name not in known:
                raise SchemaError(f"a {self.name!r} dataset has no variable {name!r}")
            variable = known[name]
            attrs: dict[str, Any] = {"units": variable.units, "long_name": variable.long_name}
            if name == "converged":
                attrs |= {"flag_values": [0, 1], "flag_meanings": "failed converged"}
            added[name] = (variable.dims, value, attrs)
        along = [name for name in values if name in self.optional and name in COORDINATES]
        return dataset.assign(added).set_coords(along)


COORDINATES = frozenset(
    {
        "nominal_pressure",
        "rms_height",
        "rms_slope",
        "nayak_parameter",
        "preload",
        "load_factor",
        "method",
        "scene",
        "time",
        "law",
    }
)
"""Physical values that label a dimension without being its index."""

_CELL = ("realisation", "step")

MICRO_RESPONSE = Schema(
    name="micro_response",
    version=1,
    variables={
        "displacement_jump": Variable((*_CELL, "component"), "m", "mean displacement jump"),
        "traction": Variable((*_CELL, "component"), "Pa", "averaged traction, eqs (2)-(3)"),
        "mean_gap": Variable(_CELL, "m", "mean distance of obstacle and deformed surface"),
        "contact_fraction": Variable(_CELL, "1", "real over nominal contact area"),
        "converged": Variable(_CELL, "1", "whether the contact solver converged"),
        "active_set_iterations": Variable(_CELL, "1", "number of active-set iterations"),
        "linear_iterations": Variable(_CELL, "1", "number of conjugate-gradient iterations"),
        "wall_time": Variable(_CELL, "s", "wall time of the step"),
    },
    optional={
        "recovered_traction": Variable(
            (*_CELL, "component"), "Pa", "averaged traction from the recovered Cauchy stress"
        ),
        "pressure": Variable((*_CELL, "y", "x"), "Pa", "local contact pressure"),
        "gap": Variable((*_CELL, "y", "x"), "m", "local gap"),
        "nominal_pressure": Variable(("step",), "Pa", "prescribed mean pressure"),
        "rms_height": Variable(("realisation",), "m", "root mean square height"),
        "rms_slope": Variable(("realisation",), "1", "root mean square slope"),
        "nayak_parameter": Variable(("realisation",), "1", "Nayak parameter"),
    },
)

_BUDGET = {
    "error_half_width": Variable(
        ("quantity", "error_term", "step"), "1", "half-width of the 95 % interval over the value"
    ),
    "error_total": Variable(("quantity", "step"), "1", "all known terms together"),
}

INTERFACE_LAW = Schema(
    name="interface_law",
    version=1,
    variables={"fit_pressure": Variable(("step",), "Pa", "mean pressure of the data fitted")},
    optional={
        "knot": Variable(("term",), "m", "gap at which a term of the normal law vanishes"),
        "coefficient": Variable(("term",), "Pa m-3", "coefficient of the normal law"),
        "coefficient_sample": Variable(
            ("sample", "term"), "Pa m-3", "coefficients of the bootstrap samples"
        ),
        "area_pressure": Variable(("area_term",), "Pa", "pressure knots of the area law"),
        "area_fraction": Variable(("area_term",), "1", "contact fraction at the pressure knots"),
        "area_fraction_sample": Variable(
            ("sample", "area_term"), "1", "contact fractions of the bootstrap samples"
        ),
        "fit_mean_gap": Variable(("step",), "m", "mean gap of the data fitted"),
        "fit_stiffness": Variable(("step",), "Pa m-1", "stiffness of the data fitted"),
        "fit_contact_fraction": Variable(("step",), "1", "contact fraction of the data fitted"),
        "fit_friction_coefficient": Variable(
            ("step",), "1", "friction coefficient of the data fitted"
        ),
        "fit_recovery": Variable(("step",), "m", "spring back of the data fitted"),
        "fit_speed": Variable(("step",), "m s-1", "sliding speed of the data fitted"),
        "fit_peak_pressure": Variable(("step",), "Pa", "largest pressure before unloading"),
        "fit_error": Variable(
            ("step",), "1", "relative error of a fit without this point, of the quantity fitted"
        ),
        "stiffness_fit_error": Variable(
            ("step",), "1", "relative error of the stiffness of a fit without this point"
        ),
        "area_fit_error": Variable(
            ("area_term",), "1", "relative error of an area law without this point"
        ),
        **_BUDGET,
    },
)
"""A law of a family with parameters also has a scalar per parameter, and one per sample."""

MACRO_RESULT = Schema(
    name="macro_result",
    version=1,
    variables={
        "converged": Variable(("step",), "1", "whether the macro solver converged"),
        "residual": Variable(("step",), "1", "residual relative to the load"),
        "wall_time": Variable(("step",), "s", "wall time of the step"),
    },
    optional={
        "preload": Variable(("step",), "Pa", "nominal preload"),
        "joint_stiffness": Variable(("step",), "Pa m-1", "normal stiffness of the whole joint"),
        "joint_stiffness_sample": Variable(
            ("sample", "step"), "Pa m-1", "joint stiffness for each sample of the law"
        ),
        "interface_stiffness": Variable(
            ("step",), "Pa m-1", "normal stiffness of the interface alone"
        ),
        "solid_stiffness": Variable((), "Pa m-1", "stiffness of the blocks without interface"),
        "approach": Variable(("step",), "m", "displacement of the loaded platen"),
        "mean_gap": Variable(("step",), "m", "area mean of the gap of the joint"),
        "contact_fraction": Variable(("step",), "1", "real over nominal contact area"),
        "contact_fraction_sample": Variable(
            ("sample", "step"), "1", "contact fraction for each sample of the law"
        ),
        "closed_fraction": Variable(("step",), "1", "share of the interface that carries pressure"),
        "position": Variable(("node", "component"), "m", "position of the nodes"),
        "ends": Variable(("link", "end"), "1", "nodes at both ends of the links"),
        "law": Variable(("link",), "1", "kind of the links: bar, beam, cable or strut"),
        "cycles": Variable(("step",), "1", "number of load cycles"),
        "damage": Variable(("step",), "1", "damage of blocks and interface by the cycles"),
        "load_factor": Variable(("step",), "1", "factor of the loads"),
        "tension": Variable(("step", "link"), "N", "tension, compression negative"),
        "slack": Variable(("step", "link"), "m", "distance by which the ends of a link miss it"),
        "displacement": Variable(("step", "node", "component"), "m", "displacement of the nodes"),
        "rotation": Variable(("step", "node", "component"), "rad", "rotation of the nodes"),
        "moment": Variable(
            ("step", "link", "part"), "N m", "torsion and end moments of beams in their axes"
        ),
        "iterations": Variable(("step",), "1", "number of residuals that the solver computed"),
        "krylov_iterations": Variable(
            ("step",), "1", "number of iterations of the linear solver in all Newton steps"
        ),
        "error_bound": Variable(
            ("step",), "1", "guaranteed bound on the error of the tensions relative to their change"
        ),
        "tangent_eigenvalue": Variable(("step",), "N m-1", "smallest eigenvalue of the tangent"),
        "stability_eigenvalue": Variable(
            ("step",), "N m-1", "smallest eigenvalue with the geometric stiffness"
        ),
        "traction": Variable(("step", "point", "direction"), "Pa", "traction of the joints"),
        "jump": Variable(("step", "point", "direction"), "m", "displacement jump of the joints"),
        "point_position": Variable(("point", "component"), "m", "position of points of joints"),
        "point_area": Variable(("point",), "m2", "area that a point of a joint stands for"),
        "point_joint": Variable(("point",), "1", "number of the joint of a point"),
        "contact_state": Variable(
            ("step", "point"), "1", "whether a point is open (0), sticks (1) or slips (2)"
        ),
        "open_fraction": Variable(("step",), "1", "share of the joint area that is open"),
        "stick_fraction": Variable(("step",), "1", "share of the joint area that sticks"),
        "slip_fraction": Variable(("step",), "1", "share of the joint area that slips"),
        "beyond_fraction": Variable(
            ("step",), "1", "share of the joint area whose pressure lies beyond the data of the law"
        ),
        "shear": Variable(("step",), "Pa", "tangential traction on the loaded face"),
        "shear_displacement": Variable(
            ("step",), "m", "mean displacement of the loaded face along the tangential traction"
        ),
        "tangential_stiffness": Variable(
            ("step",), "Pa m-1", "tangential stiffness of the whole joint"
        ),
        "cycle_energy": Variable(("cycle",), "J", "energy that the joint loses in a closed cycle"),
        "time": Variable(("step",), "s", "time"),
        "velocity": Variable(("step", "node", "component"), "m s-1", "velocity of the nodes"),
        "impulse": Variable(("step", "link"), "N s", "impulse of inextensible links in the step"),
        "kinetic_energy": Variable(("step",), "J", "kinetic energy"),
        "elastic_energy": Variable(("step",), "J", "elastic energy of the links"),
        "work": Variable(("step",), "J", "work of loads and supports since the start"),
        "numerical_dissipation": Variable(
            ("step",), "J", "energy lost to the time scheme since the start"
        ),
        "link_dissipation": Variable(
            ("step",), "J", "energy lost in the links since the start, summed link by link"
        ),
        "smallest_link_dissipation": Variable(
            ("step",), "J", "smallest energy that one link lost in the step"
        ),
        **_BUDGET,
    },
)

ERROR_BUDGET = Schema(
    name="error_budget",
    version=1,
    variables=_BUDGET,
    optional={"nominal_pressure": Variable(("step",), "Pa", "pressure of the steps")},
)

LAW_COMPARISON = Schema(
    name="law_comparison",
    version=1,
    variables={
        "cross_validated_error": Variable(
            ("family",), "1", "root mean square error at points a fit has not seen"
        ),
        "n_parameters": Variable(("family",), "1", "number of free parameters"),
        "akaike_criterion": Variable(("family",), "1", "corrected information criterion"),
        "akaike_weight": Variable(("family",), "1", "relative likelihood of the family"),
        "admissible": Variable(("family",), "1", "whether the law is admissible"),
    },
)

HOMOGENISED = Schema(
    name="homogenised",
    version=1,
    variables={
        "stiffness": Variable(
            ("status", "substructure", "resultant", "other_resultant"),
            "N m-1",
            "stiffness condensed on the resultants of the interfaces, NaN beyond their number",
        ),
        "coarse_unknown": Variable(
            ("substructure", "resultant"), "1", "number of the resultant in the structure, or -1"
        ),
        "rigid_motion": Variable(
            ("substructure", "resultant", "motion"),
            "1",
            "coarse motion in three translations, and in three rotations times m",
        ),
        "slack_links": Variable(("substructure",), "1", "number of slack links"),
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
    optional={"nominal_pressure": Variable(("step",), "Pa", "prescribed mean pressure")},
)

WORK_PRECISION = Schema(
    name="work_precision",
    version=1,
    variables={
        "error": Variable(("run",), "1", "relative error against the reference"),
        "wall_time": Variable(("run",), "s", "wall time"),
        "converged": Variable(("run",), "1", "whether the run converged"),
    },
    optional={
        "peak_memory": Variable(("run",), "byte", "peak memory"),
        "iterations": Variable(("run",), "1", "number of iterations"),
        "unknowns": Variable(("run",), "1", "number of unknowns"),
        "points": Variable(("run",), "1", "grid points along an edge"),
        "cables": Variable(("run",), "1", "number of cables"),
        "slack_fraction": Variable(("run",), "1", "share of the cables that are slack"),
        "residual": Variable(("run",), "1", "relative residual, verified in the answer"),
        "own_error": Variable(("run",), "1", "relative error against the limit of the method"),
        "error_uncertainty": Variable(("run",), "1", "uncertainty of the reference"),
        "contact_error": Variable(("run",), "1", "relative error of the contact fraction"),
        "own_contact_error": Variable(
            ("run",), "1", "relative error of the contact fraction against the method's limit"
        ),
        "contact_error_uncertainty": Variable(
            ("run",), "1", "uncertainty of the reference of the contact fraction"
        ),
        "mean_gap": Variable(("run",), "m", "mean distance of obstacle and deformed surface"),
        "contact_fraction": Variable(("run",), "1", "real over nominal contact area"),
        "relative_pressure": Variable(
            ("run",), "1", "mean pressure over contact modulus times rms slope"
        ),
        "tolerance": Variable(("run",), "1", "relative error asked for"),
        "history_run": Variable(("sample",), "1", "run that a sample of the histories belongs to"),
        "history_seconds": Variable(("sample",), "s", "time since the start of the run"),
        "history_error": Variable(("sample",), "1", "relative error at that time"),
        "method": Variable(("run",), "1", "solver or code"),
        "scene": Variable(("run",), "1", "scene"),
    },
)

DAMAGE_SECTIONS = Schema(
    name="damage_sections",
    version=1,
    variables={
        "normal": Variable(("direction", "axis"), "1", "unit normals of the sections"),
        "offset": Variable(("direction", "section"), "m", "distance from the centre"),
        "damage": Variable(("direction", "section"), "1", "damaged over whole area, eq (1)"),
        "maximum_damage": Variable((), "1", "largest damage found"),
        "worst_normal": Variable(("axis",), "1", "normal of the worst plane"),
        "worst_offset": Variable((), "m", "distance of the worst plane from the centre"),
        "mean_damage": Variable((), "1", "mean damage of the sections"),
        "quantile_damage": Variable(("quantile_rank",), "1", "quantiles of the damage"),
        "quantile": Variable(("quantile_rank",), "1", "share of sections with less damage"),
        "anisotropy": Variable(
            ("axis", "other_axis"), "1", "tensor T nearest to n.Tn = damage of the worst section"
        ),
        "box_size": Variable(("axis",), "m", "size of the representative volume"),
    },
    optional={
        "resolution_error": Variable(
            (), "1", "change of the largest damage from half the resolution"
        ),
    },
)

RVE_STIFFNESS = Schema(
    name="rve_stiffness",
    version=1,
    variables={
        "stiffness": Variable(("strain", "other_strain"), "Pa", "effective stiffness"),
        "normal": Variable(("direction", "axis"), "1", "unit normals"),
        "modulus_ratio": Variable(
            ("direction",), "1", "Young's modulus along the normal over that of the solid"
        ),
        "damage": Variable(("direction",), "1", "damage of the worst section, eq (1)"),
        "porosity": Variable((), "1", "volume fraction of void"),
    },
    optional={
        "strain": Variable(("strain",), "1", "component of stress"),
        "other_strain": Variable(("other_strain",), "1", "component of strain, shear as angle"),
    },
)

FATIGUE = Schema(
    name="fatigue",
    version=1,
    variables={
        "cycles": Variable(("record",), "1", "number of cycles"),
        "damage": Variable(("record",), "1", "damage of the micro-inclusion"),
        "plastic_strain": Variable(("record",), "1", "accumulated plastic strain of it"),
        "cycles_to_initiation": Variable((), "1", "cycles until damage sets in"),
        "cycles_to_rupture": Variable((), "1", "cycles until a crack starts"),
        "run_out": Variable((), "1", "whether the inclusion stays elastic"),
        "computed_cycles": Variable((), "1", "cycles whose stress path was followed"),
        "converged": Variable((), "1", "whether rupture or run-out was reached"),
        "wall_time": Variable((), "s", "wall time"),
    },
)

WOEHLER = Schema(
    name="woehler",
    version=1,
    variables={
        "amplitude": Variable(("step",), "Pa", "half the range of stress"),
        "cycles_to_initiation": Variable(("step",), "1", "cycles until damage sets in"),
        "cycles_to_rupture": Variable(("step",), "1", "cycles until a crack starts"),
        "run_out": Variable(("step",), "1", "whether the inclusion stays elastic"),
        "converged": Variable(("step",), "1", "whether rupture or run-out was reached"),
        "wall_time": Variable(("step",), "s", "wall time"),
    },
)

SCHEMAS = {
    schema.name: schema
    for schema in (
        MICRO_RESPONSE,
        INTERFACE_LAW,
        MACRO_RESULT,
        FIELDS,
        WORK_PRECISION,
        DAMAGE_SECTIONS,
        RVE_STIFFNESS,
        FATIGUE,
        WOEHLER,
        ERROR_BUDGET,
        LAW_COMPARISON,
        HOMOGENISED,
    )
}
