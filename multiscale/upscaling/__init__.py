"""From micro responses to interface laws with their uncertainty."""

from multiscale.upscaling.admissibility import admissibility
from multiscale.upscaling.branches import (
    fit_branches,
    hysteretic_from_dataset,
    with_damage,
    with_unloading,
)
from multiscale.upscaling.budget import error_budget, with_budget
from multiscale.upscaling.cell_size import at_rms_height, without_bias
from multiscale.upscaling.comparison import compare_laws
from multiscale.upscaling.conductance import (
    CONDUCTANCES,
    conductance_ratios,
    conductances,
    elastic_dependence,
    with_conductance,
)
from multiscale.upscaling.export import write_law_table, write_pressure_overclosure
from multiscale.upscaling.family import FAMILIES, Family, Parameter, unloading_family
from multiscale.upscaling.fit import fit_law
from multiscale.upscaling.leakage import (
    effective_permeability,
    say_sealing,
    sealing_pressures,
    with_leakage,
)
from multiscale.upscaling.observation_tables import read_observations
from multiscale.upscaling.observations import observe
from multiscale.upscaling.reading import (
    area_from_dataset,
    areas_from_dataset,
    fitted_law,
    fitted_laws,
    friction_at,
    law_band,
    law_from_dataset,
    require_law,
)
from multiscale.upscaling.resolution import estimate_grid_error
from multiscale.upscaling.response_observations import (
    area_observations,
    loading_branch,
    normal_observations,
    unloading_observations,
)
from multiscale.upscaling.scales import (
    cell_share,
    compare_scales,
    effective_cells,
    pressure_length_of_points,
)
from multiscale.upscaling.shear_branch import (
    assume_shear,
    sliders_from_dataset,
    sliding_friction_at,
    state_shear,
    take_sliding_friction,
    tangential_values,
    with_sliding,
)
from multiscale.upscaling.shear_budget import shear_errors
from multiscale.upscaling.shear_fit import with_shear
from multiscale.upscaling.structure_errors import (
    Dependence,
    add_budgets,
    changed_laws,
    interval_errors,
    limits,
    over_steps,
    structure_budget,
    with_intervals,
    with_scales,
)
from multiscale.upscaling.tangential_observations import (
    friction_observations,
    tangential_observations,
)

__all__ = [
    "CONDUCTANCES",
    "FAMILIES",
    "Dependence",
    "Family",
    "Parameter",
    "add_budgets",
    "admissibility",
    "area_from_dataset",
    "area_observations",
    "areas_from_dataset",
    "assume_shear",
    "at_rms_height",
    "cell_share",
    "changed_laws",
    "compare_laws",
    "compare_scales",
    "conductance_ratios",
    "conductances",
    "effective_cells",
    "effective_permeability",
    "elastic_dependence",
    "error_budget",
    "estimate_grid_error",
    "fit_branches",
    "fit_law",
    "fitted_law",
    "fitted_laws",
    "friction_at",
    "friction_observations",
    "hysteretic_from_dataset",
    "interval_errors",
    "law_band",
    "law_from_dataset",
    "limits",
    "loading_branch",
    "normal_observations",
    "observe",
    "over_steps",
    "pressure_length_of_points",
    "read_observations",
    "require_law",
    "say_sealing",
    "sealing_pressures",
    "shear_errors",
    "sliders_from_dataset",
    "sliding_friction_at",
    "state_shear",
    "structure_budget",
    "take_sliding_friction",
    "tangential_observations",
    "tangential_values",
    "unloading_family",
    "unloading_observations",
    "with_budget",
    "with_conductance",
    "with_damage",
    "with_intervals",
    "with_leakage",
    "with_scales",
    "with_shear",
    "with_sliding",
    "with_unloading",
    "without_bias",
    "write_law_table",
    "write_pressure_overclosure",
]

__dir__ = __all__.copy
