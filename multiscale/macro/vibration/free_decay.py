r"""Free decay of a small structure in time, which modes at rest and Masing's rule have no part in.

With the change v of the displacement since rest, the middle m of a step h solves

.. math::
    \frac{4}{h^2} M \left( v_m - v - \frac{h}{2} \dot v \right) + K v_m + B^T w\, \Delta t(B v_m)
    = 0, \qquad
    v^+ = 2 v_m - v, \qquad \dot v^+ = \frac{4}{h} (v_m - v) - \dot v,    \tag{1}

the steps of :func:`multiscale.macro.simulate` with :math:`\theta = \tfrac12`, whose links have an
energy; the tractions of joints have none, and follow the law from middle to middle.
"""

import numpy as np
from scipy.sparse import csr_array

from multiscale.errors import ConvergenceError
from multiscale.macro.substructures.bolted_path import lock_bolts
from multiscale.macro.substructures.whole_structure import Assembled, assemble
from multiscale.macro.vibration.backbone import TOLERANCE, TractionChange
from multiscale.macro.vibration.preloaded import Preloaded

__all__ = ["free_decay"]


def free_decay(
    rest: Preloaded, mass: csr_array, velocity: np.ndarray, *, step: float, count: int
) -> np.ndarray:
    """Follow a structure that a blow sets in motion.

    Parameters
    ----------
    rest : Preloaded
    mass : csr_array, shape (whole unknowns, whole unknowns), kg
    velocity : ndarray, shape (whole unknowns,), after the blow, m/s
    step : float, of time, s
    count : int, number of steps

    Returns
    -------
    ndarray, shape (count + 1, whole unknowns), change of the displacement since rest, m

    Raises
    ------
    ConvergenceError
        If a step has no solution.
    """
    whole, inertia = assemble(lock_bolts(rest.free)), csr_array(4.0 / step**2 * mass)
    moving = Assembled(csr_array(whole.stiffness + inertia), inertia, whole.jump, whole.weight)
    law = TractionChange(rest.law, rest.law.respond(rest.jump, rest.state).traction)
    jump, state, middle = rest.jump, rest.state, np.zeros(velocity.size)
    found = np.zeros((count + 1, velocity.size))
    for k in range(count):
        ahead = found[k] + 0.5 * step * velocity
        slid, state = jump * np.array([[0.0], [1.0], [1.0]]), rest.law.from_here(state)
        opened = (whole.jump @ (ahead - middle)).reshape(jump.shape)
        solution = moving.solve(
            law, ahead, start=ahead, jump=jump - slid + opened, state=state, tolerance=TOLERANCE
        )  # (1)
        if not solution.converged:
            raise ConvergenceError(f"the decay ends at {k * step:g} s: {solution.status.value}")
        jump, state = slid + solution.jump, rest.law.sliding(solution.jump, state).state
        middle = solution.value
        found[k + 1] = 2.0 * middle - found[k]
        velocity = 4.0 / step * (middle - found[k]) - velocity
    return found
