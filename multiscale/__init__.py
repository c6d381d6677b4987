"""Rough contact at the micro scale, condensed into laws for large non-smooth structures."""

import os
import sys

__version__ = "0.1.0"

# TBB, which numba would take first, can wait for minutes where a process that has it forks, and
# starts short loops six times slower than OpenMP
os.environ.setdefault("NUMBA_THREADING_LAYER_PRIORITY", "omp tbb workqueue")
if "numba" in sys.modules:  # it has read its settings
    sys.modules["numba"].config.reload_config()
