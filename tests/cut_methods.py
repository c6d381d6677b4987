"""Newton-Schur as a function, next to ``solve_latin``."""

from multiscale.macro import NewtonSchur


def solve_schur(problem, load_factor=1.0, **options):
    """Solve a cut problem by Newton-Schur with options of the method."""
    return NewtonSchur(**options).solve(problem, load_factor)
