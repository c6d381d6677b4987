"""The dual quadratic program in the tensions, solved by a conic solver."""

import numpy as np
from scipy.sparse import csc_array, diags_array, vstack

from multiscale.convergence import Solution, Status
from multiscale.macro.discrete.compatibility import LinkEquations
from multiscale.macro.discrete.link_state import force_scale
from multiscale.nonsmooth.conic import solve_conic

__all__ = ["solve_dual_program"]

TOLERANCES = (1e-13, 1e-12, 1e-11, 1e-10)
"""Tolerances of gap and feasibility for clarabel on scaled data, tried in turn until one is met."""


def solve_dual_program(
    model: LinkEquations, load_factor: float, *, tolerance: float = 1e-8
) -> Solution:
    r"""Find the tensions of least complementary energy in equilibrium with the load.

    .. math::
        \min_\tau \sum \frac{(\tau - \tau^0)^2}{2 k}, \qquad
        B^T \tau = \alpha F^d, \quad \tau^- \le \tau \le \tau^+.    \tag{1}

    The multipliers of the equilibrium are the displacement, with the opposite sign. Links of
    fixed length have no term.

    Parameters
    ----------
    load_factor : float, :math:`\alpha`, dimensionless
    tolerance : float
        Bound on the forces out of balance relative to the largest nodal load; dimensionless.

    Returns
    -------
    Solution, ``value`` are tensions and displacement, shape (rows + n,), N and m

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
    value = np.concatenate([tension, u])
    if status == "PrimalInfeasible":
        return Solution(value, Status.INFEASIBLE, (residual,))
    if not np.isfinite(residual):
        return Solution(value, Status.NOT_FINITE, (residual,))
    if status == "Solved" and residual <= tolerance:
        return Solution(value, Status.CONVERGED, (residual,))
    return Solution(value, Status.STALLED, (residual,), detail=f"status of clarabel: {status}")
