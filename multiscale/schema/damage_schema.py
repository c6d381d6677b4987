"""Datasets of damage: sections, stiffness and fatigue."""

from functools import partial

from multiscale.schema.dataset_schema import Schema, Variable

_number = partial(Variable, ())
_record = partial(Variable, ("record",))
_step = partial(Variable, ("step",))
_volume = partial(Variable, ("realisation",))
_section = partial(Variable, ("realisation", "direction"), "1")
_direction = partial(Variable, ("direction",))
_element = partial(Variable, ("element",))
_LIMITS = partial(Variable, ("limit",))

DAMAGE_SECTIONS = Schema(
    name="damage_sections",
    version=1,
    variables={
        "normal": Variable(("direction", "axis"), "1", "unit normals of the sections"),
        "offset": Variable(("direction", "section"), "m", "distance from the centre"),
        "damage": Variable(("direction", "section"), "1", "damaged over whole area, eq (1)"),
        "maximum_damage": _number("1", "largest damage of all sections"),
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

RVE_VOLUMES = Schema(
    name="rve_volumes",
    version=1,
    variables={
        "share": _volume("1", "edge over the edge of the representative volume"),
        "porosity": _volume("1", "volume fraction of void"),
        "largest_damage": _section("largest damage of sections with a normal, eq (1)"),
        "mean_damage": _section("mean damage of sections with a normal"),
        "low_damage": _section("2.5 % quantile of the damage of sections with a normal"),
        "high_damage": _section("97.5 % quantile of the damage of sections with a normal"),
        "apparent_stiffness": Variable(
            ("realisation", "sides", "strain", "other_strain"),
            "Pa",
            "stiffness with traction, periodic and displacement sides; NaN where not converged",
        ),
        "coarse_stiffness": Variable(
            ("realisation", "strain", "other_strain"),
            "Pa",
            "stiffness with periodic sides on elements twice as large",
        ),
    },
)

RVE = Schema(
    name="rve",
    version=1,
    variables={
        **RVE_VOLUMES.variables,
        "normal": Variable(("direction", "axis"), "1", "unit normals of sections and tension"),
        "box_size": Variable(("axis",), "m", "size of the representative volume"),
        "apparent_modulus": Variable(
            ("realisation", "sides", "direction"), "Pa", "Young's modulus along the normal"
        ),
        "stiffness": Variable(
            ("strain", "other_strain"), "Pa", "mean stiffness with periodic sides"
        ),
        "modulus": _direction("Pa", "Young's modulus along the normal of the mean stiffness"),
        "modulus_mean_law": Variable(
            ("limit", "direction"), "Pa", "95 % interval of the modulus of the material"
        ),
        "modulus_one_part": Variable(
            ("limit", "direction"), "Pa", "95 % interval of the modulus of one further volume"
        ),
        "modulus_error": Variable(
            ("rve_error", "direction"), "1", "half-width of the 95 % interval by its causes"
        ),
        "scatter": _direction("1", "standard deviation of the modulus between volumes"),
        "damage": _direction("1", "largest damage of a section, mean over volumes, eq (1)"),
        "damage_mean_law": Variable(
            ("limit", "direction"), "1", "95 % interval of the mean over volumes"
        ),
        "damage_one_part": Variable(
            ("limit", "direction"), "1", "95 % interval of one further volume"
        ),
        "void": Variable(("x", "y", "z"), "1", "whether a voxel of the first volume is void"),
    },
    optional={
        "sides": Variable(("sides",), "1", "condition on the sides"),
        "strain": Variable(("strain",), "1", "component of stress"),
        "other_strain": Variable(("other_strain",), "1", "component of strain, shear as angle"),
        "rve_error": Variable(("rve_error",), "1", "cause of the error"),
    },
)

FATIGUE = Schema(
    name="fatigue",
    version=1,
    variables={
        "cycles": _record("1", "number of cycles"),
        "damage": _record("1", "damage of the micro-inclusion"),
        "plastic_strain": _record("1", "accumulated plastic strain of the micro-inclusion"),
        "cycles_to_initiation": _number("1", "cycles until damage begins"),
        "cycles_to_rupture": _number("1", "cycles until a crack starts"),
        "run_out": _number("1", "whether the inclusion stays elastic"),
        "computed_cycles": _number("1", "cycles with a computed stress path"),
        "converged": _number("1", "whether rupture or run-out was reached"),
        "wall_time": _number("s", "wall time"),
    },
)

FATIGUE_LIFE = Schema(
    name="fatigue_life",
    version=1,
    variables={
        "cycles": _record("1", "number of cycles at the ends of jumps between solves"),
        "largest_share": _record("1", "largest share of an element that has cracked"),
        "largest_damage": _record("1", "largest damage of an inclusion"),
        "cracked_share": _element("1", "share of the inclusions of an element that have cracked"),
        "damage": _element("1", "mean damage of the inclusions of an element at the end"),
        "plastic_strain": _element("1", "mean accumulated plastic strain of the inclusions"),
        "first_crack": _element(
            "1", "cycles to the first crack of each element in the sound structure"
        ),
        "equivalent_amplitude": _element("Pa", "half the von Mises range of the sound structure"),
        "crack_element": _number("1", "number of the element that cracks first, or -1"),
        "cycles_to_first": _number("1", "cycles until the first inclusion cracks"),
        "cycles_to_crack": _number("1", "cycles until an element has cracked through"),
        "run_out": _number("1", "whether all inclusions stay elastic"),
        "solves": _number("1", "number of solves of the structure"),
        "converged": _number("1", "whether a crack or run-out was reached"),
    },
    optional={
        "position": Variable(("node", "component"), "m", "position of the nodes"),
        "corners": Variable(
            ("element", "corner"), "1", "nodes at the corners of the elements, in the order of VTK"
        ),
        "crack_position": Variable(("component",), "m", "middle of the element that cracks"),
        "mesh_error": _number("1", "change of the logarithm of the first life on coarser meshes"),
        "crack_distance": _number("m", "distance of first cracks in all changes for the intervals"),
        "cycles_to_crack_mean_law": _LIMITS("1", "95 % interval of the life of the mean part"),
        "cycles_to_crack_one_part": _LIMITS("1", "95 % interval of the life of the next part"),
    },
)

WOEHLER = Schema(
    name="woehler",
    version=1,
    variables={
        "amplitude": _step("Pa", "half the range of stress"),
        "cycles_to_initiation": _step("1", "cycles until damage begins"),
        "cycles_to_rupture": _step("1", "cycles until a crack starts"),
        "run_out": _step("1", "whether the inclusion stays elastic"),
        "converged": _step("1", "whether rupture or run-out was reached"),
        "wall_time": _step("s", "wall time"),
    },
)

CRACK_GROWTH = Schema(
    name="crack_growth",
    version=1,
    variables={
        "factor": _record("1", "factor of the stress at which the next crack grows"),
        "mean_strain": Variable(("record", "strain"), "1", "mean strain, shear as angle"),
        "opening": _record("m", "inelastic displacement along the stress since the start"),
        "modulus_ratio": _record("1", "stiffness along the stress over the solid's"),
        "largest_section": _record("1", "largest crack area over the section of the volume"),
        "dissipation": _record("J", "energy dissipated by the growth of all cracks"),
        "radius": Variable(("record", "crack"), "m", "radii of the cracks"),
        "grown": _record("1", "number of cracks that have grown"),
        "touching": _record("1", "whether the growing crack reaches another crack"),
        "converged": _number("1", "whether a crack has cut the volume"),
    },
)

_event = partial(Variable, ("realisation", "record"))

VOLUME_GROWTH = Schema(
    name="volume_growth",
    version=1,
    variables={
        "share": _volume("1", "edge over the edge of the representative volume"),
        "stress": _event("Pa", "mean stress at which the next crack grows"),
        "strain": _event("1", "mean strain along the pull"),
        "damage": _event("1", "damage of the section across the pull at the widest crack, eq (1)"),
        "modulus_ratio": _event("1", "stiffness along the pull over the solid's"),
        "volume_strength": _volume("Pa", "largest stress of each volume"),
        "volume_energy": _volume("J m-2", "energy per area of the crack of each volume"),
        "peak_damage": _volume("1", "damage of the section at the largest stress, eq (1)"),
        "softening_stress": Variable(("realisation", "point"), "Pa", "stress across the crack"),
        "softening_opening": Variable(("realisation", "point"), "m", "opening of the crack"),
        "mean_stress": Variable(("point",), "Pa", "stress of the mean softening law"),
        "mean_opening": Variable(("point",), "m", "opening of the mean softening law"),
        "strength": _number("Pa", "mean strength of representative volumes"),
        "fracture_energy": _number("J m-2", "mean energy per area of their cracks"),
        "strength_mean_law": _LIMITS("Pa", "95 % interval of the mean strength"),
        "strength_one_part": _LIMITS("Pa", "95 % interval of one further volume"),
        "fracture_energy_mean_law": _LIMITS("J m-2", "95 % interval of the mean energy"),
        "fracture_energy_one_part": _LIMITS("J m-2", "95 % interval of one further volume"),
        "converged": _volume("1", "whether a crack has cut the volume"),
    },
)

CRACK_BAND = Schema(
    name="crack_band",
    version=1,
    variables={
        "factor": _record("1", "factor of the loads"),
        "work_displacement": _record("J", "work of the loads at factor 1"),
        "dissipation": _record("J", "energy dissipated since the start"),
        "stiffness_share": _element("1", "stiffness of the elements over their initial stiffness"),
        "band_width": _element("m", "width of the band of cracked elements"),
        "converged": _number("1", "whether the load has fallen to its final value"),
    },
)

CRACKED_BODY = Schema(
    name="cracked_body",
    version=1,
    variables={
        **CRACK_BAND.variables,
        "peak_load": _number("1", "largest factor of the last loads of [statics]"),
        "work": _number("J", "energy dissipated by the cracks"),
        "peak_load_sample": _volume("1", "largest factor with the softening law of each volume"),
        "work_sample": _volume("J", "energy with the softening law of each volume"),
        "peak_load_mean_law": _LIMITS("1", "95 % interval with the mean law"),
        "peak_load_one_part": _LIMITS("1", "95 % interval of one further body"),
        "work_mean_law": _LIMITS("J", "95 % interval with the mean law"),
        "work_one_part": _LIMITS("J", "95 % interval of one further body"),
        "position": Variable(("node", "component"), "m", "position of the nodes"),
        "corners": Variable(
            ("element", "corner"), "1", "nodes at the corners of the elements, in the order of VTK"
        ),
    },
    optional={
        "peak_load_mesh": _number("1", "relative change of the peak on the coarser mesh"),
        "work_mesh": _number("1", "relative change of the energy on the coarser mesh"),
    },
)
