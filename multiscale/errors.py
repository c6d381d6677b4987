"""Errors that a user can correct; a message is a sentence: problem, place, value, remedy."""

from collections.abc import Iterable
from difflib import get_close_matches


class MultiscaleError(Exception):
    """Base of all errors with a message for the user."""


class CaseError(MultiscaleError):
    """A case file, an input file or a parameter is refused."""


class FileError(MultiscaleError):
    """A file or a folder cannot be written."""


class SchemaError(MultiscaleError):
    """A dataset does not follow its schema."""


class ConvergenceError(MultiscaleError):
    """A solver stopped without a solution."""


def suggest(name: str, known: Iterable[str], otherwise: str) -> str:
    """Suggest the known name nearest to a wrong name; ``otherwise`` if there is none."""
    close = get_close_matches(name, list(known), n=1)
    return f"did you mean {close[0]!r}?" if close else otherwise


def listed(names: Iterable[str]) -> str:
    """List names in a message, or "none"."""
    return ", ".join(sorted(names)) or "none"
