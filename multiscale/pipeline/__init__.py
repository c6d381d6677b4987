"""What needs more than one layer: cases of every kind and their run.

The module of a name is imported when the name is first used, as of :mod:`multiscale`.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from multiscale.pipeline.case import case_of_image as case_of_image
    from multiscale.pipeline.case import load_case as load_case
    from multiscale.pipeline.case_cells import make_cells as make_cells
    from multiscale.pipeline.case_needs import refuse_excess as refuse_excess
    from multiscale.pipeline.case_needs import requirements as requirements
    from multiscale.pipeline.planner import Plan as Plan
    from multiscale.pipeline.planner import plan as plan
    from multiscale.pipeline.runner import Results as Results
    from multiscale.pipeline.runner import run as run
    from multiscale.pipeline.runner import run_macro as run_macro
    from multiscale.pipeline.settings import Case as Case
    from multiscale.pipeline.stages.cells import run_micro as run_micro
    from multiscale.pipeline.sweep import Sweep as Sweep
    from multiscale.pipeline.sweep import load_sweep as load_sweep
    from multiscale.pipeline.sweep import run_sweep as run_sweep
    from multiscale.pipeline.tyre_settings import TyreCase as TyreCase

_NAMES = {
    "case": ("case_of_image", "load_case"),
    "case_cells": ("make_cells",),
    "case_needs": ("refuse_excess", "requirements"),
    "planner": ("Plan", "plan"),
    "runner": ("Results", "run", "run_macro"),
    "settings": ("Case",),
    "stages.cells": ("run_micro",),
    "sweep": ("Sweep", "load_sweep", "run_sweep"),
    "tyre_settings": ("TyreCase",),
}
_MODULE = {name: module for module, names in _NAMES.items() for name in names}
__all__ = sorted(_MODULE)
__dir__ = __all__.copy


def __getattr__(name: str) -> object:
    """Import a name from its module when it is first used."""
    if name not in _MODULE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = getattr(import_module(f"{__name__}.{_MODULE[name]}"), name)
    return globals()[name]
