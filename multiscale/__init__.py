"""Rough contact at the micro scale, condensed into laws for large non-smooth structures."""

import os
import sys

__version__ = "0.1.0"

# TBB, which numba would take first, can wait for minutes where a process that has it forks, and
# starts short loops six times slower than OpenMP
os.environ.setdefault("NUMBA_THREADING_LAYER_PRIORITY", "omp tbb workqueue")
# threads that wait for work spin for about a millisecond instead of ten, with which two processes
# on the same cores take eight times as long as one
if "OMP_WAIT_POLICY" not in os.environ:
    os.environ.setdefault("GOMP_SPINCOUNT", "20000")
if "numba" in sys.modules:  # it has read its settings
    sys.modules["numba"].config.reload_config()
