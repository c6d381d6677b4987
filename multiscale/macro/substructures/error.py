r"""Error of a state of LATIN: a guaranteed bound for links, a heuristic indicator for rough joints.

With a displacement :math:`\bar u` that is continuous over the interfaces, and admissible tensions
:math:`\tau^*` in equilibrium, the duality gap, the sum of the energy of the displacement and the
complementary energy of the tensions, is for the exact tensions :math:`\tau` at least [1]_

.. math:: \tfrac12 \| \tau - \tau^* \|^2_{k^{-1}}.    \tag{1}

With tractions :math:`t^*` of joints and displacements :math:`u^*` in equilibrium with them, the
state of the law nearest to them and to the jumps :math:`\bar\jmath` of :math:`\bar u`, along the
search direction :math:`\kappa`, has the jump :math:`\hat\jmath` and the traction :math:`\hat t` of

.. math:: \hat t(\hat\jmath) + \kappa \hat\jmath = t^* + \kappa \bar\jmath,    \tag{2}

and the indicator is the root of

.. math::
    \| u^* - \bar u \|^2_K + 4 \sum_\text{points} w\, |t^* - \hat t|^2_{\kappa^{-1}}.    \tag{3}

For a linear law of stiffness :math:`\kappa` without friction, half of its square is the duality gap
of both fields, a guaranteed bound. With friction the limit of a traction depends on the solution:
there is no potential and no guarantee.

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
    displacement: np.ndarray  # in equilibrium with the balanced forces, (n,), m
    traction: np.ndarray  # of joints, balanced, (3, points), Pa

    @property
    def relative(self) -> float:
        """Error over size."""
        return self.error / self.size if self.size > 0.0 else 0.0 if self.error == 0.0 else np.inf


class ErrorEstimate:
    """Bound (1) of substructures without joints, or indicator (3), of states of LATIN."""

    def __init__(self, latin: Latin) -> None:
        self.latin, stack, rows = latin, latin.stack, latin.rows
        lent = csr_array(LENT * latin.k0.matrix[rows][:, rows])
        self.factors = Factors()  # must outlive its solves
        self.solve = self.factors(stack.matrix(stack.links.stiffness, lent))
        # substructures in which the prestress is in equilibrium
        links, start = stack.links, stack.start
        unbalanced = np.abs(links.operator.T @ links.prestress)
        worst = np.zeros(len(start) - 1)
        np.maximum.at(worst, np.repeat(np.arange(worst.size), np.diff(start)), unbalanced)
        self.self_stressed = worst <= UNBALANCED * float(np.abs(links.prestress).max(initial=0.0))
        first = links.operator.indices[links.operator.indptr[:-1]]
        self.owner_of_link = np.searchsorted(start, first, "right") - 1

    def __call__(self, iterate: LatinIterate) -> ForceError:
        """Measure a state of the linear stage."""
        # gaps and residual forces are distributed equally over the sides
        latin, stack, mean = self.latin, self.latin.stack, self.latin.sides.mean
        balanced = iterate.force - mean(iterate.force)
        change = self.solve(stack.trace.T @ (balanced - iterate.force)[latin.rows])
        moved = latin.team.concatenate(stack.trace @ iterate.u)
        step = np.where(latin.sides.perfect, mean(moved) - moved, 0.0)
        continuous = iterate.u + stack.trace.T @ step[latin.rows]
        moved = latin.team.concatenate(stack.trace @ continuous)
        # energies of bodies and links
        solid, K = iterate.u + change, stack.stiffness
        apart = continuous - solid
        tension = iterate.tension + stack.links.stiffness * (stack.links.operator @ change)
        gap, stored, possible = self._of_links(tension, continuous)
        sums = [apart @ (K @ apart) + 2.0 * gap, solid @ (K @ solid) + stored, not possible]
        error, size, impossible = latin.team.total(np.array(sums, dtype=float))
        error, size = np.maximum((error, size), 0.0)  # rounding may make them negative
        # distance of the tractions from the laws
        (first, second), weight = latin.sides.joints, latin.weight
        traction = balanced[first] / weight
        k1, k2 = 1.0 / latin.compliance
        kappa = k1 * k2 / (k1 + k2) / weight
        source = traction + kappa * (moved[second] - moved[first] - latin.state.slid)  # (2)
        on_law = source - kappa * latin.law.resolvent(source, kappa, latin.state.history)
        error += 4.0 * np.sum(weight * (traction - on_law) ** 2 / kappa)  # (3)
        size += np.sum(weight * traction**2 / kappa)
        error = np.inf if impossible else np.sqrt(error)
        return ForceError(float(error), float(np.sqrt(size)), solid, traction)

    def _of_links(self, tension: np.ndarray, u: np.ndarray) -> tuple[float, float, bool]:
        """Duality gap and energy of links, J, and whether tensions can be admissible."""
        links = self.latin.stack.links
        t0, k = links.prestress, links.stiffness
        statical, possible = self._add_prestress(tension)
        e = links.operator @ u
        kinematic = np.clip(t0 + k * e, links.lower, links.upper)
        apart = statical - kinematic
        # Fenchel's inequality for each link: a sum of two terms that are never negative
        gap = apart**2 / (2.0 * k) + apart * ((kinematic - t0) / k - e)
        return float(gap.sum()), float(np.sum((statical - t0) ** 2 / k)), possible

    def _add_prestress(self, tension: np.ndarray) -> tuple[np.ndarray, bool]:
        """Add the least prestress by which every link is within its limits, if that is possible."""
        links = self.latin.stack.links
        low, high = tension < links.lower, tension > links.upper
        limit = np.where(low, links.lower, np.where(high, links.upper, tension))
        with np.errstate(divide="ignore", invalid="ignore"):
            short = np.where(low | high, (limit - tension) / links.prestress, 0.0)
        helps = np.isfinite(short) & (short > 0.0) & self.self_stressed[self.owner_of_link]
        wrong = low | high
        if np.any(wrong & ~helps):
            return tension, False
        need = np.zeros(self.self_stressed.size)
        np.maximum.at(need, self.owner_of_link[wrong], short[wrong])
        return tension + need[self.owner_of_link] * links.prestress, True
