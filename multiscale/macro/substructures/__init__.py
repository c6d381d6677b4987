"""Substructures and interfaces, and the solvers for them: LATIN and Newton-Schur."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
