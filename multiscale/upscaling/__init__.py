"""From micro responses to interface laws with their uncertainty."""

from multiscale.upscaling.admissibility import is_admissible
from multiscale.upscaling.fit import area_from_dataset, fit_law, law_from_dataset

__all__ = ["area_from_dataset", "fit_law", "is_admissible", "law_from_dataset"]
