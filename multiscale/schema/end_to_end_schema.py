"""Datasets of structures with a law against the same structures with all of their roughness."""

from functools import partial

from multiscale.schema.dataset_schema import Schema, Variable

__all__ = ["END_TO_END"]

_case = partial(Variable, ("case",))

END_TO_END = Schema(
    name="end_to_end",
    version=2,
    variables={
        "scale_ratio": _case("1", "longest wave over the length of the structure"),
        "points_per_wave": _case("1", "grid points per shortest wave"),
        "cells": _case("1", "number of cells that the law was fitted to"),
        "realisations": _case("1", "number of structures resolved"),
        "gap_law": _case("1", "mean gap with the law over the rms height"),
        "gap_direct": _case("1", "mean gap resolved over the rms height"),
        "gap_scatter": _case("1", "standard deviation of the resolved gap over its mean"),
        "gap_error": _case("1", "relative error of the mean gap with the law"),
        "gap_error_uncertainty": _case("1", "standard error of the gap error"),
        "paired_error": _case("1", "gap error with the law of the very surfaces resolved"),
        "paired_error_uncertainty": _case("1", "standard error of the paired error"),
        "area_law": _case("1", "contact fraction with the law"),
        "area_direct": _case("1", "contact fraction resolved"),
        "pressure_error": _case("1", "error of the pressure along the structure, L2 norm"),
        "error_part": Variable(("case", "error_term"), "1", "part of the gap error, with its sign"),
        "error_part_uncertainty": Variable(
            ("case", "error_term"), "1", "standard error of a part of the gap error"
        ),
        "wall_time": _case("s", "wall time of all"),
    },
)
