"""Datasets of stiff and extreme cases."""

from multiscale.schema.dataset_schema import Schema, Variable

__all__ = ["STABILITY"]

STABILITY = Schema(
    name="stability",
    version=1,
    variables={
        "family": Variable(("case",), "1", "family of problems"),
        "parameters": Variable(("case",), "1", "names and values of the parameters"),
        "tolerance": Variable(("case",), "1", "residual up to which a case has converged"),
        "outcome": Variable(("case",), "1", "0 failed, 1 refused with a sentence, 2 converged"),
        "residual": Variable(("case",), "1", "residual that was verified in the answer"),
        "wall_time": Variable(("case",), "s", "wall time"),
        "sentence": Variable(("case",), "1", "why there is no answer; empty if there is"),
    },
)
