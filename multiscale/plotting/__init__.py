"""Figures: each function takes a dataset and axes, draws on the axes and returns them.

Every function draws on ``ax``, by default the current axes, and saves nothing.

Quantities get labels and are converted to µm, MPa and kN only here. Functions with names that begin
with ``draw`` make whole figures and write them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
