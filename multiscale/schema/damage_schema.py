"""Datasets of damage: sections, stiffness and fatigue."""

from functools import partial

from multiscale.schema.dataset_schema import Schema, Variable

__all__ = ["DAMAGE_SECTIONS", "FATIGUE", "RVE_STIFFNESS", "WOEHLER"]

_number = partial(Variable, ())
_record = partial(Variable, ("record",))
_step = partial(Variable, ("step",))

DAMAGE_SECTIONS = Schema(
    name="damage_sections",
    version=1,
    variables={
        "normal": Variable(("direction", "axis"), "1", "unit normals of the sections"),
        "offset": Variable(("direction", "section"), "m", "distance from the centre"),
        "damage": Variable(("direction", "section"), "1", "damaged over whole area, eq (1)"),
        "maximum_damage": _number("1", "largest damage found"),
        "worst_normal": Variable(("axis",), "1", "normal of the worst plane"),
        "worst_offset": _number("m", "distance of the worst plane from the centre"),
        "mean_damage": _number("1", "mean damage of the sections"),
        "quantile_damage": Variable(("quantile_rank",), "1", "quantiles of the damage"),
        "quantile": Variable(("quantile_rank",), "1", "share of sections with less damage"),
        "anisotropy": Variable(
            ("axis", "other_axis"), "1", "tensor T nearest to n.Tn = damage of the worst section"
        ),
        "box_size": Variable(("axis",), "m", "size of the representative volume"),
    },
    optional={
        "resolution_error": _number("1", "change of the largest damage from half the resolution")
    },
)

RVE_STIFFNESS = Schema(
    name="rve_stiffness",
    version=1,
    variables={
        "stiffness": Variable(("strain", "other_strain"), "Pa", "effective stiffness"),
        "normal": Variable(("direction", "axis"), "1", "unit normals"),
        "modulus_ratio": Variable(
            ("direction",), "1", "Young's modulus along the normal over the solid's"
        ),
        "damage": Variable(("direction",), "1", "damage of the worst section, eq (1)"),
        "porosity": _number("1", "volume fraction of void"),
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
        "cycles": _record("1", "number of cycles"),
        "damage": _record("1", "damage of the micro-inclusion"),
        "plastic_strain": _record("1", "accumulated plastic strain of it"),
        "cycles_to_initiation": _number("1", "cycles until damage sets in"),
        "cycles_to_rupture": _number("1", "cycles until a crack starts"),
        "run_out": _number("1", "whether the inclusion stays elastic"),
        "computed_cycles": _number("1", "cycles whose stress path was followed"),
        "converged": _number("1", "whether rupture or run-out was reached"),
        "wall_time": _number("s", "wall time"),
    },
)

WOEHLER = Schema(
    name="woehler",
    version=1,
    variables={
        "amplitude": _step("Pa", "half the range of stress"),
        "cycles_to_initiation": _step("1", "cycles until damage sets in"),
        "cycles_to_rupture": _step("1", "cycles until a crack starts"),
        "run_out": _step("1", "whether the inclusion stays elastic"),
        "converged": _step("1", "whether rupture or run-out was reached"),
        "wall_time": _step("s", "wall time"),
    },
)
