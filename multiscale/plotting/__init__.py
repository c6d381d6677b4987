"""One function per figure: it takes a dataset and axes, returns the axes, and saves nothing.

Every function draws on ``ax``, the current axes if not given, and returns these axes.

Only here quantities get labels and are converted to µm, MPa and kN. Functions whose names begin
with ``draw`` make whole figures and write them.
"""

from multiscale.plotting.body_figures import plot_body_stress
from multiscale.plotting.budget_figures import plot_error_budget
from multiscale.plotting.damage_figures import (
    plot_damage_sphere,
    plot_element_field,
    plot_woehler,
    plot_worst_section,
)
from multiscale.plotting.grain_figures import (
    draw_granulate,
    plot_biaxial_curve,
    plot_contact_error,
    plot_force_network,
    plot_grain_energies,
)
from multiscale.plotting.growth_figures import plot_growth
from multiscale.plotting.interface_figures import (
    MOST_DRAWN,
    load_pictures,
    plot_bolt_forces,
    plot_load_paths,
)
from multiscale.plotting.joint_figures import (
    draw_joint,
    joint_pictures,
    plot_amplitudes,
    plot_hysteresis,
    plot_joint_plan,
)
from multiscale.plotting.law_figures import (
    plot_area_law,
    plot_gap_law,
    plot_joint_stiffness,
    plot_leakage,
    plot_shear_law,
    plot_unloading,
)
from multiscale.plotting.link_figures import (
    draw_links,
    plot_deformed_links,
    plot_energies,
    plot_sorted_tensions,
)
from multiscale.plotting.rve_figures import (
    plot_crack_damage,
    plot_cracked_load,
    plot_modulus_surface,
    plot_rve,
    plot_rve_damage,
    plot_size_damage,
    plot_size_stiffness,
    plot_size_study,
    plot_softening,
)
from multiscale.plotting.sliding_figures import (
    draw_sliding,
    plot_sliding_friction,
    plot_steady_friction,
)
from multiscale.plotting.surface_figures import (
    plot_bearing_curve,
    plot_contact_map,
    plot_flow_channels,
    plot_measured_heights,
    plot_road,
    plot_spectral_density,
    plot_surface,
)
from multiscale.plotting.sweep_figures import plot_sweep, plot_sweep_steps, sweep_ends
from multiscale.plotting.tyre_figures import (
    plot_braking_force,
    plot_footprint,
    plot_friction_bell,
)
from multiscale.plotting.vibration_figures import (
    plot_backbone,
    plot_mode_shape,
    plot_vibrating_joint,
    vibration_pictures,
)
from multiscale.plotting.work_precision_figures import (
    draw_work_precision,
    plot_history,
    plot_work_precision,
)

__all__ = [
    "MOST_DRAWN",
    "draw_granulate",
    "draw_joint",
    "draw_links",
    "draw_sliding",
    "draw_work_precision",
    "joint_pictures",
    "load_pictures",
    "plot_amplitudes",
    "plot_area_law",
    "plot_backbone",
    "plot_bearing_curve",
    "plot_biaxial_curve",
    "plot_body_stress",
    "plot_bolt_forces",
    "plot_braking_force",
    "plot_contact_error",
    "plot_contact_map",
    "plot_crack_damage",
    "plot_cracked_load",
    "plot_damage_sphere",
    "plot_deformed_links",
    "plot_element_field",
    "plot_energies",
    "plot_error_budget",
    "plot_flow_channels",
    "plot_footprint",
    "plot_force_network",
    "plot_friction_bell",
    "plot_gap_law",
    "plot_grain_energies",
    "plot_growth",
    "plot_history",
    "plot_hysteresis",
    "plot_joint_plan",
    "plot_joint_stiffness",
    "plot_leakage",
    "plot_load_paths",
    "plot_measured_heights",
    "plot_mode_shape",
    "plot_modulus_surface",
    "plot_road",
    "plot_rve",
    "plot_rve_damage",
    "plot_shear_law",
    "plot_size_damage",
    "plot_size_stiffness",
    "plot_size_study",
    "plot_sliding_friction",
    "plot_softening",
    "plot_sorted_tensions",
    "plot_spectral_density",
    "plot_steady_friction",
    "plot_surface",
    "plot_sweep",
    "plot_sweep_steps",
    "plot_unloading",
    "plot_vibrating_joint",
    "plot_woehler",
    "plot_work_precision",
    "plot_worst_section",
    "sweep_ends",
    "vibration_pictures",
]

__dir__ = __all__.copy
