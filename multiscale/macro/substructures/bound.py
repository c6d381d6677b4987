r"""Guaranteed bound on the error of the tensions, from admissible fields.

With a displacement :math:`\bar u` that is continuous over the interfaces, and tensions
:math:`\tau^*` that are in equilibrium and nowhere forbidden, the sum of the energy of one and the
complementary energy of the other, the duality gap, is at least

.. math:: \tfrac12 \| \tau - \tau^* \|^2_{k^{-1}}    \tag{1}

for the exact tensions :math:`\tau` [1]_.

References
----------
.. [1] P. Ladevèze, J.-P. Pelle, Mastering calculations in linear and nonlinear mechanics,
   Springer, 2005, doi:10.1007/b138705.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from multiscale.macro.substructures.parallel import ProcessGroup
from multiscale.macro.substructures.stack import Factors, Sides, Stack

__all__ = ["Admissible", "ErrorBound", "Fields", "ForceError"]

HELD = 1e-10
"""Stiffness that stands for the neighbours where only forces are given, relative to it."""

UNBALANCED = 1e-9
"""Force out of balance, relative to the largest tension, up to which a prestress holds itself."""


@dataclass(frozen=True)
class ForceError:
    """Error of forces in J^1/2, and the size of their change in the same norm.

    Attributes
    ----------
    error : float, root of twice the duality gap, or of what stands for it
    size : float, norm of the admissible tensions and tractions less the prestress
    """

    error: float
    size: float

    @property
    def relative(self) -> float:
        """Error over size."""
        return self.error / self.size if self.size > 0.0 else 0.0 if self.error == 0.0 else np.inf


@dataclass(frozen=True, eq=False)
class Fields:
    """What a state of the linear stage is changed to.

    Attributes
    ----------
    continuous : ndarray, shape (n,), displacement, alike on all sides of perfect interfaces, m
    balanced : ndarray, shape (m,), forces on all sides that balance on every interface, N
    change : ndarray, shape (n,)
        Displacement whose tensions and stresses bring the substructures into equilibrium with
        them, m.
    """

    continuous: np.ndarray
    balanced: np.ndarray
    change: np.ndarray


class Admissible:
    """Make states of the linear stage, whose coarse forces are balanced, admissible."""

    def __init__(self, stack: Stack, sides: Sides, side_stiffness: csr_array, own: slice) -> None:
        self.stack, self.sides, self.own = stack, sides, own
        tiny = csr_array(HELD * side_stiffness[own][:, own])
        self.factors = Factors()  # its solves live as long as they do
        self.solve = self.factors(stack.matrix(stack.links.stiffness, tiny))
        self.perfect = sides.perfect[own]

    def __call__(self, u: np.ndarray, force: np.ndarray, team: ProcessGroup) -> Fields:
        """Share out what is out of balance, and what does not fit, equally between the sides."""
        trace = self.stack.trace
        balanced = force - self.sides.mean(force)
        change = self.solve(trace.T @ (balanced - force)[self.own])
        moved = team.concatenate(trace @ u)
        step = (self.sides.mean(moved) - moved)[self.own]
        continuous = u + trace.T @ np.where(self.perfect, step, 0.0)
        return Fields(continuous, balanced, change)


class ErrorBound:
    """Bound on the error of a stack of substructures without joints.

    The prestress of a substructure that holds itself may be added to tensions in equilibrium:
    with just enough of it no cable is pushed. Without prestress there is no bound.
    """

    def __init__(self, stack: Stack, admissible: Admissible) -> None:
        self.stack, self.admissible = stack, admissible
        links = stack.links
        unbalanced = np.abs(links.operator.T @ links.prestress)
        scale = float(np.abs(links.prestress).max(initial=0.0))
        parts = np.repeat(np.arange(len(stack.start) - 1), np.diff(stack.start))
        worst = np.zeros(len(stack.start) - 1)
        np.maximum.at(worst, parts, unbalanced)
        self.self_stressed = worst <= UNBALANCED * scale
        first = links.operator.indices[links.operator.indptr[:-1]]
        self.part_of_link = np.searchsorted(stack.start, first, "right") - 1

    def evaluate(
        self, u: np.ndarray, tension: np.ndarray, force: np.ndarray, team: ProcessGroup
    ) -> ForceError:
        """Measure a state of the linear stage, whose coarse forces are balanced."""
        stack, links = self.stack, self.stack.links
        fields = self.admissible(u, force, team)
        continuous, change = fields.continuous, fields.change
        statical = tension + links.stiffness * (links.operator @ change)
        statical, possible = self._pull(statical)

        e = links.operator @ continuous
        kinematic = np.clip(links.prestress + links.stiffness * e, links.lower, links.upper)
        t0, k = links.prestress, links.stiffness
        apart = statical - kinematic
        # Fenchel's inequality, link by link; of two terms that are never negative
        gap = apart**2 / (2.0 * k) + apart * ((kinematic - t0) / k - e)
        difference, solid = continuous - (u + change), u + change
        sums = np.array(
            [
                float(gap.sum()) + 0.5 * float(difference @ (stack.stiffness @ difference)),
                float(np.sum((statical - t0) ** 2 / k)) + float(solid @ (stack.stiffness @ solid)),
                0.0 if possible else 1.0,
            ]
        )
        total, size, impossible = team.total(sums)
        error = np.inf if impossible else np.sqrt(2.0 * max(total, 0.0))
        return ForceError(float(error), float(np.sqrt(size)))

    def _pull(self, tension: np.ndarray) -> tuple[np.ndarray, bool]:
        """Add so much of the prestress that every link is within its limits."""
        links = self.stack.links
        with np.errstate(divide="ignore", invalid="ignore"):
            short = np.where(tension < links.lower, (links.lower - tension) / links.prestress, 0.0)
            short = np.where(
                tension > links.upper, (links.upper - tension) / links.prestress, short
            )
        wrong = (tension < links.lower) | (tension > links.upper)
        helps = np.isfinite(short) & (short > 0.0) & self.self_stressed[self.part_of_link]
        if np.any(wrong & ~helps):
            return tension, False
        need = np.zeros(len(self.stack.start) - 1)
        np.maximum.at(need, self.part_of_link[wrong], short[wrong])
        return tension + need[self.part_of_link] * links.prestress, True
