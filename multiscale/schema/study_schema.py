"""Datasets of studies: stiff cases, bench results, sweeps."""

from functools import partial

from multiscale.schema.dataset_schema import Schema, Variable

_case = partial(Variable, ("case",))

STABILITY = Schema(
    name="stability",
    version=1,
    variables={
        "family": _case("1", "family of problems"),
        "parameters": _case("1", "names and values of the parameters"),
        "tolerance": _case("1", "residual up to which a case has converged"),
        "outcome": _case("1", "0 failed, 1 refused with a sentence, 2 converged"),
        "residual": _case("1", "verified residual of the answer"),
        "wall_time": _case("s", "wall time"),
        "sentence": _case("1", "reason for a missing answer, or empty"),
    },
)

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
        "cpu_time": _run("s", "time of all processors"),
        "peak_memory": _run("byte", "peak memory"),
        "iterations": _run("1", "number of iterations"),
        "unknowns": _run("1", "number of unknowns"),
        "points": _run("1", "grid points along an edge"),
        "cables": _run("1", "number of cables"),
        "slack_fraction": _run("1", "share of the cables that are slack"),
        "residual": _run("1", "relative residual, verified in the answer"),
        "own_error": _run("1", "relative error against the limit of the method"),
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
        "tolerance": _run("1", "requested relative error"),
        "history_run": Variable(("sample",), "1", "run that a sample of the histories belongs to"),
        "history_seconds": Variable(("sample",), "s", "time since the start of the run"),
        "history_error": Variable(("sample",), "1", "relative error at that time"),
        "scale_ratio": _run("1", "longest wavelength over the length of the structure"),
        "realisations": _run("1", "number of realisations in the mean"),
        "time_step": _run("s", "length of a time step"),
        "mean_error": _run("1", "relative error of the mean over the realisations"),
        "mean_error_uncertainty": _run("1", "standard error of the mean error"),
        "cells_solved": _run("1", "number of cells solved"),
        "cells_reused": _run("1", "number of times a solved cell was reused"),
        "over_copy": _run("1", "time of an application over a copy of the same bytes"),
        "bytes_moved": _run("byte", "bytes that an application must read and write"),
        "operations": _run("1", "operations of an application, counted on paper"),
        "method": _run("1", "solver or code"),
        "scene": _run("1", "scene"),
        "family": _run("1", "family of scenes"),
    },
)

_point = partial(Variable, ("point",))
_answer = partial(Variable, ("answer",))

SWEEP = Schema(
    name="sweep",
    version=2,
    variables={
        "setting": Variable(("point", "parameter"), "1", "value of a swept key at a point"),
        "folder": _point("1", "run folder of a point, if it exists"),
        "failure": _point("1", "reason for a missing result, or empty"),
        "caution": _point("1", "cautions at a point, one a line"),
        "answer_label": _answer("1", "name of an answer in words"),
        "answer_unit": _answer("1", "unit in which an answer is shown"),
        "answer_scale": _answer("1", "factor by which an answer in SI units is shown"),
        "answer_over": _answer("1", "answer over which an answer is drawn; empty if none"),
        "answer_drawn": _answer("1", "whether a figure shows an answer"),
        "answer_place": Variable(
            ("point", "answer"), "1", "place of an answer along its steps or cycles at their end"
        ),
    },
    optional={
        "missing_terms": _point(
            "1", "terms of the error that are not known: the intervals are lower bounds"
        ),
    },
    news="the answers of every kind of case",
)
"""Every answer is a separate variable, along the points and its steps or cycles, with its
intervals ``NAME_mean_law`` and ``NAME_one_part`` if it has any."""
