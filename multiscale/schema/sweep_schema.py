"""Dataset of a sweep."""

from functools import partial

from multiscale.schema.dataset_schema import Schema, Variable

__all__ = ["SWEEP"]

_point = partial(Variable, ("point",))
_answer = partial(Variable, ("answer",))

SWEEP = Schema(
    name="sweep",
    version=2,
    variables={
        "setting": Variable(("point", "parameter"), "1", "what the case of a point says"),
        "folder": _point("1", "run folder of a point, if it is kept"),
        "failure": _point("1", "why a point has no result; empty if it has one"),
        "caution": _point("1", "what to beware of at a point, a line for each"),
        "answer_label": _answer("1", "name of an answer in words"),
        "answer_unit": _answer("1", "unit in which an answer is shown"),
        "answer_scale": _answer("1", "factor by which an answer in SI units is shown"),
        "answer_over": _answer("1", "answer over which an answer is drawn; empty if none"),
        "answer_drawn": _answer("1", "whether a figure shows an answer"),
        "answer_place": Variable(
            ("point", "answer"), "1", "place of an answer along its steps or cycles at their end"
        ),
    },
    news="the answers of every kind of case",
)
"""Every answer is a variable of its own name, along the points and its steps or cycles, with its
intervals ``NAME_mean_law`` and ``NAME_one_part`` if it has any."""
