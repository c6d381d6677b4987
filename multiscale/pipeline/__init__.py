"""What needs more than one layer: cases of every kind and their run.

The module of a name is imported when the name is first used, as of :mod:`multiscale`.
"""

from multiscale.lazy_names import lazy_names

__getattr__, __dir__ = lazy_names(__name__, __file__)
