"""Rough contact at the micro scale, condensed into laws for large non-smooth structures.

The names that most scripts use can be imported from here, such as ``multiscale.solve_cell``. The
module of a name, with its heavy libraries, is imported when the name is first used.
"""

import os
import sys

__version__ = "0.1.0"
__citation__ = (
    f"The multiscale developers, multiscale {__version__}: rough contact at the micro scale, "
    f"condensed into laws for large non-smooth structures"
)

_NAMES = {
    "surfaces": ("Surface", "self_affine"),
    "io": ("open_law", "open_response", "open_run", "read_surface", "save_law"),
    "micro": ("Cell", "Path", "run_ensemble", "solve_cell"),
    "micro.damage": ("max_damage", "plane_damage", "two_scale_fatigue"),
    "upscaling": ("error_budget", "fit_law", "law_from_dataset"),
    "nonsmooth": ("solve_friction", "solve_lcp", "verify_friction", "verify_lcp"),
    "macro": ("rough_joint", "simulate", "solve_latin", "solve_static", "tensegrity_grid"),
    "pipeline": ("load_case", "run"),
}
_MODULE = {name: module for module, names in _NAMES.items() for name in names}

# TBB, the first choice of numba, can block for minutes after a fork, and starts short loops six
# times slower than OpenMP
os.environ.setdefault("NUMBA_THREADING_LAYER_PRIORITY", "omp tbb workqueue")
# idle threads spin for about a millisecond instead of ten: with ten, two processes on the same
# cores take eight times as long as one
if "OMP_WAIT_POLICY" not in os.environ:
    os.environ.setdefault("GOMP_SPINCOUNT", "20000")
if "numba" in sys.modules:  # numba has read its settings already
    sys.modules["numba"].config.reload_config()


def __getattr__(name: str) -> object:
    """Import a name of the package from its module when it is first used."""
    from importlib import import_module

    if name not in _MODULE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = getattr(import_module(f"{__name__}.{_MODULE[name]}"), name)
    return globals()[name]


def __dir__() -> list[str]:
    """List the names that scripts use."""
    return sorted(["__citation__", "__version__", *_MODULE])
