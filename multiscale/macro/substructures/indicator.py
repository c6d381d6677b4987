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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from multiscale.macro.substructures.bound import Admissible, ForceError
from multiscale.macro.substructures.parallel import ProcessGroup
from multiscale.macro.substructures.problem import CutProblem

__all__ = ["HeuristicIndicator", "JointError"]


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


class HeuristicIndicator:
    """Evaluate (2) for states of the linear stage, whose coarse forces are balanced."""

    def __init__(self, problem: CutProblem, admissible: Admissible) -> None:
        self.problem, self.admissible = problem, admissible

    def evaluate(
        self,
        u: np.ndarray,
        force: np.ndarray,
        states: Sequence[np.ndarray],
        directions: Mapping[int, tuple[np.ndarray, ...]],
        team: ProcessGroup,
    ) -> JointError:
        """Measure a state.

        Parameters
        ----------
        u : ndarray, shape (n,), displacement of the substructures of this process, m
        force : ndarray, shape (m,), on all sides, N
        states : sequence of ndarray, last committed state of the law of every interface
        directions : mapping of int to tuple of ndarray
            Search directions of both sides of the joints, N/m.
        team : ProcessGroup
        """
        K, trace = self.admissible.stack.stiffness, self.admissible.stack.trace
        fields = self.admissible(u, force, team)
        moved = team.concatenate(trace @ fields.continuous)
        stressed = u + fields.change
        apart = stressed - fields.continuous
        bodies = team.total(np.array([apart @ (K @ apart), stressed @ (K @ stressed)]))
        error, size = (max(float(one), 0.0) for one in bodies)  # rounding may leave less
        tractions = [np.zeros((3, 0))]
        for index, face in enumerate(self.problem.interfaces):
            if face.law is None:
                continue
            first, second = self.admissible.sides.place[index]
            jump = (moved[second] - moved[first]).reshape(3, -1)
            traction = fields.balanced[first].reshape(3, -1) / face.weight
            k = directions[index]
            kappa = (k[0] * k[1] / (k[0] + k[1])).reshape(3, -1) / face.weight
            source = traction + kappa * jump  # (1)
            on_law = source - kappa * face.law.resolvent(source, kappa, states[index])
            error += 4.0 * float(np.sum(face.weight * (traction - on_law) ** 2 / kappa))  # (2)
            size += float(np.sum(face.weight * traction**2 / kappa))
            tractions.append(traction)
        estimate = ForceError(float(np.sqrt(error)), float(np.sqrt(size)))
        return JointError(estimate, stressed, np.concatenate(tractions, axis=1))
