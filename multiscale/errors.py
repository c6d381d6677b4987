"""Errors that a user can correct; a message is a sentence: problem, place, value, remedy."""

from collections.abc import Iterable
from difflib import get_close_matches
from math import inf
from numbers import Integral

RANGES = {  # by the ends of an interval
    "[]": "from {:g} to {:g}",
    "[)": "from {:g} to below {:g}",
    "()": "between {:g} and {:g}",
    "(]": "above {:g} and up to {:g}",
}


class MultiscaleError(Exception):
    """Base of all errors with a message for the user."""


class CaseError(MultiscaleError):
    """A case file, an input file or a parameter is refused."""


class FileError(MultiscaleError):
    """A file or a folder cannot be written."""


class SchemaError(MultiscaleError):
    """A dataset does not follow its schema."""


class NewerSchemaError(SchemaError):
    """A dataset has a newer version of its schema than this package reads."""


class ConvergenceError(MultiscaleError):
    """A solver stopped without a solution."""


def suggest(name: str, known: Iterable[str], otherwise: str) -> str:
    """Suggest the known name nearest to a wrong name; ``otherwise`` if there is none."""
    close = get_close_matches(name, list(known), n=1)
    return f"did you mean {close[0]!r}?" if close else otherwise


def listed(names: Iterable[str]) -> str:
    """List names in a message, or "none"."""
    return ", ".join(sorted(names)) or "none"


def require(
    name: str, value: float, interval: str, unit: str = "", *, integer: bool = False
) -> None:
    """Refuse a number outside an interval such as "(0, 1]", and NaN; ( and ) exclude an end."""
    low, high = (float(end) for end in interval[1:-1].split(","))
    above = low < value or (value == low and interval[0] == "[")
    if above and (value < high or (value == high and interval[-1] == "]")):
        if integer and not isinstance(value, Integral):
            raise CaseError(f"{name} must be an integer, got {value}")
        return
    if high < inf:
        words = "lie " + RANGES[interval[0] + interval[-1]].format(low, high)
    elif value == inf or low == -inf:
        words = "be finite"
    elif low == 0.0:
        words = "be positive" if interval[0] == "(" else "not be negative"
    else:
        words = f"be {'above' if interval[0] == '(' else 'at least'} {low:g}"
    raise CaseError(f"{name} must {words}{f' ({unit})' if unit else ''}, got {value:g}")
