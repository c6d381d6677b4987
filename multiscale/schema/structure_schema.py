"""Datasets of structures: results, substructures condensed on resultants, grains in motion."""

from functools import partial

from multiscale.schema.dataset_schema import BUDGET, SENSITIVITY, Schema, Variable

_step = partial(Variable, ("step",))
_face = partial(Variable, ("step", "interface"))
_element = partial(Variable, ("step", "element"))
_point = partial(Variable, ("step", "point"))
_cycle = partial(Variable, ("level", "amplitude"))
_load = partial(Variable, ("step", "load"))
_node = partial(Variable, ("step", "node", "component"))

MACRO_RESULT = Schema(
    name="macro_result",
    version=2,
    variables={
        "converged": _step("1", "whether the macro solver converged"),
        "residual": _step("1", "residual relative to the load"),
        "wall_time": _step("s", "wall time of the step"),
    },
    optional={
        "preload": _step("Pa", "nominal preload"),
        "joint_stiffness": _step(
            "Pa m-1",
            "normal stiffness of the whole joint, without slip",
            uncertain_part="interface_stiffness",
        ),
        "unloading_stiffness": _step(
            "Pa m-1", "normal stiffness of the joint at the start of unloading"
        ),
        "interface_stiffness": _step("Pa m-1", "normal stiffness of the interface only"),
        "solid_stiffness": _step("Pa m-1", "normal stiffness of the bodies only"),
        "approach": _step("m", "displacement of the loaded platen"),
        "mean_gap": _step("m", "area mean of the gap of the joint"),
        "contact_fraction": _step("1", "real over nominal contact area"),
        "real_pressure": _step("Pa", "mean pressure on the real contact area: load over that area"),
        "thermal_conductance": _step("W m-2 K-1", "thermal conductance of the interface"),
        "electrical_conductance": _step("S m-2", "electrical conductance of the interface"),
        "closed_fraction": _step("1", "share of the interface that carries pressure"),
        "position": Variable(("node", "component"), "m", "position of the nodes"),
        "ends": Variable(("link", "end"), "1", "nodes at both ends of the links"),
        "law": Variable(("link",), "1", "kind of the links: bar, beam, cable or strut"),
        "load_factor": _step("1", "factor of the loads"),
        "tension": Variable(("step", "link"), "N", "tension, compression negative"),
        "slack": Variable(("step", "link"), "m", "distance by which the ends of a link miss it"),
        "slack_links": _step("1", "number of slack links"),
        "largest_tension": _step("N", "largest tension of a link"),
        "largest_displacement": _step("m", "largest displacement of a node"),
        "displacement": _node("m", "displacement of the nodes"),
        "rotation": _node("rad", "rotation of the nodes"),
        "moment": Variable(
            ("step", "link", "part"), "N m", "torsion and end moments of beams in their axes"
        ),
        "iterations": _step("1", "number of residuals that the solver computed"),
        "krylov_iterations": _step(
            "1", "number of iterations of the linear solver in all Newton steps"
        ),
        "error_bound": _step(
            "1", "guaranteed bound on the error of the tensions relative to their change"
        ),
        "error_indicator": _step(
            "1", "heuristic indicator, no bound, of the error of joints relative to their forces"
        ),
        "tangent_eigenvalue": _step("N m-1", "smallest eigenvalue of the tangent"),
        "stability_eigenvalue": _step("N m-1", "smallest eigenvalue with the geometric stiffness"),
        "traction": Variable(("step", "point", "direction"), "Pa", "traction of the joints"),
        "jump": Variable(("step", "point", "direction"), "m", "displacement jump of the joints"),
        "point_position": Variable(("point", "component"), "m", "position of points of joints"),
        "point_area": Variable(("point",), "m2", "area that a point of a joint stands for"),
        "point_joint": Variable(("point",), "1", "number of the joint of a point"),
        "point_damage": Variable(("point",), "1", "damage of the joint at a point"),
        "gap": _point("m", "gap at points of joints"),
        "corners": Variable(
            ("element", "corner"), "1", "nodes at the corners of the elements, in the order of VTK"
        ),
        "element_body": Variable(("element",), "1", "number of the body of an element"),
        "element_damage": Variable(("element",), "1", "damage of the elements"),
        "equivalent_stress": _element("Pa", "von Mises stress of the mean stress of an element"),
        "energy_density": _element("J m-3", "mean density of the strain energy of an element"),
        "bolt_force": Variable(("step", "bolt"), "N", "tension of the bolts"),
        "contact_state": _point("1", "whether a point is open (0), sticks (1) or slips (2)"),
        "open_fraction": _step("1", "share of the nominal area that is open"),
        "stick_fraction": _step("1", "share of the nominal area that sticks"),
        "slip_fraction": _step("1", "share of the nominal area at sliding"),
        "load_below": _face("1", "share of the load at pressures below the data of the law"),
        "load_above": _face("1", "share of the load at pressures above the data of the law"),
        "load_far": _face("1", "share of the load beyond a factor of 2 outside the data"),
        "slipping_load": _step("1", "share of the contact force at sliding"),
        "dissipation": _point("J m-2", "energy dissipated by slip in the step"),
        "known": _step("1", "whether the data of the laws reach the answer"),
        "shear": _step("Pa", "tangential traction on the loaded face"),
        "shear_displacement": _step(
            "m", "mean displacement of the loaded face along the tangential traction"
        ),
        "tangential_stiffness": _step(
            "Pa m-1", "tangential stiffness of the whole joint, no point slipping"
        ),
        "sliding_speed": _step("m s-1", "speed of steady sliding"),
        "temperature": _step("K", "temperature of the body"),
        "braking_force": _step("N", "force against the motion"),
        "braking_coefficient": _step("1", "force against the motion over the load"),
        "path_step": _step("1", "step of [statics] that the load step ends, or -1"),
        "factor": _load("1", "factor of each named load"),
        "load_displacement": _load(
            "m", "mean displacement of the loaded face along its load; of bolts, their closing"
        ),
        "load_secant": _load(
            "N m-1", "load over the change of its displacement since this load was zero"
        ),
        "load_stiffness": _load(
            "N m-1", "tangent stiffness for a small increase of the load, with slip"
        ),
        "stuck_stiffness": _load(
            "N m-1", "tangent stiffness for small changes of the load, without slip"
        ),
        "interface_compliance": _load("1", "share of the interfaces in the compliance"),
        "interface_pressure": _face("Pa", "mean pressure of an interface"),
        "interface_real_pressure": _face(
            "Pa", "mean pressure of an interface on its real contact area"
        ),
        "interface_open": _face("1", "share of the nominal area of an interface that is open"),
        "interface_slip": _face("1", "share of the nominal area of an interface at sliding"),
        "interface_slipping_load": _face(
            "1", "share of the contact force of an interface at sliding"
        ),
        "interface_energy": Variable(
            ("cycle", "interface"), "J", "energy dissipated by an interface in a closed cycle"
        ),
        "cycle_energy": Variable(
            ("cycle",), "J", "energy dissipated by the joint in a closed cycle"
        ),
        "cycle_preload": Variable(("level",), "Pa", "preload of cycles of shear"),
        "cycle_shear": Variable(("amplitude",), "Pa", "amplitude of cycles of shear"),
        "cycle_loss": _cycle(
            "J", "energy dissipated by the joint in a closed cycle of an amplitude"
        ),
        "cycle_slip": _cycle("1", "share of the contact force at sliding at the amplitude"),
        "secant_stiffness": _cycle(
            "Pa m-1", "shear over displacement between both ends of a cycle, of the whole joint"
        ),
        "loss_density": Variable(
            ("level", "amplitude", "point"), "J m-2", "energy dissipated by slip in a closed cycle"
        ),
        "time": _step("s", "time"),
        "velocity": _node("m s-1", "velocity of the nodes"),
        "impulse": Variable(("step", "link"), "N s", "impulse of inextensible links in the step"),
        "kinetic_energy": _step("J", "kinetic energy"),
        "elastic_energy": _step("J", "elastic energy of the links"),
        "work": _step("J", "work of loads and supports since the start"),
        "numerical_dissipation": _step("J", "numerical dissipation since the start"),
        "link_dissipation": _step(
            "J", "energy dissipated in the links since the start, summed over links"
        ),
        "smallest_link_dissipation": _step("J", "smallest dissipation of a link in the step"),
        **BUDGET,
        **SENSITIVITY,
    },
).with_samples(
    sample=("joint_stiffness", "interface_stiffness", "braking_force"),
    unloading_sample=("unloading_stiffness",),
)
MACRO_RESULT = MACRO_RESULT.with_intervals(
    "joint_stiffness",
    "interface_stiffness",
    "solid_stiffness",
    "tangential_stiffness",
    "load_stiffness",
    "thermal_conductance",
    "electrical_conductance",
    "real_pressure",
    "interface_real_pressure",
    "slipping_load",
    "cycle_energy",
    "cycle_loss",
    "cycle_slip",
    "secant_stiffness",
)

VIBRATION = Schema(
    name="vibration",
    version=1,
    variables={
        "mode_frequency": Variable(("mode",), "Hz", "frequency of small vibration of a mode"),
        "shape": Variable(
            ("mode", "node", "component"), "kg-1/2", "shape of a mode of unit modal mass"
        ),
        "position": Variable(("node", "component"), "m", "position of the nodes"),
        "step_mode": _step("1", "number of the mode, from 1"),
        "modal_amplitude": _step("kg1/2 m", "modal amplitude"),
        "largest_displacement": _step("m", "largest displacement of a node at the amplitude"),
        "converged": _step("1", "whether the amplitude has an answer"),
        "opens": _step("1", "whether contact opens at the amplitude"),
    },
    optional={
        "frequency": _step("Hz", "frequency at the amplitude"),
        "fall": _step("Hz", "frequency of small vibration less the frequency at the amplitude"),
        "damping": _step("1", "share of critical damping at the amplitude"),
        "slipping_load": _step(
            "1", "share of the contact force at sliding, the larger of both directions"
        ),
        "rest_traction": Variable(("point", "direction"), "Pa", "traction of the joints at rest"),
        "pressure": Variable(
            ("side", "step", "point"), "Pa", "pressure at the amplitude in either direction"
        ),
        "slipping": Variable(
            ("side", "step", "point"), "1", "share of the pressure at sliding at the amplitude"
        ),
        "bolt_force": Variable(("bolt",), "N", "tension of the bolts at rest"),
        **{
            name: MACRO_RESULT.optional[name]
            for name in (
                "corners",
                "element_body",
                "point_position",
                "point_area",
                "point_joint",
            )
        },
        **BUDGET,
        **SENSITIVITY,
    },
).with_intervals("frequency", "fall", "damping")

SEAL = Schema(
    name="seal",
    version=1,
    variables={
        "nominal_pressure": _step("Pa", "mean pressure of a ring on its face"),
        "leak_rate": _step("m3 s-1", "volume flow of liquid across the ring"),
        "leak_rate_mean_law": Variable(("limit", "step"), "m3 s-1", "95 % interval of leak_rate"),
        "hydraulic_aperture": _step("m", "hydraulic aperture of the interface across the ring"),
        "percolating_cells": _step("1", "share of the cells with a percolating path of the gap"),
        "mean_gap": _step("m", "mean gap of the interface"),
        "contact_fraction": _step("1", "real over nominal contact area"),
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

_GRAIN = ("frame", "grain", "component")
_wall = partial(Variable, ("step", "wall", "component"))
_cell = partial(Variable, ("step", "component"))

GRANULATE = Schema(
    name="granulate",
    version=1,
    variables={
        "time": _step("s", "time at the end of the step"),
        "converged": _step("1", "whether the contact solver met its tolerance"),
        "residual": _step("1", "natural-map error relative to the velocities of closing contacts"),
        "iterations": _step("1", "sweeps over the contacts"),
        "penetration": _step("1", "largest overlap over the smaller radius"),
        "n_contacts": _step("1", "number of contacts that carry a force"),
        "kinetic_energy": _step("J", "kinetic energy"),
        "elastic_energy": _step("J", "elastic energy of overlaps and rebounds"),
        "work": _step("J", "work of gravity, walls and cell since the start"),
        "contact_dissipation": _step("J", "energy dissipated in the contacts since the start"),
        "numerical_dissipation": _step(
            "J", "numerical dissipation and dissipation in impacts since the start"
        ),
        "damping_dissipation": _step("J", "energy dissipated by damping since the start"),
        "wall_time": _step("s", "wall time of the step"),
        "radius": Variable(("grain",), "m", "radius"),
        "mass": Variable(("grain",), "kg", "mass"),
        "frame_step": Variable(("frame",), "1", "step of a frame, -1 for the start"),
        "position": Variable(_GRAIN, "m", "centres"),
        "velocity": Variable(_GRAIN, "m s-1", "velocities"),
        "contact_frame": Variable(("contact",), "1", "frame that a contact belongs to"),
        "contact_ends": Variable(
            ("contact", "end"), "1", "grain, and grain or number of grains plus number of the wall"
        ),
        "contact_force": Variable(
            ("contact", "component"), "N", "mean force of the step on the first end"
        ),
        "branch": Variable(("contact", "component"), "m", "first centre minus second or contact"),
    },
    optional={
        "spin": Variable(_GRAIN, "rad s-1", "angular velocities"),
        "time_step": _step("s", "length of the step"),
        "wall_force": _wall("N", "force of the grains on a wall"),
        "wall_position": _wall("m", "point of a wall"),
        "wall_direction": Variable(("wall", "component"), "1", "normal or axis of a wall"),
        "wall_radius": Variable(("wall",), "m", "radius of a cylinder, zero for a plane"),
        "side_share": _step("1", "share of the weight of the grains that side walls bear"),
        "floor_share": _step("1", "share of the weight of the grains that the floor bears"),
        "run_out": Variable(("frame",), "m", "distance of the farthest grain beyond the gate"),
        "plate_shear": _step("Pa", "shear stress of the grains on the upper plate"),
        "plate_slip": _step("m", "distance by which the upper plate has slid"),
        "plate_pressure": _step("Pa", "pressure of the grains on the upper plate"),
        "period": _cell("m", "edges of the periodic cell"),
        "stress": _cell("Pa", "mean normal stresses of the cell, tension positive"),
        "strain": _cell("1", "logarithmic strain of the cell since the start"),
    },
)
