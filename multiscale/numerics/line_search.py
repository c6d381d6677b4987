"""Length of a Newton step in a convex potential."""

from collections.abc import Callable

__all__ = ["enough", "step_length"]

SUFFICIENT = 0.1
"""Share of the first slope that may be left after a full step."""

BRACKET = 0.05
"""Width, relative to its end, at which a bracket of the minimum is narrow enough."""

MAX_EVALUATIONS = 2200
"""Enough to double or halve from one end of the floating-point numbers to the other."""


def enough(first: float, last: float) -> bool:
    """Whether so little of the first slope is left after a step that it needs no search, J."""
    return abs(last) <= SUFFICIENT * abs(first)


def step_length(slope: Callable[[float], float], first: float) -> float:
    r"""Return the step that (nearly) minimises a convex potential along a direction.

    Examples
    --------
    >>> step_length(lambda a: a - 1.0, -1.0)
    1.0
    >>> 9.4 < step_length(lambda a: a - 10.0, -10.0) < 10.0
    True
    """
    if not first < 0.0 or enough(first, slope(1.0)):
        return 1.0
    lower, upper = 0.0, 1.0
    for _ in range(MAX_EVALUATIONS):
        if not slope(upper) < 0.0:
            break
        lower, upper = upper, 2.0 * upper
    for _ in range(MAX_EVALUATIONS):
        if upper - lower <= BRACKET * upper:
            break
        middle = 0.5 * (lower + upper)
        if slope(middle) < 0.0:
            lower = middle
        else:
            upper = middle
    return lower
