"""Dataset of a granulate in motion."""

from functools import partial

from multiscale.schema.dataset_schema import Schema, Variable

__all__ = ["GRANULATE"]

_GRAIN = ("frame", "grain", "component")
_step = partial(Variable, ("step",))
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
        "elastic_energy": _step("J", "energy that overlaps and rebounds bring back"),
        "work": _step("J", "work of gravity, walls and cell since the start"),
        "contact_dissipation": _step("J", "energy the contacts took since the start"),
        "numerical_dissipation": _step(
            "J", "energy lost in impacts and to the time scheme since the start"
        ),
        "damping_dissipation": _step("J", "energy damped since the start"),
        "search_time": _step("s", "wall time of the neighbour search"),
        "wall_time": _step("s", "wall time of the step"),
        "radius": Variable(("grain",), "m", "radius"),
        "mass": Variable(("grain",), "kg", "mass"),
        "frame_step": Variable(("frame",), "1", "step that a frame shows, -1 for the start"),
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
        "period": _cell("m", "edges of the periodic cell"),
        "stress": _cell("Pa", "mean normal stresses of the cell, tension positive"),
        "strain": _cell("1", "logarithmic strain of the cell since the start"),
    },
)
