"""The errors a user can mend; each message is one sentence: what, where, found, what to do."""

__all__ = ["CaseError", "ConvergenceError", "MultiscaleError", "SchemaError"]


class MultiscaleError(Exception):
    """Base of every error whose message is written for the user."""


class CaseError(MultiscaleError):
    """A case file, an input file or a parameter is refused."""


class SchemaError(MultiscaleError):
    """A dataset does not follow its schema."""


class ConvergenceError(MultiscaleError):
    """A solver stopped without a solution."""
