r"""Error of a state of LATIN: a guaranteed bound for links, a heuristic indicator for rough joints.

With a displacement :math:`\bar u` that is continuous over the interfaces, and admissible tensions
:math:`\tau^*` in equilibrium, the duality gap is at least [1]_

.. math:: \tfrac12 \| \tau - \tau^* \|^2_{k^{-1}}.    \tag{1}

With tractions :math:`t^*` of joints, displacements :math:`u^*` in equilibrium with them, and the
nearest state of the law along the search direction :math:`\kappa`, the indicator is the root of (3)

.. math:: \hat t(\hat\jmath) + \kappa \hat\jmath = t^* + \kappa \bar\jmath,    \tag{2}

.. math::
    \| u^* - \bar u \|^2_K + 4 \sum_\text{points} w\, |t^* - \hat t|^2_{\kappa^{-1}}.    \tag{3}

.. [1] P. Ladevèze, J.-P. Pelle, Mastering calculations in linear and nonlinear mechanics,
   Springer, 2005, doi:10.1007/b138705.
"""

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from multiscale.macro.substructures.latin import Latin, LatinIterate
from multiscale.macro.substructures.stack import Factors

LENT = 1e-10
"""Stiffness lent to the sides where only forces are given, relative to the search direction."""

UNBALANCED = 1e-9
"""Residual of a self-stress, relative to the largest tension, up to which it is in equilibrium."""


class ForceError(NamedTuple):
    """Error of forces and their size in the energy norm."""

    error: float  # root of twice the duality gap, or (3), J^1/2
    size: float  # J^1/2

    @property
    def relative(self) -> float:
        """Error over size."""
        return self.error / self.size if self.size > 0.0 else 0.0 if self.error == 0.0 else np.inf


class JointError(NamedTuple):
    """Indicator (3) with displacement u*, (n,), m, and traction t*, (3, points), Pa."""

    estimate: ForceError
    stressed: np.ndarray
    traction: np.ndarray


class Admissible:
    """Projection of states of the linear stage onto admissible states."""

    def __init__(self, latin: Latin) -> None:
        self.latin, stack, rows = latin, latin.stack, latin.rows
        lent = csr_array(LENT * latin.k0.matrix[rows][:, rows])
        self.factors = Factors()  # must outlive its solves
        self.solve = self.factors(stack.matrix(stack.links.stiffness, lent))
        self.perfect = latin.sides.perfect[rows]

    def __call__(self, iterate: LatinIterate) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distribute gaps and residual forces equally over the sides."""
        latin, trace = self.latin, self.latin.stack.trace
        balanced = iterate.force - latin.sides.mean(iterate.force)
        change = self.solve(trace.T @ (balanced - iterate.force)[latin.rows])
        moved = latin.team.concatenate(trace @ iterate.u)
        step = (latin.sides.mean(moved) - moved)[latin.rows]
        return iterate.u + trace.T @ np.where(self.perfect, step, 0.0), balanced, change


class ErrorBound:
    """Bound on the error of substructures without joints."""

    def __init__(self, admissible: Admissible) -> None:
        self.admissible, self.stack = admissible, admissible.latin.stack
        links, start = self.stack.links, self.stack.start
        unbalanced = np.abs(links.operator.T @ links.prestress)
        worst = np.zeros(len(start) - 1)
        np.maximum.at(worst, np.repeat(np.arange(worst.size), np.diff(start)), unbalanced)
        self.self_stressed = worst <= UNBALANCED * float(np.abs(links.prestress).max(initial=0.0))
        first = links.operator.indices[links.operator.indptr[:-1]]
        self.owner_of_link = np.searchsorted(start, first, "right") - 1

    def __call__(self, iterate: LatinIterate) -> ForceError:
        """Measure a state of the linear stage by (1)."""
        K, links = self.stack.stiffness, self.stack.links
        continuous, _, change = self.admissible(iterate)
        t0, k = links.prestress, links.stiffness
        statical, possible = self._add_prestress(iterate.tension + k * (links.operator @ change))
        e = links.operator @ continuous
        kinematic = np.clip(t0 + k * e, links.lower, links.upper)
        apart = statical - kinematic
        # Fenchel's inequality for each link: a sum of two terms that are never negative
        gap = apart**2 / (2.0 * k) + apart * ((kinematic - t0) / k - e)
        solid = iterate.u + change
        difference = continuous - solid
        sums = [
            float(gap.sum()) + 0.5 * float(difference @ (K @ difference)),
            float(np.sum((statical - t0) ** 2 / k)) + float(solid @ (K @ solid)),
            0.0 if possible else 1.0,
        ]
        total, size, impossible = self.admissible.latin.team.total(np.array(sums))
        error = np.inf if impossible else np.sqrt(2.0 * max(total, 0.0))
        return ForceError(float(error), float(np.sqrt(size)))

    def _add_prestress(self, tension: np.ndarray) -> tuple[np.ndarray, bool]:
        """Add the least prestress by which every link is within its limits, if that is possible."""
        links = self.stack.links
        low, high = tension < links.lower, tension > links.upper
        limit = np.where(low, links.lower, np.where(high, links.upper, tension))
        with np.errstate(divide="ignore", invalid="ignore"):
            short = np.where(low | high, (limit - tension) / links.prestress, 0.0)
        helps = np.isfinite(short) & (short > 0.0) & self.self_stressed[self.owner_of_link]
        wrong = low | high
        if np.any(wrong & ~helps):
            return tension, False
        need = np.zeros(len(self.stack.start) - 1)
        np.maximum.at(need, self.owner_of_link[wrong], short[wrong])
        return tension + need[self.owner_of_link] * links.prestress, True


def indicate_error(admissible: Admissible, iterate: LatinIterate) -> JointError:
    """Evaluate (3) for a state of the linear stage."""
    # energy of the difference of both displacements
    latin = admissible.latin
    K, trace, team = latin.stack.stiffness, latin.stack.trace, latin.team
    continuous, balanced, change = admissible(iterate)
    moved, stressed = team.concatenate(trace @ continuous), iterate.u + change
    apart = stressed - continuous
    bodies = team.total(np.array([apart @ (K @ apart), stressed @ (K @ stressed)]))
    error, size = np.maximum(bodies, 0.0)  # rounding may make them negative
    # distance of the tractions from the laws
    (first, second), weight = latin.sides.joints, latin.weight
    traction = balanced[first] / weight
    k1, k2 = (latin.k0.matrix.diagonal()[side] for side in latin.sides.joints)
    kappa = k1 * k2 / (k1 + k2) / weight
    source = traction + kappa * (moved[second] - moved[first] - latin.state.slid)  # (2)
    on_law = source - kappa * latin.law.resolvent(source, kappa, latin.state.history)
    error += 4.0 * np.sum(weight * (traction - on_law) ** 2 / kappa)  # (3)
    size += np.sum(weight * traction**2 / kappa)
    return JointError(ForceError(float(np.sqrt(error)), float(np.sqrt(size))), stressed, traction)
