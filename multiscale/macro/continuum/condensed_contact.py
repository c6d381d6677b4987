r"""A linear problem condensed onto its contact unknowns.

With one factorisation of :math:`K` and the Delassus operator :math:`W = H^t K^{-1} H`,

.. math:: u = K^{-1}(f + H r), \qquad H^t u = q + W r,    \tag{1}

so that each load step is a small dense problem in the reactions :math:`r` alone.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm
from scipy.linalg import lu_factor, lu_solve
from scipy.sparse import csr_array

from multiscale.convergence import Solution, Status
from multiscale.errors import MultiscaleError
from multiscale.fe.condensation import compliances
from multiscale.macro.continuum.contact_newton import (
    CYCLE,
    PATIENCE,
    RELAXATION,
    ROUND_OFF,
    Equilibrium,
    block_diagonal,
)
from multiscale.macro.continuum.finite_assembly import FiniteAssembly, JoinedContacts
from multiscale.macro.continuum.nodal_coulomb import LocalLaw, linearise
from multiscale.numerics.factorisation import factorise
from multiscale.numerics.newton import Limits, NewtonRun

__all__ = ["CondensedContact", "condense_contact"]


@dataclass(frozen=True)
class CondensedContact:
    """A linear contact problem in its reactions.

    Attributes
    ----------
    assembly : FiniteAssembly, the problem
    joined : JoinedContacts, its contact operator
    stiffness : csr_array, shape (unknowns, unknowns), of all bodies, N/m
    solve : callable, inverse of the stiffness of the free unknowns
    delassus : ndarray, shape (contact unknowns, contact unknowns)
        Mean jump of a node, m, for a unit reaction, Pa.
    rho : ndarray, shape (contact nodes,), stiffness of the contact law, Pa/m
    """

    assembly: FiniteAssembly
    joined: JoinedContacts
    stiffness: csr_array
    solve: Callable[[np.ndarray], np.ndarray]
    delassus: np.ndarray
    rho: np.ndarray

    def step(
        self, before: Equilibrium, time: float, limits: Limits
    ) -> tuple[Solution, Equilibrium]:
        """Solve one load step; arguments and result as of ``newton_step``."""
        load = self.assembly.load(time)
        motion = self.assembly.supported(time)
        without = self._displacement(load, motion)
        q = self._jump(before, without, time)
        support = float(norm((self.stiffness @ without)[~self.assembly.free]))
        scale = max(float(norm(load)), support)

        r = np.array(before.reaction)
        law, residual = self._linearise(r, q, scale)
        run = NewtonRun(limits, PATIENCE)
        while run.goes_on(residual):
            r = r + (0.5 if run.since_best > CYCLE else 1.0) * self._direction(law)
            law, residual = self._linearise(r, q, scale)

        force = load + self.joined.operator.T @ r.ravel()
        u = self._displacement(force, motion)
        unbalance = self.stiffness @ u - force
        if run.converged and not self._balanced(u, force, unbalance, limits.tolerance):
            run.stop(Status.STALLED)
        jump = self._jump(before, u, time)
        end = Equilibrium(time, u, r, before.state, before.couplings, jump, unbalance)
        return run.solution(u), end

    def _linearise(self, r: np.ndarray, q: np.ndarray, scale: float) -> tuple[LocalLaw, float]:
        """Contact law at a reaction, and its error relative to the forces."""
        jump = q + (self.delassus @ r.ravel()).reshape(r.shape)  # (1)
        law = linearise(r, jump, self.assembly.friction, self.rho, self.joined.kept)
        size = max(scale, float(norm(self.joined.operator.T @ r.ravel())))
        error = float(norm(law.residual * self.joined.area[:, None]))
        return law, error / size if size > 0.0 else float(error > 0.0)

    def _balanced(
        self, u: np.ndarray, force: np.ndarray, unbalance: np.ndarray, tolerance: float
    ) -> bool:
        """Whether the displacement is in equilibrium, to the tolerance or to round-off."""
        free = self.assembly.free
        terms = float(norm((abs(self.stiffness) @ np.abs(u))[free]))
        scale = max(float(norm(force)), float(norm(unbalance[~free])))
        return float(norm(unbalance[free])) <= max(tolerance * scale, ROUND_OFF * terms)

    def _displacement(self, force: np.ndarray, motion: np.ndarray) -> np.ndarray:
        """Displacement under given forces and supports, m."""
        u, free = np.zeros(force.size), self.assembly.free
        u[~free] = motion
        u[free] = self.solve((force - self.stiffness @ u)[free])
        return u

    def _jump(self, before: Equilibrium, u: np.ndarray, time: float) -> np.ndarray:
        """Gap and slip of a displacement, m."""
        motions = (before.displacement, u)
        couplings = before.couplings
        return self.assembly.jump(couplings, couplings, motions, (before.time, time))

    def _direction(self, law: LocalLaw) -> np.ndarray:
        """Newton step of the reactions, Pa; open components leave at once."""
        live = np.any(law.by_jump != 0.0, axis=2).ravel()
        residual = law.residual.ravel()
        dr = np.where(live, 0.0, -residual)
        if live.any():
            by_jump, by_reaction = (
                block_diagonal(blocks)[live] for blocks in (law.by_jump, law.by_reaction)
            )
            matrix = by_jump @ self.delassus[:, live] + by_reaction[:, live].toarray()
            known = residual[live] + by_jump @ (self.delassus @ dr) + by_reaction @ dr
            dr[live] = -lu_solve(lu_factor(matrix), known)
        return dr.reshape(law.residual.shape)


def condense_contact(assembly: FiniteAssembly, start: Equilibrium) -> CondensedContact | None:
    """Factorise the bodies and compute W; None if a body is held by its contacts alone."""
    joined = assembly.join(start.couplings, start.couplings)
    stiffness = assembly.internal(start.displacement, start.state)[1]
    free = assembly.free
    try:
        solve = factorise(csr_array(stiffness[free][:, free]), name="the stiffness of the bodies")
    except MultiscaleError:
        return None
    B = csr_array(joined.operator[:, free])
    area = np.repeat(np.where(joined.area > 0.0, joined.area, 1.0), assembly.components)
    W = compliances(solve, B)[0] / area[:, None]
    own = W.diagonal()[:: assembly.components]
    usual = float(np.median(own[own > 0.0])) if np.any(own > 0.0) else 1.0
    rho = RELAXATION / np.where(own > 0.0, own, usual)
    return CondensedContact(assembly, joined, stiffness, solve, W, rho)
