"""The dual quadratic program in the tensions, solved by a conic solver."""

import numpy as np
from scipy.sparse import csc_array, diags_array, vstack

from multiscale.convergence import Solution, Status
from multiscale.macro.discrete.compatibility import LinkEquations
from multiscale.macro.discrete.link_state import LinkState, force_scale
from multiscale.nonsmooth.jamming import solve_conic

__all__ = ["solve_dual_program"]

LEAST_TOLERANCE = 1e-7
"""Forces out of balance that the answers of clarabel may leave, relative to the largest load."""

TOLERANCES = (1e-13, 1e-12, 1e-11, 1e-10)
"""Tolerances of gap and feasibility for clarabel on scaled data, tried in turn until one is met."""


def solve_dual_program(model: LinkEquations, load_factor: float, *, tolerance: float) -> LinkState:
    r"""Find the tensions of least complementary energy in equilibrium with the load.

    .. math::
        \min_\tau \sum \frac{(\tau - \tau^0)^2}{2 k}, \qquad
        B^T \tau = \alpha F^d, \quad \tau^- \le \tau \le \tau^+.    \tag{1}

    The multipliers of the equilibrium are the displacement, with the opposite sign. Links of
    fixed length have no term.

    References
    ----------
    .. [1] P. J. Goulart and Y. Chen, Clarabel: An interior-point solver for conic programs with
       quadratic objectives, 2024, arXiv:2405.12762.
    """
    rows, load = len(model.unknown), load_factor * model.load
    scale = float(np.abs(load).max(initial=0.0)) + float(np.abs(model.prestress).max()) or 1.0
    finite = np.isfinite(model.stiffness)
    unit = float(np.median(model.stiffness[finite])) if finite.any() else 1.0
    give = unit / model.stiffness
    rope, prop = np.isfinite(model.lower), np.isfinite(model.upper)
    identity = csc_array(diags_array(np.ones(rows)))
    constraints = vstack([csc_array(model.operator.T), -identity[rope], identity[prop]])
    bounds = np.concatenate([load, -model.lower[rope], model.upper[prop]]) / scale
    for wanted in TOLERANCES:
        answer = solve_conic(
            diags_array(give),
            -give * model.prestress / scale,
            constraints,
            bounds,
            zero=model.n,
            positive=bounds.size - model.n,
            tolerance=wanted,
        )
        status = str(answer.status)
        if status in ("Solved", "PrimalInfeasible"):
            break
    tension = np.clip(scale * np.array(answer.x), model.lower, model.upper)
    u = -scale / unit * np.array(answer.z)[: model.n]
    unbalanced = model.gather(tension) - load
    residual = float(np.abs(unbalanced).max(initial=0.0)) / force_scale(model, load)
    misfit = np.abs((tension - model.prestress) / model.stiffness - model.elongate(u))
    # tension or slack is zero: the smaller of the two is rounding
    typical = 1.0 / unit if finite.any() else 0.0
    slack = np.where((rope | prop) & (misfit > typical * np.abs(tension)), misfit, 0.0)
    detail = ""
    if status == "PrimalInfeasible":
        why = Status.INFEASIBLE
    elif not np.isfinite(residual):
        why = Status.NOT_FINITE
    elif status == "Solved" and residual <= max(tolerance, LEAST_TOLERANCE):
        why = Status.CONVERGED
    else:
        why, detail = Status.STALLED, f"status of clarabel: {status}"
    return LinkState(Solution(u, why, (residual,), detail=detail), tension, slack)
