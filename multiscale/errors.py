"""Errors that a user can correct; a message is one sentence: problem, place, value, remedy."""

__all__ = ["CaseError", "ConvergenceError", "FileError", "MultiscaleError", "SchemaError"]


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
