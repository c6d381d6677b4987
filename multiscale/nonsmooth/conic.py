"""The conic interior-point solver clarabel as an independent oracle."""

from typing import Any

import numpy as np
from scipy.sparse import csc_array

__all__ = ["solve_conic"]

TOLERANCE = 1e-12
"""Gap and feasibility asked of clarabel, on scaled data."""


def solve_conic(
    quadratic: csc_array,
    linear: np.ndarray,
    constraints: csc_array,
    limits: np.ndarray,
    *,
    zero: int = 0,
    positive: int = 0,
    friction: int = 0,
    tolerance: float = TOLERANCE,
) -> Any:
    r"""Return clarabel's answer to a conic program.

    .. math:: \min_x \tfrac12 x^T P x + q^T x, \qquad b - A x \in \{0\} \times R_+ \times K,

    P given by its upper triangle; the first ``zero`` rows are equations, the next ``positive`` ones
    inequalities, and the rest ``friction`` second-order cones of three rows each.
    """
    import clarabel

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    cones = [clarabel.ZeroConeT(zero)] if zero else []
    cones += [clarabel.NonnegativeConeT(positive)] if positive else []
    cones += [clarabel.SecondOrderConeT(3)] * friction
    return clarabel.DefaultSolver(
        csc_array(quadratic), linear, csc_array(constraints), limits, cones, settings
    ).solve()
