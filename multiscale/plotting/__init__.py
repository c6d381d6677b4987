"""One function per figure: it takes a dataset and axes, returns the axes, and saves nothing.

Every function draws on ``ax``, the current axes if not given, and returns these axes.

Only here quantities get labels and are converted to µm, MPa and kN. Functions whose names begin
with ``draw`` make whole figures and write them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
