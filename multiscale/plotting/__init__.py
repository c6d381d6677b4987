"""One function per figure: it takes a dataset and axes, returns the axes, and saves nothing.

Every function draws on ``ax``, the current axes if not given, and returns these axes.

Only here quantities get labels and are converted to µm, MPa and kN. Functions whose names begin
with ``draw`` make whole figures and write them.
"""

from multiscale.lazy_names import lazy_names

__getattr__, __dir__ = lazy_names(__name__, __file__)
