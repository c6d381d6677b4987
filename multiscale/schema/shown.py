"""How variables are shown: label, unit and digits, the same in tables, sentences and figures."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from multiscale.units import Unit, shown_unit

if TYPE_CHECKING:
    from xarray import Dataset


@dataclass(frozen=True)
class Show:
    """How a variable is shown."""

    unit: str = "1"  # or the name of a family of units, see multiscale.units.shown_unit
    label: str = ""  # its name in words
    digits: int = 4  # significant digits, unless its interval allows fewer
    over: tuple[str, ...] = ()  # horizontal axis of figures: the first of these in the dataset
    words: tuple[str, ...] = ()  # meanings of the values 0, 1, ...

    def named(self, name: str) -> "Show":
        """Return it with a label, by default the name of its variable in words."""
        return self if self.label else replace(self, label=name.replace("_", " "))

    def in_unit(self, values: Iterable[float]) -> Unit:
        """Return the unit for showing values, in SI units."""
        return shown_unit(self.unit, values)


PRESSURE = ("preload", "nominal_pressure", "fit_pressure")
CYCLE, SIZE, SPEED = ("cycle_shear",), ("largest_displacement",), ("sliding_speed",)

SHOWN = {
    # joints at their preloads
    "preload": Show("MPa"),
    "joint_stiffness": Show("stiffness", over=PRESSURE),
    "interface_stiffness": Show("stiffness", over=PRESSURE),
    "solid_stiffness": Show("stiffness", "stiffness of the bodies", over=PRESSURE),
    "unloading_stiffness": Show("stiffness", over=PRESSURE),
    "tangential_stiffness": Show("stiffness", "tangential stiffness without slip", over=PRESSURE),
    "mean_gap": Show("µm", over=PRESSURE),
    "contact_fraction": Show("%", "contact", 3, PRESSURE),
    "real_pressure": Show("MPa", over=PRESSURE),
    "thermal_conductance": Show("kW/(m² K)", over=PRESSURE),
    "electrical_conductance": Show("S/mm²", over=PRESSURE),
    "slipping_load": Show("%", "contact force at sliding", 3),
    "slip_fraction": Show("%", "sliding area", 3),
    "open_fraction": Show("%", "open area", 3),
    # joints in cycles
    "cycle_preload": Show("MPa", "preload"),
    "cycle_shear": Show("MPa", "amplitude of the shear"),
    "secant_stiffness": Show("stiffness", "secant shear stiffness", over=CYCLE),
    "cycle_loss": Show("mJ", "loss per cycle", over=CYCLE),
    "cycle_slip": Show("%", "contact force at sliding", 3, CYCLE),
    "cycle_energy": Show("mJ", "loss of a cycle"),
    # bodies under named loads
    "factor": Show(),
    "load_displacement": Show("µm", "displacement along the load"),
    "load_secant": Show("N/µm"),
    "load_stiffness": Show("N/µm"),
    "stuck_stiffness": Show("N/µm"),
    "interface_pressure": Show("MPa"),
    "interface_real_pressure": Show("MPa"),
    "interface_slipping_load": Show("%", digits=3),
    "interface_slip": Show("%", digits=3),
    "interface_open": Show("%", digits=3),
    "interface_energy": Show("mJ"),
    "bolt_force": Show("kN"),
    "equivalent_stress": Show("MPa", "von Mises stress"),
    "peak_load": Show(label="largest load over the loads of [statics]"),
    "work": Show("J", "energy of the crack"),
    # vibration
    "step_mode": Show(label="mode"),
    "modal_amplitude": Show("kg^1/2 m", "modal"),
    "largest_displacement": Show("largest length"),
    "frequency": Show("Hz", over=SIZE),
    "fall": Show("Hz", over=SIZE),
    "damping": Show("%", over=SIZE),
    "opens": Show(words=("no", "yes")),
    # links and plates
    "load_factor": Show(label="load"),
    "time": Show("s"),
    "slack_links": Show(),
    "largest_tension": Show("kN"),
    "iterations": Show(),
    "residual": Show(digits=2),
    # grains
    "n_contacts": Show(label="contacts"),
    "kinetic_energy": Show("J"),
    "elastic_energy": Show("J"),
    "link_dissipation": Show("J", "dissipated in the links"),
    "contact_dissipation": Show("J", "dissipated in the contacts"),
    "numerical_dissipation": Show("J", "numerical dissipation"),
    "damping_dissipation": Show("J", "dissipated by damping"),
    "penetration": Show(label="overlap over radius"),
    "axial_strain": Show(),
    "stress_ratio": Show(label="stress ratio q/p"),
    "side_share": Show("%", "weight on the side walls", 3),
    "floor_share": Show("%", "weight on the floor", 3),
    "run_out": Show("mm", "run-out beyond the gate"),
    "plate_shear": Show("kPa", "shear stress", 3),
    "plate_pressure": Show("kPa", "pressure", 3),
    # interfaces
    "nominal_pressure": Show("MPa", "pressure"),
    "fit_pressure": Show("MPa", "pressure"),
    "stiffness": Show("stiffness", over=PRESSURE),
    "shear_friction": Show(label="friction"),
    "steady_friction": Show(over=PRESSURE),
    "sliding_distance": Show("µm"),
    "effective_friction": Show(over=("sliding_distance",)),
    "leak_rate": Show("ml/h", digits=2, over=PRESSURE),
    "hydraulic_aperture": Show("µm", "aperture", 3, PRESSURE),
    "percolating_cells": Show("%", "cells with a leak path", 3, PRESSURE),
    # measured surfaces
    "place": Show(label="measured"),
    "body_rms_height": Show("largest length", "rms height", 3),
    "body_rms_slope": Show("1", "rms slope", 3),
    "body_longest_wave": Show("largest length", "longest wavelength", 3),
    "body_shortest_wave": Show("largest length", "shortest wavelength", 3),
    "filled": Show(label="filled (%)"),
    # rubber
    "temperature": Show("°C"),
    "sliding_speed": Show("m/s", "speed", 3),
    "braking_force": Show("N", over=SPEED),
    "braking_coefficient": Show(label="force over load", digits=3),
    # damage
    "porosity": Show("%"),
    "damage": Show(digits=3),
    "modulus": Show("GPa"),
    **{f"modulus_{axis}": Show("GPa", f"modulus along {axis}") for axis in "xyz"},
    "largest_damage": Show(digits=3),
    "largest_share": Show("%", "cracked share", 3),
    "cycles": Show(),
    "cycles_to_crack": Show("cycles", "life"),
    "cycles_to_first": Show("cycles", "first inclusion"),
    "strength": Show("MPa", "tensile strength"),
    "fracture_energy": Show("J/m²"),
    "volume_strength": Show("MPa", "strength"),
    "volume_energy": Show("J/m²", "energy"),
    "peak_damage": Show(label="damage at the strength"),
}
"""Presentation of variables, by names that have the same meaning in all datasets."""

SHOWN = {name: show.named(name) for name, show in SHOWN.items()}


def unit_in(data: "Dataset", name: str) -> Unit:
    """Return the unit of a variable; all stiffnesses share the unit of the first in ``SHOWN``."""
    unit = SHOWN[name].unit
    alike = (key for key in SHOWN if unit == SHOWN[key].unit == "stiffness" and key in data)
    return SHOWN[name].in_unit(data[next(alike, name)].to_numpy().ravel())
