"""Cases of every kind and their run, which use several layers of the package.

The module of a name is imported when the name is first used, as in :mod:`multiscale`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
