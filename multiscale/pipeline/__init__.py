"""What needs more than one layer: cases of every kind and their run.

The module of a name is imported when the name is first used, as of :mod:`multiscale`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
