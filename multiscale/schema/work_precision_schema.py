"""Datasets of error against run time."""

from multiscale.schema.dataset_schema import Schema, Variable

__all__ = ["WORK_PRECISION"]

WORK_PRECISION = Schema(
    name="work_precision",
    version=1,
    variables={
        "error": Variable(("run",), "1", "relative error against the reference"),
        "wall_time": Variable(("run",), "s", "wall time"),
        "converged": Variable(("run",), "1", "whether the run converged"),
    },
    optional={
        "peak_memory": Variable(("run",), "byte", "peak memory"),
        "iterations": Variable(("run",), "1", "number of iterations"),
        "unknowns": Variable(("run",), "1", "number of unknowns"),
        "points": Variable(("run",), "1", "grid points along an edge"),
        "cables": Variable(("run",), "1", "number of cables"),
        "slack_fraction": Variable(("run",), "1", "share of the cables that are slack"),
        "residual": Variable(("run",), "1", "relative residual, verified in the answer"),
        "own_error": Variable(("run",), "1", "relative error against the limit of the method"),
        "effectivity": Variable(
            ("run",), "1", "estimated over true error; heuristic with friction"
        ),
        "error_uncertainty": Variable(("run",), "1", "uncertainty of the reference"),
        "contact_error": Variable(("run",), "1", "relative error of the contact fraction"),
        "own_contact_error": Variable(
            ("run",), "1", "relative error of the contact fraction against the method's limit"
        ),
        "contact_error_uncertainty": Variable(
            ("run",), "1", "uncertainty of the reference of the contact fraction"
        ),
        "mean_gap": Variable(("run",), "m", "mean distance of obstacle and deformed surface"),
        "contact_fraction": Variable(("run",), "1", "real over nominal contact area"),
        "relative_pressure": Variable(
            ("run",), "1", "mean pressure over contact modulus times rms slope"
        ),
        "tolerance": Variable(("run",), "1", "relative error asked for"),
        "history_run": Variable(("sample",), "1", "run that a sample of the histories belongs to"),
        "history_seconds": Variable(("sample",), "s", "time since the start of the run"),
        "history_error": Variable(("sample",), "1", "relative error at that time"),
        "scale_ratio": Variable(("run",), "1", "longest wave over the length of the structure"),
        "realisations": Variable(("run",), "1", "realisations that the answer is the mean over"),
        "time_step": Variable(("run",), "s", "length of a time step"),
        "mean_error": Variable(("run",), "1", "relative error of the mean over the realisations"),
        "mean_error_uncertainty": Variable(("run",), "1", "standard error of the mean error"),
        "cells_solved": Variable(("run",), "1", "number of cells solved"),
        "cells_reused": Variable(("run",), "1", "number of times a cell solved before served"),
        "method": Variable(("run",), "1", "solver or code"),
        "scene": Variable(("run",), "1", "scene"),
        "family": Variable(("run",), "1", "family of scenes"),
    },
)
