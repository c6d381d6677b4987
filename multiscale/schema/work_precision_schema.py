"""Datasets of error against run time."""

from functools import partial

from multiscale.schema.dataset_schema import Schema, Variable

__all__ = ["WORK_PRECISION"]

_run = partial(Variable, ("run",))

WORK_PRECISION = Schema(
    name="work_precision",
    version=1,
    variables={
        "error": _run("1", "relative error against the reference"),
        "wall_time": _run("s", "wall time"),
        "converged": _run("1", "whether the run converged"),
    },
    optional={
        "peak_memory": _run("byte", "peak memory"),
        "iterations": _run("1", "number of iterations"),
        "unknowns": _run("1", "number of unknowns"),
        "points": _run("1", "grid points along an edge"),
        "cables": _run("1", "number of cables"),
        "slack_fraction": _run("1", "share of the cables that are slack"),
        "residual": _run("1", "relative residual, verified in the answer"),
        "own_error": _run("1", "relative error against the limit of the method"),
        "effectivity": _run("1", "estimated over true error; heuristic with friction"),
        "error_uncertainty": _run("1", "uncertainty of the reference"),
        "contact_error": _run("1", "relative error of the contact fraction"),
        "own_contact_error": _run(
            "1", "relative error of the contact fraction against the method's limit"
        ),
        "contact_error_uncertainty": _run(
            "1", "uncertainty of the reference of the contact fraction"
        ),
        "mean_gap": _run("m", "mean distance of obstacle and deformed surface"),
        "contact_fraction": _run("1", "real over nominal contact area"),
        "relative_pressure": _run("1", "mean pressure over contact modulus times rms slope"),
        "tolerance": _run("1", "relative error asked for"),
        "history_run": Variable(("sample",), "1", "run that a sample of the histories belongs to"),
        "history_seconds": Variable(("sample",), "s", "time since the start of the run"),
        "history_error": Variable(("sample",), "1", "relative error at that time"),
        "scale_ratio": _run("1", "longest wave over the length of the structure"),
        "realisations": _run("1", "realisations that the answer is the mean over"),
        "time_step": _run("s", "length of a time step"),
        "mean_error": _run("1", "relative error of the mean over the realisations"),
        "mean_error_uncertainty": _run("1", "standard error of the mean error"),
        "cells_solved": _run("1", "number of cells solved"),
        "cells_reused": _run("1", "number of times a cell solved before served"),
        "over_copy": _run("1", "time of an application over a copy of the same bytes"),
        "bytes_moved": _run("byte", "bytes that an application must read and write"),
        "operations": _run("1", "operations of an application, counted on paper"),
        "method": _run("1", "solver or code"),
        "scene": _run("1", "scene"),
        "family": _run("1", "family of scenes"),
    },
)
