"""Rough contact at the micro scale, condensed into laws for large non-smooth structures.

The names that most scripts use can be imported from here, such as ``multiscale.solve_cell``. The
module of a name, with its heavy libraries, is imported when the name is first used.
"""

import lazy_loader

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
    "macro": ("press_joint", "simulate", "solve_latin", "solve_static", "tensegrity_grid"),
    "pipeline": ("load_case", "run"),
}
__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, submod_attrs=_NAMES)
