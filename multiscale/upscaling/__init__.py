"""From micro responses to interface laws with their uncertainty."""

from multiscale.upscaling.admissibility import admissibility, is_admissible
from multiscale.upscaling.family import FAMILIES, Family, Parameter, unloading_family
from multiscale.upscaling.fit import fit_law
from multiscale.upscaling.observations import (
    area_observations,
    normal_observations,
    observe,
    unloading_observations,
)
from multiscale.upscaling.reading import (
    area_from_dataset,
    fitted_law,
    law_band,
    law_from_dataset,
)

__all__ = [
    "FAMILIES",
    "Family",
    "Parameter",
    "admissibility",
    "area_from_dataset",
    "area_observations",
    "fit_law",
    "fitted_law",
    "is_admissible",
    "law_band",
    "law_from_dataset",
    "normal_observations",
    "observe",
    "unloading_family",
    "unloading_observations",
]
