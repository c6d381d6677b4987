r"""Heuristic indicator of the error of bodies with rough joints, with or without friction.

A displacement :math:`\bar u` that is continuous over the perfect interfaces has jumps
:math:`\bar\jmath`; forces that balance are tractions :math:`t^*` and displacements :math:`u^*` in
equilibrium with them. What is nearest to both on the law, along the search direction
:math:`\kappa`, has the traction :math:`\hat t` with

.. math:: \hat t(\hat\jmath) + \kappa \hat\jmath = t^* + \kappa \bar\jmath,    \tag{1}

and the indicator is the root of

.. math::
    \| u^* - \bar u \|^2_K + 4 \sum_\text{points} w\, |t^* - \hat t|^2_{\kappa^{-1}}.    \tag{2}

For a linear law without friction, whose stiffness is :math:`\kappa`, half of its square is the
duality gap of both fields, which is a bound. With friction the limit of a traction depends on the
solution: there is no potential and no guarantee, and how far (2) may be trusted was measured.

References
----------
.. [1] P. Ladevèze, J.-P. Pelle, Mastering calculations in linear and nonlinear mechanics,
   Springer, 2005, doi:10.1007/b138705, on errors in the constitutive relation.
"""

from dataclasses import dataclass

import numpy as np

from multiscale.macro.substructures.bound import Admissible, ForceError
from multiscale.macro.substructures.latin import Latin, LatinIterate

__all__ = ["JointError", "indicate_error"]


@dataclass(frozen=True, eq=False)
class JointError:
    """Admissible fields and their distance.

    Attributes
    ----------
    estimate : ForceError, eq (2), heuristic
    stressed : ndarray, shape (n,), displacement :math:`u^*` of the bodies of this process, m
    traction : ndarray, shape (3, points), :math:`t^*` of all joints, Pa
    """

    estimate: ForceError
    stressed: np.ndarray
    traction: np.ndarray


def indicate_error(method: Latin, admissible: Admissible, found: LatinIterate) -> JointError:
    """Evaluate (2) for a state of the linear stage, whose coarse forces are balanced."""
    K, trace, team = admissible.stack.stiffness, admissible.stack.trace, method.team
    fields = admissible(found.u, found.force, team)
    moved = team.concatenate(trace @ fields.continuous)
    stressed = found.u + fields.change
    apart = stressed - fields.continuous
    bodies = team.total(np.array([apart @ (K @ apart), stressed @ (K @ stressed)]))
    error, size = (max(float(one), 0.0) for one in bodies)  # rounding may leave less
    (first, second), weight = method.sides.joints, method.weight
    traction = fields.balanced[first] / weight
    k1, k2 = (method.k0.matrix.diagonal()[side] for side in method.sides.joints)
    kappa = k1 * k2 / (k1 + k2) / weight
    jump = moved[second] - moved[first] - method.state.slid
    source = traction + kappa * jump  # (1)
    on_law = source - kappa * method.law.resolvent(source, kappa, method.state.history)
    error += 4.0 * float(np.sum(weight * (traction - on_law) ** 2 / kappa))  # (2)
    size += float(np.sum(weight * traction**2 / kappa))
    return JointError(ForceError(float(np.sqrt(error)), float(np.sqrt(size))), stressed, traction)
