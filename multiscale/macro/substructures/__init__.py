"""Substructures and interfaces, and the solvers for them: LATIN and Newton-Schur."""

from multiscale.lazy_names import lazy_names

__getattr__, __dir__ = lazy_names(__name__, __file__)
